// The calibrations of the bench, and the one that is guided through.

import { by, gate, h, panel } from "./dom.js";
import { take } from "./benches.js";
import { guidePart } from "./guide.js";
import { blocked, working } from "./header.js";
import { calibrationsPanel } from "./records.js";
import { state, watch } from "./stream.js";

/** The simulated bench of all rehearsals, before an even light. */
const REHEARSAL = ["rehearsal", "rehearsal-flat"];

/** Builds the view; the returned function shows and hides it. */
export function startCalibrate(view) {
  const records = calibrationsPanel();
  const use = h("button", { type: "button", id: "rehearse", onclick: () => take(REHEARSAL[1]) }, "Use the bench of the rehearsals");
  const rehearse = panel("Rehearse", {}, h("p", {}, "Each calibration can be tried on a simulated bench that has every target, in minutes and without devices."), h("div", { class: "row" }, use));
  const list = h("div", { class: "stack narrow" }, rehearse, records.element);
  const guide = guidePart();
  view.append(list, guide.element);
  const show = () => {
    const stood = rehearse.contains(document.activeElement);
    rehearse.hidden = state.console?.rig?.name === REHEARSAL[0];
    if (stood && rehearse.hidden) by("calibrate-title").focus({ preventScroll: true });
    gate(use, blocked() ?? (working() ? "A job is running." : null));
  };
  watch(["console", "control", "job", "link"], show);
  return (on, [kind] = []) => {
    list.hidden = kind !== undefined;
    guide.element.hidden = kind === undefined;
    guide.look(on && kind !== undefined ? kind : null);
    if (on && kind === undefined) records.load();
    show();
  };
}
