/** What is read off a filter: step response, bandwidth, settling time, curves in dB and degrees. */

import { fastest, gainAt, response, slowest } from "./filter.js";
import { EPSILON } from "./polynomials.js";
import { chain, doubleStep, expm1 } from "./sections.js";

/** @import { Curve, Filter } from "./filter.js" */

/**
 * Responses of F and 1 - F to a unit step at t = 0, exact on an even grid from 0.
 * @param {Filter} filter @param {number} duration seconds @param {number} points
 */
export function stepResponse(filter, duration, points) {
  const { n, A, equilibrium, C } = chain(filter);
  const dA = expm1(A, n, duration / (points - 1));
  const t = Float64Array.from({ length: points }, (_, k) => (k * duration) / (points - 1));
  const F = new Float64Array(points);
  const E = new Float64Array(points);
  let left = new Float64Array(equilibrium); // equilibrium - w
  for (let k = 0; k < points; k++) {
    let value = 0;
    for (let i = 0; i < n; i++) value += C[i] * left[i];
    F[k] = filter.dcGain - value;
    E[k] = 1 - F[k];
    const next = new Float64Array(left);
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) next[i] += dA[i * n + j] * left[j];
    left = next;
  }
  return { t, F, E };
}

/**
 * Width in rad/s of the band in which |F| stays above |F(0)|/sqrt(2) (above its peak/sqrt(2) where F(0) = 0); null
 * where it has no edge.
 * @param {Filter} filter
 * @returns {number | null}
 */
export function bandwidth(filter) {
  const omega = frequencyGrid(filter, {
    low: 0.01 * slowest(filter),
    high: Math.max(100 * fastest(filter), lastCrossing(filter)),
    points: 400,
  });
  const { re, im } = response(filter, omega);
  const gains = Array.from(re, (value, k) => Math.hypot(value, im[k]));
  const top = gains.indexOf(Math.max(...gains));
  const peak = top > 0 && top + 1 < gains.length ? largestGain(filter, omega[top - 1], omega[top + 1]) : gains[top];
  const dc = Math.abs(filter.dcGain);
  const atDc = dc > 1e-6 * gains[top];
  const level = (atDc ? dc : peak) / Math.SQRT2;
  const start = atDc ? 0 : top;
  const after = gains.findIndex((value, k) => k >= start && value < level);
  if (after < 1) return null;
  const high = crossing(filter, level, omega[after - 1], omega[after]);
  if (atDc) return high;
  let before = top;
  while (before >= 0 && gains[before] >= level) before--;
  return before < 0 ? null : high - crossing(filter, level, omega[before], omega[before + 1]);
}

/**
 * A frequency above which |F| stays below |F(0)|/sqrt(2), 0 where F(0) = 0: each of the n terms of N is below its share
 * there, as
 * |D| > omega^n / 2 from twice n times the fastest pole on.
 * @param {Filter} filter
 */
function lastCrossing(filter) {
  const { order: n, b } = filter;
  const share = Math.abs(filter.dcGain) / Math.SQRT2 / (2 * n);
  if (share === 0) return 0;
  const most = Math.max(2 * n * fastest(filter), ...b.map((value, i) => (Math.abs(value) / share) ** (1 / (n - i))));
  return Math.min(most, 1e7 * fastest(filter)); // an F(0) that is only rounding
}

/**
 * Peak of |F| between two frequencies, by golden section.
 * @param {Filter} filter @param {number} low @param {number} high
 */
function largestGain(filter, low, high) {
  const golden = (Math.sqrt(5) - 1) / 2;
  for (let i = 0; i < 40; i++) {
    const [left, right] = [high - golden * (high - low), low + golden * (high - low)];
    if (gainAt(filter, left) > gainAt(filter, right)) high = right;
    else low = left;
  }
  return gainAt(filter, (low + high) / 2);
}

/**
 * Where |F| crosses the level between two frequencies.
 * @param {Filter} filter @param {number} level @param {number} low @param {number} high
 */
