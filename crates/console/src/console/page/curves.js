// f over the half angle, several fits in one drawing, each with the band of its intervals.

import { field, h, redraw, s } from "./dom.js";
import { digits } from "./format.js";

const [WIDTH, HEIGHT] = [360, 230];
const EDGE = { left: 46, right: 8, top: 10, bottom: 34 };
const CHANNELS = ["red", "green", "blue"];
/** Ticks of the half angle, degrees. The axis is its square root, as the lobe is narrow. */
const THETA_H = [0, 2, 10, 20, 40, 60, 90];
/** So far below the highest value the axis goes at most. */
const DECADES = 4;

/** The panel; `show(fits)` with the fits of `api/compare`. */
export function curvePanel(letters) {
  const channel = h("select", { id: "curve-channel" }, CHANNELS.map((name, i) => h("option", { value: i, selected: i === 1 }, name)));
  const drawings = h("div", { class: "curves" });
  const legend = h("ul", { class: "legend" });
  const element = h("section", { class: "panel", id: "curves" }, h("h3", {}, "f over the half angle θh"), h("div", { class: "row" }, field("Channel", channel), legend), drawings, h("p", { class: "fine" }, "Bands: intervals of 95%. θd is the angle between light and half vector."));
  let fits = [];
  channel.addEventListener("change", draw);
  function draw() {
    const angles = [...new Set(fits.flatMap((fit) => fit.curves.map((curve) => curve.theta_d_deg)))];
    element.hidden = angles.length === 0;
    const c = Number(channel.value);
    redraw(legend, fits.length, () => fits.map((_, i) => h("li", { class: `curve-${i}` }, letters[i])));
    redraw(drawings, [fits, c], () => angles.map((angle) => drawing(angle, fits.map((fit) => fit.curves.find((curve) => curve.theta_d_deg === angle)), c, letters)));
  }
  return {
    element,
    show(shown) {
      fits = shown;
      draw();
    },
  };
}

/** One difference angle: a curve and a band for each fit that has it. */
function drawing(angle, curves, c, letters) {
  const there = curves.filter(Boolean);
  const highest = Math.max(...there.flatMap((curve) => curve.upper.map((rgb) => rgb[c])), 1e-12);
  const lowest = Math.max(Math.min(...there.flatMap((curve) => curve.value.map((rgb) => rgb[c]))), highest / 10 ** DECADES);
  const [low, high] = [Math.floor(Math.log10(lowest)), Math.ceil(Math.log10(highest))];
  const x = (theta) => EDGE.left + (WIDTH - EDGE.left - EDGE.right) * Math.sqrt(theta / 90);
  const y = (value) => EDGE.top + ((HEIGHT - EDGE.top - EDGE.bottom) * (high - Math.max(low, Math.log10(Math.max(value, 1e-12))))) / Math.max(1, high - low);
  const points = (curve, of) => curve.theta_h_deg.map((theta, i) => `${x(theta).toFixed(1)},${y(curve[of][i][c]).toFixed(1)}`);
  const decades = Array.from({ length: high - low + 1 }, (_, i) => low + i);
  const about = there.map((curve) => `${letters[curves.indexOf(curve)]} ${digits(curve.value[0][c], 2)} at θh 0°`).join(", ");
  return h(
    "figure",
    {},
    s(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "curve", role: "img", "aria-label": `f over θh at θd ${angle}°, ${CHANNELS[c]}: ${about}` },
      decades.map((decade) => s("path", { class: "grid", d: `M${EDGE.left} ${y(10 ** decade)}H${WIDTH - EDGE.right}` })),
      decades.map((decade) => s("text", { class: "axis", x: EDGE.left - 5, y: y(10 ** decade) + 3, "text-anchor": "end" }, decade < -3 || decade > 3 ? `1e${decade}` : String(Number((10 ** decade).toPrecision(1))))),
      THETA_H.map((theta) => s("text", { class: "axis", x: x(theta), y: HEIGHT - EDGE.bottom + 14, "text-anchor": theta === 90 ? "end" : "middle" }, `${theta}°`)),
      s("text", { class: "axis", x: EDGE.left + 4, y: EDGE.top + 9 }, "f, 1/sr"),
      s("text", { class: "axis", x: WIDTH - EDGE.right, y: HEIGHT - 4, "text-anchor": "end" }, "half angle θh"),
      curves.map((curve, i) => (curve ? s("polygon", { class: `band curve-${i}`, points: [...points(curve, "upper"), ...points(curve, "lower").reverse()].join(" ") }) : null)),
      curves.map((curve, i) => (curve ? s("polyline", { class: `line curve-${i}`, points: points(curve, "value").join(" ") }) : null)),
    ),
    h("figcaption", {}, `θd ${angle}°`),
  );
}
