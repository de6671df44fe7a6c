// Numbers as a person reads them at a bench: few digits, units, a true minus sign.

const MINUS = "\u2212";

function signed(text) {
  return text.replace(/^-/, MINUS);
}

/** With this many significant digits, without an exponent. */
export function digits(value, count = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const places = Math.max(0, count - 1 - Math.floor(Math.log10(Math.abs(value))));
  return signed(value.toFixed(Math.min(places, 12)));
}

/** With this many decimal places. */
export function fixed(value, places) {
  return Number.isFinite(value) ? signed(value.toFixed(places)) : "–";
}

/** The first hundred characters of a text. */
export function short(text) {
  return text?.length > 100 ? `${text.slice(0, 100)}…` : text;
}

/** An exposure: µs, ms or s. */
export function exposure(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds < 1e-3) return `${digits(seconds * 1e6)} µs`;
  if (seconds < 1) return `${digits(seconds * 1e3)} ms`;
  return `${digits(seconds)} s`;
}

/** A span of time in whole seconds, minutes or hours. */
export function span(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
  return `${Math.floor(whole / 3600)} h ${String(Math.floor((whole % 3600) / 60)).padStart(2, "0")} min`;
}

/** How long ago. */
export function age(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds < 90) return `${Math.max(0, Math.round(seconds))} s ago`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min ago`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h ago`;
  return `${Math.round(seconds / 86400)} days ago`;
}

/** Bytes in decimal units. */
export function bytes(count) {
  if (!Number.isFinite(count)) return "–";
  const units = ["B", "kB", "MB", "GB", "TB"];
  let unit = 0;
  while (count >= 1000 && unit < units.length - 1) {
    count /= 1000;
    unit += 1;
  }
  return `${unit === 0 ? count : digits(count)} ${units[unit]}`;
}

/** A direction: azimuth and elevation. */
export function direction(azimuth, elevation) {
  return `azimuth ${degrees(azimuth)}, elevation ${degrees(elevation)}`;
}

/** An angle in degrees with at most one decimal. */
export function degrees(value) {
  return `${signed(String(Number(value.toFixed(1))))}°`;
}

/** Drift in percent with its standard uncertainty. */
export function drift(percent, uncertainty) {
  if (!Number.isFinite(percent)) return "–";
  const value = `${percent > 0 ? "+" : ""}${fixed(percent, 2)}`;
  return Number.isFinite(uncertainty) ? `${value} ± ${fixed(uncertainty, 2)}%` : `${value}%`;
}

/** A count with thin spaces between thousands. */
export function count(value) {
  return Number.isFinite(value) ? String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, "\u202f") : "–";
}

/** A UTC time as date and time of this computer's zone. */
export function when(utc) {
  // Null would be 1970.
  const date = new Date(utc ?? NaN);
  if (Number.isNaN(date.getTime())) return "–";
  const two = (number) => String(number).padStart(2, "0");
  return `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())} ${two(date.getHours())}:${two(date.getMinutes())}`;
}
