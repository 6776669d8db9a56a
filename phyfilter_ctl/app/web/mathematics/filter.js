/** A filter F = N/D by its poles, and its frequency response. Units: rad/s, s. Polynomials ascend. */

import { EPSILON, multiply, roots } from "./polynomials.js";

/** @import { Complex } from "./polynomials.js" */
/** @typedef {{re: number, im: number}} Section  a real pole (im = 0) or a conjugate pair (im > 0) */
/** @typedef {{kind: "zeros", zeros: Complex[], gain: number}} FreeZeros */
/** @typedef {{kind: "lowpass"} | {kind: "type", type: number} | FreeZeros | {kind: "b", b: number[]}} Numerator */
/**
 * @typedef {object} Filter
 * @property {Section[]} sections of D
 * @property {number} order
 * @property {number[]} a D without its leading 1
 * @property {number[]} b N
 * @property {number[]} c D - N
 * @property {Complex[]} zeros
 * @property {number} dcGain F(0)
 * @property {number} type of 1 - F
 * @property {boolean} lowpass whether N is a_0
 */
/** @typedef {{re: Float64Array, im: Float64Array}} Curve */

// Coefficients that agree to this count as equal when the type of 1 - F is read off, as in Python.
const SAME_COEFFICIENT = 1e-12;
export const LIMITS = Object.freeze({ order: 8, slowest: 1e-3, fastest: 1e5, dtMin: 1e-5, dtMax: 1, damping: 1e-3 });

/**
 * Poles as sections, fastest first: the first states of the chain then carry the whole band, and any numerator is a
 * combination of
 * them with small coefficients. (Slowest first the coefficients cancel: 1e-3 of the noise gain is lost at poles two
 * decades apart.)
 * @param {Complex[]} poles complex ones in conjugate pairs
 * @returns {Section[]}
 */
export function sectionsOf(poles) {
  const negligible = 4 * EPSILON;
  return poles
    .filter(([re, im]) => im >= -negligible * Math.hypot(re, im))
    .map(([re, im]) => ({ re, im: Math.abs(im) <= negligible * Math.hypot(re, im) ? 0 : im }))
    .sort((p, q) => Math.hypot(q.re, q.im) - Math.hypot(p.re, p.im) || p.re - q.re);
}

/**
 * Ascending coefficients of the product of the sections' factors, the leading 1 included.
 * @param {Section[]} sections
 */
export function monic(sections) {
  let product = [1];
  for (const { re, im } of sections) {
    product = multiply(product, im ? [re * re + im * im, -2 * re, 1] : [-re, 1]);
  }
  return product;
}

/**
 * Ascending coefficients b_0 ... b_{n-1} of N: a_0 alone, the first k of a, gain * prod (s - zero), or given.
 * @param {Numerator} numerator
 * @param {number[]} a
 */
function numeratorOf(numerator, a) {
  const b = new Array(a.length).fill(0);
  if (numerator.kind === "lowpass") b[0] = a[0];
  else if (numerator.kind === "type") for (let i = 0; i < numerator.type; i++) b[i] = a[i];
  else if (numerator.kind === "zeros") {
    monic(sectionsOf(numerator.zeros)).forEach((value, i) => (b[i] = numerator.gain * value));
  } else numerator.b.forEach((value, i) => (b[i] = value));
  return b;
}

/**
 * What the preview knows of a design.
 * @param {{poles: Complex[], numerator: Numerator}} design
 * @returns {Filter}
 */
export function filterOf(design) {
  const sections = sectionsOf(design.poles);
  const a = monic(sections).slice(0, -1);
  const b = numeratorOf(design.numerator, a);
  const c = a.map((value, i) => (Math.abs(value - b[i]) <= SAME_COEFFICIENT * Math.abs(value) ? 0 : value - b[i]));
  c.push(1);
  const zeros = design.numerator.kind === "zeros" ? design.numerator.zeros : roots(b);
  const lowpass = b[0] === a[0] && b.slice(1).every((value) => value === 0);
  return {
    sections,
    order: a.length,
    a,
    b,
    c,
    zeros,
    dcGain: b[0] / a[0],
    type: c.findIndex((value) => value !== 0),
    lowpass,
  };
}

/**
 * numerator(j omega) / D(j omega): the poles are divided out one at a time, so repeated ones are right and nothing
 * overflows.
 * @param {number[]} numerator ascending, real
 * @param {Section[]} sections
 * @param {ArrayLike<number>} omega
 * @returns {Curve}
 */
function overDenominator(numerator, sections, omega) {
  const re = new Float64Array(omega.length);
  const im = new Float64Array(omega.length);
  for (let k = 0; k < omega.length; k++) {
    const w = omega[k];
    let x = 0;
    let y = 0;
    for (let i = numerator.length - 1; i >= 0; i--) {
      const real = numerator[i] - w * y;
      y = w * x;
      x = real;
    }
    for (const pole of sections) {
      for (let side = pole.im ? 2 : 1; side > 0; side--) {
        const u = -pole.re;
        const v = side === 2 ? w + pole.im : w - pole.im;
        const size = u * u + v * v;
        const real = (x * u + y * v) / size;
        y = (y * u - x * v) / size;
        x = real;
      }
    }
    re[k] = x;
    im[k] = y;
  }
  return { re, im };
}

/** F(j omega). @param {Filter} filter @param {ArrayLike<number>} omega */
export const response = (filter, omega) => overDenominator(filter.b, filter.sections, omega);

/**
 * 1 - F(j omega) = (D - N)/D, without cancellation at low frequencies.
 * @param {Filter} filter @param {ArrayLike<number>} omega
 */
export const errorResponse = (filter, omega) => overDenominator(filter.c, filter.sections, omega);

/** |F| at one frequency. @param {Filter} filter @param {number} omega */
export const gainAt = (filter, omega) => {
  const { re, im } = response(filter, [omega]);
  return Math.hypot(re[0], im[0]);
};

/** Natural frequency of the slowest pole. @param {Filter} filter */
export const slowest = (filter) => Math.min(...filter.sections.map(({ re, im }) => Math.hypot(re, im)));
/** Natural frequency of the fastest pole. @param {Filter} filter */
export const fastest = (filter) => Math.max(...filter.sections.map(({ re, im }) => Math.hypot(re, im)));
/** Mean natural frequency, geometric. @param {Filter} filter */
export const middle = (filter) => filter.a[0] ** (1 / filter.order);
