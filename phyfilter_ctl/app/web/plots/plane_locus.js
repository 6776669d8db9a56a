/** What the s-plane shows beside poles and zeros of F: where they are wanted, and the closed loop's poles. */

import { g } from "../elements.js";
import { short } from "../numbers.js";
import { outlines } from "../state/region.js";

/** @import { LocusAnswer } from "../link.js" */
/** @import { Complex } from "../mathematics/polynomials.js" */
/** @import { Region } from "../state/region.js" */
/** @import { PlaneView } from "./plane_view.js" */

const FAR = 40; // times the radius of the view, and below it
const SQUARE = 4; // px, half a side

/** @param {PlaneView} view @param {Complex} point */
function pixel(view, [re, im]) {
  const { x, y } = view.pixel({ re, im });
  // A path that leaves the picture by miles costs more than it shows.
  const held = (/** @type {number} */ at) => Math.min(Math.max(at, -2e4), 2e4).toFixed(1);
  return `${held(x)} ${held(y)}`;
}

/** Shades over where poles are not wanted. @param {PlaneView} view @param {Region} region */
export function regionShades(view, region) {
  return outlines(region, view.radius / 1e4, view.radius * FAR).map((outline) =>
    g("path", { d: `M${outline.map(({ re, im }) => pixel(view, [re, im])).join("L")}z` }),
  );
}

/**
 * The closed loop's poles: where they go, where they are, and where the loop is lost.
 * @param {PlaneView} view @param {LocusAnswer} locus @param {string} unit of what is varied
 */
export function locusPaths(view, { branches, now, limits }, unit) {
  const paths = branches.flatMap((branch) => [
    ...path(view, branch, (re) => re < 0, ""),
    ...path(view, branch, (re) => re >= 0, "pf-lost"),
  ]);
  const squares = now.map(([re, im]) => {
    const { x, y } = view.rim(view.pixel({ re, im })); // one outside is shown at the rim
    const size = 2 * SQUARE;
    return g("rect", { x: x - SQUARE, y: y - SQUARE, width: size, height: size, class: re < 0 ? null : "pf-lost" });
  });
  const texts = limits.map(({ at, omega }) => {
    const { x, y } = view.pixel({ re: 0, im: omega });
    return g("text", { x: x + 7, y: y - 4 }, `${short(at, 3)}${unit}`);
  });
  return [...paths, ...squares, ...texts];
}

/**
 * The pieces of a branch on one side of the axis, up to it and one point beyond.
 * @param {PlaneView} view @param {(Complex | null)[]} branch @param {(re: number) => boolean} mine @param {string} className
 */
function path(view, branch, mine, className) {
  let d = "";
  let down = false;
  branch.forEach((point, k) => {
    const next = branch[k + 1];
    if (!point || !(mine(point[0]) || (next && mine(next[0])) || down)) {
      down = false;
      return;
    }
    d += `${down ? "L" : "M"}${pixel(view, point)}`;
    down = mine(point[0]) || Boolean(next && mine(next[0]));
  });
  return d.includes("L") ? [g("path", { d, class: className || null })] : [];
}
