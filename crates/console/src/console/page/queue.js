// Many samples one after the other: which is next, what became of each, and more by a scanner or a table.

import { act, ask, askWith } from "./api.js";
import { field, gate, h, panel, redraw, say } from "./dom.js";
import { span } from "./format.js";
import { attempt, blocked, capturing, working } from "./header.js";
import { announce, capital, complain } from "./notices.js";
import { untilFields } from "./prepare.js";
import { slowPicture } from "./picture.js";
import { fileOf } from "./session.js";
import { secondsSince, state, watch } from "./stream.js";
import { badge } from "./verdict.js";

/** How samples are captured outlives a reload, and the change of the bench. */
const HOW = "rig-queue-how";

/** Builds the view; the returned function shows and hides it. */
export function startQueue(view) {
  const lights = h("input", { type: "text", id: "queue-lights", value: "4", "aria-describedby": "queue-lights-help" });
  const enough = untilFields("Expected error that is enough, percent; may stay empty", "", "queue-");
  const asked = () => ({ lights: lights.value.trim(), ...(enough.error.value ? enough.asked() : {}) });
  const fit = h("input", { type: "checkbox", id: "queue-fit", checked: true });
  const how = [[lights, "value"], [enough.error, "value"], [enough.most, "value"], [fit, "checked"]];
  JSON.parse(sessionStorage.getItem(HOW) ?? "[]").forEach((value, i) => (how[i][0][how[i][1]] = value));
  for (const [input] of how) input.addEventListener("change", () => sessionStorage.setItem(HOW, JSON.stringify(how.map(([one, key]) => one[key]))));
  const list = h("ul", { class: "queue" });
  const left = h("p", { class: "fine", role: "status" });
  const next = nextPanel(() => ({ ...asked(), fit: fit.checked }), set);
  const more = addPanel(set);
  view.append(
    h(
      "div",
      { class: "two" },
      h("div", { class: "stack" }, next.element, more.element, panel("How", {}, h("div", { class: "row" }, field("Lights of each sample", lights, h("span", { class: "fine", id: "queue-lights-help" }, "A number, all, or best:N. The list may say otherwise."))), h("p", { class: "inline" }, "Then the most telling ones, until the expected error is at most ", enough.error, "% (may stay empty), but at most ", enough.most, " lights."), h("label", { class: "choice" }, fit, h("span", {}, "fit a BRDF and write the report after each")))),
      panel("Samples", {}, left, list),
    ),
  );
  let queue = null;
  let shown = false;
  /** What a sample takes, seconds, by its lights. */
  const estimates = new Map();
  let was = null;

  /** Takes over a newer state of the queue. */
  function set(newer) {
    queue = newer;
    show();
    plan();
  }

  async function load() {
    if (!shown) return;
    try {
      let newer = await ask("api/queue");
      // Without fits a captured sample is done.
      if (newer.next.step === "fit" && !fit.checked && !working() && !blocked()) {
        await act("api/queue/next", { lights: lights.value.trim(), leave: true });
        newer = await ask("api/queue");
      }
      set(newer);
    } catch (failure) {
      complain(failure);
    }
  }

  /** The lights of a sample: its own, or those of the form. */
  function lightsOf(row) {
    const own = row.lights !== null || row.light.length > 0;
    return { ...asked(), lights: own ? row.lights : lights.value.trim() || null, light: row.light, fit: false };
  }

  /** What each sample that is left takes, by a dry run for all of the same lights. */
  async function plan() {
    for (const row of queue?.rows ?? []) {
      const key = JSON.stringify(lightsOf(row));
      if (row.left === 0 || estimates.has(key)) continue;
      estimates.set(key, NaN);
      const answer = await askWith("api/plan", lightsOf(row)).catch(() => null);
      estimates.set(key, answer?.plan?.estimated_s ?? NaN);
      show();
    }
  }

  function show() {
    if (!queue || !shown) return;
    next.show(queue);
    more.show();
    const capture = state.capture;
    const under = capturing() && Number.isFinite(capture?.left_s) && capture.left_at ? Math.max(0, capture.left_s - secondsSince(capture.left_at)) : 0;
    const all = queue.rows.reduce((sum, row) => sum + (row.left > 0 ? row.left * (estimates.get(JSON.stringify(lightsOf(row))) ?? NaN) : 0), under);
    const count = queue.rows.length;
    say(left, count === 0 ? "None yet." : `${count} ${count === 1 ? "sample" : "samples"}, ${queue.left} to capture${Number.isFinite(all) && all > 0 ? `: about ${span(all)} on the bench` : ""}`);
    const reason = blocked();
    redraw(list, [queue.rows, reason, capturing() ? capture?.sample : null], () => queue.rows.flatMap((row) => rowsOf(row, reason, set)));
  }

  for (const one of [lights, enough.error, enough.most]) one.addEventListener("change", plan);
  fit.addEventListener("change", load);
  watch(["control", "link", "capture"], show);
  watch(["job"], () => {
    const is = [state.job?.kind, state.job?.state].join();
    if (is !== was && !working()) load();
    was = is;
    show();
  });
  return (on) => {
    if (on && !shown) {
      shown = true;
      // The bench may be another one.
      estimates.clear();
      load();
    }
    shown = on;
  };
}

