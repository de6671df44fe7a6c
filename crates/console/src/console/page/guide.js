// One calibration from the placing of its target to its record.

import { act, ask, askWith } from "./api.js";
import { take } from "./benches.js";
import { by, field, gate, h, panel, redraw, say, standOn } from "./dom.js";
import { targetDrawing } from "./drawings.js";
import { automatic } from "./exposing.js";
import { attempt, blocked, working } from "./header.js";
import { livePanels } from "./live.js";
import { announce, capital, complain } from "./notices.js";
import { when } from "./format.js";
import { sessionName } from "./running.js";
import { state, watch } from "./stream.js";

/** What is typed and captured for a calibration outlives a reload, and the change of a simulated target. */
const kept = (kind) => `rig-guide-${kind}`;

/** The part of the view; `look(kind)` shows a guide, `look(null)` none. */
export function guidePart() {
  const live = livePanels();
  const head = h("div", { class: "stack" });
  const place = placePart(live, () => run);
  const measure = measurePart(() => run);
  const progress = progressPart();
  const result = resultPart(() => load());
  const element = h("div", { class: "stack" }, head, place.element, measure.element, progress.element, result.element);
  let run = null;
  let shown = null;
  let looks = 0;

  async function load() {
    const kind = shown;
    if (kind === null) return;
    try {
      const { guides, is_rehearsal, trial } = await ask("api/guides");
      if (shown !== kind) return;
      const guide = guides.find((one) => one.kind === kind);
      if (!guide) return (location.hash = "#calibrate");
      if (run?.guide.kind !== kind) run = begun(guide, is_rehearsal);
      run.guide = guide;
      run.trial = trial;
      if (!working()) measure.ended(run);
    } catch (failure) {
      return complain(failure);
    }
    show();
  }

  function show() {
    if (!run || shown === null) return;
    const title = h("h3", { class: "headline" }, run.guide.title);
    redraw(head, run.guide.kind, () => [h("p", {}, h("a", { href: "#calibrate" }, "← All calibrations")), title]);
    if (title.isConnected && looks > 1) standOn(title);
    for (const part of [place, measure, progress, result]) part.show(run);
  }

  let was = null;
  watch(["control", "link", "console", "bench"], show);
  watch(["job", "capture"], () => {
    const is = [state.job?.kind, state.job?.state, state.job?.began].join();
    const ended = is !== was && !working();
    was = is;
    if (run && shown !== null && ended) {
      measure.ended(run);
      load();
    }
    show();
  });
  return {
    element,
    look(kind) {
      looks += 1;
      if (kind !== shown) run = null;
      shown = kind;
      live.look(kind !== null);
      load();
    },
  };
}

/** What the operator has stated and captured so far. */
function begun(guide, rehearsed) {
  const before = JSON.parse(sessionStorage.getItem(kept(guide.kind)) ?? "{}");
  const values = Object.fromEntries(guide.values.map((one) => [one.key, rehearsed ? one.rehearsed : ""]));
  return { guide, values: { ...values, ...before.values }, sessions: before.sessions ?? [], lights: before.lights ?? (rehearsed ? guide.lights_rehearsed : guide.lights), ...before.begun };
}

function keep({ guide, values, sessions, lights, command = null, old = null, then = false, stopped = null }) {
  sessionStorage.setItem(kept(guide.kind), JSON.stringify({ values, sessions, lights, begun: { command, old, then, stopped } }));
}

/** Why nothing can be begun, or null. */
function busy() {
  return blocked() ?? (working() ? "A job is running." : null);
}

/** Whether the stage stands where its lamp shines past the target, as after homing. */
function isLow() {
  return state.bench?.stage?.position?.elevation_deg < 15;
}

/** How often a target is looked for, until it is placed, and the time in between. */
const LOOKS = 90;
const LOOK_MS = 2000;

