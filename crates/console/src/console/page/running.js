// During and after a capture: lights, last frame, progress, and the ways to stop.

import { by, facts, gate, h, panel, redraw, say } from "./dom.js";
import { bytes, degrees, digits, direction, drift, exposure, span } from "./format.js";
import { attempt, blocked, capturing } from "./header.js";
import { hemisphere } from "./hemisphere.js";
import { histogram } from "./histogram.js";
import { announce, capital } from "./notices.js";
import { picture } from "./picture.js";
import { surroundings } from "./reach.js";
import { areOn, typing } from "./shortcuts.js";
import { link, secondsSince, state, watch } from "./stream.js";
import { badge } from "./verdict.js";

const PICTURE_MS = 500;
const STATES = {
  preparing: "Preparing",
  homing: "Homing the stage",
  moving: "Moving the lamp",
  exposing: "Exposing",
  choosing: "Choosing the next light by a quick fit, lamp off",
  merging: "Merging the frames",
  paused: "Paused, lamp off",
  fitting: "Fitting the BRDF",
  ending: "Ending",
  complete: "Complete",
  interrupted: "Interrupted; everything captured is kept",
  failed: "Failed",
};
const ENDED = ["complete", "interrupted", "failed"];
/** What a frame is taken for. */
const KINDS = { light: "lamp on", ambient: "lamp off", dark: "dark frame", bias: "bias frame", flat: "flat field" };
const LIGHT_STATES = { "to-come": "to come", now: "now", done: "done" };

/** The name of a session's folder. */
export function sessionName(path) {
  return (path ?? "").replace(/\/+$/, "").split("/").pop();
}

/** Two buttons that resume the capture of the session of this name, with its fit and without; each does `then`. */
export function resumeButtons(id, name, then = () => {}) {
  const resume = (label, fit, about) =>
    h("button", { type: "button", ...about, onclick: async () => (await attempt("api/capture/resume", { session: name(), fit })) && then() }, label);
  return [resume("Resume, then fit", true, { id, class: "primary" }), resume("Resume without a fit", false, { id: `${id}-only` })];
}

/** The part of the view; `onleave` when the operator wants the next capture. */
export function runningPart(onleave) {
  const heading = progressPanel(onleave);
  const hands = handsPanel();
  const frame = framePanel();
  const lights = lightsPanel();
  const warnings = warningsPanel();
  const element = h("div", { class: "stack during" }, hands.element, heading.element, h("div", { class: "two" }, h("div", { class: "stack" }, frame.element), h("div", { class: "stack" }, lights.element, warnings.element)));
  const parts = [heading, hands, frame, lights, warnings];
  const show = () => {
    for (const part of parts) part.show(state.capture, state.job);
  };
  watch(["capture", "job", "control", "console", "link"], show);
  setInterval(() => {
    heading.tick(state.capture);
    frame.tick(state.capture);
  }, 1000);
  return {
    element,
    look(on) {
      frame.look(on);
      show();
    },
  };
}

