/** The filter as it runs: sampled by one of four methods. */

import { matching } from "./matched.js";
import { EPSILON, mul } from "./polynomials.js";
import { chain, pairsOf, product, solved } from "./sections.js";

/** @import { Complex } from "./polynomials.js" */
/** @import { Curve, Filter } from "./filter.js" */

/** @typedef {"exact" | "matched" | "euler" | "tustin"} Method  matched: exact where there is nothing to keep */

// Doublings after which the slowest pole and the shortest step allowed (1e-3 rad/s, 10 us) have long died out.
const MOST_DOUBLINGS = 64;

/**
 * The sampled recursion w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k), f_hat - f_theta = C w_k.
 * @param {Filter} filter @param {number} dt @param {Method} method
 */
function transition(filter, dt, method) {
  if (method === "exact" || method === "matched") return matching(filter, dt)[method];
  const { n, A, equilibrium, C } = chain(filter);
  const dA = A.map((value) => value * dt);
  return { n, dA: method === "tustin" ? tustin(dA, n) : dA, equilibrium, C };
}

/** (I - X/2)^-1 X by elimination with row exchanges. @param {Float64Array} X @param {number} n */
function tustin(X, n) {
  const left = X.map((value, i) => (i % (n + 1) === 0 ? 1 : 0) - value / 2);
  const right = new Float64Array(X);
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(left[i * n + k]) > Math.abs(left[pivot * n + k])) pivot = i;
    for (const M of [left, right]) {
      for (let j = 0; j < n; j++) [M[k * n + j], M[pivot * n + j]] = [M[pivot * n + j], M[k * n + j]];
    }
    for (let i = 0; i < n; i++) {
      const factor = i === k ? 0 : left[i * n + k] / left[k * n + k];
      if (factor === 0) continue;
      for (let j = 0; j < n; j++) {
        left[i * n + j] -= factor * left[k * n + j];
        right[i * n + j] -= factor * right[k * n + j];
      }
    }
  }
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) right[i * n + j] /= left[i * n + i];
  return right;
}

/** e^(j theta) - 1, without the subtraction. @param {number} theta @returns {Complex} */
export const turnedLess = (theta) => {
  const sine = Math.sin(theta / 2);
  return [-2 * sine * sine, 2 * sine * Math.cos(theta / 2)];
};

/**
 * F_d(e^(j theta)) of the recursion alone, at omega <= pi/dt, and 1 minus it without cancellation.
 * @param {Filter} filter @param {number} dt @param {Method} method @param {ArrayLike<number>} omega
 * @returns {{F: Curve, E: Curve}}
 */
export function recursionResponse(filter, dt, method, omega) {
  const { n, dA, equilibrium, C } = transition(filter, dt, method);
  const pairAt = pairsOf(filter);
  const drive = new Float64Array(n);
  let dc = 0;
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) drive[i] -= dA[i * n + j] * equilibrium[j];
    dc += C[i] * equilibrium[i];
  }
  const offset = filter.type > 0 ? 0 : 1 - dc;
  const size = omega.length;
  const F = { re: new Float64Array(size), im: new Float64Array(size) };
  const E = { re: new Float64Array(size), im: new Float64Array(size) };
  const work = new Float64Array(2 * n);
  for (let k = 0; k < size; k++) {
    const delta = turnedLess(omega[k] * dt);
    /** @type {Complex} */
    const z = [1 + delta[0], delta[1]];
    const driven = mul(z, resolvent(dA, n, pairAt, delta, drive, C, work));
    const resting = mul(z, resolvent(dA, n, pairAt, delta, equilibrium, C, work));
    const rest = mul(delta, [resting[0] - dc, resting[1]]);
    F.re[k] = driven[0];
    F.im[k] = driven[1];
    E.re[k] = offset + rest[0];
    E.im[k] = rest[1];
  }
  return { F, E };
}

/**
 * Response of the sampled filter to a continuous residual, at omega <= pi/dt: F_d(e^(j theta)) times the mean over a
 * step,
 * sinc(theta/2) e^(-j theta/2); and 1 minus it without cancellation.
 * @param {Filter} filter @param {number} dt @param {Method} method @param {ArrayLike<number>} omega
 * @returns {{F: Curve, E: Curve}}
 */