function crossing(filter, level, low, high) {
  const falling = gainAt(filter, low) > level;
  for (let i = 0; i < 60 && high - low > 4 * EPSILON * high; i++) {
    const middle = (low + high) / 2;
    if (gainAt(filter, middle) > level === falling) low = middle;
    else high = middle;
  }
  return (low + high) / 2;
}

/**
 * Time in s after which the step response stays within 2 % of its end (of its peak where F(0) = 0); null where it does
 * not settle.
 *
 * Blocks of time double in length, each fine enough for every mode that still moves.
 * @param {Filter} filter
 * @returns {number | null}
 */
export function settlingTime(filter) {
  const { n, A, equilibrium, C } = chain(filter);
  const times = [];
  const distances = [];
  let left = new Float64Array(equilibrium);
  let begun = 0;
  let length = 4 / fastest(filter);
  let step = 0;
  let dA = A;
  for (let block = 0; block < 60; block++) {
    const alive = filter.sections.filter(({ re }) => -re * begun < 12);
    if (!alive.length) break;
    const swing = Math.max(...alive.map(({ im }) => im));
    const count = Math.min(Math.max(64, Math.ceil((16 * length * swing) / (2 * Math.PI))), 4096);
    const wanted = length / count;
    if (wanted === 2 * step) doubleStep(dA, n);
    else if (wanted !== step) dA = expm1(A, n, wanted);
    step = wanted;
    for (let k = 0; k < count; k++) {
      let value = 0;
      const next = new Float64Array(left);
      for (let i = 0; i < n; i++) {
        value += C[i] * left[i];
        for (let j = 0; j < n; j++) next[i] += dA[i * n + j] * left[j];
      }
      times.push(begun + (k * length) / count);
      distances.push(Math.abs(value));
      left = next;
    }
    begun += length;
    length = begun;
  }
  const dc = Math.abs(filter.dcGain);
  const most = distances.reduce((largest, value) => Math.max(largest, value), 0);
  const band = 0.02 * (dc > 1e-9 * most ? dc : most);
  let last = distances.length - 1;
  while (last >= 0 && distances[last] <= band) last--;
  if (last < 0) return 0;
  if (last + 1 === distances.length) return null;
  // On a straight line of the logarithm: exact for one mode.
  const high = Math.log(distances[last]);
  const low = Math.log(Math.max(distances[last + 1], 1e-300));
  return times[last] + Math.min((high - Math.log(band)) / (high - low), 1) * (times[last + 1] - times[last]);
}

/**
 * Frequencies, even in log omega, with more of them around lightly damped pairs, whose peaks are narrow.
 * @param {Filter} filter @param {{low: number, high: number, points: number, extra?: number[]}} range
 */
export function frequencyGrid(filter, { low, high, points, extra = [] }) {
  const ratio = Math.log(high / low);
  const grid = Array.from({ length: points }, (_, k) => low * Math.exp((ratio * k) / (points - 1)));
  for (const { re, im } of filter.sections) {
    if (im > 2 * -re) for (let i = -8; i <= 8; i++) grid.push(im - (re * i * Math.abs(i)) / 10);
  }
  grid.push(...extra);
  return Float64Array.from(grid.filter((w) => w >= low && w <= high)).sort();
}

/**
 * Magnitude in dB and unwrapped phase in degrees of a curve.
 * @param {Curve} curve
 */
export function polar({ re, im }) {
  const db = new Float64Array(re.length);
  const phase = new Float64Array(re.length);
  let turns = 0;
  let last = 0;
  for (let k = 0; k < re.length; k++) {
    db[k] = 10 * Math.log10(re[k] * re[k] + im[k] * im[k]);
    const angle = Math.atan2(im[k], re[k]);
    if (k && Number.isFinite(angle)) {
      if (angle - last > Math.PI) turns -= 1;
      else if (angle - last < -Math.PI) turns += 1;
    }
    if (Number.isFinite(angle)) last = angle;
    phase[k] = ((angle + 2 * Math.PI * turns) * 180) / Math.PI;
  }
  return { db, phase };
}