function progressPanel(onleave) {
  const title = h("h3", { class: "headline" });
  const doing = h("p", { class: "doing", role: "status" });
  const verdict = h("p");
  const bar = h("progress", { max: "1", "aria-label": "Progress of the capture" });
  const share = h("span", { class: "share" });
  const list = h("dl", { class: "facts across" });
  const why = h("p", { class: "why" });
  const command = (label, address, about = {}) => h("button", { type: "button", ...about, onclick: () => attempt(`api/capture/${address}`) }, label);
  const pause = command("Pause", "pause", { id: "pause", title: "Lamp off, stage standing, until continued" });
  const goOn = command("Continue", "continue", { id: "continue", class: "primary" });
  const finish = command("Stop after this frame", "finish", { id: "finish", title: "Keeps what is captured; it can be resumed" });
  const halt = command("STOP now", "stop", { id: "stop-now", class: "danger", title: "Ends motion, light and capture at once; it can be resumed" });
  const resumes = resumeButtons("resume", () => sessionName(state.capture?.session));
  const open = h("a", { class: "button primary", id: "open-session" }, "Open the session");
  const next = h("button", { type: "button", id: "next", onclick: onleave }, "New capture");
  const error = h("p", { class: "error", role: "alert" });
  const element = h("section", { class: "panel" }, title, doing, verdict, h("div", { class: "progress-row" }, bar, share), list, h("div", { class: "row" }, pause, goOn, finish, halt, ...resumes, open, next), why, error);

  let lastState = null;
  function show(capture, job) {
    const running = capturing();
    const name = sessionName(capture?.session);
    const paused = running && (job.state === "paused" || capture?.state === "paused");
    const fitting = capture?.state === "fitting";
    say(title, capture?.sample || name || "Capture");
    // A fit may follow what the capture calls its end.
    const phase = paused ? "paused" : running && ENDED.includes(capture?.state) ? "ending" : (capture?.state ?? "preparing");
    const stage = capture?.fit_stage ?? job?.progress?.stage;
    const fit = fitting && stage ? `: ${stage}` : "";
    verdict.hidden = !(ENDED.includes(phase) && capture?.verdict);
    redraw(verdict, capture?.verdict ?? null, () => (capture?.verdict ? [badge({ verdict: capture.verdict })] : []));
    say(doing, job?.state === "ending" && running ? "Stopping after this frame" : `${STATES[phase] ?? capital(phase)}${fit}`);
    doing.dataset.state = phase;
    if (lastState !== null && lastState !== phase && [...ENDED, "paused", "fitting"].includes(phase)) announce(STATES[phase]);
    lastState = phase;
    const done = fitting ? (job?.progress?.done ?? null) : capture?.state === "complete" ? 1 : (capture?.done ?? 0);
    if (Number.isFinite(done)) bar.value = done;
    else bar.removeAttribute("value");
    say(share, Number.isFinite(done) ? `${Math.floor(100 * done)}%` : "");
    const ended = !running;
    const focused = document.activeElement;
    for (const control of [pause, goOn, finish, halt]) control.hidden = ended;
    pause.hidden ||= paused;
    goOn.hidden ||= !paused;
    for (const resume of resumes) resume.hidden = !(ended && capture && ["interrupted", "failed"].includes(capture.state) && name);
    open.hidden = !(ended && name);
    next.hidden = !ended;
    // Whoever pressed a button that is gone stands on the next one.
    const buttons = [pause, goOn, finish, halt, open, ...resumes, next];
    if (buttons.includes(focused) && focused.hidden) buttons.find((button) => !button.hidden)?.focus();
    if (name) open.setAttribute("href", `#sessions/${encodeURIComponent(name)}`);
    const reason = blocked();
    gate(pause, reason ?? (job?.state === "ending" ? "The capture is ending." : null));
    gate(goOn, reason);
    gate(finish, reason ?? (job?.state === "ending" ? "The capture is ending." : null));
    for (const resume of resumes) gate(resume, reason);
    say(why, reason ? `${reason} STOP works from every page.` : "");
    const failed = ended && (capture?.state === "failed" || (job?.kind === "capture" && job.state === "failed"));
    say(error, failed ? capital(capture?.error ?? (job?.log ?? []).slice(-3).join(" · ")) : "");
    tick(capture);
  }

  function tick(capture) {
    const left = Number.isFinite(capture?.left_s) && capture.left_at && capture.state !== "paused" ? capture.left_s - secondsSince(capture.left_at) : capture?.left_s;
    const running = capturing();
    const lights = capture?.lights ?? [];
    facts(list, [
      ["Time left", running && Number.isFinite(left) && capture.state !== "fitting" ? (left > 0 ? span(left) : "a moment") : null],
      ["Lights", lights.length ? `${lights.filter((light) => light.state === "done").length} of ${lights.length} done` : null],
      ["Last decision", capture?.decision ? capital(capture.decision) : null],
      ["Drift over the session", Number.isFinite(capture?.drift_percent) ? drift(capture.drift_percent, capture.drift_u_percent ?? NaN) : null],
      ["Disk free", Number.isFinite(capture?.disk_free_bytes) ? bytes(capture.disk_free_bytes) : null],
      ["Session", sessionName(capture?.session) || null],
    ]);
  }
  return { element, show, tick };
}

/** What the person at a manual stage is asked to do: confirmed by the button or the space bar. */
function handsPanel() {
  const what = h("p", { class: "big", role: "status" });
  const map = hemisphere("Where to hold the lamp");
  const answer = (done) => () => {
    const number = state.job?.asked?.number;
    if (number !== undefined) attempt("api/capture/answer", { number, done });
  };
  const done = h("button", { type: "button", class: "primary", id: "hand-done", title: "Also by the space bar", onclick: answer(true) }, "Done");
  const not = h("button", { type: "button", id: "hand-not", title: "Suspends the capture; it can be resumed", onclick: answer(false) }, "Not possible");
  const element = panel("Your turn", { hidden: true, id: "hands" }, h("div", { class: "two" }, h("div", { class: "stack-form" }, what, h("div", { class: "row" }, done, not), h("p", { class: "fine" }, "The space bar is “Done”.")), map.element));
  document.addEventListener("keydown", (event) => {
    if (event.key !== " " || event.repeat || event.ctrlKey || event.altKey || event.metaKey || !element.checkVisibility() || done.disabled || !areOn()) return;
    // A control that has the focus takes the key itself.
    if (typing(event.target) || event.target.closest?.("button, a, summary")) return;
    event.preventDefault();
    done.click();
  });
  let placed = null;
  function show(_, job) {
    const asked = job?.asked ?? null;
    const focused = element.contains(document.activeElement);
    element.hidden = asked === null || !capturing();
    if (element.hidden && focused) by("capture-title").focus({ preventScroll: true });
    if (element.hidden) return;
    if (asked.do === "place") placed = asked;
    const channels = state.console?.rig?.channels ?? [];
    say(what, { place: () => `Hold the lamp at ${direction(asked.azimuth_deg, asked.elevation_deg)}`, "lamp-on": () => `Switch the lamp on${channels.length > 1 ? `: ${channels[asked.channel]} alone` : ""}`, "lamp-off": () => "Switch the lamp off" }[asked.do]?.() ?? asked.do);
    map.show({ ...surroundings(), position: placed, target: asked.do === "place" ? asked : null, lamp: asked.do === "lamp-on" });
    const reason = blocked();
    gate(done, reason);
    gate(not, reason);
  }
  return { element, show };
}

