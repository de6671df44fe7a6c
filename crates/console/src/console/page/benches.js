// The benches of the console's folder: which one it works with, and their rig files to edit.

import { act, ask } from "./api.js";
import { by, gate, h, panel, redraw, say } from "./dom.js";
import { benchDrawing } from "./drawings.js";
import { attempt, blocked, working } from "./header.js";
import { announce, capital, complain } from "./notices.js";
import { state, watch } from "./stream.js";

/** What the benches that are not files of the folder are for. */
const BUILT_IN = { simulated: "without devices", "rehearsal-flat": "to practise calibrations" };

/** The two panels; `load()` reads the list again, `known(name)` is the bench of this name or file. */
export function benchesPart() {
  const list = h("ul", { class: "benches" });
  const again = h("button", { type: "button", class: "quiet", onclick: () => load() }, "Look again");
  const why = h("p", { class: "why" });
  const drawn = h("div", {});
  const editor = rigEditor(() => load());
  const element = h("div", { class: "stack" }, panel("Benches", {}, h("p", {}, "A rig file that was changed in an editor is read again by “Use”."), list, drawn, again, why), editor.element);
  let rigs = [];
  let uses = [];

  async function load() {
    try {
      ({ rigs } = await ask("api/rigs"));
    } catch (failure) {
      return complain(failure);
    }
    uses = [];
    list.replaceChildren(...rigs.map(row));
    show();
  }

  function draw() {
    const direction = state.console?.rig?.camera_direction;
    redraw(drawn, direction ?? null, () => (direction ? [benchDrawing(direction)] : []));
  }

  function row(one) {
    const is = one.in_use ? (one.changed ? "in use; its file has changed" : "in use") : null;
    const use = h("button", { type: "button", class: one.changed ? "primary" : null, onclick: () => take(one.rig) }, one.in_use ? "Use again" : "Use");
    use.setAttribute("aria-label", `${use.textContent}: ${one.rig}`);
    uses.push(use);
    return h(
      "li",
      { "aria-current": one.in_use ? "true" : null },
      h("div", {}, h("strong", {}, one.name ?? one.rig), BUILT_IN[one.rig] ? h("span", { class: "fine" }, ` built in, ${BUILT_IN[one.rig]}`) : h("code", {}, ` ${one.rig}`), is ? h("span", { class: "mark" }, is) : null, one.error ? h("p", { class: "error" }, capital(one.error)) : null),
      h("div", { class: "row" }, one.error && !one.in_use ? null : use, one.can_edit ? h("button", { type: "button", "aria-label": `Edit ${one.rig}`, onclick: () => editor.open(one.rig) }, "Edit") : null),
    );
  }

  function show() {
    const reason = blocked() ?? (working() ? "A job is running: the bench can be changed when it has ended." : null);
    for (const use of uses) gate(use, reason);
    say(why, reason ?? "");
    editor.show(reason);
  }
  watch(["control", "link", "job"], show);
  watch(["console"], draw);
  const known = (name) => rigs.find((one) => one.can_edit && [one.name, one.rig, one.rig.replace(/\.toml$/, "")].includes(name));
  return { element, load, known, edit: editor.open };
}

/** The console works with this bench from now on; every page then shows it where it is. */
export async function take(rig) {
  if (await attempt("api/rigs/use", { rig })) announce("The bench is being changed");
}

/** A rig file as text. `changed()` when it was saved. */
function rigEditor(changed) {
  const text = h("textarea", { id: "rig-text", rows: "24", spellcheck: "false", autocapitalize: "off", autocomplete: "off", "aria-label": "Text of the rig file", "aria-describedby": "rig-help" });
  const save = h("button", { type: "submit", class: "primary", id: "save-rig" }, "Save");
  const use = h("button", { type: "button", id: "save-use-rig", onclick: () => keep(true) }, "Save and use");
  const close = h("button", { type: "button", class: "quiet", onclick: () => leave() }, "Close");
  const error = h("p", { class: "error", role: "alert" });
  const status = h("p", { class: "fine", role: "status" });
  const title = h("h4", {});
  const drawn = h("div", {});
  const form = h("form", { class: "stack-form wide" }, text, h("div", { class: "row" }, save, use, close), error, status);
  const element = panel("Edit a rig file", { hidden: true }, title, h("p", { class: "fine", id: "rig-help" }, "Each key is explained in the file. It is checked before it is saved; the file as it was stays next to it, with .before after its name."), drawn, form);
  let opened = null;
  let from = null;

  async function open(rig) {
    from = document.activeElement;
    try {
      opened = await ask(`api/rigs/text?rig=${encodeURIComponent(rig)}`);
    } catch (failure) {
      return complain(failure);
    }
    text.value = opened.text;
    say(title, opened.rig);
    say(status, "");
    element.hidden = false;
    shown();
    text.focus();
    text.setSelectionRange(0, 0);
    text.scrollTop = 0;
    element.scrollIntoView({ block: "start" });
  }

  /** Back to where it was opened. */
  function leave() {
    element.hidden = true;
    (from?.isConnected ? from : by("setup-title")).focus();
  }

  function shown() {
    say(error, opened.error ? capital(opened.error) : "");
    drawn.replaceChildren(...(opened.camera_direction ? [benchDrawing(opened.camera_direction)] : []));
  }

  async function keep(using) {
    say(error, "");
    say(status, "");
    try {
      opened = await act("api/rigs/save", { rig: opened.rig, text: text.value, sum: opened.sum });
    } catch (failure) {
      return say(error, `${capital(failure.message)}${failure.hint ? ` – ${failure.hint}` : ""}`);
    }
    say(status, "Saved.");
    shown();
    await changed();
    if (using) await take(opened.rig);
  }
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    keep(false);
  });
  function show(reason) {
    gate(save, blocked());
    gate(use, reason);
  }
  return { element, open, show };
}
