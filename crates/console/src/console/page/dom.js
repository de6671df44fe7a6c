// Elements from a short description. Text only ever enters as text.

const SVG = "http://www.w3.org/2000/svg";

/**
 * An element. `about`: attributes; `onclick` and the like are listeners, `class` is a
 * class, true and false set and leave out. Children are elements, texts or null.
 */
export function h(name, about = {}, ...children) {
  return fill(document.createElement(name), about, children);
}

/** The same for SVG. */
export function s(name, about = {}, ...children) {
  return fill(document.createElementNS(SVG, name), about, children);
}

function fill(element, about, children) {
  for (const [key, value] of Object.entries(about)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** The element with this id. */
export function by(id) {
  return document.getElementById(id);
}

/** Sets a text only where it differs, so that screen readers and selections stay calm. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Replaces children only where their description differs from the last one. */
export function redraw(element, key, children) {
  const text = JSON.stringify(key);
  if (element.drawnFrom === text) return;
  element.drawnFrom = text;
  element.replaceChildren(...children().filter((child) => child !== null));
}

/** The control that was switched off under whoever used it. */
let stood = null;

/**
 * Disables a control with a reason, which takes the place of its tooltip, or enables it if there is
 * none; whoever stood on it stands there again.
 */
export function gate(control, reason) {
  const blocked = Boolean(reason);
  if (control.disabled !== blocked) {
    if (blocked && document.activeElement === control) stood = control;
    control.disabled = blocked;
    if (!blocked && stood === control) {
      stood = null;
      if (document.activeElement === document.body) control.focus({ preventScroll: true });
    }
  }
  control.dataset.about ??= control.title;
  const title = blocked ? reason : control.dataset.about;
  if (title) control.title = title;
  else control.removeAttribute("title");
}

/** Whoever stood on a control that is gone or off stands here, on what follows. */
export function standOn(element) {
  if (document.activeElement !== document.body) return;
  element.tabIndex = Math.min(element.tabIndex, 0);
  element.focus();
}

/** A panel with a heading. */
export function panel(title, about, ...children) {
  return h("section", { ...about, class: `panel ${about.class ?? ""}` }, h("h3", {}, title), ...children);
}

/** A labelled input. */
export function field(label, input, ...rest) {
  return h("label", { class: "field" }, h("span", {}, label), input, ...rest);
}

/** A list of names and values; `rows`: pairs, a row whose value is null is left out. */
export function facts(element, rows) {
  const shown = rows.filter(([, value]) => value !== null && value !== undefined);
  redraw(element, shown, () => shown.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
}

/** A button that copies the text which `text()` returns, and says that it did. */
export function copyButton(text, what) {
  const button = h("button", { type: "button", class: "quiet", "aria-label": `Copy ${what}` }, "Copy");
  button.addEventListener("click", async () => {
    say(button, (await copied(text())) ? "Copied" : "Select and copy by hand");
    setTimeout(() => say(button, "Copy"), 2000);
  });
  return button;
}

// The clipboard's interface exists on secure origins alone, such as loopback.
async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const field = h("textarea", { "aria-hidden": "true", class: "unseen" });
    field.value = text;
    document.body.append(field);
    field.select();
    const done = document.execCommand("copy");
    field.remove();
    return done;
  }
}
