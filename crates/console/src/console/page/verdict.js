// What a fit came to, in a few words.

import { h } from "./dom.js";
import { digits } from "./format.js";

const VERDICTS = {
  explains: ["✓", "explains the images"],
  reservations: ["!", "with reservations"],
  "not-to-be-trusted": ["✗", "not to be trusted"],
};

/** A verdict with its sign, as text. */
export function verdictWords(verdict) {
  return (VERDICTS[verdict] ?? ["?", verdict]).join(" ");
}

/** A verdict as a badge; a sign and words, not its colour alone. */
export function badge(fit) {
  if (!fit) return h("span", { class: "badge none" }, "no fit");
  const [sign, words] = VERDICTS[fit.verdict] ?? ["?", fit.verdict ?? "no verdict"];
  return h("span", { class: `badge ${fit.verdict}`, title: fit.verdict_text ?? null }, h("span", { "aria-hidden": "true" }, sign), ` ${words}`);
}

/** The newest fit of a session. */
export function latest(session) {
  return session.fits?.at(-1) ?? null;
}

/** The fit's error against the truth, which a simulated session knows; else χ². */
export function quality(fit) {
  if (!fit) return "–";
  const chi2 = Number.isFinite(fit.chi2) ? `χ² ${digits(fit.chi2, 3)}` : null;
  const error = Number.isFinite(fit.environment_error) ? `error ${digits(100 * fit.environment_error, 2)}%` : null;
  return [chi2, error].filter(Boolean).join(", ") || "–";
}

/** How many of a session's lights are captured. */
export function done(session) {
  const lights = `${session.lights} ${session.lights === 1 ? "light" : "lights"}`;
  return session.complete || session.lights_finished == null ? lights : `${session.lights_finished} of ${lights}`;
}
