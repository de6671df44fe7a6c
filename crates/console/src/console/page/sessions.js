// All sessions of the folder: search, one of them, two fits side by side.

import { ask } from "./api.js";
import { comparePart } from "./compare.js";
import { gate, h, redraw, say } from "./dom.js";
import { short, when } from "./format.js";
import { complain } from "./notices.js";
import { sessionPart } from "./session.js";
import { state, watch } from "./stream.js";
import { badge, latest, quality } from "./verdict.js";

const WAIT_MS = 250;

/** Builds the view; the returned function shows and hides it. */
export function startSessions(view) {
  const list = listPart();
  const one = sessionPart();
  const two = comparePart();
  view.append(list.element, one.element, two.element);
  let path = [];
  let shown = false;
  function show() {
    const [first, ...rest] = path;
    list.element.hidden = first !== undefined;
    one.element.hidden = first === undefined || first === "compare";
    two.element.hidden = first !== "compare";
    if (!shown) return;
    if (first === undefined) list.load();
    else if (first === "compare") two.load(rest);
    else one.load(first);
  }
  watch(["sessions"], show);
  // A job that has ended has left a fit, an export or a session.
  let working = null;
  watch(["job"], () => {
    const before = working;
    working = state.job?.state ?? null;
    if (before !== null && before !== working && !["running", "paused", "ending"].includes(working)) show();
  });
  return (on, rest) => {
    shown = on;
    if (on) path = rest;
    show();
  };
}

function listPart() {
  const search = h("input", { type: "search", id: "search", placeholder: "sample, date or verdict", "aria-label": "Search sessions", autocomplete: "off" });
  const compare = h("button", { type: "button", id: "compare" }, "Compare two fits");
  const body = h("div", { class: "cards" });
  const number = h("p", { class: "fine", role: "status" });
  const element = h(
    "section",
    { class: "panel" },
    h("h3", {}, "Sessions"),
    h("div", { class: "row" }, search, compare, number),
    h("p", { class: "fine" }, "Tick two sessions to see their latest fits side by side."),
    body,
  );
  const ticked = [];
  let timer = null;
  let request = null;
  search.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(load, WAIT_MS);
  });
  compare.addEventListener("click", () => {
    location.hash = `#sessions/compare/${ticked.map(encodeURIComponent).join("/")}`;
  });
  showTicked();

  function tick(name, on) {
    const there = ticked.indexOf(name);
    if (there >= 0) ticked.splice(there, 1);
    if (on) ticked.push(name);
    // A third tick replaces the first.
    while (ticked.length > 2) ticked.shift();
    for (const box of body.querySelectorAll("input[type=checkbox]")) box.checked = ticked.includes(box.value);
    showTicked();
  }
  function showTicked() {
    gate(compare, ticked.length === 2 ? null : "Tick two sessions first.");
  }

  async function load() {
    request?.abort();
    const mine = new AbortController();
    request = mine;
    try {
      const sessions = await ask(`api/sessions?search=${encodeURIComponent(search.value)}`, mine.signal);
      say(number, `${sessions.length} ${sessions.length === 1 ? "session" : "sessions"}${search.value ? " found" : ` in ${state.console?.folder ?? "the folder"}`}`);
      redraw(body, sessions, () => sessions.map((session) => card(session, ticked, tick)));
    } catch (error) {
      complain(error);
    }
  }
  return { element, load };
}

/** What is known of a session that can be read. */
function known(session, fit) {
  const lights = `${session.lights} ${session.lights === 1 ? "light" : "lights"}`;
  return [
    session.complete || session.lights_finished == null ? lights : `${session.lights_finished} of ${lights} captured`,
    session.simulated ? `simulated${session.material ? `: ${short(session.material)}` : ""}` : null,
    session.suspect ? "the stage lost steps" : null,
    session.fits?.length > 1 ? `${session.fits.length} fits` : null,
    quality(fit) === "–" ? null : quality(fit),
  ];
}

function card(session, ticked, tick) {
  const fit = latest(session);
  const box = h("input", { type: "checkbox", value: session.name, "aria-label": `Compare ${short(session.sample) ?? session.name} of ${when(session.began)}` });
  box.checked = ticked.includes(session.name);
  box.disabled = !fit;
  box.addEventListener("change", () => tick(session.name, box.checked));
  const facts = [
    session.began ? when(session.began) : null,
    ...(session.error ? [session.error.error] : known(session, fit)),
  ].filter(Boolean);
  return h(
    "article",
    { class: "card" },
    h("label", { class: "tick" }, box),
    h(
      "div",
      {},
      h("h4", {}, h("a", { href: `#sessions/${encodeURIComponent(session.name)}` }, short(session.sample) || session.name)),
      h("p", { class: "fine" }, facts.join(" · ")),
    ),
    session.error ? h("span", { class: "badge incomplete", title: session.error.error }, "can’t be read") : session.complete ? badge(fit) : h("span", { class: "badge incomplete" }, "not complete"),
  );
}
