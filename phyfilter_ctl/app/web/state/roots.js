/** Poles and zeros as what is held: a real root, or a pair that moves as one. */

import { short } from "../numbers.js";

/** @import { Complex } from "../mathematics/polynomials.js" */

/** @typedef {{re: number, im: number}} Place */
/** @typedef {{id: number, re: number, im: number}} Root  im = 0: a real root; im > 0: the pair re +- j im */

let rootNumber = 0;

/** A root of its own number. @param {Place} place @returns {Root} */
export const newRoot = ({ re, im }) => ({ id: ++rootNumber, re, im });

/** Distance from the origin. @param {Place} place */
export const sizeOf = ({ re, im }) => Math.hypot(re, im);

/** Roots of a list in which conjugates are complete. @param {Complex[]} list @returns {Root[]} */
export const rootsOf = (list) => list.filter(([, im]) => im >= 0).map(([re, im]) => newRoot({ re, im }));

/** With the conjugates written out. @param {Root[]} list @returns {Complex[]} */
export const complexOf = (list) =>
  list.flatMap(({ re, im }) =>
    im
      ? [
          [re, im],
          [re, -im],
        ]
      : [[re, 0]],
  );

/** How many poles or zeros the roots stand for. @param {Root[]} list */
export const countOf = (list) => list.reduce((n, { im }) => n + (im ? 2 : 1), 0);

/**
 * The list with one root moved. A pair that comes to the axis splits into two real roots there; a real root that leaves
 * it takes a
 * partner along.
 * @param {Root[]} list @param {number} id @param {Place} to @param {number | null} [partner] real root to leave with
 * @returns {Root[]}
 */
export function moved(list, id, to, partner = null) {
  const place = list.findIndex((root) => root.id === id);
  const root = list[place];
  const next = [...list];
  if (root.im && to.im === 0) {
    next.splice(place, 1, { id, re: to.re, im: 0 }, newRoot({ re: to.re, im: 0 }));
    return next;
  }
  const leaves = root.im === 0 && to.im > 0 && partner !== null;
  next[place] = { id, re: to.re, im: root.im || leaves ? to.im : 0 };
  return leaves ? next.filter((other) => other.id !== partner) : next;
}

/** A value as people write it. @param {Place} root */
export const written = ({ re, im }) => (im ? `${short(re)} ± ${short(im)}j` : short(re));

/**
 * Where a root goes when one of its values is typed, and where the second of a pair goes that splits; or why it cannot.
 * @param {Place} root @param {"re" | "im" | "wn" | "zeta"} what @param {number} value
 * @returns {{to: Place, second?: number} | string}
 */
export function placed(root, what, value) {
  if (!Number.isFinite(value)) return "expected a number";
  const size = sizeOf(root);
  if (what === "re") return { to: { re: value, im: root.im } };
  if (what === "im") return { to: { re: root.re, im: Math.abs(value) } };
  if (what === "wn") {
    if (!(value > 0)) return "expected a natural frequency above 0 rad/s";
    return { to: size ? { re: (root.re / size) * value, im: (root.im / size) * value } : { re: -value, im: 0 } };
  }
  if (root.im && value >= 1) {
    const apart = Math.sqrt(value * value - 1);
    return { to: { re: -size * (value - apart), im: 0 }, second: -size * (value + apart) };
  }
  if (root.im) return { to: { re: -value * size, im: size * Math.sqrt(Math.max(1 - value * value, 0)) } };
  if (value === (size ? -root.re / size : 1)) return { to: root };
  return "a real root has the damping ratio 1; bring two together and pull them off the axis";
}
