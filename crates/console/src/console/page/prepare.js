// Before a capture: what to capture, the dry run, the checks and the calibrations.

import { askWith } from "./api.js";
import { copyButton, facts, field, gate, h, panel, say } from "./dom.js";
import { bytes, digits, direction, exposure, span } from "./format.js";
import { attempt, blocked } from "./header.js";
import { hemisphere } from "./hemisphere.js";
import { announce, capital, complain } from "./notices.js";
import { loaded, recordsPanel } from "./records.js";
import { surroundings, unreachable } from "./reach.js";
import { state, watch } from "./stream.js";

const WAIT_MS = 500;
/** `best:N` compares many directions, which takes seconds; it is planned when asked for. */
const AT_ONCE = ["count", "all", "listed", "until"];

/** The part of the view; `look(on)` when it is shown or hidden. */
export function preparePart() {
  const form = captureForm();
  const checks = checksPanel();
  const records = recordsPanel();
  const element = h(
    "div",
    { class: "stack" },
    h("div", { class: "two" }, form.element, form.planElement),
    h("div", { class: "two" }, checks.element, records.element),
  );
  let looking = false;
  return {
    element,
    look(on) {
      if (on && !looking) {
        form.plan(false);
        checks.load();
        records.load();
      }
      looking = on;
      form.show();
    },
  };
}