/** How the target is placed, and whether it is. */
function placePart(live, current) {
  const steps = h("div", { class: "stack" });
  const put = h("button", { type: "button", class: "primary", id: "put-target", onclick: () => (pressed = true) && take(current().guide.lacks) }, "Put it before the simulated camera");
  const simulated = h("p", { class: "fine" }, "The simulated bench puts it before its camera by itself.");
  const connect = h("button", { type: "button", id: "guide-light" });
  const check = h("button", { type: "button", id: "check-target" }, "Is it placed?");
  const seen = h("p", { role: "status", id: "target-seen" });
  const failed = h("p", { class: "error", role: "alert" });
  let again = null;
  let pressed = false;
  const look = h("div", { class: "stack" }, live.picture, h("div", { class: "row" }, connect, check), failed, seen);
  const element = h("div", { class: "two even" }, panel("1. Place the target", {}, steps, h("div", { class: "row" }, put), simulated), look);
  connect.addEventListener("click", () => {
    automatic(true);
    if (!state.bench?.connected) return attempt("api/bench/connect");
    if (state.bench.stage?.position === null) return attempt("api/bench/home");
    if (isLow()) {
      const [azimuth_deg, elevation_deg] = /^(-?[\d.]+),(-?[\d.]+)$/.exec(current().lights)?.slice(1).map(Number) ?? [0, 75];
      return attempt("api/bench/move", { azimuth_deg, elevation_deg });
    }
    attempt("api/bench/lamp", { channel: state.bench.stage?.lamp === null ? 0 : null });
  });
  check.addEventListener("click", () => {
    say(seen, "Looking …");
    lookFor(current().guide, LOOKS);
  });
  /** Looks so many times: the exposure may still be adjusted, and the target moved. */
  async function lookFor(guide, times) {
    clearTimeout(again);
    let is_right = false;
    try {
      const found = await askWith("api/guides/check", { kind: guide.kind, values: current().values });
      if (current()?.guide.kind !== guide.kind) return;
      is_right = found.is_right;
      say(seen, `${is_right ? "Yes" : "Not yet"}: ${found.seen}.`);
    } catch (failure) {
      times = 0;
      say(seen, capital(failure.message));
    }
    seen.className = is_right ? "" : "warn";
    if (!is_right && times > 1 && seen.checkVisibility()) again = setTimeout(() => current()?.guide.kind === guide.kind && lookFor(guide, times - 1), LOOK_MS);
  }
  function show({ guide }) {
    if (steps.drawnFrom !== JSON.stringify(guide.kind)) say(seen, "");
    redraw(steps, guide.kind, () => [targetDrawing(guide.kind), h("ul", { class: "steps" }, guide.place.map((sentence) => h("li", {}, sentence)))]);
    const rig = state.console?.rig;
    const itself = rig?.simulated && guide.frames === "own";
    put.hidden = !guide.lacks;
    simulated.hidden = !itself;
    look.hidden = Boolean(itself || guide.lacks);
    const bench = state.bench;
    const idle = busy() ?? (bench?.busy ? "The bench is busy." : null);
    const hasLamp = rig?.has_stage !== false;
    connect.hidden = Boolean(bench?.connected) && !hasLamp;
    say(connect, !bench?.connected ? "Show the live picture" : bench.stage?.position === null ? "Home the stage" : isLow() ? "Aim the light" : bench.stage?.lamp === null ? "Lamp on" : "Lamp off");
    check.hidden = !guide.can_check;
    say(failed, bench?.error ? `${capital(bench.error.error)}${bench.error.hint ? ` – ${bench.error.hint}` : ""}` : "");
    gate(put, busy());
    gate(connect, idle);
    gate(check, idle ?? (bench?.connected ? null : "Show the live picture first."));
    // Whoever pressed the button that is gone stands on the next one.
    if (pressed && put.hidden && !connect.disabled) {
      pressed = false;
      standOn(connect);
    }
  }
  return { element, show };
}

