// The hemisphere of directions, seen from above: the zenith in the middle, the horizon
// around it, azimuth 0° to the right and counted anticlockwise. The distance from the
// middle is proportional to the angle from the zenith. Where lamps go below the horizon, the
// drawing ends at the lowest of them and the horizon is a ring within it.

import { h, redraw, s, say } from "./dom.js";
import { degrees, direction } from "./format.js";

const R = 100;
const STEP_DEG = 5;

/** The elevation of the drawing's edge (degrees). */
function edge({ range, lights = [], position, target }) {
  const marked = [...lights, position, target].filter(Boolean).map((mark) => mark.elevation_deg);
  return Math.max(-90, Math.min(0, range?.elevation?.[0] ?? 0, ...marked));
}

/** Where directions are on a drawing that ends at this elevation. */
function drawnTo(lowest) {
  return (azimuth, elevation) => {
    const r = (R * (90 - elevation)) / (90 - lowest);
    const angle = (azimuth * Math.PI) / 180;
    return [r * Math.cos(angle), -r * Math.sin(angle)];
  };
}

/**
 * A hemisphere. `onpick(azimuth, elevation)` is called with a direction in whole degrees
 * that was clicked, or chosen by the arrow keys and Enter; without it the drawing is a picture.
 * `show(what)`: `range` {azimuth, elevation} (degrees or null), `camera`, `position`,
 * `target` {azimuth_deg, elevation_deg}, `lamp` on or off, `lights` [{azimuth_deg, elevation_deg, state, label, title}].
 */
export function hemisphere(label, { onpick, help } = {}) {
  const layer = s("g", {});
  const cursor = s("g", { class: "cursor" }, s("circle", { r: 7 }), s("path", { d: "M-11 0H-4M4 0H11M0 -11V-4M0 4V11" }));
  const drawing = s("svg", { viewBox: "-130 -122 260 244", class: "hemisphere", role: onpick ? "application" : "img", "aria-label": label }, layer);
  const reading = h("p", { class: "fine reading", "aria-live": onpick ? "polite" : "off" }, help ?? "");
  const element = h("div", { class: "directions" }, drawing, reading);
  let aim = [0, 60];
  let blocked = null;
  let lowest = 0;

  function show(what) {
    lowest = edge(what);
    const at = drawnTo(lowest);
    blocked = what.blocked ?? null;
    drawing.classList.toggle("blocked", Boolean(blocked));
    redraw(layer, what, () => [...ground(what, at, lowest), ...marks(what, at)]);
    aimAt();
    if (!onpick) drawing.setAttribute("aria-label", `${label}: ${spoken(what.lights ?? [])}`);
  }

  function aimAt() {
    place(cursor, drawnTo(lowest)(...aim));
  }
  function describe() {
    say(reading, direction(...aim));
  }
  function pick() {
    if (blocked) say(reading, blocked);
    else onpick(...aim);
  }
  if (onpick) {
    drawing.setAttribute("tabindex", "0");
    drawing.append(cursor);
    drawing.addEventListener("click", (event) => {
      aim = pointed(drawing, event, lowest);
      aimAt();
      describe();
      pick();
    });
    drawing.addEventListener("keydown", (event) => {
      const step = event.shiftKey ? 1 : STEP_DEG;
      const turn = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
      if (turn) {
        aim = [wrap(aim[0] + turn[0]), Math.min(90, Math.max(lowest, aim[1] + turn[1]))];
        aimAt();
        describe();
      } else if (event.key === "Enter" || event.key === " ") pick();
      else return;
      event.preventDefault();
    });
    aimAt();
  }
  return { element, show };
}

function place(mark, xy) {
  mark.setAttribute("transform", `translate(${xy.map((v) => v.toFixed(2)).join(" ")})`);
}

function wrap(azimuth) {
  return azimuth > 180 ? azimuth - 360 : azimuth <= -180 ? azimuth + 360 : azimuth;
}

function pointed(drawing, event, lowest) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
  const r = Math.min(Math.hypot(point.x, point.y), R);
  const azimuth = r < 1 ? 0 : Math.round((Math.atan2(-point.y, point.x) * 180) / Math.PI);
  return [azimuth, Math.round(90 - (r / R) * (90 - lowest))];
}

