// The live picture with its marks, sharpness and histogram.

import { ask } from "./api.js";
import { facts, h, panel, redraw, s, say } from "./dom.js";
import { count, digits, exposure, span } from "./format.js";
import { histogram } from "./histogram.js";
import { picture } from "./picture.js";
import { link, state, watch } from "./stream.js";

const TREND = 80;
const INTERVAL_MS = 250;
const MARKS = [
  ["marks", "Saturation", true, "Marks pixels that are saturated"],
  ["peaking", "Focus peaking", false, "Marks sharp edges, to focus by"],
  ["outline", "Outline", true, "Where the rig file has the sample in the image"],
  ["cross", "Centre cross", false, "The centre of the image"],
  ["zoom", "Zoom 3×", false, "Three times as large; scroll to look around"],
  ["whole", "Whole window", false, "As large as the window allows, below STOP"],
];

/** The panels of the picture, and of what is measured in it. */
export function livePanels() {
  const on = new Map(MARKS.map(([name, , first]) => [name, JSON.parse(localStorage.getItem(`rig-${name}`) ?? String(first))]));
  const view = picture("Live picture of the camera", (n) => `api/live.jpg?n=${n}&peaking=${Number(on.get("peaking"))}&marks=${Number(on.get("marks"))}`, INTERVAL_MS);
  const overlay = s("svg", { class: "overlay", "aria-hidden": "true", preserveAspectRatio: "xMidYMid meet" });
  const empty = h("p", { class: "empty" });
  const stage = h("div", { class: "picture", tabindex: "0", role: "group", "aria-label": "Live picture" }, h("div", { class: "sheet" }, view.element, overlay), empty);
  const stale = h("p", { class: "age", role: "status" });
  const toggles = MARKS.map(([name, label, , about]) => toggle(name, label, about, on, apply));
  const pictureElement = panel("Live picture", { class: "wide-picture" }, h("div", { class: "toggles" }, toggles), stage, stale);

  const { element: figuresElement, show: showFigures, reset } = figurePanels();
  let outline = null;
  let number = null;
  let numberAt = performance.now();

  function apply() {
    stage.classList.toggle("zoomed", on.get("zoom"));
    pictureElement.classList.toggle("whole", on.get("whole"));
    drawOverlay();
    view.newer();
  }

  function drawOverlay() {
    const camera = state.bench?.camera;
    const [width, height] = [outline?.width ?? camera?.width, outline?.height ?? camera?.height];
    redraw(overlay, [outline, width, height, on.get("outline"), on.get("cross")], () => {
      if (!width || !height) return [];
      overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
      const polygons = on.get("outline") ? (outline?.polygons ?? []) : [];
      return [
        ...polygons.map((points) => s("polygon", { points: points.map((xy) => xy.join(",")).join(" "), class: "outline" })),
        on.get("cross") ? s("path", { d: `M${width / 2} 0V${height}M0 ${height / 2}H${width}`, class: "cross" }) : null,
      ].filter(Boolean);
    });
  }

  async function loadOutline() {
    try {
      outline = await ask("api/outline");
    } catch {
      outline = null;
    }
    drawOverlay();
  }

  let connected = false;
  let looking = false;
  function show() {
    const bench = state.bench;
    const figures = bench?.connected ? bench.view : null;
    if (Boolean(bench?.connected) !== connected) {
      connected = Boolean(bench?.connected);
      number = null;
      if (connected) loadOutline();
      else view.clear();
      reset();
    }
    view.look(looking && connected);
    say(empty, connected ? (figures ? "" : state.console?.rig?.simulated ? "Waiting for the simulation’s first frame …" : "Waiting for the first frame …") : "The camera is not connected.");
    if (figures && figures.number !== number) {
      number = figures.number;
      numberAt = performance.now();
      showFigures(figures);
      view.newer();
    } else if (!figures) showFigures(null);
    drawOverlay();
    showAge();
  }

  function showAge() {
    const figures = state.bench?.connected ? state.bench.view : null;
    const age_s = (performance.now() - numberAt) / 1000;
    const old = figures && (age_s > 3 + 2 * (figures.exposure_s ?? 0) || link().kind !== "live");
    stage.classList.toggle("stale", Boolean(old));
    // A new direction of the light is rendered before its first frame.
    const rendering = state.console?.rig?.simulated && link().kind === "live";
    say(stale, !old ? "" : rendering ? `Waiting for the simulation, which renders this light: the picture is ${span(age_s)} old` : `STALE: no new frame for ${span(age_s)}`);
  }

  apply();
  watch(["bench"], show);
  watch(["link"], showAge);
  return {
    picture: pictureElement,
    figures: figuresElement,
    look(shown) {
      looking = shown;
      show();
    },
  };
}

function toggle(name, label, about, on, apply) {
  const button = h("button", { type: "button", class: "toggle", title: about, "aria-pressed": String(on.get(name)) }, label);
  button.addEventListener("click", () => {
    on.set(name, !on.get(name));
    // A page does not begin with a picture over all of it.
    if (name !== "whole") localStorage.setItem(`rig-${name}`, String(on.get(name)));
    button.setAttribute("aria-pressed", String(on.get(name)));
    apply();
  });
  return button;
}

/** Sharpness with its best and trend, counts, and the frame's facts. */
function figurePanels() {
  const sharpness = h("span", { class: "big" }, "–");
  const best = h("span", { class: "fine" });
  const line = s("polyline", { points: "" });
  const trend = s("svg", { viewBox: `0 0 ${TREND} 30`, class: "trend", preserveAspectRatio: "none", role: "img", "aria-label": "Trend of the sharpness" }, line);
  const counts = histogram("Histogram of the live frame");
  const list = h("dl", { class: "facts" });
  const none = h("p", { class: "fine" }, "No frame yet.");
  let values = [];
  let highest = 0;
  function reset() {
    values = [];
    highest = 0;
    draw();
  }
  function draw() {
    const top = Math.max(highest, 1e-12);
    line.setAttribute("points", values.map((value, i) => `${TREND - values.length + i},${(29 - (27 * value) / top).toFixed(2)}`).join(" "));
    say(best, highest > 0 ? `best ${digits(highest, 3)} · now ${Math.round((100 * (values.at(-1) ?? 0)) / highest)}%` : "");
  }
  function show(figures) {
    none.hidden = Boolean(figures);
    counts.show(figures);
    if (!figures) {
      say(sharpness, "–");
      facts(list, []);
      return;
    }
    highest = Math.max(highest, figures.sharpness);
    values = [...values, figures.sharpness].slice(-TREND);
    say(sharpness, digits(figures.sharpness, 3));
    draw();
    facts(list, [
      ["Camera", figures.model],
      ["Frame", figures.width ? `${figures.width} × ${figures.height}, ${figures.bit_depth} bits` : null],
      ["Exposure", exposure(figures.exposure_s)],
      ["Gain", figures.gain === undefined ? null : digits(figures.gain, 3)],
      ["Frames", figures.frames_per_s === undefined ? null : `${count(figures.number)} (${digits(figures.frames_per_s, 2)} per s)`],
    ]);
  }
  const again = h("button", { type: "button", class: "quiet", onclick: reset }, "Reset best");
  const element = h(
    "div",
    { class: "two" },
    panel("Sharpness", {}, h("div", { class: "row" }, sharpness, best, again), trend, h("p", { class: "fine" }, "Turn the focus until it is highest. It compares frames of one scene at one exposure.")),
    panel("Counts", {}, none, counts.element, list),
  );
  return { element, show, reset };
}