/** What is stated, the captures, and the start. */
function measurePart(current) {
  const entries = h("div", { class: "entries" });
  const lights = h("input", { type: "text", id: "guide-lights" });
  const lightsField = field("Lights: a number, or directions as 0,90", lights);
  const views = h("div", {});
  const others = h("select", { id: "guide-session" });
  const add = h("button", { type: "button", id: "guide-use" }, "Use it");
  const there = h("details", {}, h("summary", {}, "Use a session that is there"), h("div", { class: "row" }, field("Session", others), add));
  const view = h("button", { type: "button", id: "guide-view" }, "Take a view");
  const go = h("button", { type: "submit", class: "primary", id: "guide-start" });
  const resume = h("button", { type: "button", id: "guide-resume", onclick: () => begin(current(), "api/capture/resume", { session: current().stopped, fit: false }, current().then) }, "Resume it");
  const why = h("p", { class: "why" });
  const error = h("p", { class: "error", role: "alert" });
  const form = h("form", { class: "stack-form" }, entries, lightsField, views, h("div", { class: "row" }, view, go, resume), there, why, error);
  const element = panel("2. Measure", {}, form);

  form.addEventListener("input", () => {
    const run = current();
    for (const { key } of run.guide.values) run.values[key] = form.elements[`guide-${key}`].value;
    run.lights = lights.value;
    keep(run);
    show(run);
  });
  there.addEventListener("toggle", async () => {
    if (!there.open) return;
    const sessions = (await ask("api/sessions?search=").catch(() => [])).filter((one) => one.complete);
    sessions.sort((a, b) => (b.began ?? "").localeCompare(a.began ?? ""));
    others.replaceChildren(...sessions.map((one) => h("option", { value: one.name }, `${one.sample ?? one.name}, ${when(one.began)}`)));
  });
  add.addEventListener("click", () => {
    const run = current();
    if (!others.value) return;
    run.sessions = run.guide.several ? [...run.sessions, others.value] : [others.value];
    keep(run);
    show(run);
  });
  view.addEventListener("click", () => capture(current(), false));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const run = current();
    if (run.guide.frames === "sessions" && run.sessions.length === 0) capture(run, true);
    else measure(run);
  });

  /** Captures the target; `then`: what follows is the measurement. */
  async function capture(run, then) {
    await begin(run, "api/guides/capture", { kind: run.guide.kind, lights: lights.value }, then);
  }
  async function measure(run) {
    await begin(run, "api/guides/measure", { kind: run.guide.kind, sessions: run.sessions, values: run.values });
  }
  async function begin(run, address, body, then = false) {
    say(error, "");
    // What follows is not here: the result.
    document.activeElement.blur();
    gate(go, "Starting …");
    gate(view, "Starting …");
    const old = state.job?.began ?? null;
    try {
      const { command } = await act(address, body);
      Object.assign(run, { command, old, then, stopped: null });
      keep(run);
    } catch (failure) {
      say(error, `${capital(failure.message)}${failure.hint ? ` – ${failure.hint}` : ""}`);
    }
    show(run);
  }

  /** A job has ended: where it was the capture of this guide, its session is used. */
  function ended(run) {
    const { job, capture: last } = state;
    if (job?.kind !== "capture" || !run.command || job.command !== run.command || job.began === run.old) return;
    run.command = null;
    if (last?.state !== "complete") {
      run.stopped = last?.session ? sessionName(last.session) : null;
      keep(run);
      return say(error, `${job.state === "interrupted" ? "The capture was stopped." : (job.log ?? []).filter((line) => /^(error|hint): /.test(line)).map((line) => `${capital(line.replace(/^\w+: /, ""))}.`).join(" ")} ${run.stopped ? "“Resume it” goes on where it was." : "“Capture and measure” begins it anew."}`);
    }
    run.sessions = run.guide.several ? [...run.sessions, sessionName(last.session)] : [sessionName(last.session)];
    keep(run);
    if (run.then) measure(run);
  }

  function show(run) {
    const { guide } = run;
    const ofSessions = guide.frames === "sessions";
    redraw(entries, guide.kind, () => guide.values.map((one) => entry(one, run.values[one.key])));
    if (lights.value !== run.lights) lights.value = run.lights ?? "";
    lightsField.hidden = there.hidden = !ofSessions;
    redraw(views, run.sessions, () => (run.sessions.length ? [h("p", {}, guide.several ? "Views, in order:" : "Of the session"), h("ol", { class: "steps" }, run.sessions.map((name, i) => h("li", {}, h("a", { href: `#sessions/${encodeURIComponent(name)}` }, name), " ", h("button", { type: "button", class: "quiet", "aria-label": `Leave ${name} out`, onclick: () => { run.sessions.splice(i, 1); keep(run); show(run); } }, "×"))))] : []));
    view.hidden = !(ofSessions && (guide.several || run.sessions.length));
    say(view, guide.several ? `Take view ${run.sessions.length + 1}` : "Capture it anew");
    say(go, ofSessions && !run.sessions.length ? "Capture and measure" : "Measure");
    element.hidden = Boolean(guide.lacks);
    const missing = guide.values.find((one) => one.required && !run.values[one.key]?.trim());
    const reason = busy() ?? (run.trial === null ? "The records of this bench are built into the program: use the bench of the rehearsals, or a rig file of your own." : null);
    resume.hidden = !run.stopped;
    gate(resume, reason);
    gate(view, reason);
    gate(go, reason ?? (missing ? `State first: ${missing.label}.` : null));
    say(why, reason ?? "");
  }
  return { element, show, ended };
}

function entry(one, value) {
  const number = one.form === "number";
  const id = `guide-${one.key}`;
  const input = h("input", { type: number ? "number" : "text", id, name: id, step: number ? "any" : null, min: number ? one.least : null, max: number ? one.most : null, required: one.required, autocomplete: "off", value: value || null });
  return h("div", { class: "question" }, field(one.required ? one.label : `${one.label} (may stay empty)`, input));
}