/** Reachable directions, rings of equal elevation, and their labels. */
function ground({ range }, at, lowest) {
  const rings = [0, 30, 60].map((elevation) => s("circle", { r: at(0, elevation)[0], class: elevation === 0 ? "horizon" : "ring" }));
  const spokes = s("path", { d: `M${-R} 0H${R}M0 ${-R}V${R}`, class: "ring" });
  const corner = { "text-anchor": "middle", class: "axis" };
  const labels = [
    s("text", { ...corner, x: R + 11, y: 4 }, "0°"),
    s("text", { ...corner, x: 0, y: -R - 6 }, "90°"),
    s("text", { ...corner, x: -R - 14, y: 4 }, "180°"),
    s("text", { ...corner, x: 0, y: R + 15 }, degrees(-90)),
    ...[30, 60].map((elevation) => s("text", { class: "axis", x: 3, y: at(0, elevation)[0] - 3 }, degrees(elevation))),
  ];
  return [s("circle", { r: R, class: "sky" }), range ? s("path", { d: reach(range, at, lowest), class: "reach", "fill-rule": "evenodd" }) : null, ...rings, spokes, ...labels].filter(Boolean);
}

function reach({ azimuth, elevation }, at, lowest) {
  const [low, high] = elevation ?? [lowest, 90];
  const [from, to] = azimuth ?? [-180, 180];
  const [outer, inner] = [at(0, Math.max(low, lowest))[0], at(0, Math.min(high, 90))[0]];
  const circle = (r) => `M${r} 0A${r} ${r} 0 1 1 ${-r} 0A${r} ${r} 0 1 1 ${r} 0Z`;
  if (to - from >= 359.5) return circle(outer) + (inner > 0.5 ? circle(inner) : "");
  const large = to - from > 180 ? 1 : 0;
  const point = (azimuth_deg, elevation_deg) => at(azimuth_deg, elevation_deg).map((v) => v.toFixed(2)).join(" ");
  return `M${point(from, low)}A${outer} ${outer} 0 ${large} 0 ${point(to, low)}L${point(to, high)}A${inner} ${inner} 0 ${large} 1 ${point(from, high)}Z`;
}

/** Camera, lights, where the lamp is and where it is to go. */
function marks({ camera, lights = [], position, target, lamp }, at) {
  const eye = camera ? at(camera.azimuth_deg, camera.elevation_deg) : [0, 0];
  const shift = (xy) => ({ transform: `translate(${xy.map((v) => v.toFixed(2)).join(" ")})` });
  return [
    s("g", { class: "eye", ...shift(eye) }, s("rect", { x: -5, y: -3.5, width: 10, height: 7, rx: 1.5 }), s("circle", { r: 2 }), s("title", {}, "camera")),
    ...lights.map((light) =>
      s(
        "g",
        { class: `light ${light.state ?? "to-come"}`, ...shift(at(light.azimuth_deg, light.elevation_deg)) },
        s("circle", { r: 7.5 }),
        s("text", { "text-anchor": "middle", y: 3 }, String(light.label)),
        s("title", {}, light.title ?? direction(light.azimuth_deg, light.elevation_deg)),
      ),
    ),
    target ? s("circle", { r: 10, class: "target", ...shift(at(target.azimuth_deg, target.elevation_deg)) }) : null,
    position
      ? s("g", { class: lamp ? "lamp-at on" : "lamp-at", ...shift(at(position.azimuth_deg, position.elevation_deg)) }, s("circle", { r: 5 }), s("title", {}, `lamp at ${direction(position.azimuth_deg, position.elevation_deg)}`))
      : null,
  ].filter(Boolean);
}

function spoken(lights) {
  if (lights.length === 0) return "no lights";
  const of = (kind) => lights.filter((light) => light.state === kind).length;
  const counted = of("done") + of("now") > 0 ? `, ${of("done")} done, ${of("now")} now` : "";
  return `${lights.length} lights${counted}`;
}