function framePanel() {
  const view = picture("Last frame of the capture", (n) => `api/frame.jpg?n=${n}`, PICTURE_MS);
  const empty = h("p", { class: "empty" }, "No frame yet.");
  const sheet = h("div", { class: "picture", role: "group", "aria-label": "Last frame" }, h("div", { class: "sheet" }, view.element), empty);
  const ageLine = h("p", { class: "age" });
  const list = h("dl", { class: "facts" });
  const steps = h("p", { class: "bracket" });
  const counts = histogram("Histogram of the last frame");
  const element = panel("Last frame", {}, sheet, ageLine, list, counts.element, h("h4", {}, "Bracket of this light"), steps);
  let number = null;

  function show(capture) {
    const frame = capture?.frame ?? null;
    if (!frame) {
      view.clear();
      number = null;
    } else if (`${capture.session} ${frame.number}` !== number) {
      number = `${capture.session} ${frame.number}`;
      view.newer();
    }
    say(empty, frame ? "" : "No frame yet.");
    counts.show(frame?.figures ?? null);
    const channels = state.console?.rig?.channels ?? [];
    facts(list, frame ? [
      ["Frame", `light ${frame.light + 1}, ${KINDS[frame.kind] ?? frame.kind}`],
      ["Lamp", frame.lamp === null || frame.lamp === undefined ? "off" : (channels[frame.lamp] ?? `channel ${frame.lamp}`)],
      ["Exposure", exposure(frame.exposure_s)],
    ] : []);
    const bracket = capture?.bracket ?? [];
    redraw(steps, bracket, () => (bracket.length ? bracket.map((step) => h("span", { class: "chip" }, `${exposure(step.exposure_s)}${step.frames > 1 ? ` × ${step.frames}` : ""}`)) : ["Not planned yet."]));
    tick(capture);
  }

  function tick(capture) {
    const frame = capture?.frame;
    if (!frame) return say(ageLine, "");
    const age_s = Math.max(0, secondsSince(frame.stored_at));
    const ended = !capturing();
    const late = !ended && (age_s > 10 + 3 * (frame.exposure_s ?? 0) || link().kind !== "live");
    sheet.classList.toggle("stale", late);
    ageLine.classList.toggle("warn", late);
    say(ageLine, ended ? `The last frame of this capture, stored ${span(age_s)} ago` : `${late ? "STALE: " : ""}stored ${span(age_s)} ago`);
  }
  return { element, show, tick, look: (on) => view.look(on) };
}

function lightsPanel() {
  const map = hemisphere("Lights of this capture");
  const body = h("tbody");
  const columns = ["Light", "Direction", "State", "SNR in the dark", "Frames", "Taken again", "Drift"];
  const table = h("table", { class: "lights" }, h("caption", { class: "unseen" }, "Lights of this capture"), h("thead", {}, h("tr", {}, columns.map((name) => h("th", { scope: "col" }, name)))), body);
  const element = panel("Lights", {}, map.element, h("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Table of lights" }, table));
  function show(capture) {
    const lights = capture?.lights ?? [];
    map.show({ ...surroundings(), lights: lights.map((light) => ({ ...pick(light), label: light.index + 1, title: `light ${light.index + 1}, ${direction(light.azimuth_deg, light.elevation_deg)}, ${LIGHT_STATES[light.state]}` })) });
    redraw(body, lights, () => lights.map(row));
  }
  return { element, show };
}

function pick({ azimuth_deg, elevation_deg, state: is }) {
  return { azimuth_deg, elevation_deg, state: is };
}

function row(light) {
  const cells = [
    `${degrees(light.azimuth_deg)}, ${degrees(light.elevation_deg)}`,
    LIGHT_STATES[light.state] ?? light.state,
    light.dark_snr == null ? "–" : digits(light.dark_snr, 3),
    light.frames == null ? "–" : String(light.frames),
    light.retakes ? String(light.retakes) : "–",
    drift(light.drift_percent ?? NaN, light.drift_u_percent ?? NaN),
  ];
  return h("tr", { class: light.state, "aria-current": light.state === "now" ? "step" : null }, h("th", { scope: "row" }, String(light.index + 1)), cells.map((text, i) => h("td", { class: i === 1 ? "state" : null }, text)));
}

function warningsPanel() {
  const list = h("ul", { class: "warnings" });
  const log = h("pre", { class: "log", tabindex: "0", "aria-label": "Log" });
  const element = panel("Warnings", {}, list, h("details", {}, h("summary", {}, "What the program says"), log));
  function show(capture, job) {
    const warnings = capture?.warnings ?? [];
    redraw(list, warnings, () => (warnings.length ? warnings.map((text) => h("li", { class: "warn" }, text)) : [h("li", { class: "fine" }, "None.")]));
    say(log, job?.kind === "capture" ? (job.log ?? []).join("\n") : "");
  }
  return { element, show };
}
