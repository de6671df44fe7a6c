// What is always in reach: the rig's name, the connection, who controls, STOP.

import { Refused, act, giveUpQuestions, viewer } from "./api.js";
import { by, gate, say } from "./dom.js";
import { short, span } from "./format.js";
import { announce, capital, complain, tell } from "./notices.js";
import { link, state, watch } from "./stream.js";
import { verdictWords } from "./verdict.js";

const PING_MS = 5000;
/** A page that controls and was silent for longer is replaced by whoever acts. */
const SILENT_S = 30;

/** True where this page controls the bench. */
export function controls() {
  return state.control?.viewer === viewer();
}

/** Why this page may do nothing now, or null. A bench that nobody controls is taken by acting. */
export function blocked() {
  const { kind } = link();
  if (kind === "connecting") return "There is no connection to the console.";
  const holder = state.control?.viewer ?? null;
  if (holder !== null && holder !== viewer() && !silent()) return "Another page controls the bench. Press “Take control” to use it from here.";
  return null;
}

/** True where the page that controls has fallen silent. */
function silent() {
  return (state.control?.age_s ?? 0) > SILENT_S;
}

/** True while a capture is running or paused, so that the bench belongs to it. */
export function capturing() {
  return state.job?.kind === "capture" && working();
}

/** True while any job is under way. */
export function working() {
  return ["running", "paused", "ending"].includes(state.job?.state);
}

/** Runs an action and shows what it failed with. Returns null then. */
export async function attempt(address, body) {
  try {
    return await act(address, body);
  } catch (error) {
    complain(error);
    return null;
  }
}

async function stop() {
  const button = by("stop");
  button.classList.add("pressed");
  setTimeout(() => button.classList.remove("pressed"), 600);
  announce("STOP sent");
  giveUpQuestions();
  // Both, always: what this page last heard of a capture may be old.
  const outcomes = await Promise.allSettled([act("api/capture/stop"), act("api/bench/stop")]);
  const refused = outcomes.filter((outcome) => outcome.status === "rejected").map((outcome) => outcome.reason);
  if (refused.some((reason) => reason.status === 0)) return complain(new Refused("STOP had no answer: nothing may have been stopped", "use the emergency stop", 0));
  const reached = [...new Set(outcomes.map((outcome) => outcome.value?.stopping).filter(Boolean))].join(" and ");
  const unchecked = refused.map((reason) => `${capital(reason.message)}${reason.hint ? ` – ${reason.hint}` : ""}.`);
  if (!reached) return tell(["Nothing was running.", ...unchecked].join(" "));
  tell([`STOP reached ${reached} …`, ...unchecked].join(" "));
  // A program that has the devices switches its lamp off before it ends, or fails.
  const ofStage = /the stage|the bench/.test(reached);
  const hasDevices = outcomes[1].status === "fulfilled";
  const { error, hint } = (await stopped()) ? ((ofStage && state.bench?.error) || {}) : { error: `STOP has not ended ${reached} yet`, hint: "press it again, or the emergency stop" };
  const failed = hasDevices && !ofStage && state.job?.state === "failed" ? "the program that had the devices failed: look whether the lamp is on" : null;
  if (error ?? failed) return complain(new Refused(error ?? failed, hint ?? null, 409));
  const own = state.bench?.stage?.lamp_word === "reported" ? ", the lamp is off" : ", lamp off was sent, not verified: look at it";
  const is = ofStage ? `STOP: the stage stands${own}.` : `STOP ended ${reached}${hasDevices ? ", its lamp was switched off" : ""}.`;
  tell([is, ...unchecked].join(" "));
}

/** Waits until no job runs and the stage stands, or a quarter of a minute; whether they do. */
async function stopped() {
  for (const end = performance.now() + 15000; performance.now() < end; ) {
    // What this page last heard is older than the answer.
    await new Promise((then) => setTimeout(then, 250));
    if (!working() && state.bench?.busy !== "stopping") return true;
  }
  return false;
}

function showRig() {
  const rig = state.console?.rig;
  if (!rig) return;
  say(by("rig-name"), rig.name);
  by("simulated").hidden = !rig.simulated || rig.name === "simulated";
  showTitle();
  document.body.classList.toggle("camera-alone", state.console.mode === "camera");
}

/** What a tab in the background has to tell: how far it is, and what it came to. */
function showTitle() {
  const { console: desk, job, capture } = state;
  if (!desk?.rig) return;
  const isCapture = job?.kind === "capture";
  const share = isCapture && capture?.state !== "fitting" ? capture?.done : job?.progress?.done;
  const sample = short((isCapture ? capture?.sample : job?.session) ?? "");
  const verdict = (isCapture ? capture?.verdict : job?.verdict) ?? null;
  const at = Number.isFinite(share) ? `${Math.floor(100 * share)}%` : null;
  const is = working()
    ? [job.state === "paused" ? "paused" : null, at, isCapture ? (capture?.state === "fitting" ? "fit" : null) : job.kind]
    : job?.state && (isCapture || ["fit", "calibration"].includes(job.kind))
      ? [job.state === "done" ? (verdict ? verdictWords(verdict) : "done") : job.state]
      : [];
  const parts = [is.filter(Boolean).join(" "), is.length ? sample : null, `${desk.rig.name} – rig console`];
  const title = parts.filter(Boolean).join(" · ");
  if (document.title !== title) document.title = title;
}

function showLink() {
  const { kind, silent_s } = link();
  const text = {
    live: "live",
    connecting: silent_s > 5 ? `no connection for ${span(silent_s)}, trying again` : "connecting",
    stale: `stale: nothing heard for ${span(silent_s)}`,
    paused: "paused while hidden",
  }[kind];
  say(by("link-text"), text);
  by("link").dataset.kind = kind;
  showControl();
}

function showControl() {
  const holder = state.control?.viewer ?? null;
  const viewers = state.console?.viewers ?? 1;
  const others = viewers > 1 ? ` · ${viewers} pages open` : "";
  const mine = holder !== null && holder === viewer();
  const text = mine ? "This page controls" : holder === null ? "Nobody controls" : silent() ? `Another page controls, silent for ${span(state.control.age_s)}` : "Another page controls";
  say(by("control-text"), text + others);
  by("control").dataset.mine = mine ? "yes" : "no";
  const take = by("take");
  say(take, mine ? "Release control" : "Take control");
  gate(take, link().kind === "connecting" ? "There is no connection to the console." : null);
}

/** Wires the header. */
export function startHeader() {
  by("stop").addEventListener("click", stop);
  by("take").addEventListener("click", async () => {
    const address = controls() ? "api/control/release" : "api/control/take";
    if (await attempt(address)) announce(address.endsWith("take") ? "This page controls the bench" : "Control released");
  });
  watch(["console"], showRig);
  watch(["job", "capture"], showTitle);
  watch(["console", "control"], showControl);
  watch(["link"], showLink);
  setInterval(() => {
    if (controls()) act("api/control/ping").catch(() => {});
  }, PING_MS);
}
