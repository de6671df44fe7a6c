// One drawing for each part of a bench, with the words that the questions use.

import { s } from "./dom.js";
import { degrees, direction } from "./format.js";

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
    path("M154 112A34 34 0 0 0 144 88", { class: "span" }), text(159, 99, "elevation"),
    path("M74 118A46 10 0 0 0 166 118", { class: "span" }), text(120, 146, "azimuth", { "text-anchor": "middle" }),
    text(120, 15, "90°", { "text-anchor": "middle" }), text(216, 116, "0°"), text(24, 116, "0°", { "text-anchor": "end" }),
  ]],
  lamp: ["The lamp: its channels are lit one after another, at one distance from the sample", () => [
    lamp(150, 22), lamp(170, 32), lamp(188, 46), bowl, ground,
    path("M170 32L122 106", { class: "span" }), text(152, 84, "distance from the lamp"),
    text(196, 28, "channels"),
  ]],
};

/** A card, a standard or a board that lies level below the camera. */
const card = path("M70 124L52 142H188L170 124Z", { class: "thick" });
const above = [...camera, path("M112 38L74 122M128 38L166 122", { class: "thin" })];

/** One for each calibration: what is put before the camera. */
const TARGETS = {
  sensor: ["The camera in front of an even light", () => [...camera, path("M70 80H170V96H70Z", { class: "thick" }), ...[85, 103, 120, 137, 155].map((x) => path(`M${x} 126V104`, { class: "span" })), text(120, 142, "even, steady light", { "text-anchor": "middle" }), text(178, 92, "diffuser")]],
  lamp: ["The lamp lights a white card below the camera", () => [...above, card, lamp(206, 40), path("M202 46L150 128", { class: "span" }), text(206, 28, "lamp, cold", { "text-anchor": "middle" }), text(120, 138, "white card", { "text-anchor": "middle" })]],
  camera: ["A checkerboard below the camera, then tilted", () => [...above, path("M66 120L174 132L166 146L58 134Z", { class: "thick" }), path("M93 123L85 137M120 126L112 140M147 129L139 143M62 127L170 139", { class: "thin" }), path("M188 140A70 70 0 0 0 194 112", { class: "span" }), text(200, 130, "tilt")]],
  focus: ["Three edges across the camera’s axis, at three heights", () => [...above, ...[[96, 60], [112, 84], [128, 108]].map(([y, x]) => path(`M${x} ${y}H${x + 34}`, { class: "thick" })), span(196, 96, 196, 128), text(202, 116, "heights")]],
  glare: ["A white card with a wide and a narrow hole, a black box behind each", () => [...above, path("M40 112H84M124 112H150M162 112H200", { class: "thick" }), path("M84 112V142H124V112", { class: "thick" }), path("M150 112V142H162V112", { class: "thick" }), text(104, 136, "box", { "text-anchor": "middle" }), text(206, 116, "white card")]],
  lights: ["A polished ball halfway in a hole of a white card, below the camera", () => [...camera, path("M40 116H94M146 116H200", { class: "thick" }), s("circle", { cx: 120, cy: 116, r: 26, class: "thick" }), lamp(196, 48), path("M191 53L134 94L122 40", { class: "span" }), text(206, 120, "white card"), text(120, 120, "ball", { "text-anchor": "middle" })]],
  white: ["A white standard in the sample’s place, below the camera", () => [...above, card, lamp(206, 40), path("M202 46L150 128", { class: "span" }), text(120, 138, "white standard", { "text-anchor": "middle" })]],
  pose: ["The sample as it will be measured, below the camera", () => [...above, bowl, ground, text(120, 146, "the sample, seated", { "text-anchor": "middle" })]],
};
TARGETS.flat = TARGETS.sensor;

/** The drawing of a part of a bench; null if there is none. */
export function drawing(part) {
  return drawn(DRAWINGS[part]);
}

/** The drawing of a calibration's target; null if there is none. */
export function targetDrawing(kind) {
  return drawn(TARGETS[kind]);
}

function drawn(known) {
  if (!known) return null;
  const [about, parts] = known;
  return s("svg", { viewBox: "0 0 280 150", class: "drawing", role: "img", "aria-label": about }, parts().map((one) => one.cloneNode(true)));
}

/** The bench from the side, with azimuth 0° on the right, and from above; its camera in this direction as seen from the sample. */
export function benchDrawing({ azimuth_deg, elevation_deg }) {
  const rad = Math.PI / 180;
  const [x0, y0] = [96, 122];
  const tilted = elevation_deg < 89.5;
  const side = tilted && Math.cos(azimuth_deg * rad) < 0 ? -1 : 1;
  const at = (r, elevation) => [x0 + side * r * Math.cos(elevation * rad), y0 - r * Math.sin(elevation * rad)].map((v) => v.toFixed(1));
  const [x, y] = at(72, elevation_deg);
  const [ax, ay] = at(46, elevation_deg);
  const [px, py] = [232 + 30 * Math.cos(elevation_deg * rad) * Math.cos(azimuth_deg * rad), 62 - 30 * Math.cos(elevation_deg * rad) * Math.sin(azimuth_deg * rad)];
  const where = tilted ? `at ${direction(azimuth_deg, elevation_deg)}` : "straight above the sample";
  return s(
    "svg",
    { viewBox: "0 0 280 150", class: "drawing", role: "img", "aria-label": `The camera is ${where}` },
    path("M6 138H186", { class: "thin" }),
    path("M70 122H78A18 18 0 0 0 114 122H122", { class: "thick" }),
    path(`M${x0} ${y0}L${x} ${y}`, { class: "thin" }),
    s("g", { transform: `translate(${x} ${y}) rotate(${(side * (90 - elevation_deg)).toFixed(1)})` }, s("rect", { x: -14, y: -24, width: 28, height: 18, class: "thick" }), s("rect", { x: -8, y: -6, width: 16, height: 10, class: "thick" })),
    path(`M${x0 + side * 46} ${y0}A46 46 0 0 ${side > 0 ? 0 : 1} ${ax} ${ay}`, { class: "span" }),
    text(x0 + side * 54, y0 - 6, degrees(elevation_deg), { "text-anchor": side > 0 ? "start" : "end" }),
    s("circle", { cx: 232, cy: 62, r: 30, class: "thin" }),
    path("M232 62H262", { class: "thin" }),
    s("circle", { cx: px.toFixed(1), cy: py.toFixed(1), r: 5, class: "lit" }),
    text(266, 66, "0°"),
    text(232, 106, tilted ? `azimuth ${degrees(azimuth_deg)}` : "straight above", { "text-anchor": "middle" }),
    text(232, 22, "from above", { "text-anchor": "middle" }),
  );
}
