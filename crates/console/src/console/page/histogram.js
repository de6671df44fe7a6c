// Counts of a frame as a histogram with a logarithmic scale.

import { h, redraw, s, say } from "./dom.js";
import { count, digits } from "./format.js";

const WIDTH = 320;
const HEIGHT = 110;

/** A histogram; `show(figures)` with what the console measured in a frame, or null. */
export function histogram(title) {
  const drawing = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT + 18}`, class: "histogram", role: "img", "aria-label": title });
  const legend = h("p", { class: "fine" });
  const clipping = h("p", { class: "clipping" });
  const element = h("div", {}, drawing, clipping, legend);

  function show(figures) {
    element.hidden = !figures?.histogram;
    if (element.hidden) return;
    redraw(drawing, [figures.histogram, figures.black_dn, figures.full_well_dn], () => draw(figures));
    drawing.setAttribute("aria-label", `${title}: ${spoken(figures)}`);
    say(clipping, clippingText(figures));
    clipping.classList.toggle("warn", figures.clipped_pixels > 0);
    say(legend, legendText(figures));
  }
  return { element, show };
}

function draw(figures) {
  const bins = figures.histogram;
  const logs = bins.map((pixels) => Math.log10(1 + pixels));
  const highest = Math.max(...logs, 1e-9);
  const width = WIDTH / bins.length;
  const bars = logs.map((log, bin) => {
    const height = (log / highest) * (HEIGHT - 4);
    const last = bin === bins.length - 1 && figures.clipped_pixels > 0;
    return s("rect", { x: bin * width, y: HEIGHT - height, width: Math.max(width - 0.6, 0.5), height, class: last ? "bar clipped" : "bar" });
  });
  const saturation = figures.saturation_dn ?? 2 ** (figures.bit_depth ?? 12) - 1;
  const marks = [
    ["black level", figures.black_dn],
    ["full well", figures.full_well_dn],
  ]
    .filter(([, dn]) => Number.isFinite(dn))
    .map(([name, dn]) => {
      const x = Math.min(Math.max((dn / saturation) * WIDTH, 1), WIDTH - 1);
      return s("g", { class: name === "full well" ? "level full" : "level" }, s("line", { x1: x, x2: x, y1: 0, y2: HEIGHT }), s("title", {}, `${name} ${digits(dn, 4)} DN`));
    });
  const axis = [0, 0.5, 1].map((share) =>
    s("text", { x: share * WIDTH, y: HEIGHT + 14, class: "axis", "text-anchor": ["start", "middle", "end"][share * 2] }, count(share * saturation)),
  );
  return [...bars, s("line", { x1: 0, x2: WIDTH, y1: HEIGHT, y2: HEIGHT, class: "base" }), ...marks, ...axis];
}

function spoken(figures) {
  return `counts from ${figures.minimum_dn} to ${figures.maximum_dn} DN, mean ${digits(figures.mean_dn, 4)} DN`;
}

function clippingText(figures) {
  const share = (pixels) => {
    const all = (figures.width ?? 0) * (figures.height ?? 0);
    return all > 0 ? ` (${digits((100 * pixels) / all, 2)}%)` : "";
  };
  const clipped = figures.clipped_pixels;
  const saturated = clipped > 0 ? `${count(clipped)} ${clipped === 1 ? "pixel" : "pixels"} saturated${share(clipped)}` : "No pixel saturated";
  return figures.zero_pixels > 0 ? `${saturated}, ${count(figures.zero_pixels)} at 0${share(figures.zero_pixels)}` : saturated;
}

function legendText(figures) {
  const levels = [
    Number.isFinite(figures.black_dn) ? `dashed: black level ${digits(figures.black_dn, 3)} DN` : null,
    Number.isFinite(figures.full_well_dn) ? `solid: full well ${digits(figures.full_well_dn, 4)} DN` : null,
  ].filter(Boolean);
  return `Pixels (logarithmic) by count in DN; ${spoken(figures)}${levels.length ? `; ${levels.join(", ")}` : ""}.`;
}
