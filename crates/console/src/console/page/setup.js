// From boxes to a bench: the questions of `rig init` as a form, then what to calibrate.

import { act, ask } from "./api.js";
import { benchesPart, take } from "./benches.js";
import { copyButton, gate, h, panel, redraw, say } from "./dom.js";
import { drawing } from "./drawings.js";
import { blocked } from "./header.js";
import { announce, capital, complain } from "./notices.js";
import { watch } from "./stream.js";
import { tryPanel } from "./trying.js";

/** The parts of a bench in the order of their questions: id, heading, and which keys belong to it. */
const SECTIONS = [
  ["name", "Name", /^name$/],
  ["camera", "Camera", /^(camera|camera_address|width_px|height_px|bit_depth|mosaic)$/],
  ["lens", "Lens", /^(lens|field_width_mm|focal_mm|pixel_um|f_number|camera_(distance_mm|tilt_deg)|housing.*)$/],
  ["sample", "Sample", /^(sample_|groove_|mesh_)/],
  ["stage", "Stage", /^(stage|port|lamp_distance_mm|lights|dmx_first|mechanism|azimuth_|elevation_|[xy]_|first_|second_)/],
  ["lamp", "Lamp", /^(lamp$|grbl_|zaber_|warm_up_s)/],
  ["more", "More", /./],
];

/** Builds the view; the returned function shows and hides it. */
export function startSetup(view) {
  const benches = benchesPart();
  const questions = h("div", { class: "questions" });
  const write = h("button", { type: "submit", class: "primary", id: "write-rig" }, "Write the rig file");
  const again = h("button", { type: "button", class: "quiet", onclick: () => load(true) }, "Look for devices again");
  const exists = h("p", { class: "why", role: "status" });
  const why = h("p", { class: "why" });
  const error = h("p", { class: "error", role: "alert" });
  const form = h("form", { class: "stack-form" }, questions, h("div", { class: "row" }, write, again), exists, why, error);
  const result = h("div", { role: "status" });
  view.append(
    h(
      "div",
      { class: "stack narrow" },
      benches.element,
      tryPanel(),
      panel("A new bench of your own", {}, h("p", {}, "Answer what rig cannot find out by itself. It writes a commented rig file; a second bench gets a file with its own name."), form),
      result,
    ),
  );
  let asked = [];
  let boxes = new Map();
  let loaded = false;

  async function load(anew) {
    if (loaded && !anew) return;
    loaded = true;
    gate(again, "Looking for devices …");
    try {
      const given = answers();
      asked = await ask("api/setup");
      boxes = new Map(asked.map((question) => [question.key, entry(question, given[question.key])]));
      questions.replaceChildren(...sections(boxes));
      arrange();
    } catch (failure) {
      loaded = false;
      complain(failure);
    }
    gate(again, null);
  }

  /** What was typed so far, by key; questions that are not asked are left out. */
  function answers() {
    const given = {};
    for (const question of asked) {
      const input = form.elements[`q-${question.key}`];
      if (!input || !isAsked(question)) continue;
      const text = question.kind === "choice" && question.others && input.value === "" ? (form.elements[`q-${question.key}-other`]?.value ?? "") : input.value;
      if (text === "") continue;
      given[question.key] = question.kind === "number" ? Number(text) : question.kind === "yes-no" ? text === "yes" : text;
    }
    return given;
  }

  function isAsked(question) {
    if (!question.when) return true;
    const on = asked.find((one) => one.key === question.when.key);
    if (!on || !isAsked(on)) return false;
    const value = form.elements[`q-${on.key}`]?.value;
    return [question.when.is].flat().map(String).includes(String(value));
  }

  /** Shows the questions that are asked, and the field for another value. */
  function arrange() {
    asked.forEach((question) => {
      const box = boxes.get(question.key);
      const on = isAsked(question);
      box.hidden = !on;
      for (const input of box.querySelectorAll("input, select")) input.disabled = !on;
      const other = box.querySelector(".other");
      if (other) {
        other.hidden = form.elements[`q-${question.key}`].value !== "";
        other.querySelector("input").disabled = !on || other.hidden;
      }
      const choice = form.elements[`q-${question.when?.key}`]?.value;
      box.querySelector(".help")?.replaceChildren(...sentences(question.help, choice));
    });
    // A part of which nothing is asked has no heading.
    for (const section of questions.children) section.hidden = [...section.querySelectorAll(".question")].every((box) => box.hidden);
  }

  /** A bench of this name that exists is opened for editing, not made again. */
  function showExisting() {
    const one = benches.known(form.elements["q-name"]?.value.trim());
    redraw(exists, one?.rig ?? null, () => (one ? [`${one.rig} exists. `, h("button", { type: "button", class: "quiet", onclick: () => benches.edit(one.rig) }, "Edit it")] : []));
    show();
  }

  form.addEventListener("input", arrange);
  form.addEventListener("input", showExisting);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    say(error, "");
    gate(write, "Writing …");
    try {
      const { file, next = [], steps = null } = await act("api/setup", { answers: answers() });
      result.replaceChildren(done(file, steps ?? next.map((command) => ({ command, purpose: null }))));
      result.scrollIntoView({ block: "nearest" });
      await benches.load();
      announce(`${file} was written`);
    } catch (failure) {
      say(error, `${capital(failure.message)}${failure.hint ? ` – ${failure.hint}` : ""}`);
    }
    show();
  });
  function show() {
    const reason = blocked() ?? (exists.firstChild ? "A bench of this name exists." : null);
    gate(write, reason);
    say(why, reason ?? "");
  }
  watch(["control", "link"], show);
  return (on) => {
    if (on) load(false);
    if (on) benches.load();
    show();
  };
}

