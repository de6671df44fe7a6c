// One drawing for each part of a bench, with the words that the questions use.

import { s } from "./dom.js";

const text = (x, y, words, about = {}) => s("text", { x, y, ...about }, words);
const path = (d, about = {}) => s("path", { d, ...about });
const lamp = (x, y) => s("circle", { cx: x, cy: y, r: 6, class: "lit" });
/** An arrow at both ends of a length. */
const span = (x1, y1, x2, y2) => path(`M${x1} ${y1}L${x2} ${y2}`, { class: "span" });
const ground = path("M30 128H210", { class: "thin" });
const bowl = path("M88 112H98A22 22 0 0 0 142 112H152", { class: "thick" });
const camera = [s("rect", { x: 104, y: 4, width: 32, height: 22, class: "thick" }), s("rect", { x: 110, y: 26, width: 20, height: 12, class: "thick" })];
const arm = "M28 112A92 92 0 0 1 212 112";

const DRAWINGS = {
  camera: ["The frame: its width and height in pixels, and the colour filters over them", () => [
    s("rect", { x: 60, y: 22, width: 120, height: 80, class: "thick" }),
    ...[80, 100, 120, 140, 160].map((x) => path(`M${x} 22V102`, { class: "thin" })),
    ...[42, 62, 82].map((y) => path(`M60 ${y}H180`, { class: "thin" })),
    span(60, 114, 180, 114), text(120, 127, "width of a frame", { "text-anchor": "middle" }),
    span(48, 22, 48, 102), text(40, 66, "height", { "text-anchor": "end" }),
  ]],
  lens: ["Camera and lens above the sample: the distance from the lens to the sample, and the width of the field of view", () => [
    ...camera, bowl, path("M30 134H66M174 134H210", { class: "thin" }),
    path("M110 38L70 112M130 38L170 112", { class: "thin" }),
    span(190, 38, 190, 112), text(196, 78, "distance"),
    span(70, 136, 170, 136), text(120, 148, "width of the field of view", { "text-anchor": "middle" }),
  ]],
  sample: ["The sample from the side: the radius of its opening", () => [
    path("M40 50H60A60 60 0 0 0 180 50H200", { class: "thick" }),
    span(120, 40, 180, 40), text(150, 32, "radius", { "text-anchor": "middle" }),
    path("M120 44V118", { class: "thin" }), text(120, 132, "axis", { "text-anchor": "middle" }),
  ]],
  stage: ["The stage: the elevation goes from 0° at the horizon to 90° straight above the sample; the azimuth goes round the sample", () => [
    path(arm, { class: "thin" }), bowl, ground, lamp(185, 47),
    path("M120 112L185 47", { class: "thin" }),
    path("M160 112A40 40 0 0 0 148 84", { class: "span" }), text(166, 96, "elevation"),
    path("M74 118A46 10 0 0 0 166 118", { class: "span" }), text(120, 146, "azimuth", { "text-anchor": "middle" }),
    text(120, 15, "90°", { "text-anchor": "middle" }), text(216, 116, "0°"), text(24, 116, "0°", { "text-anchor": "end" }),
  ]],
  lamp: ["The lamp: its channels are lit one after another, at one distance from the sample", () => [
    lamp(150, 22), lamp(170, 32), lamp(188, 46), bowl, ground,
    path("M170 32L122 106", { class: "span" }), text(152, 84, "distance from the lamp"),
    text(196, 28, "channels"),
  ]],
};

/** The drawing of a part; null if there is none. */
export function drawing(part) {
  const known = DRAWINGS[part];
  if (!known) return null;
  const [about, parts] = known;
  return s("svg", { viewBox: "0 0 280 150", class: "drawing", role: "img", "aria-label": about }, parts().map((one) => one.cloneNode(true)));
}
