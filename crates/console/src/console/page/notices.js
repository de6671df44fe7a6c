// What went wrong, and what STOP came to, at the head of the page, until it is dismissed or 20 s have passed.

import { by, h, say } from "./dom.js";

const SHOWN_MS = 20000;

/** Shows a failed action; one that repeats is shown once. */
export function complain(error) {
  if (error?.name === "AbortError") return;
  notice(error?.message ?? String(error), error?.hint ?? null, "wrong");
}

/** Shows what an action came to, in place of the last such answer. */
export function tell(text) {
  for (const answer of by("notices").querySelectorAll(".answer")) answer.remove();
  notice(text, null, "answer");
}

function notice(fact, hint, kind) {
  const notices = by("notices");
  const same = [...notices.children].find((one) => one.dataset.fact === fact);
  same?.remove();
  const text = h("p", {}, h("strong", {}, capital(fact)), hint ? ` – ${hint}` : null);
  const close = h("button", { type: "button", class: "quiet", "aria-label": "Dismiss this message" }, "Dismiss");
  const element = h("div", { class: `notice ${kind}`, "data-fact": fact }, text, close);
  close.addEventListener("click", () => element.remove());
  notices.append(element);
  setTimeout(() => element.remove(), SHOWN_MS);
}

/** Tells a screen reader what has changed. */
export function announce(text) {
  say(by("spoken"), text);
}

/** A fact with a capital first letter. */
export function capital(text) {
  return text === "" ? text : text[0].toUpperCase() + text.slice(1);
}