/** The questions by the parts of a bench, each part with a drawing. */
function sections(boxes) {
  const left = new Map(boxes);
  return SECTIONS.flatMap(([part, title, keys]) => {
    const mine = [...left].filter(([key]) => keys.test(key));
    for (const [key] of mine) left.delete(key);
    if (mine.length === 0) return [];
    return [h("section", { class: "part", "aria-labelledby": `part-${part}` }, h("h4", { id: `part-${part}` }, title), drawing(part), h("div", { class: "entries" }, mine.map(([, box]) => box)))];
  });
}

/**
 * An explanation as sentences, with what is typed as code. Where it has a part for each answer
 * to another question ("v4l: …; folder: …"), only that of the answer `choice` stays.
 */
function sentences(help, choice) {
  const parts = help.split(/;\s+(?=[\w.-]+: )/).map((part) => part.match(/^([\w.-]+): ([\s\S]*)$/));
  const mine = parts.length > 1 && parts.every(Boolean) ? parts.find(([, name]) => name === choice)?.[2] : null;
  const words = capital(mine ?? help).replace(/\.$/, "");
  return `${words}.`.split("`").map((piece, i) => (i % 2 ? h("code", {}, piece) : piece));
}

/** A question with its control, its help and its unit. */
function entry(question, given) {
  const id = `q-${question.key}`;
  const help = question.help ? h("p", { class: "fine help", id: `${id}-help` }, sentences(question.help)) : null;
  const about = { id, name: id, "aria-describedby": help ? `${id}-help` : null };
  const value = given ?? question.default ?? null;
  const limits = Number.isFinite(question.least) && Number.isFinite(question.most) ? `, ${question.least} to ${question.most}` : "";
  const label = h("label", { for: id }, capital(question.title), question.unit ? h("span", { class: "fine" }, ` (${question.unit}${limits})`) : limits ? h("span", { class: "fine" }, ` (${limits.slice(2)})`) : null);
  return h("div", { class: "question" }, label, help, control(question, about, value));
}

function control(question, about, value) {
  if (question.kind === "choice") {
    const options = (question.choices ?? []).map((choice) => h("option", { value: choice.value }, choice.label));
    if (question.others) options.push(h("option", { value: "" }, "something else"));
    const select = h("select", about, options);
    const known = (question.choices ?? []).some((choice) => choice.value === value);
    if (value !== null) select.value = known ? value : "";
    if (!question.others) return select;
    const other = h("input", { type: "text", name: `${about.name}-other`, "aria-label": `${question.title}: something else`, required: question.default === null });
    if (value !== null && !known) other.value = value;
    return h("div", {}, select, h("div", { class: "other" }, other));
  }
  if (question.kind === "yes-no") {
    const yes = value === true || value === "yes";
    return h("select", about, h("option", { value: "yes", selected: yes }, "yes"), h("option", { value: "no", selected: !yes }, "no"));
  }
  const number = question.kind === "number";
  const input = h("input", { ...about, type: number ? "number" : "text", step: number ? (question.whole ? "1" : "any") : null, min: number ? question.least : null, max: number ? question.most : null, inputmode: number ? "decimal" : null, required: question.default === null || question.default === undefined, autocomplete: "off" });
  if (value !== null) input.value = value;
  return input;
}

/** The file that was written, and what comes next, in order. */
function done(file, steps) {
  return panel(
    "Written",
    {},
    h("div", { class: "row" }, h("p", {}, h("code", {}, file)), h("button", { type: "button", class: "primary", onclick: () => take(file) }, "Use this bench")),
    h("h4", {}, "What to calibrate next, in this order; once the bench is in use ", h("a", { href: "#calibrate" }, "from this page"), ", or at the terminal"),
    h("ol", { class: "steps" }, steps.map(({ command, purpose }) => h("li", {}, purpose ? h("p", {}, capital(purpose)) : null, h("div", { class: "copy" }, h("code", { class: "command", tabindex: "0" }, command), copyButton(() => command, command))))),
  );
}
