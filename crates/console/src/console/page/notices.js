// What went wrong, at the head of the page, until it is dismissed or 20 s have passed.

import { by, h, say } from "./dom.js";

const SHOWN_MS = 20000;

/** Shows a failed action; one that repeats is shown once. */
export function complain(error) {
  if (error?.name === "AbortError") return;
  const fact = error?.message ?? String(error);
  const hint = error?.hint ?? null;
  const notices = by("notices");
  const same = [...notices.children].find((notice) => notice.dataset.fact === fact);
  same?.remove();
  const text = h("p", {}, h("strong", {}, capital(fact)), hint ? ` – ${hint}` : null);
  const close = h("button", { type: "button", class: "quiet", "aria-label": "Dismiss this message" }, "Dismiss");
  const notice = h("div", { class: "notice", "data-fact": fact }, text, close);
  close.addEventListener("click", () => notice.remove());
  notices.append(notice);
  setTimeout(() => notice.remove(), SHOWN_MS);
}

/** Tells a screen reader what has changed. */
export function announce(text) {
  say(by("spoken"), text);
}

/** A fact with a capital first letter. */
export function capital(text) {
  return text === "" ? text : text[0].toUpperCase() + text.slice(1);
}