export function sampledResponse(filter, dt, method, omega) {
  const { F, E } = recursionResponse(filter, dt, method, omega);
  for (let k = 0; k < omega.length; k++) {
    const half = (omega[k] * dt) / 2;
    const sine = Math.sin(half);
    const cosine = Math.cos(half);
    /** @type {Complex} */
    const driven = [F.re[k], F.im[k]];
    // Mean over a step: sinc e^(-j half); 1 minus it is short - sinc (e^(-j half) - 1), both without a subtraction.
    const sinc = half === 0 ? 1 : sine / half;
    const square = half * half;
    const short = half < 0.02 ? (square / 6) * (1 - (square / 20) * (1 - square / 42)) : 1 - sinc;
    const quarter = Math.sin(half / 2);
    const missing = mul(driven, [short + 2 * sinc * quarter * quarter, sinc * sine]);
    const seen = mul(driven, [sinc * cosine, -sinc * sine]);
    F.re[k] = seen[0];
    F.im[k] = seen[1];
    E.re[k] += missing[0];
    E.im[k] += missing[1];
  }
  return { F, E };
}

/**
 * C (delta I - dA)^-1 drive.
 * @param {Float64Array} dA @param {number} n @param {Uint8Array} pairAt @param {Complex} delta
 * @param {Float64Array} drive
 * @param {Float64Array} C @param {Float64Array} work
 * @returns {Complex}
 */
function resolvent(dA, n, pairAt, delta, drive, C, work) {
  solved(dA, n, pairAt, delta, drive, work);
  let re = 0;
  let im = 0;
  for (let i = 0; i < n; i++) {
    re += C[i] * work[2 * i];
    im += C[i] * work[2 * i + 1];
  }
  return [re, im];
}

/**
 * Standard deviation of f_hat per standard deviation of noise on x that is independent from sample to sample, in 1/s;
 * null where the
 * sampled filter is unstable.
 *
 * u_k = (nu_k - nu_{k-1})/h: the state less B nu_k / h is driven by dA B nu_{k-1} / h. Its covariance is summed by
 * doubling,
 * P + (I + X) P (I + X)', with X kept in delta form: slow poles keep their digits.
 * @param {Filter} filter @param {number} dt @param {Method} method
 * @returns {number | null}
 */
export function noiseGain(filter, dt, method) {
  if (method === "euler" && !(dt < eulerLimit(filter))) return null;
  const { n, dA, equilibrium, C } = transition(filter, dt, method);
  const B = new Float64Array(n);
  const drive = new Float64Array(n);
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) B[i] -= (dA[i * n + j] * equilibrium[j]) / dt;
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) drive[i] += dA[i * n + j] * B[j];
  const P = Float64Array.from({ length: n * n }, (_, k) => drive[Math.floor(k / n)] * drive[k % n]);
  let X = dA;
  for (let doubling = 0; doubling < MOST_DOUBLINGS; doubling++) {
    const M = X.map((value, i) => (i % (n + 1) === 0 ? 1 : 0) + value);
    const added = product(product(M, P, n), transposed(M, n), n);
    let largest = 0;
    let change = 0;
    for (let i = 0; i < n * n; i++) {
      P[i] += added[i];
      change = Math.max(change, Math.abs(added[i]));
      largest = Math.max(largest, Math.abs(P[i]));
    }
    if (!Number.isFinite(largest)) return null;
    if (change <= EPSILON * 1e-3 * largest) break;
    const square = product(X, X, n);
    X = X.map((value, i) => 2 * value + square[i]);
  }
  let variance = 0;
  let direct = 0;
  for (let i = 0; i < n; i++) {
    direct += C[i] * B[i];
    for (let j = 0; j < n; j++) variance += C[i] * P[i * n + j] * C[j];
  }
  return Math.sqrt(Math.max(variance, 0) + direct * direct);
}

/** Transpose of an n x n matrix. @param {Float64Array} X @param {number} n */
const transposed = (X, n) => X.map((_, k) => X[(k % n) * n + Math.floor(k / n)]);

/** Largest step at which forward Euler is stable, |1 + p h| < 1 for every pole. @param {Filter} filter */
export const eulerLimit = (filter) => Math.min(...filter.sections.map(({ re, im }) => (-2 * re) / (re * re + im * im)));
