// The bench: camera and stage before a capture.

import { facts, field, gate, h, panel, redraw, say } from "./dom.js";
import { direction, digits, exposure, span } from "./format.js";
import { automatic, isAutomatic } from "./exposing.js";
import { attempt, blocked, capturing } from "./header.js";
import { hemisphere } from "./hemisphere.js";
import { livePanels } from "./live.js";
import { announce, complain } from "./notices.js";
import { surroundings, unreachable } from "./reach.js";
import { now, state, watch } from "./stream.js";

/** What keeps the bench from taking another command. */
const BUSY = {
  connecting: "The devices are being opened.",
  homing: "The stage is homing.",
  moving: "The stage is moving.",
  switching: "The lamp is being switched.",
  stopping: "Motion and lamp are being stopped.",
  disconnecting: "The devices are being closed.",
};

/** Why camera and stage can't be used now, or null. */
function notReady(reason) {
  const bench = state.bench;
  if (reason) return reason;
  if (!bench?.connected) return "Connect first.";
  return bench.busy ? (BUSY[bench.busy] ?? `The bench is ${bench.busy}.`) : null;
}

/** Why the devices can't be used now, or null. */
function unavailable() {
  if (capturing()) return "A capture is running: camera and stage belong to it.";
  return blocked();
}

/** Builds the view; the returned function shows and hides it. */
export function startBench(view) {
  const live = livePanels();
  const connection = connectionPanel();
  const settings = settingsPanel();
  const stage = stagePanel();
  const lamps = lampPanel();
  const why = h("p", { class: "why" });
  view.append(
    h(
      "div",
      { class: "stack" },
      why,
      connection.element,
      h("div", { class: "bench-grid" }, h("div", { class: "stack" }, live.picture, live.figures), h("div", { class: "stack" }, settings.element, stage.element, lamps.element)),
    ),
  );
  const show = () => {
    const reason = unavailable();
    say(why, reason ?? "");
    for (const part of [connection, settings, stage, lamps]) part.show(reason);
  };
  watch(["bench", "console", "control", "job", "link"], show);
  return (shown) => {
    live.look(shown);
    show();
  };
}

function connectionPanel() {
  const button = h("button", { type: "button", class: "primary", title: "Opens camera and stage; a capture takes them over by itself" }, "Connect");
  const status = h("p", { role: "status" });
  const error = h("p", { class: "error", role: "alert" });
  button.addEventListener("click", () => attempt(state.bench?.connected ? "api/bench/disconnect" : "api/bench/connect"));
  const element = panel("Devices", { class: "devices" }, button, status, error);
  function show(reason) {
    const bench = state.bench;
    const busy = bench?.busy === "connecting";
    say(button, bench?.connected ? "Disconnect" : busy ? "Connecting …" : "Connect");
    button.classList.toggle("primary", !bench?.connected);
    gate(button, reason ?? BUSY[bench?.busy] ?? (bench?.lent_to ? `The devices are in use by ${bench.lent_to}.` : null));
    const camera = bench?.camera;
    say(status, bench?.connected ? (camera ? `${camera.model}${camera.serial ? `, serial ${camera.serial}` : ""}` : "Connected") : "Not connected");
    const failed = bench?.error;
    say(error, failed ? `${failed.error}${failed.hint ? ` – ${failed.hint}` : ""}` : "");
  }
  return { element, show };
}

function settingsPanel() {
  const time = h("input", { type: "number", id: "exposure", min: "0.001", step: "any", inputmode: "decimal", required: true });
  const gain = h("input", { type: "number", id: "gain", min: "1", step: "any", inputmode: "decimal", required: true });
  const set = h("button", { type: "submit" }, "Set");
  const range = h("p", { class: "fine" });
  const form = h("form", { class: "row" }, field("Exposure, ms", time), field("Gain", gain), set);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt("api/bench/exposure", { exposure_ms: time.valueAsNumber, gain: gain.valueAsNumber });
  });
  const half = h("button", { type: "button", "aria-label": "½× the exposure" }, "½×");
  const twice = h("button", { type: "button", "aria-label": "2× the exposure" }, "2×");
  for (const [button, factor] of [[half, 0.5], [twice, 2]]) {
    button.addEventListener("click", () => {
      const camera = state.bench?.camera;
      const now_s = state.bench?.settings?.exposure_s ?? 0.01;
      const [least, most] = camera?.exposure_range_s ?? [0, Infinity];
      const exposure_ms = 1e3 * Math.min(most, Math.max(least, now_s * factor));
      attempt("api/bench/exposure", { exposure_ms, gain: state.bench?.settings?.gain ?? 1 });
    });
  }
  const auto = h("button", { type: "button", class: "toggle", id: "auto-exposure", title: "Sets the exposure by what the frames show" }, "Auto");
  auto.addEventListener("click", () => {
    automatic(!isAutomatic());
    show(last);
  });
  form.append(half, twice, auto);
  let last = null;
  let known = null;
  function show(reason) {
    last = reason;
    const bench = state.bench;
    const settings = bench?.settings;
    // What the camera applied replaces what was typed, but never while somebody types.
    const key = settings ? `${settings.exposure_s} ${settings.gain}` : null;
    if (key !== known && Number.isFinite(settings?.exposure_s) && !form.contains(document.activeElement)) {
      time.value = digits(settings.exposure_s * 1e3, 5).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
      gain.value = String(settings.gain);
      known = key;
    }
    const off = reason ?? (bench?.connected ? (Number.isFinite(settings?.exposure_s) ? null : "The exposure of this camera cannot be set.") : "Connect first.");
    auto.setAttribute("aria-pressed", String(isAutomatic()));
    gate(auto, off);
    for (const control of [time, gain, set, half, twice]) gate(control, off ?? (isAutomatic() ? "It is set by itself: press “Auto” to end that." : null));
    const limits = bench?.camera?.exposure_range_s;
    say(range, limits && Number.isFinite(settings?.exposure_s) && Number.isFinite(limits[0]) ? `Applied: ${exposure(settings.exposure_s)}. Allowed: ${exposure(limits[0])} to ${exposure(limits[1])}.` : "");
  }
  return { element: panel("Exposure", {}, form, range), show };
}

