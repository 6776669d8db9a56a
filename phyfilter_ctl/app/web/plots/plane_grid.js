/** What lies behind poles and zeros: circles, damping rays, axes, and where forward Euler is stable. */

import { g } from "../elements.js";
import { nice, powerOfTen } from "../numbers.js";

/** @import { Given } from "../elements.js" */
/** @import { PlaneView } from "./plane_view.js" */

const DAMPING_RAYS = [0.2, 0.4, 0.6, 0.8, 0.95];

/** @param {PlaneView} view @param {number | null} euler step in s of forward Euler, where it is used */
export function planeGrid(view, euler) {
  const sizes = circleSizes(view);
  return [
    ...circles(view, sizes),
    ...rays(view),
    ...(euler ? [eulerDisc(view, euler)] : []),
    ...axes(view),
    ...ticks(view, sizes),
  ];
}

/** Names of the axes, on the right, where no pole can be. @param {PlaneView} view */
export function planeNames(view) {
  const { width, height } = view;
  const { x: ox, y: oy } = view.origin;
  return [
    name("Re s, rad/s", { x: width - 6, y: oy - 7, "text-anchor": "end" }),
    name(view.log ? "log |s|" : "", { x: width - 6, y: oy + 17, "text-anchor": "end" }),
    name("Im s", { x: ox + 6, y: 14 }),
    name("unstable", { x: width - 6, y: height - 8, "text-anchor": "end" }),
  ];
}

/** @param {string} text @param {Record<string, Given>} given */
const name = (text, given) => g("text", { class: "pf-axis-name", ...given }, text);

/** @param {PlaneView} view @returns {number[]} */
function circleSizes({ log, radius, decades }) {
  if (!log) return Array.from({ length: 8 }, (_, k) => (k + 1) * nice(radius / 4.5));
  const sizes = [];
  for (let power = Math.ceil(Math.log10(radius) - decades); power <= Math.log10(radius) + 1; power++)
    sizes.push(10 ** power);
  return sizes;
}

/** @param {PlaneView} view @param {number[]} sizes */
function circles(view, sizes) {
  const { x: ox, y: oy } = view.origin;
  return sizes
    .map((size) => ox - view.pixel({ re: -size, im: 0 }).x)
    .filter((r) => r >= 12 && r <= Math.hypot(view.width, view.height))
    .map((r) => g("path", { d: `M${ox} ${oy - r}A${r} ${r} 0 0 0 ${ox} ${oy + r}` }));
}

/** @param {PlaneView} view */
function rays(view) {
  const { x: ox, y: oy } = view.origin;
  return DAMPING_RAYS.flatMap((zeta) => {
    const [dx, dy] = [-zeta, Math.sqrt(1 - zeta * zeta)];
    const length = Math.min((ox - 4) / -dx, (oy - 4) / dy);
    const lines = [1, -1].map((sign) =>
      g("line", { x1: ox, y1: oy, x2: ox + dx * length, y2: oy - sign * dy * length }),
    );
    const tag = Math.min((ox - 22) / -dx, (oy - 14) / dy);
    const anchor = dy * tag > oy - 20 ? "middle" : "start";
    const place = {
      x: ox + dx * tag,
      y: oy - dy * tag,
      "text-anchor": anchor,
      "dominant-baseline": "central",
      class: "pf-ray",
    };
    return [...lines, g("text", place, `ζ ${zeta}`)];
  });
}

/** Where forward Euler is stable: the disc |1 + s h| < 1. @param {PlaneView} view @param {number} step */
function eulerDisc(view, step) {
  const points = Array.from({ length: 121 }, (_, k) => {
    const angle = (k / 120) * 2 * Math.PI;
    const { x, y } = view.pixel({ re: (Math.cos(angle) - 1) / step, im: Math.sin(angle) / step });
    return `${x.toFixed(1)} ${y.toFixed(1)}`;
  });
  return g("path", { class: "pf-euler", d: `M${points.join("L")}z` });
}

/** @param {PlaneView} view */
function axes({ width, height, origin: { x: ox, y: oy } }) {
  return [
    g("line", { class: "pf-axis", x1: 0, y1: oy, x2: width, y2: oy }),
    g("line", { class: "pf-axis", x1: ox, y1: 0, x2: ox, y2: height }),
  ];
}

/** Numbers under the axis, as far as they do not meet. @param {PlaneView} view @param {number[]} sizes */
function ticks(view, sizes) {
  const { x: ox, y: oy } = view.origin;
  const found = [];
  let edge = ox;
  for (const size of sizes) {
    const { x } = view.pixel({ re: -size, im: 0 });
    const text = powerOfTen(size);
    if (x < 16 || edge - x < 20 + 6 * text.length) continue;
    edge = x;
    found.push(g("text", { class: "pf-tick", x, y: oy + 19, "text-anchor": "middle" }, view.log ? text : `−${text}`));
  }
  return found;
}