/** What is to be done now, with its buttons. */
function nextPanel(how, set) {
  const what = h("p", { class: "big", role: "status" });
  const notes = h("p", { class: "fine" });
  const bar = h("progress", { max: "1", "aria-label": "Progress of this capture" });
  const about = h("p", {});
  const go = h("button", { type: "button", class: "primary", id: "queue-next" });
  const leave = h("button", { type: "button", id: "queue-leave" });
  const skip = h("button", { type: "button", id: "queue-skip" }, "Leave out …");
  const repeat = h("button", { type: "button", id: "queue-repeat" });
  const watchIt = h("a", { class: "button", href: "#capture" }, "Watch");
  const reason = h("input", { type: "text", id: "queue-reason", maxlength: "200", autocomplete: "off" });
  const sure = h("button", { type: "submit", id: "queue-skip-sure" }, "Leave it out");
  const form = h("form", { class: "row", hidden: true }, field("Why (may stay empty)", reason), sure, h("button", { type: "button", class: "quiet", onclick: () => (form.hidden = true) }, "Cancel"));
  const why = h("p", { class: "why" });
  const buttons = [go, watchIt, leave, repeat, skip];
  let stood = null;
  const element = panel("Next", { class: "next" }, what, notes, bar, about, h("div", { class: "row" }, go, watchIt, leave, repeat, skip), form, why);
  element.addEventListener("focusin", ({ target }) => (stood = target));
  let queue = null;

  const step = (more) => async () => {
    gate(go, "Starting …");
    if (await attempt("api/queue/next", { ...how(), ...more })) set(await ask("api/queue"));
    else show(queue);
  };
  const change = async (address, body) => {
    const newer = await attempt(address, body);
    if (newer) set(newer);
  };
  go.addEventListener("click", step({}));
  leave.addEventListener("click", step({ leave: true }));
  repeat.addEventListener("click", () => change("api/queue/again"));
  skip.addEventListener("click", () => {
    form.hidden = false;
    reason.value = "";
    reason.focus();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    form.hidden = true;
    change("api/queue/skip", { sample: queue.next.sample, reason: reason.value.trim() || null });
    go.focus();
  });

  function show(newer) {
    queue = newer;
    const { next } = queue;
    const focused = document.activeElement;
    if (focused !== document.body && !buttons.includes(focused)) stood = null;
    const busy = working();
    const words = {
      capture: () => `${next.run > 1 ? "Take off and put back" : "Put on the bench"}: ${next.sample}${next.of > 1 ? ` (${next.run} of ${next.of})` : ""}`,
      resume: () => `${next.sample} was interrupted. Put it on the bench as it was`,
      fit: () => "The last capture has no fit",
      end: () => (queue.rows.length ? "All samples are done" : "Add the first sample"),
    };
    const doing = state.job?.kind === "capture" ? `${state.capture?.sample ?? "A sample"} is being captured` : `A job is running: ${state.job?.kind}`;
    say(what, busy ? (state.capture?.state === "fitting" ? `${state.capture.sample} is being fitted` : doing) : words[next.step]());
    say(notes, busy ? "" : [next.material, next.comment].filter(Boolean).join("; "));
    bar.hidden = !busy;
    const share = state.capture?.state === "fitting" ? state.job?.progress?.done : (state.capture?.done ?? state.job?.progress?.done);
    if (Number.isFinite(share)) bar.value = share;
    else bar.removeAttribute("value");
    say(about, busy && state.job?.asked ? "You are asked for something: press “Watch”." : "");
    watchIt.hidden = !busy;
    go.hidden = busy || next.step === "end";
    say(go, { capture: "Capture", resume: "Go on with it", fit: "Fit it" }[next.step] ?? "");
    leave.hidden = busy || !["resume", "fit"].includes(next.step);
    say(leave, next.step === "fit" ? "Go on without" : "Leave it as it is");
    skip.hidden = busy || next.step !== "capture";
    form.hidden ||= skip.hidden;
    repeat.hidden = busy || !queue.last || !["capture", "end"].includes(next.step);
    say(repeat, `Repeat ${queue.last ?? ""}`);
    const reasonNot = blocked();
    for (const control of [go, leave, repeat, skip, sure]) gate(control, reasonNot);
    say(why, reasonNot ?? "");
    // Whoever pressed a button that is gone stands on the next one.
    if (buttons.includes(stood) && stood.hidden) {
      stood = buttons.find((button) => !button.hidden && !button.disabled) ?? null;
      stood?.focus();
    }
  }
  return { element, show };
}