function stagePanel() {
  const azimuth = h("input", { type: "number", min: "-180", max: "360", step: "any", inputmode: "decimal", required: true });
  const elevation = h("input", { type: "number", min: "0", max: "90", step: "any", inputmode: "decimal", required: true });
  const go = h("button", { type: "submit", title: "Moves the lamp to this direction" }, "Move");
  const home = h("button", { type: "button", title: "Moves the stage to its reference, so that its position is known", onclick: () => attempt("api/bench/home") }, "Home");
  const form = h("form", { class: "row" }, field("Azimuth, °", azimuth), field("Elevation, °", elevation), go, home);
  const list = h("dl", { class: "facts" });
  const map = hemisphere("Directions the lamp can move to. Arrow keys aim in steps of 5°, with Shift 1°; Enter moves there", {
    onpick: (az, el) => {
      azimuth.value = az;
      elevation.value = el;
      move(az, el);
    },
    help: "Click or tap a direction to move the lamp there; or aim by the arrow keys and press Enter.",
  });

  async function move(azimuth_deg, elevation_deg) {
    const outside = unreachable(azimuth_deg, elevation_deg);
    if (outside) return complain(new Error(outside));
    announce(`Moving to ${direction(azimuth_deg, elevation_deg)}`);
    await attempt("api/bench/move", { azimuth_deg, elevation_deg });
  }
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    move(azimuth.valueAsNumber, elevation.valueAsNumber);
  });
  const element = panel("Stage", {}, list, map.element, form);

  function show(reason) {
    const bench = state.bench;
    element.hidden = state.console?.mode === "camera" || state.console?.rig?.has_stage === false;
    const position = bench?.stage?.position ?? null;
    const busy = bench?.busy ?? null;
    const off = notReady(reason);
    const unknown = off ?? (position ? null : "The position is unknown: home the stage first.");
    gate(home, off);
    for (const control of [azimuth, elevation, go]) gate(control, unknown);
    // The fields begin with where the lamp is; what was typed stays.
    if (position && azimuth.value === "" && elevation.value === "") {
      azimuth.value = Number(position.azimuth_deg.toFixed(1));
      elevation.value = Number(position.elevation_deg.toFixed(1));
    }
    facts(list, [
      ["Position", position ? direction(position.azimuth_deg, position.elevation_deg) : bench?.connected ? "unknown until homed" : "–"],
      ["State", busy ?? bench?.stage?.activity ?? "–"],
    ]);
    map.show({ ...surroundings(), position, target: bench?.stage?.target ?? null, lamp: bench?.stage?.lamp != null, blocked: unknown });
  }
  return { element, show };
}

function lampPanel() {
  const buttons = h("div", { class: "row" });
  const status = h("p", { class: "fine", role: "status" });
  const element = panel("Lamp", {}, buttons, status, h("p", { class: "fine" }, "A lamp that was lit here goes out 30 s after this page has fallen silent, and when the console ends."));
  let offAt = null;
  function light(channel) {
    attempt("api/bench/lamp", { channel: state.bench?.stage?.lamp === channel ? null : channel });
  }
  function show(reason) {
    const bench = state.bench;
    const channels = state.console?.rig?.channels ?? [];
    element.hidden = state.console?.mode === "camera" || state.console?.rig?.has_stage === false || channels.length === 0;
    redraw(buttons, channels, () => channels.map((name, i) => h("button", { type: "button", class: "toggle", title: `Lights the ${name} lamp, or puts it out`, onclick: () => light(i) }, name)));
    const lit = bench?.stage?.lamp ?? null;
    const off = notReady(reason);
    [...buttons.children].forEach((button, i) => {
      button.setAttribute("aria-pressed", String(lit === i));
      gate(button, off);
    });
    offAt = lit !== null && bench?.lamp_off_in_s != null ? now() + bench.lamp_off_in_s * 1000 : null;
    tick();
  }
  function tick() {
    const lit = state.bench?.stage?.lamp ?? null;
    const name = state.console?.rig?.channels?.[lit] ?? `channel ${lit}`;
    const left = offAt === null ? "" : `; off in ${span((offAt - now()) / 1000)} unless its page keeps control`;
    const word = state.bench?.stage?.lamp_word;
    const sent = state.bench?.stage && word !== "reported" ? "Sent, not verified: this stage does not report its lamp." : "";
    const is = lit === null ? (word === null ? "Not known." : "Off.") : `On: ${name}${left}.`;
    say(status, [is, sent].filter(Boolean).join(" "));
  }
  setInterval(tick, 1000);
  return { element, show };
}
