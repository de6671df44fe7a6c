// Which view is shown, and the start of everything.

import { settleIdentity } from "./api.js";
import { startBench } from "./bench.js";
import { startCalibrate } from "./calibrate.js";
import { startCapture } from "./capture.js";
import { by } from "./dom.js";
import { startHeader } from "./header.js";
import { startQueue } from "./queue.js";
import { startSessions } from "./sessions.js";
import { startSetup } from "./setup.js";
import { startShortcuts } from "./shortcuts.js";
import { open, state, watch } from "./stream.js";

const VIEWS = ["bench", "calibrate", "capture", "queue", "sessions", "setup"];
const shown = {};
let current = null;

/** The hash as a view and the rest of its path. */
function route() {
  const [view, ...rest] = decodeURIComponent(location.hash.slice(1)).split("/");
  return VIEWS.includes(view) ? [view, rest] : [null, []];
}

function show(focus) {
  let [view, rest] = route();
  if (view === null) {
    view = current ?? "bench";
    rest = [];
  }
  const changed = current !== view;
  current = view;
  for (const name of VIEWS) by(`view-${name}`).hidden = name !== view;
  for (const tab of document.querySelectorAll("#tabs a")) {
    if (tab.hash === `#${view}`) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  for (const name of VIEWS) shown[name]?.(name === view, rest);
  if (changed) window.scrollTo(0, 0);
  if (focus && changed) by(`${view}-title`).focus({ preventScroll: true });
}

// A capture that runs when the page opens is what its operator looks for.
let opened = false;
function chooseFirst() {
  if (opened || state.job === null) return;
  opened = true;
  const running = state.job.kind === "capture" && ["running", "paused", "ending"].includes(state.job.state);
  if (location.hash === "" && running) location.hash = "#capture";
}

// Another bench: what the view shows is loaded anew, and whoever uses it stays where they are.
let since = null;
function renew() {
  const before = since;
  since = state.console?.since ?? null;
  if (before === null || before === since) return;
  const [view, rest] = route();
  shown[view ?? current]?.(false, rest);
  show(false);
}

async function start() {
  startHeader();
  startShortcuts();
  shown.bench = startBench(by("view-bench"));
  shown.calibrate = startCalibrate(by("view-calibrate"));
  shown.capture = startCapture(by("view-capture"));
  shown.queue = startQueue(by("view-queue"));
  shown.sessions = startSessions(by("view-sessions"));
  shown.setup = startSetup(by("view-setup"));
  by("skip").addEventListener("click", (event) => {
    event.preventDefault();
    by("main").focus();
  });
  window.addEventListener("hashchange", () => show(true));
  show(false);
  watch(["job"], chooseFirst);
  watch(["console"], renew);
  await settleIdentity();
  open();
}

start();
