/** Where a root goes when it is dragged, or led by the arrow keys. */

import { heldPole } from "../mathematics/edits.js";
import { moved, sizeOf } from "../state/roots.js";

/** @import { Kind } from "../state/design.js" */
/** @import { Place, Root } from "../state/roots.js" */
/** @import { Pixel, PlaneView } from "./plane_view.js" */

const ON_AXIS = 6; // px: a pair this near the axis splits
const OFF_AXIS = 13; // px: a real root pulled this far leaves it, if another one is
const TOGETHER = 10; // px from it
const SNAP = 4; // px: real roots this near become equal
const LEAST = 4; // px between a pole and the imaginary axis
const WAYS = /** @type {Record<string, [number, number]>} */ ({
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
});

/**
 * The list with a root under the pointer.
 * @param {PlaneView} view @param {Kind} kind @param {Root[]} list @param {Root} root @param {Pixel} at
 * @param {boolean} snapping
 * @returns {Root[]}
 */
export function dragged(view, kind, list, root, at, snapping) {
  const { x: ox, y: oy } = view.origin;
  const height = Math.abs(at.y - oy);
  const gap = (/** @type {Root} */ other) => Math.abs(view.pixel(other).x - at.x);
  const others = list.filter((other) => other.id !== root.id && other.im === 0);
  const nearest = others.length ? others.reduce((best, other) => (gap(other) < gap(best) ? other : best)) : null;
  const onAxis = root.im ? height < ON_AXIS : height < OFF_AXIS || !nearest || gap(nearest) > TOGETHER;
  const under = view.point(onAxis ? { x: at.x, y: oy } : at);
  let to = { re: under.re, im: onAxis ? 0 : Math.abs(under.im) };
  if (onAxis && nearest && snapping && gap(nearest) < SNAP) to.re = nearest.re;
  if (kind === "pole") to = heldPole(to.re, to.im, -view.point({ x: ox - LEAST, y: oy }).re);
  else if (Math.hypot(at.x - ox, at.y - oy) < ON_AXIS) to = { re: 0, im: 0 };
  return moved(list, root.id, to, onAxis ? null : (nearest?.id ?? null));
}

/**
 * The list with a root led one step by an arrow key; null for another key, a sentence where it cannot go.
 * @param {PlaneView} view @param {Kind} kind @param {Root[]} list @param {Root} root @param {KeyboardEvent} event
 * @returns {Root[] | string | null}
 */
export function led(view, kind, list, root, event) {
  const way = WAYS[event.key];
  if (!way || event.ctrlKey || event.metaKey) return null;
  const size = sizeOf(root) || 0.02 * view.radius;
  const step = size * (event.shiftKey ? 0.1 : 0.01);
  /** @type {Place} */
  let to = { re: root.re + way[0] * step, im: Math.max(root.im + way[1] * step, 0) };
  if (root.im && to.im < 0.5 * step) to.im = 0;
  const leaves = !root.im && way[1] !== 0;
  const partner = leaves
    ? list.find((other) => other.id !== root.id && !other.im && Math.abs(other.re - root.re) <= 0.05 * size)
    : null;
  if (leaves && !partner)
    return `A real ${kind} leaves the axis together with another one: bring two within 5 % of each other first.`;
  if (partner) to = { re: (root.re + partner.re) / 2, im: step };
  if (kind === "pole") to = heldPole(to.re, to.im);
  return moved(list, root.id, to, partner?.id ?? null);
}
