/** What an edit keeps: the gain of F, the open left half plane, the shape of a filter that becomes faster. */

import { filterOf, gainAt, LIMITS, middle } from "./filter.js";

/** @import { Filter, Numerator } from "./filter.js" */
/** @import { Complex } from "./polynomials.js" */

/**
 * Gain that a numerator edit keeps: F(0), or |F| at the mean natural frequency where F(0) = 0.
 * @param {Filter} filter
 */
export function heldGain(filter) {
  if (filter.dcGain !== 0) return filter.dcGain;
  const sign = Math.sign(filter.b.find((value) => value !== 0) ?? 1);
  return sign * gainAt(filter, middle(filter));
}

/**
 * The gain factor of N = gain * prod (s - zero) that gives F(0), or |F| at the mean natural frequency, a value.
 * @param {Complex[]} poles @param {Complex[]} zeros @param {number} value
 */
export function gainFor(poles, zeros, value) {
  const filter = filterOf({ poles, numerator: { kind: "zeros", zeros, gain: 1 } });
  const now = filter.dcGain !== 0 ? filter.dcGain : gainAt(filter, middle(filter));
  return now === 0 || !Number.isFinite(value / now) ? 1 : value / now;
}

/**
 * A pole held in the open left half plane and within the sizes allowed; the imaginary part is taken as positive.
 * @param {number} re @param {number} im @param {number} [margin] least -re
 * @returns {{re: number, im: number}}
 */
export function heldPole(re, im, margin = 0) {
  let x = Math.min(re, -margin);
  let y = Math.abs(im);
  const size = Math.hypot(x, y);
  const held = Math.min(Math.max(size, LIMITS.slowest), LIMITS.fastest);
  if (size === 0) [x, y] = [-held, 0];
  else if (held !== size) [x, y] = [(x / size) * held, (y / size) * held];
  if (-x < LIMITS.damping * held) {
    x = -LIMITS.damping * held;
    y = Math.sqrt(held * held - x * x);
  }
  return { re: x, im: y };
}

/**
 * The same filter with time running faster.
 * @param {{poles: Complex[], numerator: Numerator}} design @param {number} factor
 */
export function scaled(design, factor) {
  const n = design.poles.length;
  const by = (/** @type {Complex[]} */ list) =>
    list.map(([re, im]) => /** @type {Complex} */ ([re * factor, im * factor]));
  /** @type {Numerator} */
  let numerator = design.numerator;
  if (numerator.kind === "b") numerator = { kind: "b", b: numerator.b.map((value, i) => value * factor ** (n - i)) };
  if (numerator.kind === "zeros") {
    numerator = {
      kind: "zeros",
      zeros: by(numerator.zeros),
      gain: numerator.gain * factor ** (n - numerator.zeros.length),
    };
  }
  return { poles: by(design.poles), numerator };
}