/** One field for a name, as a scanner types it, and a table from a file. */
function addPanel(set) {
  const name = h("input", { type: "text", id: "queue-add", placeholder: "cup-7", autocomplete: "off", autocapitalize: "off", spellcheck: "false" });
  const add = h("button", { type: "submit" }, "Add");
  const file = h("input", { type: "file", id: "queue-file", accept: ".csv,.tsv,.txt,text/csv,text/plain" });
  const anyway = h("button", { type: "button", hidden: true }, "Add it all the same");
  const error = h("p", { class: "error", role: "alert" });
  const form = h("form", { class: "stack-form" }, h("div", { class: "row" }, field("Sample, typed or scanned; Enter adds it", name), add), field("Or a table (CSV): name, material, comment, repeats", file), error, anyway);
  let last = "";

  async function send(text, again) {
    last = text;
    say(error, "");
    anyway.hidden = true;
    try {
      set(await act("api/queue/add", { text, again }));
      announce("Added to the queue");
      name.value = "";
    } catch (failure) {
      say(error, `${capital(failure.message)}${failure.hint ? ` – ${failure.hint}` : ""}`);
      anyway.hidden = !failure.hint?.startsWith("add it all the same");
    }
  }
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (name.value.trim()) send(name.value.trim(), false);
    name.focus();
  });
  file.addEventListener("change", async () => {
    if (file.files.length) await send(await file.files[0].text(), false);
    file.value = "";
  });
  anyway.addEventListener("click", () => send(last, true));
  const show = () => {
    for (const control of [add, file, anyway]) gate(control, blocked());
  };
  return { element: panel("Add", {}, form), show };
}

const STATES = { begun: "interrupted", abandoned: "interrupted, left so", captured: "captured" };

/** A sample's sessions, and what is left or left out of it. */
function rowsOf(row, reason, set) {
  const item = (mark, ...about) => h("li", {}, h("div", { class: "thumbnail" }, mark), h("div", {}, h("strong", {}, row.sample), " ", ...about));
  const runs = row.sessions.map((run, i) => {
    const now = capturing() && state.capture?.sample === row.sample && run.state === "begun";
    const words = now ? h("span", { class: "badge" }, "now") : run.verdict ? badge(run) : h("span", { class: "badge none" }, run.error ? "fit failed" : (STATES[run.state] ?? "captured, not fitted"));
    const complete = !["begun", "abandoned"].includes(run.state);
    return item(complete ? slowPicture(fileOf(run.session, "derived/thumbnail.png"), { alt: "" }) : null, row.planned > 1 ? h("span", { class: "fine" }, `${i + 1} of ${row.planned} `) : null, h("a", { href: `#sessions/${encodeURIComponent(run.session)}` }, "session"), " ", words);
  });
  const out = row.left_out;
  const back = out ? h("button", { type: "button", class: "quiet", "aria-label": `Bring back ${row.sample}`, onclick: async () => { const newer = await attempt("api/queue/back", { sample: row.sample }); if (newer) set(newer); } }, "Bring back") : null;
  if (back) gate(back, reason);
  return [
    ...runs,
    out ? item(null, h("span", { class: "badge incomplete" }, out.sessions > 1 ? `${out.sessions} left out` : "left out"), out.reason ? h("span", { class: "fine" }, ` ${out.reason} `) : " ", back) : null,
    row.left > 0 ? item(null, h("span", { class: "fine" }, row.left > 1 ? `${row.left} to do` : "to do", row.material ? `, ${row.material}` : "")) : null,
  ].filter(Boolean);
}