function captureForm() {
  const sample = h("input", { type: "text", id: "sample", required: true, maxlength: "64", pattern: "[A-Za-z0-9._\\-]+", placeholder: "red-paint", autocomplete: "off", autocapitalize: "off", spellcheck: "false", "aria-describedby": "sample-help" });
  const many = h("input", { type: "number", id: "lights", min: "1", max: "200", value: "4", "aria-label": "Number of lights" });
  const best = h("input", { type: "number", id: "best", min: "1", max: "60", value: "4", "aria-label": "Number of most informative lights" });
  const enough = untilFields("Expected error that is enough, percent", "5");
  const radio = (value, ...label) => {
    const input = h("input", { type: "radio", name: "choice", value, checked: value === "count" });
    return h("label", { class: "choice" }, input, h("span", {}, label));
  };
  const fit = h("input", { type: "checkbox", id: "fit", checked: true });
  const listed = h("ul", { class: "chips" });
  const command = h("code", { class: "command", tabindex: "0", "aria-label": "Command line" }, "rig capture");
  const start = h("button", { type: "submit", class: "primary", id: "start" }, "Start the capture");
  const dry = h("button", { type: "button", id: "dry-run" }, "Dry run");
  const why = h("p", { class: "why" });
  const status = h("p", { class: "fine", role: "status", id: "plan-status" });
  const numbers = h("dl", { class: "facts" });
  const directions = [];
  const map = hemisphere("Directions of the lights. Arrow keys aim in steps of 5°, with Shift 1°; Enter adds the direction to the list or removes it", {
    onpick: (azimuth_deg, elevation_deg) => toggle(azimuth_deg, elevation_deg),
    help: "Click a direction to list it, click it again to remove it.",
  });
  const form = h(
    "form",
    { class: "stack-form" },
    field("Sample", sample, h("span", { class: "fine", id: "sample-help" }, "Letters, digits, dots, hyphens, underscores.")),
    h(
      "fieldset",
      {},
      h("legend", {}, "Lights"),
      radio("count", "evenly spread: ", many),
      radio("all", "all that the stage reaches, 15° apart"),
      radio("best", "the most informative: ", best, " (takes some seconds)"),
      radio("until", "as many as it takes: from one on, each time the most telling one, until the expected error is at most ", enough.error, "%, but at most ", enough.most),
      radio("listed", "those that I list: click them on the hemisphere"),
      listed,
    ),
    h("label", { class: "choice" }, fit, h("span", {}, "fit a BRDF and write the report afterwards")),
    h("div", { class: "row" }, start, dry),
    why,
    h("p", { class: "fine" }, "The same at the terminal:"),
    h("div", { class: "copy" }, command, copyButton(() => command.textContent, "the command line")),
  );
  const element = panel("New capture", {}, form);
  const planElement = panel("Plan", {}, map.element, status, numbers);
  let plan = null;
  let request = null;
  let timer = null;

  const choice = () => form.elements.choice.value;
  function body() {
    const lights = { count: String(many.valueAsNumber || ""), all: "all", best: `best:${best.valueAsNumber || ""}`, listed: null, until: null }[choice()];
    return { sample: sample.value || null, lights, light: choice() === "listed" ? directions.map(([az, el]) => `${az},${el}`) : [], ...(choice() === "until" ? enough.asked() : {}), fit: fit.checked };
  }
  /** Why it can't be planned, or null. */
  function incomplete() {
    if (sample.value !== "" && !sample.validity.valid) return "The sample's name may have letters, digits, dots, hyphens and underscores.";
    if (choice() === "listed" && directions.length === 0) return "List a direction at least: click it on the hemisphere.";
    if (choice() === "count" && !(many.validity.valid && many.value)) return "State a number of lights from 1 to 200.";
    if (choice() === "best" && !(best.validity.valid && best.value)) return "State a number of lights from 1 to 60.";
    if (choice() === "until") return enough.incomplete();
    return null;
  }

  function toggle(azimuth_deg, elevation_deg) {
    // A click near a listed direction takes it out: a finger is some degrees wide.
    const near = directions.findIndex(([az, el]) => angle(az, el, azimuth_deg, elevation_deg) < 6);
    if (near >= 0) directions.splice(near, 1);
    else {
      const outside = unreachable(azimuth_deg, elevation_deg);
      if (outside) return complain(new Error(outside));
      directions.push([azimuth_deg, elevation_deg]);
    }
    form.elements.choice.value = "listed";
    announce(`${directions.length} directions listed`);
    changed();
  }

  function changed() {
    plan = null;
    listed.replaceChildren(
      ...directions.map(([az, el], i) =>
        h("li", {}, direction(az, el), " ", h("button", { type: "button", class: "quiet", "aria-label": `Remove ${direction(az, el)}`, onclick: () => { directions.splice(i, 1); changed(); } }, "×")),
      ),
    );
    listed.hidden = choice() !== "listed";
    clearTimeout(timer);
    timer = setTimeout(() => askPlan(false), WAIT_MS);
    say(command, composed(body()));
    show();
  }

  async function askPlan(wanted) {
    request?.abort();
    request = null;
    if (incomplete()) return say(status, "");
    if (!wanted && !AT_ONCE.includes(choice())) return say(status, "Press “Dry run” to see which directions are chosen.");
    const mine = new AbortController();
    request = mine;
    say(status, "Planning …");
    try {
      const answer = await askWith("api/plan", body(), mine.signal);
      say(command, answer.command);
      if (answer.error) throw Object.assign(new Error(answer.error), { hint: answer.hint });
      plan = answer.plan;
      say(status, wanted ? "Dry run: nothing was opened and nothing moved." : "");
    } catch (error) {
      if (error.name === "AbortError") {
        // Another one follows, or STOP came in between.
        if (request === mine) say(status, "");
        return;
      }
      plan = null;
      say(status, `${capital(error.message)}${error.hint ? ` – ${error.hint}` : ""}`);
    }
    show();
  }

  function show() {
    const missing = incomplete();
    const unnamed = sample.value === "" ? "Name the sample first." : null;
    const reason = blocked() ?? (state.job?.state === "running" ? `A job is running (${state.job.kind}).` : null) ?? missing ?? unnamed;
    gate(start, reason);
    gate(dry, missing);
    say(why, reason ?? "");
    const listing = choice() === "listed";
    const lights = plan?.lights ?? (listing ? directions.map(([azimuth_deg, elevation_deg]) => ({ azimuth_deg, elevation_deg })) : []);
    map.show({ ...surroundings(), lights: lights.map((light, i) => ({ ...light, label: i + 1, state: "to-come" })) });
    facts(numbers, plan ? planRows(plan) : []);
  }

  form.addEventListener("input", changed);
  dry.addEventListener("click", () => askPlan(true));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    gate(start, "Starting …");
    if (await attempt("api/capture/start", body())) announce("The capture has started");
    show();
  });
  watch(["console", "control", "job", "link"], show);
  changed();
  return { element, planElement, plan: askPlan, show };
}

