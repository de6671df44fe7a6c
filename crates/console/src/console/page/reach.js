// Which directions the stage reaches.

import { degrees } from "./format.js";
import { state } from "./stream.js";

/** Reachable directions and the camera's, for a hemisphere. */
export function surroundings() {
  const rig = state.console?.rig;
  return {
    range: rig?.has_stage ? { azimuth: rig.azimuth_range_deg, elevation: rig.elevation_range_deg } : null,
    camera: rig?.camera_direction ?? null,
  };
}

/** Why the stage can't reach a direction, or null. */
export function unreachable(azimuth_deg, elevation_deg) {
  const { range } = surroundings();
  const [low, high] = range?.elevation ?? [-90, 90];
  if (elevation_deg < low - 1e-6 || elevation_deg > high + 1e-6) {
    return `the stage reaches elevations from ${degrees(low)} to ${degrees(high)}, not ${degrees(elevation_deg)}`;
  }
  const [from, to] = range?.azimuth ?? [-Infinity, Infinity];
  const turns = [-360, 0, 360].map((turn) => azimuth_deg + turn);
  if (to - from < 360 && !turns.some((value) => value >= from - 1e-6 && value <= to + 1e-6)) {
    return `the stage reaches azimuths from ${degrees(from)} to ${degrees(to)}, not ${degrees(azimuth_deg)}`;
  }
  return null;
}
