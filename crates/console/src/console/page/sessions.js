// All sessions of the folder: search and order, one of them, fits side by side.

import { ask } from "./api.js";
import { comparePart } from "./compare.js";
import { gate, h, redraw, say } from "./dom.js";
import { short, when } from "./format.js";
import { complain } from "./notices.js";
import { slowPicture } from "./picture.js";
import { fileOf, sessionBadge, sessionPart } from "./session.js";
import { state, watch } from "./stream.js";
import { done, latest, quality } from "./verdict.js";

const WAIT_MS = 250;
/** Fits that are compared at once. */
const MOST = 4;
const GRAVEST = ["not-to-be-trusted", "reservations", "explains"];
const text = (a, b) => (a ?? "").localeCompare(b ?? "", undefined, { numeric: true });
const newest = (a, b) => text(b.began, a.began);
/** The gravest verdict first; what is not complete or can't be read before all. */
const gravity = (session) => (session.error || !session.complete ? -1 : latest(session) ? GRAVEST.indexOf(latest(session).verdict) : 3);
const ORDERS = [
  ["newest", "newest first", newest],
  ["oldest", "oldest first", (a, b) => newest(b, a)],
  ["sample", "by sample", (a, b) => text(a.sample ?? a.name, b.sample ?? b.name) || newest(a, b)],
  ["verdict", "gravest verdict first", (a, b) => gravity(a) - gravity(b) || newest(a, b)],
];
const SORT = "rig-sort";

/** Builds the view; the returned function shows and hides it. */
export function startSessions(view) {
  const list = listPart();
  const one = sessionPart();
  const several = comparePart();
  view.append(list.element, one.element, several.element);
  let path = [];
  let shown = false;
  function show() {
    const [first, ...rest] = path;
    list.element.hidden = first !== undefined;
    one.element.hidden = first === undefined || first === "compare";
    several.element.hidden = first !== "compare";
    if (!shown) return;
    if (first === undefined) list.load();
    else if (first === "compare") several.load(rest);
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
  const search = h("input", { type: "search", id: "search", placeholder: "sample, date, material or note", "aria-label": "Search sessions", autocomplete: "off" });
  const order = h("select", { id: "sort", "aria-label": "Order of the sessions" }, ORDERS.map(([value, label]) => h("option", { value }, label)));
  order.value = ORDERS.some(([name]) => name === localStorage.getItem(SORT)) ? localStorage.getItem(SORT) : "newest";
  const compare = h("button", { type: "button", id: "compare" }, "Compare fits");
  const body = h("div", { class: "cards" });
  const number = h("p", { class: "fine", role: "status" });
  const element = h(
    "section",
    { class: "panel" },
    h("h3", {}, "Sessions"),
    h("div", { class: "row" }, search, order, compare, number),
    h("p", { class: "fine" }, `Tick up to ${MOST} sessions to compare their latest fits, or one session to compare its own.`),
    body,
  );
  const ticked = [];
  let sessions = [];
  let timer = null;
  let request = null;
  search.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(load, WAIT_MS);
  });
  order.addEventListener("change", () => {
    localStorage.setItem(SORT, order.value);
    draw();
  });
  compare.addEventListener("click", () => {
    const fits = ticked.length === 1 ? [...ownFits()].slice(-MOST).map((fit) => `${ticked[0]}:${fit.name}`) : ticked;
    location.hash = `#sessions/compare/${fits.map(encodeURIComponent).join("/")}`;
  });
  showTicked();

  function tick(name, on) {
    const there = ticked.indexOf(name);
    if (there >= 0) ticked.splice(there, 1);
    if (on) ticked.push(name);
    // One too many replaces the first.
    while (ticked.length > MOST) ticked.shift();
    for (const box of body.querySelectorAll("input[type=checkbox]")) box.checked = ticked.includes(box.value);
    showTicked();
  }
  function ownFits() {
    return sessions.find((session) => session.name === ticked[0])?.fits ?? [];
  }
  function showTicked() {
    const enough = ticked.length > 1 || (ticked.length === 1 && ownFits().length > 1);
    gate(compare, enough ? null : "Tick two sessions, or one with two fits.");
  }

  function draw() {
    const [, , by] = ORDERS.find(([name]) => name === order.value);
    const sorted = [...sessions].sort(by);
    redraw(body, sorted, () => sorted.map((session) => card(session, ticked, tick)));
    showTicked();
  }

  async function load() {
    request?.abort();
    const mine = new AbortController();
    request = mine;
    try {
      sessions = await ask(`api/sessions?search=${encodeURIComponent(search.value)}`, mine.signal);
      say(number, `${sessions.length} ${sessions.length === 1 ? "session" : "sessions"}${search.value ? " found" : ` in ${state.console?.folder ?? "the folder"}`}`);
      draw();
    } catch (error) {
      complain(error);
    }
  }
  return { element, load };
}

/** What is known of a session that can be read. */
function known(session, fit) {
  return [
    session.complete ? done(session) : `${done(session)} captured`,
    session.simulated ? `simulated${session.true_material ? `: ${short(session.true_material)}` : ""}` : null,
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
    thumbnail(session),
    h(
      "div",
      {},
      h("h4", {}, h("a", { href: `#sessions/${encodeURIComponent(session.name)}` }, short(session.sample) || session.name)),
      h("p", { class: "fine" }, facts.join(" · ")),
    ),
    sessionBadge(session),
  );
}

/** A small picture of the sample, where a light of it is captured. */
function thumbnail(session) {
  const there = !session.error && (session.complete || session.lights_finished > 0);
  return h("div", { class: "thumbnail" }, there ? slowPicture(fileOf(session.name, "derived/thumbnail.png"), { alt: "" }) : null);
}