/** The angle between two directions, degrees. */
function angle(azimuth1, elevation1, azimuth2, elevation2) {
  const rad = Math.PI / 180;
  const cosine = Math.sin(elevation1 * rad) * Math.sin(elevation2 * rad) + Math.cos(elevation1 * rad) * Math.cos(elevation2 * rad) * Math.cos((azimuth1 - azimuth2) * rad);
  return Math.acos(Math.min(1, Math.max(-1, cosine))) / rad;
}

/** When a capture has enough: an error in percent, and lights at most; `value`: the error at first, "" for none. */
export function untilFields(label, value, id = "") {
  const error = h("input", { type: "number", id: `${id}until`, min: "0.1", max: "100", step: "any", value, inputmode: "decimal", "aria-label": label });
  const most = h("input", { type: "number", id: `${id}most`, min: "1", max: "60", value: "12", inputmode: "numeric", "aria-label": "Lights at most" });
  return {
    error,
    most,
    /** Why they can't be asked for, or null. */
    incomplete() {
      if (!error.value || !error.validity.valid) return "State an error that is enough, from 0.1 to 100 percent.";
      return most.validity.valid && most.value ? null : "State how many lights at most, from 1 to 60.";
    },
    /** As a request takes them. */
    asked: () => ({ until: error.value, max_lights: most.value }),
  };
}

function composed({ sample, lights, light, until, max_lights, fit }) {
  const words = ["rig", "capture"];
  if (sample) words.push("--sample", sample);
  if (lights) words.push("--lights", lights);
  for (const one of light) words.push(`--light=${one}`);
  if (until) words.push("--until", until, "--max-lights", max_lights);
  if (!fit) words.push("--no-fit");
  return words.join(" ");
}

function planRows(plan) {
  const e = plan.exposure ?? {};
  return [
    ["Lights", plan.lights ? String(plan.lights.length) : null],
    ["Then", plan.until ? `the most telling, until the expected error is at most ${digits(100 * plan.until.error, 2)}%; ${plan.until.max_lights} lights at most` : null],
    ["Time", Number.isFinite(plan.estimated_s) ? `${plan.until ? "at most " : ""}about ${span(plan.estimated_s)}, without the ${plan.until ? "fits" : "fit"}` : null],
    ["Disk", Number.isFinite(plan.estimated_bytes) ? `about ${bytes(plan.estimated_bytes)}` : null],
    ["Exposures", Number.isFinite(e.shortest_s) ? `${exposure(e.shortest_s)} to ${exposure(e.longest_s)}, up to ${e.max_frames} frames of each` : null],
    ["Dark SNR", Number.isFinite(e.dark_snr) ? `at least ${digits(e.dark_snr, 2)} in the sample's dark parts` : null],
    ["Sensor record", plan.sensor_record ?? null],
  ];
}

const WORDS = { ok: "ok", warning: "warning", failed: "FAILED" };

function checksPanel() {
  return loaded("Checks", "api/doctor", ({ checks = [] }) => {
    const order = ["failed", "warning", "ok"];
    const sorted = [...checks].sort((a, b) => order.indexOf(a.verdict) - order.indexOf(b.verdict));
    const item = (check) =>
      h("li", { class: check.verdict }, h("span", { class: "state" }, WORDS[check.verdict] ?? check.verdict), h("div", {}, h("strong", {}, capital(check.name)), `: ${check.fact}`, check.remedy ? h("div", { class: "fine" }, `→ ${check.remedy}`) : null));
    const bad = sorted.filter((check) => check.verdict !== "ok");
    const good = sorted.filter((check) => check.verdict === "ok");
    return h(
      "div",
      {},
      h("ul", { class: "checks" }, bad.map(item)),
      h("details", { open: bad.length === 0 }, h("summary", {}, `${good.length} ${good.length === 1 ? "check" : "checks"} passed`), h("ul", { class: "checks" }, good.map(item))),
    );
  });
}
