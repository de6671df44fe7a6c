// Keys that lead somewhere, and the list of them on "?".

import { by, h } from "./dom.js";

const KEYS = [
  ["b", "Bench", () => go("#bench")],
  ["k", "Calibrate", () => go("#calibrate")],
  ["c", "Capture", () => go("#capture")],
  ["q", "Queue", () => go("#queue")],
  ["s", "Sessions", () => go("#sessions")],
  ["u", "Set-up", () => go("#setup")],
  ["/", "Search the sessions", search],
  ["?", "This list", () => open()],
];
const SETTING = "rig-keys";
let dialog = null;

function go(hash) {
  location.hash = hash;
}

function search() {
  go("#sessions");
  setTimeout(() => by("search")?.focus(), 50);
}

/** Single keys can be turned off: speech and tremor type them unasked. */
export function areOn() {
  return localStorage.getItem(SETTING) !== "off";
}

function build() {
  const on = h("input", { type: "checkbox", id: "keys-on" });
  on.checked = areOn();
  on.addEventListener("change", () => localStorage.setItem(SETTING, on.checked ? "on" : "off"));
  const rows = [...KEYS.map(([key, what]) => [key, what]), ["Shift Esc", "STOP, also while typing; always on"]];
  const list = h("dl", { class: "facts keys" }, rows.flatMap(([key, what]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, what)]));
  const close = h("button", { type: "button", onclick: () => dialog.close() }, "Close");
  const about = h("dialog", { "aria-labelledby": "keys-title" }, h("h3", { id: "keys-title" }, "Keyboard shortcuts"), list, h("label", { class: "choice" }, on, h("span", {}, "single keys act")), close);
  document.body.append(about);
  return about;
}

function open() {
  dialog ??= build();
  // Not modal: STOP stays in reach.
  if (dialog.open) dialog.close();
  else dialog.show();
  if (dialog.open) dialog.querySelector("button").focus();
}

/** Where a key is text, or acts on the control that has the focus. */
export function typing(target) {
  return target.closest?.("input, select, textarea, [role=application], [contenteditable]") !== null;
}

/** Wires keys and button. */
export function startShortcuts() {
  by("keys").addEventListener("click", open);
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && event.shiftKey) {
      event.preventDefault();
      by("stop").click();
      return;
    }
    if (event.key === "Escape" && dialog?.open) {
      dialog.close();
      by("keys").focus();
      return;
    }
    if (event.ctrlKey || event.altKey || event.metaKey || event.isComposing || event.repeat || !areOn() || typing(event.target)) return;
    const known = KEYS.find(([key]) => key === event.key);
    if (!known) return;
    event.preventDefault();
    known[2]();
  });
}
