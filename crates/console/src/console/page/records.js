// The calibrations of the bench: how old each is, whether it holds, what it is worth, how it is made.

import { ask } from "./api.js";
import { copyButton, gate, h, panel } from "./dom.js";
import { age } from "./format.js";
import { capital } from "./notices.js";

/** A panel whose content is loaded, with a button to load it again. */
export function loaded(title, address, content) {
  const list = h("div", { class: "loaded" });
  const button = h("button", { type: "button", class: "quiet", onclick: () => load() }, "Check again");
  const element = panel(title, {}, list, button);
  async function load() {
    gate(button, "Checking …");
    if (!list.firstChild) list.append(h("p", { class: "fine" }, "Checking …"));
    try {
      list.replaceChildren(content(await ask(address)));
    } catch (error) {
      list.replaceChildren(h("p", { class: "error" }, `${capital(error.message)}${error.hint ? ` – ${error.hint}` : ""}`));
    }
    gate(button, null);
  }
  return { element, load };
}

/** What a record is of, and what is put before the camera for it. */
const KINDS = {
  sensor: ["Sensor", "an even, steady light; noise, full well, linearity"],
  flat: ["Flat field", "the same light; how sensitive each pixel is"],
  scale: ["Radiometric scale", "a light of certified radiance"],
  lights: ["Irradiance", "a white standard in the sample’s place, from its session"],
  directions: ["Light directions", "a mirror ball in the sample’s place, from its session"],
  lamp: ["Lamp", "a white card, the lamp cold: warm-up, drift, flicker"],
  focus: ["Focus", "a slanted edge at three heights"],
  pose: ["Pose", "the sample as it lies, from its session"],
  response: ["Response curve", "a camera that is not linear"],
  camera: ["Lens", "a checkerboard: focal length, distortion"],
  glare: ["Glare", "a hole into a black box in a white card"],
};
const STATES = { good: "ok", doubtful: "doubtful", refused: "refused", missing: "none" };
const named = (kind) => KINDS[kind]?.[0] ?? capital(kind);
const made = (record) => (record.date ? age((Date.now() - Date.parse(record.date)) / 1000) : "–");

/** The records at a glance, before a capture. */
export function recordsPanel() {
  return loaded("Calibrations", "api/calibrations", ({ records = [] }) => {
    const row = (record) => h("tr", { class: record.state }, h("th", { scope: "row" }, named(record.kind)), h("td", {}, STATES[record.state] ?? record.state), h("td", {}, made(record)));
    return h("div", {}, h("table", { class: "records" }, h("thead", {}, h("tr", {}, ["Record", "State", "Made"].map((name) => h("th", { scope: "col" }, name)))), h("tbody", {}, records.map(row))), h("p", {}, h("a", { href: "#calibrate" }, "What each is worth, and how it is made")));
  });
}

/** Every record in full. */
export function calibrationsPanel() {
  return loaded("Calibrations", "api/calibrations", ({ records = [], library }) => {
    const item = (record) => {
      const [, target] = KINDS[record.kind] ?? [];
      const mark = record.state === "good" ? "explains" : record.state === "missing" ? "none" : "reservations";
      return h(
        "li",
        {},
        h("h4", {}, named(record.kind), " ", h("span", { class: `badge ${mark}` }, STATES[record.state] ?? record.state), record.date ? h("span", { class: "fine" }, ` ${made(record)}`) : null),
        h("p", {}, capital(record.summary)),
        (record.concerns ?? []).map((concern) => h("p", { class: "warn" }, concern)),
        record.guide ? h("p", {}, h("a", { class: "button", href: `#calibrate/${record.guide}` }, record.state === "missing" ? "Measure it" : "Measure it again")) : null,
        h("details", {}, h("summary", {}, record.guide ? "At the terminal" : "How it is made"), target ? h("p", { class: "fine" }, `Before the camera: ${target}.`) : null, record.method ? h("p", { class: "fine" }, `The present one: ${record.method}.`) : null, h("div", { class: "copy" }, h("code", { class: "command", tabindex: "0" }, record.command), copyButton(() => record.command, record.command))),
      );
    };
    return h("div", {}, h("ul", { class: "calibrations" }, records.map(item)), h("p", { class: "fine" }, records.some((record) => record.guide) ? `Records in ${library}.` : "These records are built into the program. Others are made with a rig file of your own, or on the bench of the rehearsals."));
  });
}