/** What the person at the bench is asked to do. */
const HANDS = { cover: "Cover the lens", uncover: "Take the cover off the lens", "light-on": "Switch the even light on, and leave the room as it is", "light-off": "Switch the even light off, and leave the room as it is", "lamp-on": "Switch the lamp on", "lamp-off": "Switch the lamp off", place: "Hold the lamp above the target" };

/** The job of this guide while it runs. */
function progressPart() {
  const status = h("p", { class: "big", role: "status" });
  const bar = h("progress", { max: "1", "aria-label": "Progress" });
  const answer = (done) => () => attempt("api/capture/answer", { number: state.job?.asked?.number, done });
  const done = h("button", { type: "button", class: "primary", id: "guide-done", onclick: answer(true) }, "Done");
  const not = h("button", { type: "button", onclick: answer(false) }, "Not possible");
  const watchIt = h("a", { class: "button", href: "#capture" }, "Watch");
  const halt = h("button", { type: "button", id: "guide-stop", onclick: () => attempt("api/jobs/stop") }, "Stop it");
  const element = panel("Under way", { id: "guide-progress" }, status, bar, h("div", { class: "row" }, done, not, watchIt, halt));
  function show() {
    const { job, capture } = state;
    const own = ["capture", "calibration"].includes(job?.kind);
    element.hidden = !(own && working());
    if (element.hidden) return;
    const capturing = job.kind === "capture";
    const asked = job.asked ?? null;
    say(status, asked ? (HANDS[asked.do] ?? "You are asked for something: press “Watch”.") : capturing ? "The target is being captured" : "Measuring");
    const share = capturing ? capture?.done : job.progress?.done;
    if (Number.isFinite(share)) bar.value = share;
    else bar.removeAttribute("value");
    done.hidden = not.hidden = !HANDS[asked?.do];
    watchIt.hidden = !capturing;
    for (const control of [done, not]) gate(control, blocked());
  }
  return { element, show };
}

/** What was found; it is in force once it is accepted. */
function resultPart(reload) {
  const said = h("ul", { class: "warnings", id: "guide-said" });
  const figure = h("div", { class: "gallery figures" });
  const accept = h("button", { type: "button", class: "primary", id: "guide-accept" }, "Accept it");
  const repeat = h("button", { type: "button", id: "guide-repeat" }, "Discard it and repeat");
  const what = h("p", {});
  const buttons = h("div", { class: "row" }, accept, repeat);
  const element = panel("3. Result", { id: "guide-result" }, what, said, figure, buttons);
  let run = null;
  const end = (address, then) => async () => {
    if (!(await attempt(address))) return;
    then();
  };
  accept.addEventListener("click", end("api/guides/accept", () => {
    sessionStorage.removeItem(kept(run.guide.kind));
    announce("The record is in force");
    location.hash = "#calibrate";
    by("calibrate-title").focus();
  }));
  repeat.addEventListener("click", end("api/guides/discard", () => {
    // Views may be left out one by one.
    if (!run.guide.several) run.sessions = [];
    keep(run);
    by("guide-start").focus();
    reload();
  }));
  function show(newer) {
    run = newer;
    const { job } = state;
    const mine = job?.kind === "calibration" && job.command?.startsWith(`rig calibrate ${run.guide.kind} `) && !working();
    const records = run.trial?.of === run.guide.kind ? run.trial.records : [];
    const was = element.hidden;
    element.hidden = working() || !(mine || records.length);
    if (element.hidden) return;
    if (was) standOn(element.querySelector("h3"));
    say(what, records.length ? `Not in force yet: ${records.join(", ")}.` : job?.state === "done" ? "" : `It ended without a record: ${job?.state}. “${by("guide-start").innerText}” begins it anew.`);
    const lines = mine ? (job.log ?? []).filter((line) => !/^(figure|EMVA 1288 figures): /.test(line)).map((line) => line.replace("/.trial/", "/")) : [];
    redraw(said, lines, () => lines.map((line) => h("li", { class: /^(warning|error|hint)/.test(line) ? "warn" : null }, line)));
    redraw(figure, [records, run.trial?.has_figure], () => (records.length && run.trial.has_figure ? [h("figure", {}, h("img", { src: `api/guides/figure.png?of=${encodeURIComponent(records[0])}`, alt: `The figure of ${records[0]}` }))] : []));
    buttons.hidden = !records.length;
    for (const control of [accept, repeat]) gate(control, busy());
  }
  return { element, show };
}
