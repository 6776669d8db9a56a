/**
 * The chain of unit-gain sections that the step response and the sampled filter run on. Matrices are n x n, row by row.
 */

import { monic } from "./filter.js";
import { div, mul, multiply } from "./polynomials.js";

/** @import { Complex } from "./polynomials.js" */
/** @import { Filter } from "./filter.js" */

const TAYLOR_NORM = 0.5;
const TAYLOR_TERMS = 18;

/**
 * The chain of unit-gain sections: A (n x n, row by row), its equilibrium for a unit input, and the output row C.
 *
 * A real pole p: w' = p (w - v). A pair: w1' = re w1 - im^2/r w2 + r v, w2' = r w1 + re w2, r = |p|.
 * @param {Filter} filter
 */
export function chain(filter) {
  const n = filter.order;
  const A = new Float64Array(n * n);
  const equilibrium = new Float64Array(n).fill(1);
  let i = 0;
  for (const { re, im } of filter.sections) {
    A[i * n + i] = re;
    if (!im) {
      if (i) A[i * n + i - 1] = -re;
      i += 1;
      continue;
    }
    const r = Math.hypot(re, im);
    A[(i + 1) * n + i + 1] = re;
    A[i * n + i + 1] = -(im * im) / r;
    A[(i + 1) * n + i] = r;
    if (i) A[i * n + i - 1] = r;
    equilibrium[i] = -re / r;
    i += 2;
  }
  return { n, A, equilibrium, C: chainOutput(filter, equilibrium) };
}

/**
 * Row C so that C (sI - A)^-1 B = N/D. In s / scale all coefficients are of one size, and the numerators of the states
 * fall by one
 * degree a state, so the system is triangular.
 * @param {Filter} filter @param {Float64Array} equilibrium
 */
function chainOutput(filter, equilibrium) {
  const { order: n, a, b, sections } = filter;
  const C = new Float64Array(n);
  if (filter.lowpass) {
    C[n - 1] = 1;
    return C;
  }
  const scale = Math.abs(a[0]) ** (1 / n);
  const scaled = sections.map(({ re, im }) => ({ re: re / scale, im: im / scale }));
  /** @type {number[][]} */
  const columns = [];
  let gain = 1;
  scaled.forEach(({ re, im }, k) => {
    const later = monic(scaled.slice(k + 1));
    if (!im) {
      gain *= -re;
      columns.push(later.map((value) => gain * value));
      return;
    }
    const r = Math.hypot(re, im);
    columns.push(multiply(later, [-re, 1]).map((value) => gain * r * value));
    gain *= r * r;
    columns.push(later.map((value) => gain * value));
  });
  for (let i = 0; i < n; i++) {
    const power = n - 1 - i; // state i is the last whose numerator reaches this power
    let value = b[power] / scale ** (n - power);
    for (let j = 0; j < i; j++) value -= columns[j][power] * C[j];
    C[i] = value / columns[i][power];
  }
  let dc = 0;
  for (let i = 0; i < n; i++) dc += C[i] * equilibrium[i];
  C[n - 1] += b[0] / a[0] - dc; // F(0) to the last digit
  return C;
}

/** Product of two n x n matrices, row by row. @param {Float64Array} X @param {Float64Array} Y @param {number} n */
export function product(X, Y, n) {
  const Z = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < n; k++) {
      const x = X[i * n + k];
      if (x !== 0) for (let j = 0; j < n; j++) Z[i * n + j] += x * Y[k * n + j];
    }
  }
  return Z;
}

/**
 * exp(A step) - I by a Taylor series and squarings in delta form, (I + X)^2 - I = 2X + X^2: slow poles keep their
 * digits.
 * @param {Float64Array} A @param {number} n @param {number} step
 */
export function expm1(A, n, step) {
  let norm = 0;
  for (let i = 0; i < n; i++) {
    let row = 0;
    for (let j = 0; j < n; j++) row += Math.abs(A[i * n + j]);
    norm = Math.max(norm, row);
  }
  const squarings = norm * step > 0 ? Math.max(0, Math.ceil(Math.log2((norm * step) / TAYLOR_NORM))) : 0;
  const scaled = A.map((value) => (value * step) / 2 ** squarings);
  let X = new Float64Array(scaled);
  let term = new Float64Array(scaled);
  for (let j = 2; j <= TAYLOR_TERMS; j++) {
    term = product(term, scaled, n).map((value) => value / j);
    for (let i = 0; i < X.length; i++) X[i] += term[i];
  }
  for (let q = 0; q < squarings; q++) doubleStep(X, n);
  return X;
}

/** From exp(A h) - I to exp(2 A h) - I, in place. @param {Float64Array} X @param {number} n */
export function doubleStep(X, n) {
  const square = product(X, X, n);
  for (let i = 0; i < X.length; i++) X[i] = 2 * X[i] + square[i];
}

/** Where a conjugate pair begins among the states. @param {Filter} filter */
export function pairsOf(filter) {
  const pairAt = new Uint8Array(filter.order);
  filter.sections.reduce((i, { im }) => ((pairAt[i] = im ? 1 : 0), i + (im ? 2 : 1)), 0);
  return pairAt;
}

/**
 * (delta I - dA)^-1 drive, real and imaginary parts in turn, by forward substitution over the sections: dA is lower
 * triangular but for the pairs.
 * @param {Float64Array} dA @param {number} n @param {Uint8Array} pairAt @param {Complex} delta
 * @param {Float64Array} drive @param {Float64Array} [work] where they go
 */
export function solved(dA, n, pairAt, delta, drive, work = new Float64Array(2 * n)) {
  for (let i = 0; i < n;) {
    const rows = pairAt[i] ? 2 : 1;
    for (let r = i; r < i + rows; r++) {
      let x = drive[r];
      let y = 0;
      for (let j = 0; j < i; j++) {
        x += dA[r * n + j] * work[2 * j];
        y += dA[r * n + j] * work[2 * j + 1];
      }
      work[2 * r] = x;
      work[2 * r + 1] = y;
    }
    if (rows === 1) {
      const [x, y] = div([work[2 * i], work[2 * i + 1]], [delta[0] - dA[i * n + i], delta[1]]);
      work[2 * i] = x;
      work[2 * i + 1] = y;
    } else {
      /** @type {Complex} */
      const p = [delta[0] - dA[i * n + i], delta[1]];
      /** @type {Complex} */
      const s = [delta[0] - dA[(i + 1) * n + i + 1], delta[1]];
      const q = -dA[i * n + i + 1];
      const t = -dA[(i + 1) * n + i];
      const whole = mul(p, s);
      whole[0] -= q * t;
      /** @type {Complex} */
      const u = [work[2 * i], work[2 * i + 1]];
      /** @type {Complex} */
      const v = [work[2 * i + 2], work[2 * i + 3]];
      const first = mul(s, u);
      const second = mul(p, v);
      const one = div([first[0] - q * v[0], first[1] - q * v[1]], whole);
      const two = div([second[0] - t * u[0], second[1] - t * u[1]], whole);
      work.set([one[0], one[1], two[0], two[1]], 2 * i);
    }
    i += rows;
  }
  return work;
}
