/** Matched sampling: the output row that keeps the zeros of 1 - F at the samples; `filter/matching.py` says why. */

import { add, div, mul, roots } from "./polynomials.js";
import { chain, expm1, pairsOf, solved } from "./sections.js";

/** @import { Complex } from "./polynomials.js" */
/** @import { Filter } from "./filter.js" */

// A zero of 1 - F this near the axis, relative to its magnitude, was put there.
const ON_AXIS = 1e-6;
// A row so many times larger than that of F lives on differences of states that a step too long made alike.
const LARGEST_CHANGE = 50;

/** Frequencies in rad/s at which 1 - F vanishes, ascending. @param {Filter} filter */
function followedFrequencies({ c, type }) {
  const degree = c.length - 1 - type;
  if (degree < 2) return [];
  const scale = Math.abs(c[type]) ** (1 / degree);
  const scaled = c.slice(type).map((value, i) => value / scale ** (degree - i));
  const found = roots(scaled).filter(([re, im]) => im > 0 && Math.abs(re) <= ON_AXIS * Math.hypot(re, im));
  return found.map((root) => scale * polished(scaled, root)[1]).sort((v, w) => v - w);
}

/** A root two steps of Newton's method nearer. @param {number[]} c @param {Complex} root @returns {Complex} */
function polished(c, root) {
  for (let step = 0; step < 2; step++) {
    let value = /** @type {Complex} */ ([0, 0]);
    let slope = /** @type {Complex} */ ([0, 0]);
    for (let i = c.length - 1; i >= 0; i--) {
      slope = add(mul(slope, root), value);
      value = add(mul(value, root), [c[i], 0]);
    }
    if (slope[0] === 0 && slope[1] === 0) return root;
    const [re, im] = div(value, slope);
    root = [root[0] - re, root[1] - im];
  }
  return root;
}

/** Every curve and figure of a frame wants the same. @type {WeakMap<Filter, ReturnType<typeof match>>} */
const known = new WeakMap();

/**
 * Exact sampling, and what matched sampling makes of it.
 * @param {Filter} filter @param {number} dt
 */
export function matching(filter, dt) {
  let found = known.get(filter);
  if (found?.dt !== dt) known.set(filter, (found = match(filter, dt)));
  return found;
}

/** @param {Filter} filter @param {number} dt */
function match(filter, dt) {
  const { n, A, equilibrium, C } = chain(filter);
  const dA = expm1(A, n, dt);
  const w = followedFrequencies(filter);
  const nothing = filter.type < 2 && !w.length;
  const found = nothing ? null : change(filter, dt, w, dA, equilibrium, C);
  return {
    dt,
    exact: { n, dA, equilibrium, C },
    /** The matched row; C itself where there is nothing to keep, or it cannot be kept. */
    matched: { n, dA, equilibrium, C: found ? C.map((value, i) => value + found[i]) : C },
    /** Whether the matched row keeps what the exact one loses; null where it cannot, and the exact one stands for it. */
    kept: nothing ? false : found ? true : null,
  };
}

/**
 * What the matched row has beyond C, null where there is none.
 * @param {Filter} filter @param {number} dt @param {number[]} w @param {Float64Array} dA
 * @param {Float64Array} equilibrium @param {Float64Array} C
 */
function change(filter, dt, w, dA, equilibrium, C) {
  const beyond = w.length > 0 && w[w.length - 1] * dt >= Math.PI;
  if (beyond || Math.max(filter.type, 1) + 2 * w.length > filter.order) return null;
  const rows = atZero(filter, dt, dA, equilibrium);
  const targets = rows.map((_, i) => (i > 0 ? 0 : filter.type > 0 ? 1 : dot(C, equilibrium)));
  for (const X of w.map((omega) => onAxis(filter, dt, omega, dA, equilibrium))) {
    rows.push(...X);
    targets.push(1, 0);
  }
  const missing = rows.map((row, i) => targets[i] - dot(row, C));
  const found = least(rows, missing);
  return largest(found) <= LARGEST_CHANGE * largest(C) ? found : null;
}

/**
 * Taylor coefficients of X(s) at s = 0, s in units of the slowest pole.
 * @param {Filter} filter @param {number} dt @param {Float64Array} dA @param {Float64Array} equilibrium
 */
function atZero(filter, dt, dA, equilibrium) {
  const n = filter.order;
  const unit = dt * Math.min(...filter.sections.map(({ re, im }) => Math.hypot(re, im)));
  /** @type {Float64Array[]} */
  const rows = [];
  const power = [1]; // (s h)^j / j!
  for (let j = 0; j < Math.max(filter.type, 1); j++) {
    power.push((power[j] * unit) / (j + 1));
    const row = equilibrium.map((value) => value * (power[j] / (j + 1)));
    if (j) {
      const earlier = new Float64Array(n);
      for (let i = 1; i <= j; i++) for (let k = 0; k < n; k++) earlier[k] += power[i] * rows[j - i][k];
      const work = solved(dA, n, pairsOf(filter), [0, 0], earlier);
      for (let k = 0; k < n; k++) row[k] -= work[2 * k];
    }
    rows.push(row);
  }
  return rows;
}

/**
 * Real and imaginary part of X(j omega).
 * @param {Filter} filter @param {number} dt @param {number} omega @param {Float64Array} dA
 * @param {Float64Array} equilibrium
 */
function onAxis(filter, dt, omega, dA, equilibrium) {
  const n = filter.order;
  const theta = omega * dt;
  const sine = Math.sin(theta / 2);
  const delta = /** @type {Complex} */ ([-2 * sine * sine, Math.sin(theta)]);
  const drive = new Float64Array(n);
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) drive[i] -= dA[i * n + j] * equilibrium[j];
  const work = solved(dA, n, pairsOf(filter), delta, drive);
  const entry = div(delta, [0, theta]);
  const X = [new Float64Array(n), new Float64Array(n)];
  for (let k = 0; k < n; k++) [X[0][k], X[1][k]] = mul(entry, [work[2 * k], work[2 * k + 1]]);
  return X;
}

/**
 * The least x with row_i x = missing_i: by orthogonal rows, each made so twice over.
 * @param {Float64Array[]} rows @param {number[]} missing
 */
function least(rows, missing) {
  const x = new Float64Array(rows[0].length);
  /** @type {Float64Array[]} */
  const found = [];
  for (const [i, row] of rows.entries()) {
    const size = Math.hypot(...row);
    let left = row.map((value) => value / size);
    const direction = left;
    for (let pass = 0; pass < 2; pass++) {
      for (const q of found) {
        const share = dot(q, left);
        left = left.map((value, k) => value - share * q[k]);
      }
    }
    const rest = Math.hypot(...left);
    const q = left.map((value) => value / rest);
    const step = (missing[i] / size - dot(direction, x)) / rest;
    for (let k = 0; k < x.length; k++) x[k] += step * q[k];
    found.push(q);
  }
  return x;
}

/** @param {Float64Array} x @param {Float64Array} y */
const dot = (x, y) => x.reduce((sum, value, i) => sum + value * y[i], 0);

/** @param {Float64Array} x */
const largest = (x) => x.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
