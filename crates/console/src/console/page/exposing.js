// The exposure of the live picture, set by what its frames show while a page wants that.

import { attempt, blocked } from "./header.js";
import { state, watch } from "./stream.js";

/** Where the brightest half percent of the pixels shall lie, in parts of saturation; within these bounds it stays. */
const WANTED = 0.7;
const RIGHT = [0.5, 0.9];
const BRIGHTEST = 0.005;
/** Most that one step changes, darker and brighter. */
const STEP = [0.3, 8];

let on = false;
let asked = null;

/** Whether it is set by itself. */
export function isAutomatic() {
  return on;
}

/** Sets it by itself from now on, or no longer. */
export function automatic(wanted) {
  on = wanted;
  asked = null;
  follow();
}

/** The factor by which the exposure of a frame with these figures is to change. */
function factor({ histogram, clipped_pixels = 0 }) {
  const all = histogram.reduce((sum, pixels) => sum + pixels, 0);
  if (clipped_pixels > BRIGHTEST * all) return STEP[0];
  let bin = histogram.length - 1;
  for (let above = histogram[bin]; bin > 0 && above < BRIGHTEST * all; above += histogram[bin]) bin -= 1;
  const share = (bin + 0.5) / histogram.length;
  return share > RIGHT[0] && share < RIGHT[1] ? 1 : Math.min(STEP[1], WANTED / share);
}

function follow() {
  const { settings, view, camera, busy, connected } = state.bench ?? {};
  // The next bench counts its frames from 1.
  if (!connected) asked = null;
  if (!on || !connected || busy || blocked() || !view?.histogram || !Number.isFinite(settings?.exposure_s)) return;
  // The frames before the last change have come to an end.
  if (asked !== null && view.number < asked + 1) return;
  if (Math.abs(view.exposure_s / settings.exposure_s - 1) > 0.01) return;
  const [least, most] = camera?.exposure_range_s ?? [0, Infinity];
  const wanted_s = Math.min(most, Math.max(least, settings.exposure_s * factor(view)));
  if (Math.abs(wanted_s / settings.exposure_s - 1) < 0.05) return;
  asked = view.number;
  attempt("api/bench/exposure", { exposure_ms: 1e3 * wanted_s, gain: settings.gain ?? 1 });
}

watch(["bench"], follow);
