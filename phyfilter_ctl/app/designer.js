/**
 * Interactive designer of a PhyFilter: preview mathematics first, then the interface.
 *
 * One ES module without dependencies, in anywidget's format: `export default { render({ model, el }) }`. It talks to Python
 * through `model.send(message)` and `model.on("msg:custom", reply)` only. While something is dragged it draws what the functions
 * below compute (equal to the library's to 1e-9); Python's answer follows and replaces the figures.
 *
 * Units: rad/s, s. Polynomials ascend: a[0] is a_0. Complex numbers are [re, im].
 */

/** @typedef {[number, number]} Complex */
/** @typedef {{re: number, im: number}} Section  a real pole (im = 0) or a conjugate pair (im > 0) */
/** @typedef {{kind: "lowpass"} | {kind: "type", type: number} | {kind: "zeros", zeros: Complex[], gain: number} | {kind: "b", b: number[]}} Numerator */
/** @typedef {"exact" | "euler" | "tustin"} Method */
/** @typedef {{sections: Section[], order: number, a: number[], b: number[], c: number[], zeros: Complex[], dcGain: number, type: number, lowpass: boolean}} Filter */
/** @typedef {{re: Float64Array, im: Float64Array}} Curve */

// ---------------------------------------------------------------------------------------------------------------
// Preview mathematics
// ---------------------------------------------------------------------------------------------------------------

const EPSILON = 2 ** -52;
// Coefficients that agree to this count as equal when the type of 1 - F is read off, as in Python.
const SAME_COEFFICIENT = 1e-12;
const TAYLOR_NORM = 0.5;
const TAYLOR_TERMS = 18;
// Doublings after which the slowest pole and the shortest step allowed (1e-3 rad/s, 10 us) have long died out.
const MOST_DOUBLINGS = 64;
export const LIMITS = Object.freeze({ order: 8, slowest: 1e-3, fastest: 1e5, dtMin: 1e-5, dtMax: 1, damping: 1e-3 });

/**
 * Poles as sections, fastest first: the first states of the chain then carry the whole band, and any numerator is a combination of
 * them with small coefficients. (Slowest first the coefficients cancel: 1e-3 of the noise gain is lost at poles two decades apart.)
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
function monic(sections) {
  let product = [1];
  for (const { re, im } of sections) {
    product = multiply(product, im ? [re * re + im * im, -2 * re, 1] : [-re, 1]);
  }
  return product;
}

/** Product of two ascending polynomials. @param {number[]} p @param {number[]} q */
function multiply(p, q) {
  const product = new Array(p.length + q.length - 1).fill(0);
  p.forEach((u, i) => q.forEach((v, j) => (product[i + j] += u * v)));
  return product;
}

/**
 * Ascending coefficients a_0 ... a_{n-1} of D.
 * @param {Complex[]} poles
 */
export function denominator(poles) {
  return monic(sectionsOf(poles)).slice(0, -1);
}

/**
 * Ascending coefficients b_0 ... b_{n-1} of N: a_0 alone, the first k of a, gain * prod (s - zero), or given.
 * @param {Numerator} numerator
 * @param {number[]} a
 */
export function numeratorOf(numerator, a) {
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
  return { sections, order: a.length, a, b, c, zeros, dcGain: b[0] / a[0], type: c.findIndex((value) => value !== 0), lowpass };
}

/**
 * Roots of an ascending real polynomial, conjugates exactly paired; zeros at the origin are exact.
 * Aberth's simultaneous iteration in scaled coordinates.
 * @param {number[]} coefficients
 * @returns {Complex[]}
 */
export function roots(coefficients) {
  let degree = coefficients.length - 1;
  while (degree > 0 && coefficients[degree] === 0) degree--;
  let low = 0;
  while (low < degree && coefficients[low] === 0) low++;
  /** @type {Complex[]} */
  const found = Array.from({ length: low }, () => [0, 0]);
  const m = degree - low;
  if (m === 0) return found;
  const lead = coefficients[degree];
  const scale = Math.abs(coefficients[low] / lead) ** (1 / m);
  const p = Array.from({ length: m + 1 }, (_, i) => coefficients[low + i] / lead / scale ** (m - i));
  if (m === 1) return [...found, [-p[0] * scale, 0]];
  // Not symmetric about the real axis, or a double real root would never be reached.
  let guess = Array.from({ length: m }, (_, k) => /** @type {Complex} */ ([Math.cos((2 * Math.PI * k) / m + 0.4), Math.sin((2 * Math.PI * k) / m + 0.4)]));
  for (let sweep = 0; sweep < 200; sweep++) {
    let moved = 0;
    guess = guess.map((z, k) => {
      let value = /** @type {Complex} */ ([1, 0]);
      let slope = /** @type {Complex} */ ([0, 0]);
      for (let i = m - 1; i >= 0; i--) {
        slope = add(mul(slope, z), value);
        value = mul(value, z);
        value[0] += p[i];
      }
      if (value[0] === 0 && value[1] === 0) return z;
      const newton = div(slope, value);
      let push = /** @type {Complex} */ ([0, 0]);
      guess.forEach((other, j) => {
        const gap = /** @type {Complex} */ ([z[0] - other[0], z[1] - other[1]]);
        if (j !== k && (gap[0] !== 0 || gap[1] !== 0)) push = add(push, div([1, 0], gap));
      });
      const step = div([1, 0], [newton[0] - push[0], newton[1] - push[1]]);
      if (!Number.isFinite(step[0]) || !Number.isFinite(step[1])) return z;
      moved = Math.max(moved, Math.hypot(...step) / Math.max(Math.hypot(...z), 1e-300));
      return [z[0] - step[0], z[1] - step[1]];
    });
    if (moved < 4 * EPSILON) break;
  }
  return [...found, ...paired(guess).map(([re, im]) => /** @type {Complex} */ ([re * scale, im * scale]))];
}

/** Make roots of a real polynomial exact conjugate pairs. @param {Complex[]} values @returns {Complex[]} */
function paired(values) {
  const left = [...values].sort((p, q) => Math.abs(p[1]) - Math.abs(q[1]));
  /** @type {Complex[]} */
  const pairs = [];
  while (left.length) {
    const z = /** @type {Complex} */ (left.pop());
    let partner = -1;
    let nearest = Math.abs(z[1]);
    left.forEach((other, i) => {
      const distance = Math.hypot(other[0] - z[0], other[1] + z[1]);
      if (distance < nearest) [partner, nearest] = [i, distance];
    });
    if (partner < 0 || Math.abs(z[1]) < 1e-12 * Math.hypot(...z)) pairs.push([z[0], 0]);
    else {
      const [other] = left.splice(partner, 1);
      const re = (z[0] + other[0]) / 2;
      const im = Math.abs(z[1] - other[1]) / 2;
      pairs.push([re, im], [re, -im]);
    }
  }
  return pairs;
}

/** @param {Complex} p @param {Complex} q @returns {Complex} */
const add = (p, q) => [p[0] + q[0], p[1] + q[1]];
/** @param {Complex} p @param {Complex} q @returns {Complex} */
const mul = (p, q) => [p[0] * q[0] - p[1] * q[1], p[0] * q[1] + p[1] * q[0]];
/** @param {Complex} p @param {Complex} q @returns {Complex} */
const div = (p, q) => {
  const size = q[0] * q[0] + q[1] * q[1];
  return [(p[0] * q[0] + p[1] * q[1]) / size, (p[1] * q[0] - p[0] * q[1]) / size];
};

/**
 * numerator(j omega) / D(j omega): the poles are divided out one at a time, so repeated ones are right and nothing overflows.
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
    for (let i = numerator.length - 1; i >= 0; i--) [x, y] = [numerator[i] - w * y, w * x];
    for (const pole of sections) {
      for (let side = pole.im ? 2 : 1; side > 0; side--) {
        const u = -pole.re;
        const v = side === 2 ? w + pole.im : w - pole.im;
        const size = u * u + v * v;
        [x, y] = [(x * u + y * v) / size, (y * u - x * v) / size];
      }
    }
    re[k] = x;
    im[k] = y;
  }
  return { re, im };
}

/** F(j omega). @param {Filter} filter @param {ArrayLike<number>} omega */
export const response = (filter, omega) => overDenominator(filter.b, filter.sections, omega);

/** 1 - F(j omega) = (D - N)/D, without cancellation at low frequencies. @param {Filter} filter @param {ArrayLike<number>} omega */
export const errorResponse = (filter, omega) => overDenominator(filter.c, filter.sections, omega);

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
 * Row C so that C (sI - A)^-1 B = N/D. In s / scale all coefficients are of one size, and the numerators of the states fall by one
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
function product(X, Y, n) {
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
 * exp(A step) - I by a Taylor series and squarings in delta form, (I + X)^2 - I = 2X + X^2: slow poles keep their digits.
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
  for (let q = 0; q < squarings; q++) {
    const square = product(X, X, n);
    for (let i = 0; i < X.length; i++) X[i] = 2 * X[i] + square[i];
  }
  return X;
}

/**
 * The sampled recursion w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k), f_hat - f_theta = C w_k.
 * @param {Filter} filter @param {number} dt @param {Method} method
 */
export function transition(filter, dt, method) {
  const { n, A, equilibrium, C } = chain(filter);
  let dA;
  if (method === "exact") dA = expm1(A, n, dt);
  else {
    dA = A.map((value) => value * dt);
    if (method === "tustin") dA = tustin(dA, n);
  }
  return { n, dA, equilibrium, C };
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

/**
 * Response of the sampled filter to a continuous residual, at omega <= pi/dt: F_d(e^(j theta)) times the mean over a step,
 * sinc(theta/2) e^(-j theta/2); and 1 minus it without cancellation. delta = z - 1 is formed without the subtraction.
 * @param {Filter} filter @param {number} dt @param {Method} method @param {ArrayLike<number>} omega
 * @returns {{F: Curve, E: Curve}}
 */
export function sampledResponse(filter, dt, method, omega) {
  const { n, dA, equilibrium, C } = transition(filter, dt, method);
  const pairAt = new Uint8Array(n);
  filter.sections.reduce((i, { im }) => ((pairAt[i] = im ? 1 : 0), i + (im ? 2 : 1)), 0);
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
    const theta = omega[k] * dt;
    const half = theta / 2;
    const sine = Math.sin(half);
    const cosine = Math.cos(half);
    /** @type {Complex} */
    const delta = [-2 * sine * sine, 2 * sine * cosine];
    /** @type {Complex} */
    const z = [1 + delta[0], delta[1]];
    const driven = mul(z, resolvent(dA, n, pairAt, delta, drive, C, work));
    const resting = mul(z, resolvent(dA, n, pairAt, delta, equilibrium, C, work));
    const rest = mul(delta, [resting[0] - dc, resting[1]]);
    // Mean over a step: sinc e^(-j half); 1 minus it is short - sinc (e^(-j half) - 1), both parts without a subtraction.
    const sinc = half === 0 ? 1 : sine / half;
    const square = half * half;
    const short = half < 0.02 ? (square / 6) * (1 - (square / 20) * (1 - square / 42)) : 1 - sinc;
    const quarter = Math.sin(half / 2);
    const missing = mul(driven, [short + 2 * sinc * quarter * quarter, sinc * sine]);
    const seen = mul(driven, [sinc * cosine, -sinc * sine]);
    F.re[k] = seen[0];
    F.im[k] = seen[1];
    E.re[k] = offset + rest[0] + missing[0];
    E.im[k] = rest[1] + missing[1];
  }
  return { F, E };
}

/**
 * C (delta I - dA)^-1 drive by forward substitution over the sections: dA is lower triangular but for the pairs.
 * @param {Float64Array} dA @param {number} n @param {Uint8Array} pairAt @param {Complex} delta @param {Float64Array} drive
 * @param {Float64Array} C @param {Float64Array} work
 * @returns {Complex}
 */
function resolvent(dA, n, pairAt, delta, drive, C, work) {
  let outRe = 0;
  let outIm = 0;
  for (let i = 0; i < n; ) {
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
    for (let r = i; r < i + rows; r++) {
      outRe += C[r] * work[2 * r];
      outIm += C[r] * work[2 * r + 1];
    }
    i += rows;
  }
  return [outRe, outIm];
}

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
 * Standard deviation of f_hat per standard deviation of noise on x that is independent from sample to sample, in 1/s; null where the
 * sampled filter is unstable.
 *
 * u_k = (nu_k - nu_{k-1})/h: the state less B nu_k / h is driven by dA B nu_{k-1} / h. Its covariance is summed by doubling,
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

/** |F| at one frequency. @param {Filter} filter @param {number} omega */
const gainAt = (filter, omega) => {
  const { re, im } = response(filter, [omega]);
  return Math.hypot(re[0], im[0]);
};

/**
 * Width in rad/s of the band in which |F| stays above |F(0)|/sqrt(2) (above its peak/sqrt(2) where F(0) = 0); null where it has no edge.
 * @param {Filter} filter
 * @returns {number | null}
 */
export function bandwidth(filter) {
  const omega = frequencyGrid(filter, { low: 0.01 * slowest(filter), high: Math.max(100 * fastest(filter), lastCrossing(filter)), points: 400 });
  const gains = Array.from(omega, (w) => gainAt(filter, w));
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
 * A frequency above which |F| stays below |F(0)|/sqrt(2), 0 where F(0) = 0: each of the n terms of N is below its share there, as
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

/** Peak of |F| between two frequencies, by golden section. @param {Filter} filter @param {number} low @param {number} high */
function largestGain(filter, low, high) {
  const golden = (Math.sqrt(5) - 1) / 2;
  for (let i = 0; i < 40; i++) {
    const [left, right] = [high - golden * (high - low), low + golden * (high - low)];
    if (gainAt(filter, left) > gainAt(filter, right)) high = right;
    else low = left;
  }
  return gainAt(filter, (low + high) / 2);
}

/** Where |F| crosses the level between two frequencies. @param {Filter} filter @param {number} level @param {number} low @param {number} high */
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
 * Time in s after which the step response stays within 2 % of its end (of its peak where F(0) = 0); null where it does not settle.
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
  for (let block = 0; block < 60; block++) {
    const alive = filter.sections.filter(({ re }) => -re * begun < 12);
    if (!alive.length) break;
    const swing = Math.max(...alive.map(({ im }) => im));
    const count = Math.min(Math.max(64, Math.ceil((16 * length * swing) / (2 * Math.PI))), 4096);
    const dA = expm1(A, n, length / count);
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

/** @param {Filter} filter */
const slowest = (filter) => Math.min(...filter.sections.map(({ re, im }) => Math.hypot(re, im)));
/** @param {Filter} filter */
const fastest = (filter) => Math.max(...filter.sections.map(({ re, im }) => Math.hypot(re, im)));
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

/** Gain that a numerator edit keeps: F(0), or |F| at the mean natural frequency where F(0) = 0. @param {Filter} filter */
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

/** Mean natural frequency, geometric. @param {Filter} filter */
const middle = (filter) => filter.a[0] ** (1 / filter.order);

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

/** The same filter with time running faster. @param {{poles: Complex[], numerator: Numerator}} design @param {number} factor */
export function scaled(design, factor) {
  const n = design.poles.length;
  const by = (/** @type {Complex[]} */ list) => list.map(([re, im]) => /** @type {Complex} */ ([re * factor, im * factor]));
  /** @type {Numerator} */
  let numerator = design.numerator;
  if (numerator.kind === "b") numerator = { kind: "b", b: numerator.b.map((value, i) => value * factor ** (n - i)) };
  if (numerator.kind === "zeros") {
    numerator = { kind: "zeros", zeros: by(numerator.zeros), gain: numerator.gain * factor ** (n - numerator.zeros.length) };
  }
  return { poles: by(design.poles), numerator };
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
    db[k] = 20 * Math.log10(Math.hypot(re[k], im[k]));
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

// ---------------------------------------------------------------------------------------------------------------
// Words, numbers and small parts of the page
// ---------------------------------------------------------------------------------------------------------------

const SVG = "http://www.w3.org/2000/svg";
let instances = 0;

/**
 * An element. Text goes in as text, never as markup.
 * @param {string} tag @param {Record<string, any>} [given] attributes, listeners ("onclick") and "data-test"
 * @param {...(Node | string | null)} children
 * @returns {any}
 */
function h(tag, given = {}, ...children) {
  return filled(document.createElement(tag), given, children);
}

/** The same in SVG. @param {string} tag @param {Record<string, any>} [given] @param {...(Node | string | null)} children @returns {any} */
function g(tag, given = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), given, children);
}

/** @param {Element} element @param {Record<string, any>} given @param {(Node | string | null)[]} children */
function filled(element, given, children) {
  for (const [name, value] of Object.entries(given)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Text that may stand already. @param {Element} element @param {string} text */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A number at so many significant digits, short. @param {number | null | undefined} value @param {number} [digits] */
export function short(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  let text = size < 1e-3 || size >= 1e6 ? value.toExponential(Math.max(digits - 2, 0)) : String(Number(value.toPrecision(digits)));
  if (text.includes("e")) text = text.replace(/\.?0*e/, "e").replace("e+", "e");
  return text.replace(/-/g, "−");
}

/** A value in a unit that reads well. @param {number | null} value @param {string} unit @param {number} [digits] @returns {[string, string]} */
export function inUnit(value, unit, digits = 4) {
  if (value !== null && unit === "s" && value !== 0) {
    const size = Math.abs(value);
    if (size < 1e-3) return [short(value * 1e6, digits), "µs"];
    if (size < 1) return [short(value * 1e3, digits), "ms"];
  }
  return [short(value, digits), unit === "deg" ? "°" : unit];
}

/** What someone typed as a number; NaN if it is none. @param {string} text */
export const typed = (text) => (/^\s*[-+−]?(\d+\.?\d*|\.\d+)([eE][-+−]?\d+)?\s*$/.test(text.replace(",", ".")) ? Number(text.replace(",", ".").replace(/−/g, "-")) : NaN);

/** A number for an input field. @param {number} value @param {number} [digits] */
const field = (value, digits = 6) => String(Number(value.toPrecision(digits)));

/** Numbers 1, 2, 5 times a power of ten, the first at or above the value. @param {number} value */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const lead = value / power;
  return (lead <= 1 ? 1 : lead <= 2 ? 2 : lead <= 5 ? 5 : 10) * power;
}

const SHORT_NAMES = {
  bandwidth: "Bandwidth",
  settling: "Settling, 2 %",
  noise_gain: "Noise gain",
  noise: "Noise of f̂",
  euler_dt: "Euler limit",
  bound: "Error bound",
  bound_sampled: "Bound, sampled",
  ratio_low: "Least M̂/M",
  ratio_high: "Largest M̂/M",
  delay_margin: "Delay margin",
  phase_margin: "Phase margin",
};

const IN_UNIT_OF_F = ["noise", "bound", "bound_sampled"];

const MEANINGS = {
  bandwidth: "Residuals slower than this pass into the estimate; |F| has fallen to 71 % there.",
  settling: "Time after which the answer to a sudden, constant residual stays within 2 % of its end.",
  noise_gain: "Standard deviation of f̂ for white noise of standard deviation 1 on every sample of x. Smaller is quieter.",
  noise: "Standard deviation of f̂ that the assumed noise of x leaves.",
  euler_dt: "Forward Euler is unstable at this step and above. The exact method has no such limit.",
  bound: "Certified: with |γ′| below the assumed slope the error |f − f̂| ends below this, whatever the residual does.",
  bound_sampled: "The same bound for the filter as it runs, sampled, at the samples.",
  ratio_low: "With f̂ fed back, the loop is stable from this modelled inertia over the true one ...",
  ratio_high: "... up to this one, with the assumed lag and delay.",
  delay_margin: "Further delay that the loop bears before it turns unstable.",
  phase_margin: "Phase that the loop bears in addition before it turns unstable.",
};

const FAMILY_NAMES = {
  binomial: "Binomial, no overshoot",
  butterworth: "Butterworth, flattest gain",
  bessel: "Bessel, flattest delay",
  itae: "ITAE, quick",
  damped: "Damped pairs",
  bandpass: "Band-pass",
};

const WIENER =
  "Wiener filter: about the least that a causal linear filter can reach. Every block of the log is scored by one fitted to the others, so a filter learned from all of it can come out slightly below.";

const TYPE_MEANINGS = ["constants", "ramps", "parabolas", "cubics"];

// ---------------------------------------------------------------------------------------------------------------
// Python: one message of a kind in flight, the newest of the waiting ones next
// ---------------------------------------------------------------------------------------------------------------

const BUSY_AFTER = 300; // ms
const LOST_AFTER = 60_000; // ms; a kernel that was restarted never answers

class Link {
  /** @param {any} model @param {(since: number | null) => void} onBusy called with when the oldest open question was asked */
  constructor(model, onBusy) {
    this.model = model;
    this.onBusy = onBusy;
    // Two views of one notebook model hear each other's replies: their numbers must not meet.
    this.next = Math.floor(Math.random() * 2 ** 30) * 2 ** 20 + 1;
    /** @type {Map<string, {id: number, resolve: Function, since: number, timer: any} | null>} */
    this.flying = new Map();
    /** @type {Map<string, {message: any, resolve: Function}[]>} */
    this.waiting = new Map();
    this.receive = this.receive.bind(this);
    model.on("msg:custom", this.receive);
    this.clock = setInterval(() => this.watch(), 100);
  }

  close() {
    this.model.off?.("msg:custom", this.receive);
    clearInterval(this.clock);
    for (const entry of this.flying.values()) clearTimeout(entry?.timer);
  }

  /**
   * Ask Python. Resolves with the reply; with null where a newer question of the kind took its place.
   * @param {string} op @param {Record<string, any>} [fields] @param {{latest?: boolean}} [how]
   * @returns {Promise<any>}
   */
  ask(op, fields = {}, { latest = false } = {}) {
    return new Promise((resolve) => {
      const queue = this.waiting.get(op) ?? [];
      if (latest) queue.splice(0).forEach((old) => old.resolve(null));
      queue.push({ message: { op, ...fields }, resolve });
      this.waiting.set(op, queue);
      this.send(op);
    });
  }

  /** @param {string} op */
  send(op) {
    const next = this.flying.get(op) ? undefined : this.waiting.get(op)?.shift();
    if (!next) return;
    const id = this.next++;
    const lost = () => this.settle(op, id, { id, op, ok: false, error: "Python has not answered for a minute: is the kernel still running?" });
    this.flying.set(op, { id, resolve: next.resolve, since: performance.now(), timer: setTimeout(lost, LOST_AFTER) });
    try {
      this.model.send({ id, ...next.message });
    } catch (error) {
      this.settle(op, id, { id, op, ok: false, error: `the message could not be sent: ${error}` });
    }
  }

  /** @param {any} reply */
  receive(reply) {
    if (reply && typeof reply === "object") this.settle(reply.op, reply.id, reply);
  }

  /** @param {string | null} op @param {number} id @param {any} reply */
  settle(op, id, reply) {
    // A refusal may not know its op: the number decides.
    const kind = [...this.flying.keys()].find((name) => this.flying.get(name)?.id === id) ?? op;
    const entry = kind ? this.flying.get(kind) : null;
    if (!kind || !entry || entry.id !== id) return;
    clearTimeout(entry.timer);
    this.flying.set(kind, null);
    entry.resolve(reply);
    this.send(kind);
    this.watch();
  }

  /** True while a question of the kind is open. @param {string} op */
  open(op) {
    return Boolean(this.flying.get(op));
  }

  watch() {
    const since = Math.min(...[...this.flying.values()].map((entry) => entry?.since ?? Infinity));
    this.onBusy(performance.now() - since > BUSY_AFTER ? since : null);
  }
}

// ---------------------------------------------------------------------------------------------------------------
// A chart: curves on a canvas, what is touched on an SVG above it
// ---------------------------------------------------------------------------------------------------------------

const MARGIN = { left: 52, right: 24 };
const TOP = { named: 24, plain: 10 }; // px above the plot, with and without a name of the vertical axis
const BOTTOM = { named: 40, plain: 22 }; // px below the axis, with and without a name of it
const DASHES = { solid: [], dash: [8, 4], dot: [2, 3], dashdot: [9, 3, 2, 3], long: [14, 4] };
// Pinned designs, behind the current one.
const PIN_DASHES = [[5, 4], [1, 3], [10, 3, 2, 3], [3, 2], [12, 5]];

/** @typedef {{x: ArrayLike<number>, y: ArrayLike<number | null>, colour: string, width?: number, dash?: number[], step?: boolean}} Series */

class Chart {
  /**
   * @param {{test: string, label: string, height: number, logX?: boolean, logY?: boolean, degrees?: boolean, xLabel: string, yLabel: string,
   *   onCursor?: (x: number | null) => void}} settings
   */
  constructor(settings) {
    this.settings = settings;
    this.canvas = h("canvas", { "aria-hidden": "true" });
    this.overlay = g("svg", { class: "pf-overlay", role: "group", "aria-label": settings.label });
    this.cursorLine = g("line", { class: "pf-cursor", y1: 0, y2: 0, visibility: "hidden" });
    this.overlay.append(this.cursorLine);
    this.element = h("div", { class: "pf-chart", "data-test": settings.test }, this.canvas, this.overlay);
    this.element.style.height = `${settings.height}px`;
    this.width = 0;
    this.height = settings.height;
    this.bottom = settings.xLabel ? BOTTOM.named : BOTTOM.plain;
    this.top = settings.yLabel ? TOP.named : TOP.plain;
    this.x = [0, 1];
    this.y = [0, 1];
    /** @type {Series[]} */
    this.series = [];
    /** @type {{x: number, text: string}[]} */
    this.marks = [];
    this.palette = {};
    this.overlay.addEventListener("pointermove", (event) => {
      const { left } = this.overlay.getBoundingClientRect();
      const at = event.clientX - left;
      this.settings.onCursor?.(at >= MARGIN.left && at <= this.width - MARGIN.right ? this.xAt(at) : null);
    });
    this.overlay.addEventListener("pointerleave", () => this.settings.onCursor?.(null));
  }

  /** Take the size of the page's box; true if it has changed. */
  measure() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = window.devicePixelRatio || 1;
    if (!width || !height) return false;
    if (width === this.width && height === this.height && ratio === this.ratio) return false;
    [this.width, this.height, this.ratio] = [width, height, ratio];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    return true;
  }

  get inner() {
    return { width: this.width - MARGIN.left - MARGIN.right, height: this.height - this.top - this.bottom };
  }

  /** @param {number} value */
  px(value) {
    const [low, high] = this.x;
    const share = this.settings.logX ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    return MARGIN.left + share * this.inner.width;
  }

  /** @param {number} value */
  py(value) {
    const [low, high] = this.y;
    const share = this.settings.logY ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    return this.top + (1 - share) * this.inner.height;
  }

  /** @param {number} at */
  xAt(at) {
    const [low, high] = this.x;
    const share = (at - MARGIN.left) / this.inner.width;
    return this.settings.logX ? low * (high / low) ** share : low + share * (high - low);
  }

  /** @param {number} at */
  yAt(at) {
    const [low, high] = this.y;
    return low + (1 - (at - this.top) / this.inner.height) * (high - low);
  }

  /** @param {number | null} x */
  cursor(x) {
    const at = x === null ? NaN : this.px(x);
    const shown = at >= MARGIN.left && at <= this.width - MARGIN.right;
    this.cursorLine.setAttribute("visibility", shown ? "visible" : "hidden");
    if (!shown) return;
    for (const [name, value] of Object.entries({ x1: at, x2: at, y1: this.top, y2: this.height - this.bottom })) {
      this.cursorLine.setAttribute(name, String(value));
    }
  }

  /** @param {Record<string, string>} palette */
  draw(palette) {
    this.measure();
    const { width, height } = this;
    if (!width) return;
    const context = this.canvas.getContext("2d");
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = `11px ${palette.font}`;
    this.grid(context, palette);
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, this.top, this.inner.width, this.inner.height);
    context.clip();
    for (const mark of this.marks) this.mark(context, palette, mark);
    for (const series of this.series) this.line(context, series);
    context.restore();
  }

  /** @param {CanvasRenderingContext2D} context @param {Record<string, string>} palette */
  grid(context, palette) {
    const { width, height, settings } = this;
    const [bottom, right] = [height - this.bottom, width - MARGIN.right];
    const vertical = settings.logX ? logTicks(this.x, this.inner.width) : linearTicks(this.x, this.inner.width / 80);
    const horizontal = settings.logY ? logTicks(this.y, this.inner.height) : linearTicks(this.y, this.inner.height / (settings.degrees ? 26 : 34), settings.degrees);
    context.lineWidth = 1;
    context.fillStyle = palette.muted;
    context.textAlign = "center";
    context.textBaseline = "top";
    const columns = vertical.map(({ value, minor }) => ({ at: Math.round(this.px(value)) + 0.5, minor }));
    const rows = horizontal.map(({ value, minor }) => ({ at: Math.round(this.py(value)) + 0.5, minor }));
    for (const faint of [true, false]) {
      // One path for all lines of a colour: a drag draws this in every frame.
      context.strokeStyle = faint ? palette.faint : palette.grid;
      context.beginPath();
      for (const { at, minor } of columns) if (Boolean(minor) === faint) line(context, [at, this.top, at, bottom]);
      for (const { at, minor } of rows) if (Boolean(minor) === faint) line(context, [MARGIN.left, at, right, at]);
      context.stroke();
    }
    let free = -Infinity;
    for (const { value, text } of vertical) {
      const at = Math.round(this.px(value)) + 0.5;
      const half = text ? context.measureText(text).width / 2 : 0;
      if (!text || at - half < free || at + half > width) continue;
      context.fillText(text, at, bottom + 6);
      free = at + half + 8;
    }
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const { value, text } of horizontal) {
      if (text) context.fillText(text, MARGIN.left - 7, Math.round(this.py(value)) + 0.5);
    }
    context.fillStyle = palette.muted;
    context.textAlign = "center";
    context.textBaseline = "top";
    context.fillText(settings.xLabel, (MARGIN.left + right) / 2, bottom + 22);
    context.textAlign = "left";
    context.fillText(settings.yLabel, MARGIN.left, 4);
  }

  /** Text on a patch of ground, so that grid lines do not strike it through. */
  badge(context, palette, text, x, y) {
    if (!text) return;
    const { width } = context.measureText(text);
    const left = context.textAlign === "right" ? x - width : x;
    context.fillStyle = palette.card;
    context.fillRect(left - 3, y - 2, width + 6, 15);
    context.fillStyle = palette.muted;
    context.fillText(text, x, y);
  }

  mark(context, palette, { x, text }) {
    const at = this.px(x);
    if (!(at >= MARGIN.left && at <= this.width - MARGIN.right)) return;
    context.setLineDash([3, 4]);
    stroke(context, palette.muted, [at, this.top, at, this.height - this.bottom]);
    context.setLineDash([]);
    const right = at + 6 + context.measureText(text).width > this.width - MARGIN.right;
    context.textAlign = right ? "right" : "left";
    context.textBaseline = "top";
    // Above 0 dB, where the curves are seldom.
    this.badge(context, palette, text, right ? at - 5 : at + 5, this.top + 3);
  }

  /** @param {CanvasRenderingContext2D} context @param {Series} series */
  line(context, { x, y, colour, width = 2, dash = [] }) {
    context.beginPath();
    let down = false;
    const [low, high] = [-50, this.height + 50]; // far outside, a canvas spends long on dashes
    const [left, right] = this.settings.logX ? [this.x[0] / 1.2, 1.2 * this.x[1]] : [2 * this.x[0] - this.x[1], 2 * this.x[1] - this.x[0]];
    for (let k = 0; k < x.length; k++) {
      const value = y[k];
      const inside = x[k] >= left && x[k] <= right;
      if (value === null || Number.isNaN(value) || !inside) {
        down = false;
        continue;
      }
      const [at, level] = [this.px(x[k]), Math.min(Math.max(this.py(value), low), high)];
      if (down) context.lineTo(at, level);
      else context.moveTo(at, level);
      down = true;
    }
    context.setLineDash(dash);
    context.lineWidth = width;
    context.lineJoin = "round";
    context.strokeStyle = colour;
    context.stroke();
    context.setLineDash([]);
  }
}

/** @param {CanvasRenderingContext2D} context @param {string} colour @param {number[]} ends */
function stroke(context, colour, ends) {
  context.strokeStyle = colour;
  context.beginPath();
  line(context, ends);
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {number[]} ends */
function line(context, [x1, y1, x2, y2]) {
  context.moveTo(x1, y1);
  context.lineTo(x2, y2);
}

/** @param {number[]} range @param {number} count @param {boolean} [degrees] */
function linearTicks([low, high], count, degrees = false) {
  const wanted = (high - low) / Math.max(count, 2);
  const step = degrees ? [15, 30, 45, 90, 180, 360].find((value) => value >= wanted) ?? 720 : nice(wanted);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    ticks.push({ value: k * step, text: short(Number((k * step).toPrecision(10))), minor: false });
  }
  return ticks;
}

/** @param {number[]} range @param {number} size */
function logTicks([low, high], size) {
  const ticks = [];
  const decades = Math.log10(high / low);
  if (decades < 0.7) return linearTicks([low, high], size / 20); // hardly a 1, 2 or 5 in it
  const every = Math.max(1, Math.ceil((decades * 46) / size));
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (let lead = 1; lead < 10; lead++) {
      const value = lead * 10 ** power;
      if (value < low * 0.9999 || value > high * 1.0001 || (lead > 1 && decades > 7)) continue;
      const major = lead === 1;
      const named = major ? power % every === 0 : decades < 1.6 && (lead === 2 || lead === 5);
      ticks.push({ value, text: named ? powerOfTen(value) : "", minor: !major });
    }
  }
  return ticks;
}

/** @param {number} value */
function powerOfTen(value) {
  if (value >= 1e-3 && value < 1e6) return short(value);
  const digits = String(Math.round(Math.log10(value))).replace(/./g, (digit) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(digit)]);
  return `10${digits}`;
}

// ---------------------------------------------------------------------------------------------------------------
// Poles and zeros as what is held: a real root, or a pair that moves as one
// ---------------------------------------------------------------------------------------------------------------

/** @typedef {{id: number, re: number, im: number}} Root  im = 0: a real root; im > 0: the pair re +- j im */

let rootNumber = 0;

/** Roots of a list in which conjugates are complete. @param {Complex[]} list @returns {Root[]} */
export const rootsOf = (list) => list.filter(([, im]) => im >= 0).map(([re, im]) => ({ id: ++rootNumber, re, im }));

/** @param {Root[]} list @returns {Complex[]} */
export const complexOf = (list) => list.flatMap(({ re, im }) => (im ? [[re, im], [re, -im]] : [[re, 0]]));

/** How many poles or zeros the roots stand for. @param {Root[]} list */
export const countOf = (list) => list.reduce((n, { im }) => n + (im ? 2 : 1), 0);

/**
 * The list with one root moved. A pair that comes to the axis splits into two real roots there; a real root that leaves it takes a
 * partner along.
 * @param {Root[]} list @param {number} id @param {{re: number, im: number}} to @param {number | null} [partner] real root to leave with
 * @returns {Root[]}
 */
export function moved(list, id, to, partner = null) {
  const place = list.findIndex((root) => root.id === id);
  const root = list[place];
  const next = [...list];
  if (root.im && to.im === 0) {
    next.splice(place, 1, { id, re: to.re, im: 0 }, { id: ++rootNumber, re: to.re, im: 0 });
    return next;
  }
  const leaves = root.im === 0 && to.im > 0 && partner !== null;
  next[place] = { id, re: to.re, im: root.im || leaves ? to.im : 0 };
  return leaves ? next.filter((other) => other.id !== partner) : next;
}

/** A value as people write it. @param {{re: number, im: number}} root */
const written = ({ re, im }) => (im ? `${short(re)} ± ${short(im)}j` : short(re));

// ---------------------------------------------------------------------------------------------------------------
// The s-plane
// ---------------------------------------------------------------------------------------------------------------

const ON_AXIS = 6; // px: a pair this near the axis splits
const OFF_AXIS = 13; // px: a real root pulled this far leaves it, if another one is
const TOGETHER = 10; // px from it
const SNAP = 4; // px: real roots this near become equal
const RIM = 20; // px
const DAMPING_RAYS = [0.2, 0.4, 0.6, 0.8, 0.95];
const FAR_APART = 15; // ratio from which the slowest poles crowd at the origin
const PLANE_HINT = "Drag a pole ×; double-click adds one";

class Plane {
  /**
   * @param {{
   *   roots: (kind: "pole" | "zero") => Root[],
   *   change: (kind: "pole" | "zero", list: Root[]) => void,
   *   begin: () => void, commit: (what: string) => void, add: (kind: string, at: {re: number, im: number}) => void,
   *   select: (kind: "pole" | "zero" | null, id?: number) => void, selected: () => {kind: string, id: number} | null,
   *   remove: () => void, say: (text: string) => void, hover: (text: string) => void, refit: () => void,
   * }} app
   */
  constructor(app) {
    this.app = app;
    this.view = { log: false, radius: 60, decades: 3 };
    const id = `pf-hatch-${instances}`;
    this.unstable = g("rect", { class: "pf-unstable", fill: `url(#${id})` });
    this.grid = g("g", { class: "pf-plane-grid", "aria-hidden": "true" });
    this.ghosts = g("g", { class: "pf-ghosts", "aria-hidden": "true" });
    this.handles = g("g", {});
    const pattern = g("pattern", { id, width: 9, height: 9, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" });
    pattern.append(g("rect", { width: 9, height: 9, class: "pf-hatch-ground" }), g("line", { x1: 0, y1: 0, x2: 0, y2: 9, class: "pf-hatch" }));
    this.svg = g("svg", { class: "pf-plane", role: "group", "aria-label": "s-plane: poles and zeros", "data-test": "plane" }, g("defs", {}, pattern), this.grid, this.unstable, this.ghosts, this.handles);
    this.element = h("div", { class: "pf-plane-box" }, this.svg);
    /** @type {Map<string, any>} */
    this.drawn = new Map();
    /** @type {Root[]} */
    this.pinned = [];
    this.drag = null;
    this.euler = null;
    this.gridKey = "";
    this.svg.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.svg.addEventListener("dblclick", (event) => {
      if (event.target.closest?.(".pf-root")) return;
      const at = this.where(event);
      this.app.add(event.altKey ? "zero" : "pole", Math.abs(this.pixel(at).y - this.origin.y) < 12 ? { re: at.re, im: 0 } : at);
    });
    this.svg.addEventListener("pointerdown", (event) => {
      if (!event.target.closest?.(".pf-root")) this.app.select(null);
    });
    this.svg.addEventListener("pointermove", (event) => this.hover(event));
    this.svg.addEventListener("pointerleave", () => this.app.hover(""));
  }

  get origin() {
    return { x: 0.76 * this.width, y: this.height / 2 };
  }

  /** Length in px of the view's radius. */
  get reach() {
    return 0.68 * this.width;
  }

  measure() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || (width === this.width && height === this.height)) return;
    [this.width, this.height] = [width, height];
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  }

  /** Pixels of a point; in the logarithmic view the angle is kept, so damping rays stay straight. @param {{re: number, im: number}} point */
  pixel({ re, im }) {
    const size = Math.hypot(re, im);
    const { log, radius, decades } = this.view;
    const share = log ? (size > 0 ? Math.max(0, 1 + Math.log10(size / radius) / decades) / size : 0) : 1 / radius;
    return { x: this.origin.x + re * share * this.reach, y: this.origin.y - im * share * this.reach };
  }

  /** The point under pixels. @param {{x: number, y: number}} at @returns {{re: number, im: number}} */
  point({ x, y }) {
    const [u, v] = [(x - this.origin.x) / this.reach, (this.origin.y - y) / this.reach];
    const { log, radius, decades } = this.view;
    if (!log) return { re: u * radius, im: v * radius };
    const share = Math.hypot(u, v) || 1e-9;
    const size = radius * 10 ** ((share - 1) * decades);
    return { re: (u / share) * size, im: (v / share) * size };
  }

  /** @param {MouseEvent} event */
  where(event) {
    const box = this.svg.getBoundingClientRect();
    return this.point({ x: event.clientX - box.left, y: event.clientY - box.top });
  }

  /** Show all poles and zeros; with `needed` only where one is outside or all are tiny. @param {boolean} [needed] */
  fit(needed = false) {
    const poles = this.app.roots("pole");
    if (!this.width || !poles.length) return;
    const zeros = this.app.roots("zero").filter(({ re, im }) => re || im);
    const { view } = this;
    // A zero far out would press all the poles together: it stays at the rim.
    const near = view.log ? zeros : zeros.filter((zero) => this.share([zero]) <= 3 * this.share(poles));
    const all = [...poles, ...near];
    const inside = this.share(all);
    if (needed && inside <= 1 && inside >= (view.log ? 0.6 : 0.25) && (!view.log || this.innermost(all) > 0.05)) return;
    const sizes = all.map(({ re, im }) => Math.hypot(re, im));
    if (view.log) {
      const spread = Math.log10(Math.max(...sizes) / Math.min(...sizes));
      view.decades = Math.min(Math.max(Math.ceil(spread + 1), 2), 9);
      // The share of the view moves by 1/decades for every decade of the radius.
      view.radius = Math.max(...sizes);
      for (let turn = 0; turn < 20 && this.share(all) > 0.97; turn++) view.radius *= 10 ** ((this.share(all) - 0.95) * view.decades + 0.02);
    } else {
      const needs = view.radius * inside * 1.06;
      view.radius = Math.max(nice(needs) > 1.6 * needs ? 1.25 * needs : nice(needs), 2e-3);
    }
    this.app.refit();
  }

  /** How far out the outermost root is, 1 at the edge of what is comfortably seen. @param {Root[]} list */
  share(list) {
    const { x: ox, y: oy } = this.origin;
    const seen = (root) => {
      const { x, y } = this.pixel(root);
      return Math.max((ox - x) / (0.92 * ox), (x - ox) / (0.8 * (this.width - ox)), (oy - y) / (0.88 * oy));
    };
    return Math.max(...list.map(seen));
  }

  /** @param {Root[]} list */
  innermost(list) {
    return Math.min(...list.map((root) => Math.hypot(this.pixel(root).x - this.origin.x, this.pixel(root).y - this.origin.y))) / this.reach;
  }

  /** @param {number} factor */
  zoom(factor) {
    this.view.radius = Math.min(Math.max(this.view.radius * factor, 2e-3), 3e5);
    this.app.refit();
  }

  wheel(event) {
    // The bare wheel scrolls the page or the notebook, which are longer than a screen; a pinch comes with ctrlKey.
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    const decades = event.shiftKey && this.view.log;
    if (decades) this.view.decades = Math.min(Math.max(this.view.decades + Math.sign(event.deltaY), 1), 9);
    this.zoom(decades ? 1 : 1.12 ** Math.sign(event.deltaY));
  }

  hover(event) {
    if (this.drag || event.pointerType === "touch") return;
    const { re, im } = this.where(event);
    const size = Math.hypot(re, im);
    this.app.hover(`${short(re, 3)} ${im < 0 ? "−" : "+"} ${short(Math.abs(im), 3)}j   ωₙ ${short(size, 3)} rad/s   ζ ${short(-re / size, 2)}`);
  }

  // -- drawing ----------------------------------------------------------------------------------------------------

  draw() {
    this.measure();
    if (!this.width) return;
    this.drawGrid();
    const seen = new Set();
    for (const kind of /** @type {("zero" | "pole")[]} */ (["zero", "pole"])) {
      this.app.roots(kind).forEach((root, index) => {
        for (const side of root.im ? [1, -1] : [1]) seen.add(this.drawHandle(kind, root, index, side));
      });
    }
    for (const [key, handle] of this.drawn) {
      if (seen.has(key)) continue;
      const focused = handle.element.contains(document.activeElement);
      handle.element.remove();
      this.drawn.delete(key);
      if (focused) this.svg.querySelector(".pf-root[tabindex]")?.focus();
    }
    this.ghosts.replaceChildren(
      ...this.pinned.flatMap((root) => (root.im ? [root, { ...root, im: -root.im }] : [root])).map((root) => {
        const { x, y } = this.pixel(root);
        return g("path", { d: `M${x - 4} ${y - 4}l8 8m0 -8l-8 8` });
      }),
    );
  }

  /** @param {"pole" | "zero"} kind @param {Root} root @param {number} index @param {number} side @returns {string} */
  drawHandle(kind, root, index, side) {
    const key = `${kind} ${root.id} ${side}`;
    let handle = this.drawn.get(key);
    if (!handle) this.drawn.set(key, (handle = this.handle(kind, root.id, side)));
    const { x, y } = this.pixel({ re: root.re, im: side * root.im });
    const at = this.rim(x, y);
    handle.element.setAttribute("transform", `translate(${at.x.toFixed(2)} ${at.y.toFixed(2)})`);
    handle.arrow.setAttribute("visibility", at.outside ? "visible" : "hidden");
    if (at.outside) handle.arrow.setAttribute("transform", `rotate(${((at.angle * 180) / Math.PI).toFixed(1)})`);
    const chosen = this.app.selected();
    const selected = chosen !== null && chosen.kind === kind && chosen.id === root.id;
    handle.element.classList.toggle("pf-selected", selected);
    const twins = this.app.roots(kind).filter((other) => Math.hypot(other.re - root.re, other.im - root.im) <= 1e-9 * Math.hypot(root.re, root.im));
    const first = twins[0].id === root.id;
    handle.count.textContent = twins.length > 1 && first ? `×${twins.length}` : "";
    handle.label.textContent = side > 0 && (at.outside || (selected && this.drag)) ? written(root) : "";
    const leftmost = at.x < 0.42 * this.width;
    handle.label.setAttribute("text-anchor", leftmost ? "start" : "end");
    handle.label.setAttribute("x", leftmost ? "14" : "-14");
    handle.label.setAttribute("y", at.y < 40 ? "24" : "-13");
    const name = `${kind}-${index}`;
    if (handle.name !== name) handle.element.setAttribute("data-test", side > 0 ? name : `${name}-conjugate`);
    handle.name = name;
    if (side > 0) {
      const words = `${root.im ? `${kind} pair` : kind} ${index + 1}`;
      handle.element.setAttribute("aria-label", `${words}; arrow keys move it, Delete removes it`);
      handle.element.setAttribute("aria-valuetext", `${written(root)} rad/s`);
      handle.element.setAttribute("aria-valuenow", String(Math.hypot(root.re, root.im)));
    }
    return key;
  }

  /** @param {"pole" | "zero"} kind @param {number} id @param {number} side */
  handle(kind, id, side) {
    const label = g("text", { class: "pf-root-label" });
    const count = g("text", { class: "pf-root-count", x: 9, y: -8 });
    const arrow = g("path", { class: "pf-rim", d: "M10 -4.5L16 0L10 4.5z", visibility: "hidden" });
    const shape = kind === "pole" ? g("path", { class: "pf-mark", d: "M-6 -6L6 6M6 -6L-6 6" }) : g("circle", { class: "pf-mark", r: 6.5 });
    const element = g("g", { class: `pf-root pf-${kind}` }, g("circle", { class: "pf-hit", r: 15 }), g("circle", { class: "pf-halo", r: 12 }), shape, arrow, count, label);
    if (side > 0) {
      for (const [name, value] of Object.entries({ tabindex: 0, role: "slider", "aria-valuemin": LIMITS.slowest, "aria-valuemax": LIMITS.fastest })) {
        element.setAttribute(name, String(value));
      }
      element.addEventListener("focus", () => this.app.select(kind, id));
      element.addEventListener("keydown", (event) => this.key(event, kind, id));
    }
    element.addEventListener("pointerdown", (event) => this.grab(event, kind, id, side));
    this.handles.append(element);
    return { element, label, count, arrow, name: "" };
  }

  /** A point outside is shown at the rim, in its direction. @param {number} x @param {number} y */
  rim(x, y) {
    const { x: ox, y: oy } = this.origin;
    const over = Math.max((ox - x) / (ox - RIM), (x - ox) / (this.width - RIM - ox), Math.abs(y - oy) / (oy - RIM));
    if (over <= 1) return { x, y, outside: false, angle: 0 };
    return { x: ox + (x - ox) / over, y: oy + (y - oy) / over, outside: true, angle: Math.atan2(y - oy, x - ox) };
  }

  drawGrid() {
    const { log, radius, decades } = this.view;
    const key = [this.width, this.height, log, radius, decades, this.euler].join();
    if (key === this.gridKey) return;
    this.gridKey = key;
    const { x: ox, y: oy } = this.origin;
    this.unstable.setAttribute("x", String(ox));
    this.unstable.setAttribute("width", String(this.width - ox));
    this.unstable.setAttribute("height", String(this.height));
    const parts = [];
    const sizes = [];
    if (log) for (let power = Math.ceil(Math.log10(radius) - decades); power <= Math.log10(radius) + 1; power++) sizes.push(10 ** power);
    else for (let k = 1; k <= 8; k++) sizes.push(k * nice(radius / 4.5));
    for (const size of sizes) {
      const r = ox - this.pixel({ re: -size, im: 0 }).x;
      if (r < 12 || r > Math.hypot(this.width, this.height)) continue;
      parts.push(g("path", { d: `M${ox} ${oy - r}A${r} ${r} 0 0 0 ${ox} ${oy + r}` }));
    }
    for (const zeta of DAMPING_RAYS) {
      const [dx, dy] = [-zeta, Math.sqrt(1 - zeta * zeta)];
      const length = Math.min((ox - 4) / -dx, (oy - 4) / dy);
      for (const sign of [1, -1]) parts.push(g("line", { x1: ox, y1: oy, x2: ox + dx * length, y2: oy - sign * dy * length }));
      const tag = Math.min((ox - 22) / -dx, (oy - 14) / dy);
      const text = g("text", { x: ox + dx * tag, y: oy - dy * tag, "text-anchor": dy * tag > oy - 20 ? "middle" : "start", "dominant-baseline": "central", class: "pf-ray" });
      text.textContent = `ζ ${zeta}`;
      parts.push(text);
    }
    if (this.euler) parts.push(this.eulerDisc());
    parts.push(g("line", { class: "pf-axis", x1: 0, y1: oy, x2: this.width, y2: oy }), g("line", { class: "pf-axis", x1: ox, y1: 0, x2: ox, y2: this.height }));
    let edge = ox;
    for (const size of sizes) {
      const { x } = this.pixel({ re: -size, im: 0 });
      const text = powerOfTen(size);
      if (x < 16 || edge - x < 20 + 6 * text.length) continue;
      edge = x;
      const tick = g("text", { class: "pf-tick", x, y: oy + 19, "text-anchor": "middle" });
      tick.textContent = log ? text : `−${text}`;
      parts.push(tick);
    }
    // On the right, where no pole can be.
    const real = g("text", { class: "pf-axis-name", x: this.width - 6, y: oy - 7, "text-anchor": "end" });
    real.textContent = "Re s, rad/s";
    const scale = g("text", { class: "pf-axis-name", x: this.width - 6, y: oy + 17, "text-anchor": "end" });
    scale.textContent = log ? "log |s|" : "";
    const imaginary = g("text", { class: "pf-axis-name", x: ox + 6, y: 14 });
    imaginary.textContent = "Im s";
    const stable = g("text", { class: "pf-axis-name", x: this.width - 6, y: this.height - 8, "text-anchor": "end" });
    stable.textContent = "unstable";
    this.grid.replaceChildren(...parts);
    this.unstable.after(this.ghosts);
    this.labels?.remove();
    this.labels = g("g", { class: "pf-plane-grid", "aria-hidden": "true" }, real, scale, imaginary, stable);
    this.ghosts.before(this.labels);
  }

  /** Where forward Euler is stable: the disc |1 + s h| < 1. */
  eulerDisc() {
    const h = /** @type {number} */ (this.euler);
    const points = Array.from({ length: 121 }, (_, k) => {
      const angle = (k / 120) * 2 * Math.PI;
      const { x, y } = this.pixel({ re: (Math.cos(angle) - 1) / h, im: Math.sin(angle) / h });
      return `${x.toFixed(1)} ${y.toFixed(1)}`;
    });
    return g("path", { class: "pf-euler", d: `M${points.join("L")}z` });
  }

  // -- moving -----------------------------------------------------------------------------------------------------

  /** @param {PointerEvent} event @param {"pole" | "zero"} kind @param {number} id @param {number} side */
  grab(event, kind, id, side) {
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    this.app.select(kind, id);
    this.drawn.get(`${kind} ${id} 1`)?.element.focus({ preventScroll: true });
    this.app.begin();
    // On the plane, not on the handle: the handle may go when a pair splits or two roots join.
    this.svg.setPointerCapture(event.pointerId);
    this.drag = { kind, id, side, start: { x: event.clientX, y: event.clientY }, moved: false };
    const move = (next) => this.follow(next);
    const end = () => {
      this.svg.removeEventListener("pointermove", move);
      this.svg.removeEventListener("pointerup", end);
      this.svg.removeEventListener("pointercancel", end);
      const { moved: changed } = this.drag;
      this.drag = null;
      this.app.commit(changed ? `move ${kind}` : "");
    };
    this.svg.addEventListener("pointermove", move);
    this.svg.addEventListener("pointerup", end);
    this.svg.addEventListener("pointercancel", end);
  }

  /** @param {PointerEvent} event */
  follow(event) {
    const drag = this.drag;
    if (!drag.moved && Math.hypot(event.clientX - drag.start.x, event.clientY - drag.start.y) < 2) return;
    drag.moved = true;
    const box = this.svg.getBoundingClientRect();
    const at = { x: event.clientX - box.left, y: event.clientY - box.top };
    const list = this.app.roots(drag.kind);
    const root = list.find((other) => other.id === drag.id);
    if (!root) return;
    const height = Math.abs(at.y - this.origin.y);
    const others = list.filter((other) => other.id !== root.id && other.im === 0);
    const gap = (other) => Math.abs(this.pixel(other).x - at.x);
    const nearest = others.length ? others.reduce((best, other) => (gap(other) < gap(best) ? other : best)) : null;
    const onAxis = root.im ? height < ON_AXIS : height < OFF_AXIS || !nearest || gap(nearest) > TOGETHER;
    let to = this.point(onAxis ? { x: at.x, y: this.origin.y } : at);
    to = { re: to.re, im: onAxis ? 0 : Math.abs(to.im) };
    if (onAxis && nearest && !event.altKey && gap(nearest) < SNAP) to.re = nearest.re;
    if (drag.kind === "pole") {
      const close = -this.point({ x: this.origin.x - 4, y: this.origin.y }).re;
      to = heldPole(to.re, to.im, close);
    } else if (Math.hypot(at.x - this.origin.x, at.y - this.origin.y) < ON_AXIS) to = { re: 0, im: 0 };
    this.app.change(drag.kind, moved(list, root.id, to, onAxis ? null : (nearest?.id ?? null)));
  }

  /** @param {KeyboardEvent} event @param {"pole" | "zero"} kind @param {number} id */
  key(event, kind, id) {
    if (event.key === "Delete" || event.key === "Backspace") {
      event.preventDefault();
      this.app.remove();
      return;
    }
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const way = ways[event.key];
    if (!way || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const list = this.app.roots(kind);
    const root = list.find((other) => other.id === id);
    if (!root) return;
    const size = Math.hypot(root.re, root.im) || 0.02 * this.view.radius;
    const step = size * (event.shiftKey ? 0.1 : 0.01);
    let to = { re: root.re + way[0] * step, im: Math.max(root.im + way[1] * step, 0) };
    if (root.im && to.im < 0.5 * step) to.im = 0;
    const partner = list.find((other) => other.id !== id && !other.im && Math.abs(other.re - root.re) <= 0.05 * size);
    if (!root.im && way[1]) {
      if (!partner) {
        this.app.say(`A real ${kind} leaves the axis together with another one: bring two within 5 % of each other first.`);
        return;
      }
      to = { re: (root.re + partner.re) / 2, im: step };
    }
    if (kind === "pole") to = heldPole(to.re, to.im);
    this.app.begin();
    this.app.change(kind, moved(list, id, to, !root.im && way[1] ? (partner?.id ?? null) : null));
    this.app.commit(`move ${kind}`);
  }
}

// ---------------------------------------------------------------------------------------------------------------
// The designer
// ---------------------------------------------------------------------------------------------------------------

const CURVE_POINTS = 360;
const STEP_POINTS = 320;
const POLL = 250; // ms between looks at a learning job
const LARGEST_LOG = 20_000_000; // characters
const PREVIEW_AGREES = 1e-6;
const MOST_UNDO = 200;

const START = Object.freeze({
  poles: [[-20, 0], [-20, 0]],
  numerator: { kind: "lowpass" },
  sampling: { dt: 0.002, method: "exact" },
  assume: { slope: 1, noise: 0.001, ratio: 1, lag: 0.02, delay: 0, unit: "" },
  limits: null,
});

const CURVES = /** @type {const} */ ({
  F: { text: "F", title: "F: from the residual to the estimate", colour: "F", dash: DASHES.solid },
  E: { text: "1 − F", title: "1 − F: from the residual to the error of the estimate", colour: "E", dash: DASHES.dash },
  S: { text: "F sampled", title: "F as it runs, sampled, up to the Nyquist frequency", colour: "S", dash: DASHES.dashdot },
});

// What each limit holds down, and where: |1 - F| below its frequency, |F| above it.
const LIMIT_KINDS = {
  error: { text: "|1−F|", curve: "E", below: true, start: { share: 0.15, level: 0.3 } },
  estimate: { text: "|F|", curve: "F", below: false, start: { share: 6, level: 0.3 } },
};

class Designer {
  /** @param {any} model @param {HTMLElement} el */
  constructor(model, el) {
    instances += 1;
    this.model = model;
    // The attribute keeps JupyterLab's single-key shortcuts off the designer.
    this.root = h("div", { class: "pf-designer", tabindex: -1, "data-test": "designer", "data-lm-suppress-shortcuts": "true" });
    this.palette = {};
    this.link = new Link(model, (since) => this.showBusy(since));
    /** @type {any} */
    this.state = structuredClone(START);
    this.poles = rootsOf(START.poles);
    /** @type {Root[]} */
    this.zeros = [];
    this.chosen = null;
    this.filter = filterOf(START);
    this.answer = null; // Python's last
    this.answered = ""; // the design it is for
    this.numbers = new Map();
    this.undoStack = [];
    this.redoStack = [];
    this.saved = JSON.stringify(START);
    this.pins = [];
    this.log = null;
    this.channel = 0;
    this.estimate = null;
    this.job = null;
    this.curve = [];
    this.greeted = false;
    this.shown = { F: true, E: true, S: true };
    this.cursorAt = null;
    this.frame = 0;
    this.family = "custom";
    this.can = { fmu: true, c: true, why: "" };
    this.cleanups = [];
    this.build();
    el.append(this.root);
    this.showPins();
    this.showLog();
    this.theme();
    this.watchSize();
    this.keyboard();
    this.rebuilt({ fit: true });
    this.start();
  }

  destroy() {
    this.link.close();
    this.closed = true;
    clearTimeout(this.polling);
    clearTimeout(this.saying);
    cancelAnimationFrame(this.frame);
    this.cleanups.forEach((undo) => undo());
    this.root.remove();
  }

  async start() {
    this.say("Starting Python …");
    const reply = await this.link.ask("hello");
    this.greeted = true;
    if (!this.ok(reply)) {
      void this.ask();
      return;
    }
    this.can = reply.can ?? this.can;
    if (Array.isArray(reply.families)) this.offerFamilies(reply.families);
    this.showAbilities();
    if (reply.version) this.parts.version.textContent = reply.version;
    if (reply.design && this.undoStack.length === 0 && !this.dragging) {
      this.load(reply.design, { fit: true });
      this.saved = JSON.stringify(this.design());
    } else void this.ask(); // something was designed while Python started
    this.setLog(reply.log ?? null);
    this.say("Ready. Drag a pole, type a value, or start from a family.");
  }

  // -- the design -------------------------------------------------------------------------------------------------

  /** The design as messages have it. */
  design() {
    const poles = complexOf(this.poles);
    const { numerator } = this.state;
    const held = numerator.kind === "zeros" ? { ...numerator, zeros: complexOf(this.zeros) } : numerator;
    return { poles, numerator: held, sampling: { ...this.state.sampling }, assume: { ...this.state.assume }, limits: this.state.limits };
  }

  /** Take over a design. @param {any} design @param {{fit?: boolean, family?: string}} [how] */
  load(design, { fit = false, family } = {}) {
    this.state = structuredClone({ ...START, ...design, limits: knownLimits(design.limits) });
    this.poles = rootsOf(design.poles);
    this.zeros = this.state.numerator.kind === "zeros" ? rootsOf(this.state.numerator.zeros) : [];
    const [first] = this.poles;
    const equal = !first.im && this.poles.every(({ re, im }) => !im && re === first.re);
    this.family = family ?? (equal && this.state.numerator.kind !== "zeros" ? "binomial" : "custom");
    this.chosen = null;
    this.rebuilt({ fit });
  }

  /** Something of the design has changed: preview now, ask Python. @param {{fit?: boolean}} [how] */
  rebuilt({ fit = false } = {}) {
    const { numerator } = this.state;
    if (numerator.kind === "type") numerator.type = Math.min(numerator.type, countOf(this.poles));
    if (numerator.kind !== "zeros") {
      const found = rootsOf(roots(filterOf(this.design()).b));
      this.zeros = found.map((root, i) => ({ ...root, id: this.zeros[i]?.id ?? root.id }));
    }
    this.filter = filterOf(this.design());
    if (fit) this.plane.fit(true);
    this.fresh = true;
    this.paint();
    void this.ask();
  }

  /** Ask Python about the design as it is; the newest question wins. */
  async ask() {
    // The design that Python holds comes first: a question would put this one in its place.
    if (!this.greeted) return;
    const design = this.design();
    const text = JSON.stringify(design);
    if (text === this.asking) return;
    this.root.classList.toggle("pf-stale", text !== this.answered);
    if (text === this.answered && !this.asking) return;
    this.asking = text;
    const asked = this.moveTime;
    const reply = await this.link.ask("design", { design }, { latest: true });
    if (this.asking === text) this.asking = null;
    if (!reply || this.closed) return;
    if (!reply.ok) {
      if (text === JSON.stringify(this.design())) this.fail(reply);
      return;
    }
    const current = text === JSON.stringify(this.design());
    this.answer = reply;
    this.answered = text;
    this.pins.filter((pin) => !pin.numbers && pin.key === text).forEach((pin) => (pin.numbers = reply.numbers));
    this.root.classList.toggle("pf-stale", !current);
    this.numbers = new Map(reply.numbers.map((number) => [number.key, number]));
    if (current) this.compare(reply);
    this.showMessages(reply.messages ?? []);
    this.showComparison();
    this.showNumbers(); // the curves are the preview's: they stand already
    if (asked) this.measure("drag-to-answer", asked);
    if (this.failed) this.say("");
    if (this.log && current && (!this.dragging || performance.now() - (this.estimatedAt ?? 0) > 200)) void this.askEstimate();
  }

  /** Python's curves are the truth: where the preview leaves them it says so. @param {any} reply */
  compare(reply) {
    const { omega, F } = reply.frequency;
    const { re, im } = response(this.filter, omega);
    let most = 0;
    let worst = 0;
    omega.forEach((_, k) => {
      const gain = Math.hypot(re[k], im[k]);
      most = Math.max(most, F[0][k] ?? 0);
      worst = Math.max(worst, Math.abs(gain - (F[0][k] ?? gain)));
    });
    if (worst > PREVIEW_AGREES * most) this.say("The preview of F differs from Python's by more than 1e-6: trust the figures, not the curves.", "warn");
  }

  /** What a drag or a gesture starts from. */
  begin() {
    this.dragging = true;
    this.before = { held: heldGain(this.filter) };
  }

  /** New poles or zeros, in a gesture. @param {"pole" | "zero"} kind @param {Root[]} list */
  change(kind, list) {
    this.moveTime ??= performance.now();
    if (kind === "zero") this.freeZeros();
    else this.scaleB();
    this[kind === "pole" ? "poles" : "zeros"] = list;
    this.regain();
    this.family = "custom";
    this.rebuilt();
  }

  /** N by its zeros, as they are. */
  freeZeros() {
    const { numerator } = this.state;
    if (numerator.kind === "zeros") return;
    const { b } = this.filter;
    const lead = b.reduce((last, value) => (value !== 0 ? value : last), 0);
    this.state.numerator = { kind: "zeros", zeros: complexOf(this.zeros), gain: lead || 1 };
  }

  /** Coefficients given as numbers mean nothing beside other poles: their zeros do. */
  scaleB() {
    if (this.state.numerator.kind === "b") this.freeZeros();
  }

  regain() {
    const { numerator } = this.state;
    if (numerator.kind !== "zeros") return;
    numerator.gain = gainFor(complexOf(this.poles), complexOf(this.zeros), this.before?.held || 1);
  }

  /** The gesture is over: one step of undo. @param {string} what */
  commit(what) {
    this.dragging = false;
    this.before = null;
    const now = JSON.stringify(this.design());
    if (now === this.saved) return;
    const repeated = what && what === this.lastStep?.what && performance.now() - this.lastStep.at < 700;
    if (!repeated) this.undoStack.push(this.saved);
    if (this.undoStack.length > MOST_UNDO) this.undoStack.shift();
    this.redoStack = [];
    this.saved = now;
    this.lastStep = { what, at: performance.now() };
    this.paint();
    void this.ask();
    if (this.log && now === this.answered) void this.askEstimate();
  }

  /** A change in one go. @param {string} what @param {() => void} work @param {{fit?: boolean}} [how] */
  edit(what, work, how = {}) {
    this.begin();
    work();
    this.rebuilt(how);
    this.commit(what);
  }

  /** @param {"undoStack" | "redoStack"} from @param {"undoStack" | "redoStack"} to */
  travel(from, to) {
    const text = this[from].pop();
    if (text === undefined) return;
    this[to].push(this.saved);
    this.saved = text;
    this.lastStep = null;
    this.load(JSON.parse(text), { fit: true });
  }

  undo() {
    this.travel("undoStack", "redoStack");
  }

  redo() {
    this.travel("redoStack", "undoStack");
  }

  // -- poles and zeros --------------------------------------------------------------------------------------------

  /** @param {string} kind "pole", "pair" or "zero" @param {{re: number, im: number}} [at] */
  add(kind, at) {
    const zero = kind === "zero";
    const sizes = this.poles.map(({ re, im }) => Math.hypot(re, im));
    const size = Math.min(1.5 * Math.max(...sizes), LIMITS.fastest);
    const place = at ?? (kind === "pair" ? { re: -0.7 * size, im: 0.7 * size } : { re: -size, im: 0 });
    const root = { id: ++rootNumber, re: place.re, im: Math.abs(place.im) };
    const taken = root.im ? 2 : 1;
    const order = countOf(this.poles);
    if (zero && countOf(this.zeros) + taken > order - 1) {
      this.say(`F of order ${order} has at most ${order - 1} zero${order === 2 ? "" : "s"}: add a pole first${root.im ? ", or put the zero on the real axis" : ""}.`, "warn");
      return;
    }
    if (!zero && order + taken > LIMITS.order) {
      this.say(`The highest order is ${LIMITS.order}: delete a pole first.`, "warn");
      return;
    }
    if (!zero && root.re >= 0) {
      this.say("A pole on or right of the imaginary axis makes F unstable: put it on the left.", "warn");
      return;
    }
    this.edit(`add ${kind}`, () => {
      if (zero) this.freeZeros();
      else this.scaleB();
      if (zero) this.zeros = [...this.zeros, root];
      else this.poles = [...this.poles, { ...root, ...heldPole(root.re, root.im) }];
      this.regain();
      this.family = "custom";
      this.chosen = { kind: zero ? "zero" : "pole", id: root.id };
    }, { fit: true });
  }

  remove(which = this.chosen) {
    if (!which) return;
    const list = which.kind === "pole" ? this.poles : this.zeros;
    const left = list.filter(({ id }) => id !== which.id);
    if (left.length === list.length) return;
    if (which.kind === "pole" && !left.length) {
      this.say("A filter has at least one pole.", "warn");
      return;
    }
    this.edit(`delete ${which.kind}`, () => {
      if (which.kind === "zero") this.freeZeros();
      else this.scaleB();
      if (which.kind === "pole") this.poles = left;
      else this.zeros = left;
      // F must stay strictly proper.
      while (this.state.numerator.kind === "zeros" && countOf(this.zeros) >= countOf(this.poles)) this.zeros = this.zeros.slice(0, -1);
      this.regain();
      this.family = "custom";
      this.chosen = null;
    }, { fit: true });
  }

  /** A root typed in the table. @param {"pole" | "zero"} kind @param {number} id @param {"re" | "im" | "wn" | "zeta"} what @param {number} value */
  typeRoot(kind, id, what, value) {
    const list = kind === "pole" ? this.poles : this.zeros;
    const root = list.find((other) => other.id === id);
    if (!root || !Number.isFinite(value)) return "expected a number";
    const size = Math.hypot(root.re, root.im);
    const zeta = size ? -root.re / size : 1;
    let to = { re: root.re, im: root.im };
    let second = null;
    if (what === "re") to.re = value;
    else if (what === "im") to.im = Math.abs(value);
    else if (what === "wn") {
      if (!(value > 0)) return "expected a natural frequency above 0 rad/s";
      to = size ? { re: (root.re / size) * value, im: (root.im / size) * value } : { re: -value, im: 0 };
    } else if (value >= 1 && root.im) {
      const apart = Math.sqrt(value * value - 1);
      to = { re: -size * (value - apart), im: 0 };
      second = -size * (value + apart);
    } else if (root.im) to = { re: -value * size, im: size * Math.sqrt(Math.max(1 - value * value, 0)) };
    else if (value !== zeta) return "a real root has the damping ratio 1; bring two together and pull them off the axis";
    if (what === "im" && to.im && !root.im) {
      const partner = list.find((other) => other.id !== id && !other.im);
      if (!partner) return "a complex root needs a partner: add another real one first";
      return this.replaced(kind, moved(list, id, to, partner.id), to);
    }
    let next = moved(list, id, to);
    if (second !== null) next = next.map((other, i) => (next[i - 1]?.id === id ? { ...other, re: second } : other));
    return this.replaced(kind, next, to);
  }

  /** @param {"pole" | "zero"} kind @param {Root[]} next @param {{re: number, im: number}} to */
  replaced(kind, next, to) {
    const size = Math.hypot(to.re, to.im);
    if (kind === "pole" && !(to.re < 0)) return `expected a real part below 0, got ${short(to.re)}: F would be unstable`;
    if (kind === "pole" && !(size >= LIMITS.slowest && size <= LIMITS.fastest)) {
      return `expected ${short(LIMITS.slowest)} to ${short(LIMITS.fastest)} rad/s, got ${short(size)}`;
    }
    this.begin();
    this.change(kind, next);
    this.plane.fit(true);
    this.commit("");
    return "";
  }

  // -- coarse knobs -----------------------------------------------------------------------------------------------

  /** Bandwidth, or a natural frequency where F has none. */
  cutoff() {
    return bandwidth(this.filter) ?? middle(this.filter);
  }

  /** Everything faster or slower, at once. @param {number} value rad/s */
  setCutoff(value) {
    const factor = value / this.cutoff();
    const sizes = this.poles.map(({ re, im }) => Math.hypot(re, im) * factor);
    if (!(Math.min(...sizes) >= LIMITS.slowest && Math.max(...sizes) <= LIMITS.fastest)) return;
    this.moveTime ??= performance.now();
    const next = scaled(this.design(), factor);
    this.poles = this.poles.map((root) => ({ ...root, re: root.re * factor, im: root.im * factor }));
    this.zeros = this.zeros.map((root) => ({ ...root, re: root.re * factor, im: root.im * factor }));
    this.state.numerator = next.numerator;
    this.rebuilt({ fit: true });
  }

  /** Poles of a family, from Python. @param {{family?: string, order?: number, band?: number[], damping?: number}} [wanted] */
  async askFamily(wanted = {}) {
    const family = wanted.family ?? this.family;
    let order = Math.min(Math.max(Math.round(wanted.order ?? countOf(this.poles)), 1), LIMITS.order);
    if (family === "custom") {
      this.changeOrder(order);
      return;
    }
    const fields = { family, cutoff: Math.min(Math.max(this.cutoff(), LIMITS.slowest), LIMITS.fastest) };
    if (family === "damped") fields.damping = wanted.damping ?? this.damping ?? 0.7;
    if (family === "bandpass") {
      if (order % 2) order = order < LIMITS.order ? order + 1 : order - 1;
      fields.band = wanted.band ?? this.band ?? [fields.cutoff / 2, fields.cutoff * 2];
      this.band = fields.band;
    }
    if (this.state.numerator.kind === "type" && family !== "bandpass") fields.type = Math.min(this.state.numerator.type, order);
    const reply = await this.link.ask("family", { ...fields, order }, { latest: true });
    if (!reply) return;
    if (!reply.ok) {
      this.fail(reply);
      this.paint();
      return;
    }
    this.begin();
    const { sampling, assume, limits } = this.state;
    this.load({ ...reply.design, sampling, assume, limits }, { fit: true, family });
    this.commit("");
    this.say(`${FAMILY_NAMES[family] ?? family}, order ${order}.`);
  }

  /** @param {number} order */
  changeOrder(order) {
    const now = countOf(this.poles);
    if (order > now) this.add("pole");
    else if (order < now) {
      const size = ({ re, im }) => Math.hypot(re, im);
      const fast = this.poles.reduce((best, root) => (size(root) > size(best) ? root : best));
      this.remove({ kind: "pole", id: fast.id });
    }
  }

  /** @param {string} kind @param {number} [type] */
  setNumerator(kind, type = 2) {
    this.edit("numerator", () => {
      if (kind === "zeros") this.freeZeros();
      else this.state.numerator = kind === "type" ? { kind, type: Math.min(Math.max(type, 1), countOf(this.poles)) } : { kind: "lowpass" };
    });
  }

  // -- limits -----------------------------------------------------------------------------------------------------

  /** @param {"error" | "estimate"} kind */
  toggleLimit(kind) {
    this.edit("limit", () => {
      const limits = { ...this.state.limits };
      if (limits[kind]) delete limits[kind];
      else {
        const { share, level } = LIMIT_KINDS[kind].start;
        limits[kind] = { omega: Number((share * this.cutoff()).toPrecision(3)), level };
      }
      this.state.limits = Object.keys(limits).length ? limits : null;
    });
  }

  /** How far a curve is above its limit in dB; negative: below. @param {"error" | "estimate"} kind */
  excess(kind) {
    const limit = this.state.limits[kind];
    const { curve, below } = LIMIT_KINDS[kind];
    const { omega } = this.curves;
    const db = this.curves[curve].db;
    const at = (curve === "E" ? errorResponse : response)(this.filter, [limit.omega]);
    let worst = 20 * Math.log10(Math.hypot(at.re[0], at.im[0]));
    for (let k = 0; k < omega.length; k++) if (below ? omega[k] <= limit.omega : omega[k] >= limit.omega) worst = Math.max(worst, db[k]);
    return worst - 20 * Math.log10(limit.level);
  }

  // -- log and learning -------------------------------------------------------------------------------------------

  /** @param {File} file */
  async take(file) {
    if (file.size > LARGEST_LOG) {
      this.say(`${file.name} has ${short(file.size / 1e6, 3)} MB, expected at most 20 MB: cut or thin the log.`, "error");
      return;
    }
    const text = await file.text();
    const name = file.name.slice(0, 200);
    if (/\.toml$/i.test(name)) {
      const reply = await this.link.ask("open", { name, text });
      if (!this.ok(reply)) return;
      this.begin();
      this.load(reply.design, { fit: true });
      this.commit("");
      this.say((reply.messages ?? []).join(" ") || `Opened ${name}.`);
      return;
    }
    this.say(`Reading ${name} …`);
    const reply = await this.link.ask("log", { name, text });
    if (!this.ok(reply)) return;
    this.setLog(reply.log);
    this.say(`Read ${name}.`);
  }

  setLog(log) {
    this.log = log;
    this.channel = 0;
    this.estimate = null;
    this.logWindow = null; // times in s that are drawn, null: all
    this.logWhole = null;
    this.curve = [];
    this.learnMessage("");
    this.showLog();
    if (log) void this.askEstimate();
    this.paint();
  }

  async forget() {
    if (this.job) await this.cancel();
    if (this.ok(await this.link.ask("forget"))) this.setLog(null);
  }

  async askEstimate() {
    this.estimatedAt = performance.now();
    const reply = await this.link.ask("estimate", { design: this.design(), channel: this.channel, ...(this.logWindow ? { window: this.logWindow } : {}) }, { latest: true });
    if (!reply || !this.log) return;
    if (!reply.ok) {
      this.estimate = null;
      this.fail(reply);
    } else this.estimate = reply;
    this.logWhole ??= reply.ok ? [reply.t[0], reply.t[reply.t.length - 1]] : null;
    this.showEstimate();
    this.paint();
  }

  /** Draw a part of the log, or all of it. @param {number} low s @param {number} high s */
  showWindow(low, high) {
    if (!this.logWhole) return;
    const [first, last] = this.logWhole;
    const least = 10 * this.log.dt;
    const span = Math.min(Math.max(high - low, least), last - first);
    const from = Math.min(Math.max((low + high - span) / 2, first), last - span);
    this.logWindow = span >= 0.999 * (last - first) ? null : [from, from + span];
    void this.askEstimate();
  }

  /** Move or scale the part that is drawn. @param {number} factor @param {number} shift in parts of its width */
  moveWindow(factor, shift) {
    if (!this.logWhole) return;
    const [low, high] = this.logWindow ?? this.logWhole;
    const middle = (low + high) / 2 + shift * (high - low);
    const half = (factor * (high - low)) / 2;
    this.showWindow(middle - half, middle + half);
  }

  /** A stretch marked with the mouse is what is drawn next. */
  markWindow() {
    const { overlay } = this.logChart;
    const box = g("rect", { class: "pf-marked", visibility: "hidden" });
    overlay.append(box);
    overlay.addEventListener("dblclick", () => this.logWhole && this.showWindow(...this.logWhole));
    overlay.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.estimate) return;
      const { left } = overlay.getBoundingClientRect();
      const held = (at) => Math.min(Math.max(at - left, MARGIN.left), this.logChart.width - MARGIN.right);
      const start = held(event.clientX);
      let end = start;
      overlay.setPointerCapture(event.pointerId);
      const move = (next) => {
        end = held(next.clientX);
        const values = { visibility: "visible", x: Math.min(start, end), width: Math.abs(end - start), y: this.logChart.top, height: this.logChart.inner.height };
        for (const [name, value] of Object.entries(values)) box.setAttribute(name, String(value));
      };
      const stop = (last) => {
        overlay.removeEventListener("pointermove", move);
        overlay.removeEventListener("pointerup", stop);
        overlay.removeEventListener("pointercancel", stop);
        box.setAttribute("visibility", "hidden");
        if (last.type === "pointerup" && Math.abs(end - start) > 6) this.showWindow(this.logOrigin + this.logChart.xAt(Math.min(start, end)), this.logOrigin + this.logChart.xAt(Math.max(start, end)));
      };
      overlay.addEventListener("pointermove", move);
      overlay.addEventListener("pointerup", stop);
      overlay.addEventListener("pointercancel", stop);
    });
  }

  async learn() {
    const order = Number(this.parts.learnOrder.value);
    const form = this.parts.learnForm.value;
    const reply = await this.link.ask("learn", { order, form });
    if (!this.ok(reply)) return;
    this.job = reply.job;
    this.curve = [];
    this.learnMessage("learning …");
    this.showLearning();
    this.poll();
  }

  poll() {
    clearTimeout(this.polling);
    this.polling = setTimeout(async () => {
      if (this.job === null || this.closed) return;
      const reply = await this.link.ask("job", { job: this.job });
      if (this.job === null || this.closed) return;
      if (!reply.ok) {
        this.job = null;
        this.fail(reply);
        this.showLearning();
        return;
      }
      this.progress(reply);
      if (reply.state === "running") this.poll();
    }, POLL);
  }

  /** @param {any} reply */
  progress(reply) {
    this.curve = reply.curve ?? [];
    this.learnMessage(reply.message ?? reply.state);
    if (reply.state !== "running") {
      this.job = null;
      if (reply.state === "done" && reply.design) this.learned(reply.design);
      if (reply.state === "failed") this.say(reply.message, "error");
    }
    this.showLearning();
    this.paint();
  }

  /** @param {any} design */
  learned(design) {
    this.begin();
    const { assume, limits } = this.state;
    this.load({ ...design, assume, limits }, { fit: true });
    this.commit("");
    this.say("The learned design is in place; undo brings the one before back.");
    void this.askEstimate();
  }

  async cancel() {
    const job = this.job;
    if (job === null) return;
    const reply = await this.link.ask("cancel", { job });
    if (this.ok(reply) && this.job === job) {
      if (reply.state === "running") this.learnMessage("stopping …");
      else this.progress(reply);
    }
  }

  // -- handing over -----------------------------------------------------------------------------------------------

  async copyPython() {
    const reply = await this.link.ask("python", { design: this.design() });
    if (!this.ok(reply)) return;
    this.parts.code.textContent = reply.text;
    this.parts.codeBox.hidden = false;
    try {
      await navigator.clipboard.writeText(reply.text);
      this.say("Copied as Python.");
    } catch {
      const range = document.createRange();
      range.selectNodeContents(this.parts.code);
      getSelection()?.removeAllRanges();
      getSelection()?.addRange(range);
      this.say("The clipboard is closed to this page: the text is selected, copy it by hand.", "warn");
    }
  }

  async save() {
    const reply = await this.link.ask("save", { design: this.design(), name: "filter" });
    if (this.ok(reply)) this.download(reply);
  }

  /** @param {"fmu2" | "fmu3" | "c"} kind */
  async export(kind) {
    const channels = Math.min(Math.max(Math.round(Number(this.parts.channels.value)) || 1, 1), 12);
    this.parts.channels.value = String(channels);
    const button = this.parts[kind];
    button.disabled = true;
    this.say(kind === "c" ? "Writing C …" : "Building the FMU …");
    const reply = await this.link.ask("export", { design: this.design(), kind, channels });
    this.showAbilities();
    if (this.ok(reply)) this.download(reply);
  }

  /** @param {{name: string, mime: string, base64: string, written?: string}} file */
  download({ name, mime, base64, written }) {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const address = URL.createObjectURL(new Blob([bytes], { type: mime }));
    const link = h("a", { href: address, download: name });
    this.root.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(address), 10_000);
    this.say(`${name}, ${short(Math.max(bytes.length / 1000, 0.1), 3)} kB, is with your downloads${written ? `, and is ${written}` : ""}.`);
  }

  // -- pins -------------------------------------------------------------------------------------------------------

  pin() {
    const design = this.design();
    const key = JSON.stringify(design);
    const number = Math.max(0, ...this.pins.map((pin) => pin.number)) + 1;
    const numbers = key === this.answered ? this.answer.numbers : null;
    this.pins.push({ number, name: `Design ${number}`, key, design, filter: filterOf(design), numbers });
    if (this.pins.length > PIN_DASHES.length) this.pins.shift();
    this.showPins();
    this.fresh = true;
    this.paint();
    this.say(`Pinned as Design ${number}: it stays behind in grey.`);
  }

  unpin(pin) {
    this.pins = this.pins.filter((other) => other !== pin);
    this.showPins();
    this.fresh = true;
    this.paint();
  }

  // -- saying -----------------------------------------------------------------------------------------------------

  /** @param {any} reply */
  ok(reply) {
    if (reply?.ok) return true;
    if (reply) this.fail(reply);
    return false;
  }

  fail(reply) {
    this.say(reply.error || "Python gave no reason.", "error");
  }

  /** @param {string} text @param {"" | "warn" | "error"} [level] */
  say(text, level = "") {
    this.failed = level === "error";
    const { status } = this.parts;
    status.textContent = text;
    status.className = `pf-status ${level ? `pf-${level}` : ""}`;
    clearTimeout(this.saying);
    // What went wrong stays until the next word.
    if (level !== "error") this.saying = setTimeout(() => status.classList.add("pf-past"), level ? 9000 : 5000);
  }

  /** @param {number | null} since */
  showBusy(since) {
    const { busy } = this.parts;
    busy.hidden = since === null;
    if (since === null) return;
    const seconds = (performance.now() - since) / 1000;
    busy.textContent = seconds < 1 ? "Python is busy" : `Python is busy, ${seconds.toFixed(0)} s`;
  }

  /** @param {string} name @param {number} start */
  measure(name, start) {
    try {
      // A benchmark reads them; a long session must not fill the browser with them.
      this.measured = (this.measured ?? 0) + 1;
      if (this.measured % 5000 === 0) ["drag-to-preview", "drag-to-answer"].forEach((each) => performance.clearMeasures(each));
      performance.measure(name, { start, end: performance.now() });
    } catch {
      // An old browser without the options: only the benchmark misses it.
    }
  }

  // -- the page ---------------------------------------------------------------------------------------------------

  build() {
    this.parts = {};
    const { root } = this;
    this.plane = new Plane({
      roots: (kind) => (kind === "pole" ? this.poles : this.zeros),
      change: (kind, list) => this.change(kind, list),
      begin: () => this.begin(),
      commit: (what) => this.commit(what),
      add: (kind, at) => this.add(kind, at),
      select: (kind, id) => this.select(kind, id),
      selected: () => this.chosen,
      remove: () => this.remove(),
      say: (text) => this.say(text, "warn"),
      hover: (text) => {
        this.planeText = text;
        this.showPlaneText();
      },
      refit: () => this.paint(),
    });
    root.append(
      this.buildHeader(),
      this.buildCode(),
      this.buildNumbers(),
      h("div", { class: "pf-columns" }, h("div", { class: "pf-column pf-knobs" }, ...this.buildKnobs()), h("div", { class: "pf-column pf-s" }, this.buildPlane(), this.buildTable(), this.buildPins()), h("div", { class: "pf-column pf-plots" }, this.buildBode(), this.buildStep())),
      this.buildLog(),
      this.keep("status", h("p", { class: "pf-status", role: "status", "aria-live": "polite", "data-test": "status" })),
    );
    root.addEventListener("dragover", (event) => {
      event.preventDefault();
      root.classList.add("pf-dropping");
    });
    root.addEventListener("dragleave", (event) => {
      if (!root.contains(event.relatedTarget)) root.classList.remove("pf-dropping");
    });
    root.addEventListener("drop", (event) => {
      event.preventDefault();
      root.classList.remove("pf-dropping");
      const file = event.dataTransfer?.files?.[0];
      if (file) void this.take(file);
    });
  }

  /** Remember a part by name. @param {string} name @param {any} element */
  keep(name, element) {
    this.parts[name] = element;
    return element;
  }

  /** @param {string} test @param {string} text @param {() => void} click @param {Record<string, any>} [more] */
  button(test, text, click, more = {}) {
    return h("button", { type: "button", "data-test": test, onclick: click, ...more }, text);
  }

  /** @param {string} title @param {Node[]} body @param {{test?: string, side?: (Node | null)[], className?: string}} [more] */
  card(title, body, { test, side = [], className = "" } = {}) {
    return h("section", { class: `pf-card ${className}`, "data-test": test, "aria-label": title }, h("header", { class: "pf-card-head" }, h("h2", {}, title), h("div", { class: "pf-side" }, ...side)), ...body);
  }

  buildHeader() {
    const logo = g("svg", { viewBox: "0 0 32 32", class: "pf-logo", "aria-hidden": "true" }, g("rect", { width: 32, height: 32, rx: 8 }), g("path", { d: "M7 10h7c6 0 5 12 12 12", class: "pf-logo-curve" }), g("path", { d: "M7 19l5 5m0-5l-5 5", class: "pf-logo-pole" }));
    const theme = this.button("theme", "◐", () => this.nextTheme(), { class: "pf-icon", title: "Light, dark or as the system", "aria-label": "Change between light and dark" });
    const open = h("label", { class: "pf-file", "data-test": "open" }, "Open", this.keep("openFile", h("input", { type: "file", accept: ".toml", "aria-label": "Open a filter file", "data-test": "open-file", onchange: (event) => this.picked(event) })));
    const group = (label, ...items) => h("div", { class: "pf-group", role: "group", "aria-label": label }, ...items);
    return h(
      "header",
      { class: "pf-header" },
      h("div", { class: "pf-brand" }, logo, h("div", {}, h("h1", {}, "PhyFilter designer", this.keep("version", h("small", {}))), this.keep("summary", h("p", { class: "pf-summary", "data-test": "summary" })))),
      this.keep("busy", h("span", { class: "pf-busy", role: "status", "data-test": "busy", hidden: true }, "Python is busy")),
      h(
        "div",
        { class: "pf-tools" },
        group("History", this.keep("undo", this.button("undo", "↶", () => this.undo(), { class: "pf-icon", title: "Undo, Ctrl+Z", "aria-label": "Undo" })), this.keep("redo", this.button("redo", "↷", () => this.redo(), { class: "pf-icon", title: "Redo, Ctrl+Shift+Z", "aria-label": "Redo" }))),
        group("Compare", this.button("pin", "Pin", () => this.pin(), { title: "Keep this design behind in grey to compare with" })),
        group("File", open, this.button("save", "Save", () => void this.save(), { title: "The filter as a TOML file" }), this.button("python", "Copy as Python", () => void this.copyPython())),
        group(
          "Export",
          h("span", { class: "pf-group-name" }, "Export"),
          this.keep("fmu2", this.button("export-fmu2", "FMU 2", () => void this.export("fmu2"), { class: "pf-primary" })),
          this.keep("fmu3", this.button("export-fmu3", "FMU 3", () => void this.export("fmu3"), { class: "pf-primary" })),
          this.keep("c", this.button("export-c", "C", () => void this.export("c"), { class: "pf-primary" })),
          h("label", { class: "pf-channels", title: "Channels of x in the export: one filter for each" }, "channels", this.keep("channels", h("input", { type: "number", min: 1, max: 12, value: 1, "aria-label": "Channels of the export", "data-test": "channels" }))),
        ),
        theme,
      ),
    );
  }

  buildCode() {
    const close = this.button("python-close", "Close", () => (this.parts.codeBox.hidden = true));
    this.keep("code", h("pre", { "data-test": "python-text", tabindex: 0 }));
    return this.keep("codeBox", h("section", { class: "pf-card pf-code", hidden: true, "aria-label": "Python" }, this.parts.code, close));
  }

  buildNumbers() {
    this.cards = new Map();
    this.keep("numbers", h("div", { class: "pf-numbers", "data-test": "numbers" }));
    this.keep("explain", h("p", { class: "pf-explain", "data-test": "explain" }, "Point at a figure to read what it means."));
    this.keep("messages", h("ul", { class: "pf-messages", "data-test": "messages" }));
    return h("section", { class: "pf-figures", "aria-label": "Figures" }, this.parts.numbers, h("div", { class: "pf-under" }, this.parts.explain, this.parts.messages));
  }

  /** A labelled number with its unit. @param {string} test @param {string} label @param {string} unit @param {(value: number) => string | void} set @param {string} [title] */
  numberField(test, label, unit, set, title = "") {
    const input = h("input", { type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false", "data-test": test, "aria-label": unit ? `${label} in ${unit}` : label });
    input.addEventListener("change", () => {
      const value = typed(input.value);
      const wrong = Number.isNaN(value) ? `${label}: expected a number, got “${input.value}”.` : set(value);
      input.setAttribute("aria-invalid", String(Boolean(wrong)));
      if (wrong) this.say(wrong, "warn");
      else this.paint();
    });
    const unitText = h("span", { class: "pf-unit" }, unit);
    return { input, unitText, element: h("label", { class: "pf-field", title: title || null }, h("span", { class: "pf-name" }, label), h("span", { class: "pf-entry" }, input, unitText)) };
  }

  buildKnobs() {
    return [this.buildStart(), this.buildNumerator(), this.buildSampling(), this.buildAssumptions()];
  }

  buildStart() {
    const family = h("select", { "data-test": "family", "aria-label": "Family", onchange: () => void this.askFamily({ family: family.value }) });
    this.keep("family", family);
    this.offerFamilies(Object.keys(FAMILY_NAMES));
    const order = this.keep("order", h("output", { "data-test": "order" }));
    const step = (by) => void this.askFamily({ order: countOf(this.poles) + by * (this.family === "bandpass" ? 2 : 1) });
    const cutoff = this.numberField("cutoff", "Bandwidth", "rad/s", (value) => {
      if (!(value >= LIMITS.slowest && value <= LIMITS.fastest)) return `Bandwidth: expected ${LIMITS.slowest} to 1e5 rad/s, got ${value}.`;
      this.begin();
      this.setCutoff(value);
      this.commit("");
      return "";
    });
    this.keep("cutoff", cutoff.input);
    const slider = this.keep("cutoffSlider", this.logSlider("cutoff-slider", "Bandwidth", 0.1, 1e4, (value) => this.setCutoff(value), "speed"));
    const damping = this.numberField("damping", "Damping ζ", "", (value) => {
      if (!(value >= 0.01 && value <= 1)) return `Damping ratio: expected 0.01 to 1, got ${value}.`;
      this.damping = value;
      void this.askFamily({ damping: value });
      return "";
    });
    this.keep("damping", damping.input);
    this.keep("dampingRow", damping.element);
    const edges = ["low", "high"].map((name, i) =>
      this.numberField(`band-${name}`, i ? "Upper edge" : "Lower edge", "rad/s", (value) => {
        const band = [...(this.band ?? [this.cutoff() / 2, this.cutoff() * 2])];
        band[i] = value;
        if (!(band[0] > 0 && band[0] < band[1])) return `Band: expected 0 < lower < upper edge, got ${short(band[0])} and ${short(band[1])} rad/s.`;
        void this.askFamily({ band });
        return "";
      }),
    );
    this.keep("edges", edges.map(({ input }) => input));
    this.keep("edgeRows", edges.map(({ element }) => element));
    return this.card(
      "Start from",
      [
        h("label", { class: "pf-field pf-wide" }, h("span", { class: "pf-name" }, "Family"), family),
        h("div", { class: "pf-field" }, h("span", { class: "pf-name" }, "Order"), h("span", { class: "pf-stepper" }, this.button("order-less", "−", () => step(-1), { "aria-label": "Lower the order" }), order, this.button("order-more", "+", () => step(1), { "aria-label": "Raise the order" }))),
        cutoff.element,
        slider,
        damping.element,
        ...edges.map(({ element }) => element),
      ],
      { test: "knobs" },
    );
  }

  /** A slider over decades. @param {string} test @param {string} label @param {number} low @param {number} high @param {(value: number) => void} set @param {string} what */
  logSlider(test, label, low, high, set, what) {
    const slider = h("input", { type: "range", min: 0, max: 1000, step: 1, "data-test": test, "aria-label": `${label}, coarse` });
    slider.addEventListener("input", () => {
      if (!this.dragging) this.begin();
      set(Number((low * (high / low) ** (Number(slider.value) / 1000)).toPrecision(3)));
    });
    slider.addEventListener("change", () => this.commit(what));
    slider.show = (value) => (slider.value = String(Math.round((1000 * Math.log(value / low)) / Math.log(high / low))));
    return slider;
  }

  buildNumerator() {
    const names = { lowpass: "Low-pass", type: "Type k", zeros: "Free zeros" };
    this.parts.kinds = Object.entries(names).map(([kind, text]) => this.button(`numerator-${kind}`, text, () => this.setNumerator(kind), { "aria-pressed": "false" }));
    const type = h("select", { "data-test": "type", "aria-label": "Type of 1 − F", onchange: () => this.setNumerator("type", Number(type.value)) });
    this.keep("type", type);
    this.keep("typeRow", h("label", { class: "pf-field" }, h("span", { class: "pf-name" }, "Type"), type));
    const gain = this.numberField("gain", "F(0)", "", (value) => {
      if (value === 0) return "Gain: expected a number other than 0.";
      this.edit("gain", () => {
        this.freeZeros();
        this.before = { held: value };
        this.regain();
      });
      return "";
    });
    this.keep("gain", gain.input);
    this.keep("gainRow", gain.element);
    this.keep("numeratorNote", h("p", { class: "pf-note" }));
    return this.card("Numerator", [h("div", { class: "pf-segments", role: "group", "aria-label": "Numerator" }, ...this.parts.kinds), this.parts.typeRow, gain.element, this.parts.numeratorNote]);
  }

  buildSampling() {
    const set = (value) => {
      if (!(value >= LIMITS.dtMin && value <= LIMITS.dtMax)) return `Step h: expected 0.01 to 1000 ms, got ${short(value * 1e3)} ms.`;
      this.edit("step", () => (this.state.sampling.dt = value));
      return "";
    };
    const dt = this.numberField("dt", "Step h", "ms", (value) => set(value / 1e3));
    this.keep("dt", dt.input);
    const slider = this.logSlider("dt-slider", "Step h", LIMITS.dtMin, LIMITS.dtMax, (value) => {
      this.state.sampling.dt = value;
      this.rebuilt();
    }, "step");
    this.keep("dtSlider", slider);
    this.keep("eulerMark", h("span", { class: "pf-euler-mark", title: "Forward Euler is unstable right of here" }));
    const names = { exact: "Exact", euler: "Euler", tustin: "Tustin" };
    this.parts.methods = Object.entries(names).map(([method, text]) => this.button(`method-${method}`, text, () => this.edit("method", () => (this.state.sampling.method = method)), { "aria-pressed": "false" }));
    this.keep("samplingNote", h("p", { class: "pf-note", "data-test": "euler" }));
    return this.card("Sampling", [dt.element, h("div", { class: "pf-track" }, slider, this.parts.eulerMark), h("div", { class: "pf-segments", role: "group", "aria-label": "Method" }, ...this.parts.methods), this.parts.samplingNote], { test: "sampling" });
  }

  buildAssumptions() {
    const rows = [
      ["slope", "Slope of γ ≤", () => `${this.unit()}/s`, 1, 0, 1e12, "How fast the residual γ = f − f_θ, what the model misses, may change: the error bound rests on it"],
      ["noise", "Noise of x, sd", () => `${this.unit()}·s`, 1, 0, 1e12, "Standard deviation of the white noise on every sample of x"],
      ["ratio", "M̂/M", () => "", 1, 1e-3, 1e3, "Modelled inertia over the true one: the margins start from it"],
      ["lag", "Actuator lag", () => "ms", 1e3, 0, 10, "Time constant between the command that cancels f̂ and its force"],
      ["delay", "Delay", () => "ms", 1e3, 0, 10, "Further dead time in the loop"],
    ];
    this.assumed = rows.map(([key, label, unit, factor, low, high, title]) => {
      const entry = this.numberField(key, label, unit(), (value) => {
        if (!(value / factor >= low && value / factor <= high)) return `${label}: expected ${short(low * factor)} to ${short(high * factor)} ${unit()}, got ${short(value)}.`;
        this.edit(key, () => (this.state.assume[key] = value / factor));
        return "";
      }, title);
      return { ...entry, key, factor, unit };
    });
    const unit = h("input", { type: "text", maxlength: 40, placeholder: "m/s²", "data-test": "unit", "aria-label": "Unit of f", onchange: () => this.edit("unit", () => (this.state.assume.unit = unit.value.trim())) });
    this.keep("unit", unit);
    return this.card("Assume", [...this.assumed.map(({ element }) => element), h("label", { class: "pf-field" }, h("span", { class: "pf-name" }, "Unit of f"), h("span", { class: "pf-entry" }, unit))], { test: "assume" });
  }

  unit() {
    return this.state.assume.unit || "[f]";
  }

  buildPlane() {
    const readout = this.keep("planeReadout", h("p", { class: "pf-readout pf-below-plane", "data-test": "plane-readout" }, PLANE_HINT));
    const log = this.button("plane-log", "log", () => {
      this.plane.view.log = !this.plane.view.log;
      log.setAttribute("aria-pressed", String(this.plane.view.log));
      this.plane.fit();
    }, { "aria-pressed": "false", title: "Distance from the origin in decades; directions stay" });
    const view = h("div", { class: "pf-group" }, this.button("zoom-out", "−", () => this.plane.zoom(1.5), { class: "pf-icon", "aria-label": "Zoom out", title: "Zoom out, or Ctrl and the wheel" }), this.button("zoom-in", "+", () => this.plane.zoom(1 / 1.5), { class: "pf-icon", "aria-label": "Zoom in", title: "Zoom in, or Ctrl and the wheel" }), this.button("fit", "Fit", () => this.plane.fit(), { title: "Show all poles and zeros" }), log);
    const tools = h(
      "div",
      { class: "pf-bar" },
      h("div", { class: "pf-group" }, this.button("add-pole", "+ pole", () => this.add("pole"), { title: "Or double-click the plane" }), this.button("add-pair", "+ pair", () => this.add("pair"), { title: "Two conjugate poles" }), this.button("add-zero", "+ zero", () => this.add("zero"), { title: "A zero of F; or double-click with Alt" })),
      h("div", { class: "pf-group pf-right" }, this.keep("delete", this.button("delete", "Delete", () => this.remove(), { title: "Delete the selected one, Del" }))),
    );
    return this.card("Poles and zeros", [this.plane.element, readout, tools], { side: [view], className: "pf-plane-card" });
  }

  buildTable() {
    this.keep("rows", h("tbody"));
    const heads = [["", "kind"], ["Re", "rad/s"], ["± Im", "rad/s"], ["ωₙ", "rad/s"], ["ζ", ""], ["", "delete"]];
    const head = h("tr", {}, ...heads.map(([text, unit]) => h("th", { scope: "col" }, text, text && unit ? h("small", {}, ` ${unit}`) : null)));
    this.tableRows = new Map();
    return this.card("Values", [h("table", { class: "pf-table", "data-test": "values" }, h("thead", {}, head), this.parts.rows)]);
  }

  buildPins() {
    this.keep("pins", h("div", { class: "pf-pins" }));
    return this.keep("pinCard", this.card("Compare", [this.parts.pins], { test: "pins" }));
  }

  buildBode() {
    const cursor = (x) => {
      this.cursorAt = x;
      this.paint();
    };
    this.magnitude = new Chart({ test: "bode-magnitude", label: "Magnitude", height: 290, logX: true, xLabel: "", yLabel: "magnitude, dB", onCursor: cursor });
    this.phase = new Chart({ test: "bode-phase", label: "Phase", height: 175, logX: true, degrees: true, xLabel: "ω, rad/s", yLabel: "phase, °", onCursor: cursor });
    this.limitHandles = new Map();
    const legend = Object.entries(CURVES).map(([key, curve]) => {
      const item = this.button(`legend-${key}`, "", () => {
        this.shown[key] = !this.shown[key];
        item.setAttribute("aria-pressed", String(this.shown[key]));
        this.paint();
      }, { class: "pf-legend", "aria-pressed": "true", title: curve.title });
      item.append(swatch(`pf-stroke-${curve.colour}`, curve.dash), curve.text);
      return item;
    });
    const limits = Object.entries(LIMIT_KINDS).map(([kind, { text }]) => this.keep(`limit-${kind}`, this.button(`limit-${kind}`, `Limit ${text}`, () => this.toggleLimit(kind), { "aria-pressed": "false", title: `Draw a limit of ${text}, and drag its corner` })));
    this.keep("readout", h("p", { class: "pf-readout pf-line", "data-test": "readout" }));
    return this.card("Frequency", [h("div", { class: "pf-bar" }, h("div", { class: "pf-legends" }, ...legend), h("div", { class: "pf-group pf-right" }, ...limits)), this.magnitude.element, this.phase.element, this.parts.readout]);
  }

  buildStep() {
    this.stepChart = new Chart({
      test: "step",
      label: "Step response",
      height: 210,
      xLabel: "t, s",
      yLabel: "",
      onCursor: (t) => {
        this.stepAt = t;
        this.paint();
      },
    });
    this.keep("stepReadout", h("span", { class: "pf-readout" }));
    const item = (key, text) => h("span", { class: "pf-legend" }, swatch(`pf-stroke-${CURVES[key].colour}`, CURVES[key].dash), text);
    return this.card("Answer to a unit step of the residual", [h("div", { class: "pf-bar" }, h("div", { class: "pf-legends" }, item("F", "estimate"), item("E", "error")), this.parts.stepReadout), this.stepChart.element]);
  }

  buildLog() {
    this.logChart = new Chart({
      test: "log-plot",
      label: "Estimate on the log",
      height: 230,
      xLabel: "t, s",
      yLabel: "f",
      onCursor: (t) => {
        this.logAt = t;
        this.paint();
      },
    });
    this.costChart = new Chart({ test: "cost-plot", label: "Cost while learning", height: 150, logY: true, xLabel: "improvements", yLabel: "RMSE" });
    this.markWindow();
    const part = (test, text, words, factor, shift) => this.button(test, text, () => this.moveWindow(factor, shift), { class: "pf-icon", "aria-label": words, title: words });
    const parts = h(
      "div",
      { class: "pf-group pf-right", role: "group", "aria-label": "Part of the log that is drawn" },
      part("log-earlier", "‹", "Earlier", 1, -0.5),
      part("log-later", "›", "Later", 1, 0.5),
      part("log-out", "−", "Draw a longer part", 2, 0),
      part("log-in", "+", "Draw a shorter part, or mark it in the plot", 0.5, 0),
      this.keep("logAll", this.button("log-whole", "Whole", () => this.logWhole && this.showWindow(...this.logWhole), { title: "Draw the whole log; or double-click the plot" })),
    );
    const file = h("input", { type: "file", accept: ".csv,.txt,.tsv,.toml", "data-test": "log-file", "aria-label": "Pick a CSV log", onchange: (event) => this.picked(event) });
    this.keep("drop", h("label", { class: "pf-drop", "data-test": "drop" }, h("strong", {}, "Drop a recorded log here"), h("span", {}, "or pick a CSV file: a column t in s, the measured x, and if known label_x, g_x, f_theta_x"), file));
    const channel = h("select", { "data-test": "channel", "aria-label": "Channel", onchange: () => {
      this.channel = Number(channel.value);
      void this.askEstimate();
    } });
    this.keep("channel", channel);
    this.keep("logSummary", h("p", { class: "pf-log-summary", "data-test": "log" }));
    this.keep("rmse", h("dl", { class: "pf-rmse", "data-test": "rmse" }));
    this.keep("logLegend", h("div", { class: "pf-legends" }));
    this.keep("logReadout", h("span", { class: "pf-readout" }));
    this.keep("learnOrder", h("select", { "data-test": "learn-order", "aria-label": "Order to learn" }, ...Array.from({ length: LIMITS.order }, (_, i) => h("option", { value: i + 1, selected: i === 1 }, String(i + 1)))));
    this.keep("learnForm", h("select", { "data-test": "learn-form", "aria-label": "Form to learn" }, h("option", { value: "lowpass" }, "low-pass"), h("option", { value: "general" }, "general")));
    this.keep("learn", this.button("learn", "Learn from the log", () => void this.learn(), { class: "pf-primary" }));
    this.keep("cancel", this.button("cancel", "Cancel", () => void this.cancel()));
    this.keep("learnMessage", h("p", { class: "pf-note", "data-test": "learn-message" }));
    const field = (text, input) => h("label", { class: "pf-field" }, h("span", { class: "pf-name" }, text), input);
    this.keep("learning", h("div", { class: "pf-learning" }, h("h3", {}, "Learn"), field("Order up to", this.parts.learnOrder), field("Form", this.parts.learnForm), h("div", { class: "pf-bar" }, this.parts.learn, this.parts.cancel), this.parts.learnMessage, this.costChart.element));
    this.keep("logBody", h("div", { class: "pf-log-body" }, h("div", { class: "pf-log-left" }, h("div", { class: "pf-bar" }, this.parts.logLegend, this.parts.logReadout, parts), this.logChart.element, this.parts.rmse), this.parts.learning));
    this.keep("forget", this.button("forget", "Close the log", () => void this.forget()));
    return this.card("Log", [this.parts.drop, this.parts.logBody], { test: "log-card", side: [this.parts.logSummary, channel, this.parts.forget], className: "pf-log-card" });
  }

  picked(event) {
    const file = event.target.files?.[0];
    event.target.value = "";
    if (file) void this.take(file);
  }

  // -- showing ----------------------------------------------------------------------------------------------------

  offerFamilies(names) {
    const { family } = this.parts;
    const entries = [["custom", "Custom"], ...names.map((name) => [name, FAMILY_NAMES[name] ?? name])];
    family.replaceChildren(...entries.map(([value, text]) => h("option", { value }, text)));
    family.value = this.family;
  }

  showAbilities() {
    const { fmu, c, why } = this.can;
    for (const [name, able] of [["fmu2", fmu], ["fmu3", fmu], ["c", c]]) {
      this.parts[name].disabled = !able;
      this.parts[name].title = able ? { fmu2: "FMU of FMI 2.0", fmu3: "FMU of FMI 3.0", c: "C99 sources in a zip" }[name] : why || "not on this machine";
    }
  }

  /** Where the mouse is; else what can be done. */
  showPlaneText() {
    const sizes = this.poles.map(({ re, im }) => Math.hypot(re, im));
    const apart = !this.plane.view.log && Math.max(...sizes) > FAR_APART * Math.min(...sizes);
    write(this.parts.planeReadout, this.planeText || (apart ? "Poles far apart: “log” shows each" : PLANE_HINT));
  }

  select(kind, id) {
    this.chosen = kind ? { kind, id } : null;
    this.paint();
  }

  /** Draw what has changed at the next frame. */
  paint() {
    if (this.frame || this.closed) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.render();
      if (this.moveTime !== null && this.moveTime !== undefined) this.measure("drag-to-preview", this.moveTime);
      this.moveTime = null;
    });
  }

  render() {
    if (!this.root.isConnected || !this.root.clientWidth) return;
    const first = !this.plane.width;
    this.plane.measure();
    if (first && this.plane.width) this.plane.fit();
    this.computeCurves();
    // Canvases before text: text on a canvas makes the browser lay out whatever has changed, once for every change.
    this.drawStep();
    if (this.log) this.drawLog();
    this.drawBode();
    this.plane.euler = this.state.sampling.method === "euler" ? this.state.sampling.dt : null;
    this.plane.draw();
    this.showPlaneText();
    this.showTable();
    this.showKnobs();
    this.showNumbers();
    this.fresh = false;
  }

  /** Curves of the preview, when the design or an axis has changed. */
  computeCurves() {
    const range = this.frequencyRange();
    const key = range.join();
    if (!this.fresh && key === this.rangeKey) return;
    this.rangeKey = key;
    const { dt, method } = this.state.sampling;
    const { filter } = this;
    this.curves = responses(filter, range, dt, method);
    for (const pin of this.pins) pin.curves = responses(pin.filter, range, pin.design.sampling.dt, pin.design.sampling.method);
    this.settling = settlingTime(filter);
    const slow = Math.min(...filter.sections.map(({ re }) => -re));
    const wanted = 1.5 * (this.settling || 4 / slow);
    // The axis follows in steps, and during a drag only where it must: a curve on a moving axis cannot be read.
    const kept = this.dragging && this.duration && wanted < 1.3 * this.duration && wanted > 0.25 * this.duration;
    if (!kept) this.duration = nice(wanted * 0.999);
    this.stepCurves = stepCurve(filter, this.duration);
    for (const pin of this.pins) pin.step = stepCurve(pin.filter, this.duration);
    this.preview = new Map(
      Object.entries({
        bandwidth: bandwidth(filter),
        settling: this.settling,
        noise_gain: noiseGain(filter, dt, method),
        euler_dt: eulerLimit(filter),
      }),
    );
    const gain = this.preview.get("noise_gain");
    this.preview.set("noise", gain === null ? null : gain * this.state.assume.noise);
  }

  /** Whole decades around poles, limits and Nyquist; during a drag the axis only grows. */
  frequencyRange() {
    const sizes = [...this.poles, ...this.zeros].map(({ re, im }) => Math.hypot(re, im)).filter((size) => size > 0);
    const nyquist = Math.PI / this.state.sampling.dt;
    const drawn = Object.values(this.state.limits ?? {}).map(({ omega }) => omega).filter((omega) => omega > 0);
    let low = 10 ** Math.floor(Math.log10(Math.min(...sizes, ...drawn) / 8));
    let high = 10 ** Math.ceil(Math.log10(Math.max(8 * Math.max(...sizes), 2 * Math.max(...drawn, 0), Math.min(1.2 * nyquist, 100 * Math.max(...sizes)))));
    if (this.dragging && this.range) [low, high] = [Math.min(low, this.range[0]), Math.max(high, this.range[1])];
    this.range = [low, high];
    return this.range;
  }

  showTable() {
    const seen = new Set();
    const entries = [...this.poles.map((root, i) => ["pole", root, i]), ...this.zeros.map((root, i) => ["zero", root, i])];
    entries.forEach(([kind, root, index], place) => {
      const key = `${kind} ${root.id}`;
      seen.add(key);
      let row = this.tableRows.get(key);
      if (!row) this.tableRows.set(key, (row = this.tableRow(kind, root.id)));
      if (this.parts.rows.children[place] !== row.element) this.parts.rows.insertBefore(row.element, this.parts.rows.children[place] ?? null);
      const size = Math.hypot(root.re, root.im);
      const values = { re: root.re, im: root.im, wn: size, zeta: size ? -root.re / size : null };
      for (const [name, input] of Object.entries(row.inputs)) {
        if (input !== document.activeElement || this.dragging) {
          input.value = values[name] === null ? "" : field(values[name], 5);
          input.removeAttribute("aria-invalid");
        }
        if (row.index !== index) input.setAttribute("data-test", `${kind}-${index}-${name}`);
      }
      row.inputs.zeta.disabled = !root.im;
      if (row.index !== index) row.remove.setAttribute("data-test", `${kind}-${index}-delete`);
      row.index = index;
      row.element.classList.toggle("pf-selected", this.chosen?.kind === kind && this.chosen.id === root.id);
    });
    for (const [key, row] of this.tableRows) {
      if (seen.has(key)) continue;
      row.element.remove();
      this.tableRows.delete(key);
    }
    this.parts.delete.disabled = !this.chosen;
  }

  tableRow(kind, id) {
    const names = { re: "real part", im: "imaginary part", wn: "natural frequency", zeta: "damping ratio" };
    const inputs = {};
    for (const [name, words] of Object.entries(names)) {
      const input = h("input", { type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false", "aria-label": `${kind}, ${words}` });
      input.addEventListener("focus", () => this.select(kind, id));
      input.addEventListener("change", () => {
        const wrong = this.typeRoot(kind, id, name, typed(input.value));
        input.setAttribute("aria-invalid", String(Boolean(wrong)));
        if (wrong) this.say(`The ${words} of a ${kind}: ${wrong}.`, "warn");
        else input.blur();
      });
      inputs[name] = input;
    }
    const remove = h("button", { type: "button", class: "pf-icon pf-quiet", "aria-label": `Delete this ${kind}`, onclick: () => this.remove({ kind, id }) }, "✕");
    const cells = Object.values(inputs).map((input) => h("td", {}, input));
    const sign = h("span", { class: `pf-sign pf-${kind}`, role: "img", "aria-label": kind }, kind === "pole" ? "×" : "○");
    return { element: h("tr", {}, h("th", { scope: "row" }, sign), ...cells, h("td", {}, remove)), inputs, remove, index: -1 };
  }

  /** Write a value where nobody types. @param {HTMLInputElement} input @param {string} text */
  put(input, text) {
    if (input === document.activeElement && !this.dragging) return;
    if (input.value !== text) input.value = text;
    input.removeAttribute("aria-invalid");
  }

  showKnobs() {
    const { parts, state, filter } = this;
    const order = filter.order;
    const cutoff = this.cutoff();
    parts.family.value = this.family;
    parts.order.textContent = String(order);
    this.put(parts.cutoff, field(Number(cutoff.toPrecision(4))));
    if (parts.cutoffSlider !== document.activeElement || !this.dragging) parts.cutoffSlider.show(cutoff);
    parts.dampingRow.hidden = this.family !== "damped";
    this.put(parts.damping, field(this.damping ?? 0.7));
    parts.edgeRows.forEach((row) => (row.hidden = this.family !== "bandpass"));
    if (this.band) parts.edges.forEach((input, i) => this.put(input, field(this.band[i])));
    const kind = state.numerator.kind === "b" ? "zeros" : state.numerator.kind;
    parts.kinds.forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.test === `numerator-${kind}`)));
    parts.typeRow.hidden = kind !== "type";
    if (parts.type.length !== order) parts.type.replaceChildren(...Array.from({ length: order }, (_, i) => h("option", { value: i + 1 }, String(i + 1))));
    if (kind === "type") parts.type.value = String(state.numerator.type);
    parts.gainRow.hidden = kind !== "zeros";
    parts.gainRow.firstChild.textContent = filter.dcGain !== 0 ? "F(0)" : "|F| mid-band";
    this.put(parts.gain, field(heldGain(filter)));
    const follows = filter.type === 0 ? "a share of a constant residual stays" : `${TYPE_MEANINGS.slice(0, filter.type).join(", ")}${filter.type > 4 ? ", …" : ""} followed with no steady error`;
    parts.numeratorNote.textContent = `Type ${filter.type}: ${follows}.`;
    this.showSampling();
    for (const { key, factor, unit, input, unitText } of this.assumed) {
      this.put(input, field(state.assume[key] * factor));
      unitText.textContent = unit();
    }
    this.put(parts.unit, state.assume.unit);
    parts.undo.disabled = !this.undoStack.length;
    parts.redo.disabled = !this.redoStack.length;
    const size = filter.dcGain !== 0 ? "" : "band-pass, ";
    parts.summary.textContent = `${size}order ${order}, type ${filter.type}, ${short(cutoff, 3)} rad/s, h = ${inUnit(state.sampling.dt, "s").join(" ")}`;
  }

  showSampling() {
    const { parts } = this;
    const { dt, method } = this.state.sampling;
    const limit = eulerLimit(this.filter);
    this.put(parts.dt, field(dt * 1e3));
    if (parts.dtSlider !== document.activeElement || !this.dragging) parts.dtSlider.show(dt);
    parts.methods.forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.test === `method-${method}`)));
    const share = Math.log(limit / LIMITS.dtMin) / Math.log(LIMITS.dtMax / LIMITS.dtMin);
    parts.eulerMark.hidden = !(share >= 0 && share <= 1);
    // The thumb's middle travels from half a thumb inside to half a thumb inside.
    parts.eulerMark.style.left = `calc(8px + ${(100 * share).toFixed(2)}% - ${(16 * share).toFixed(2)}px)`;
    const unstable = method === "euler" && !(dt < limit);
    parts.samplingNote.classList.toggle("pf-violated", unstable);
    const reach = `Euler is stable below ${inUnit(limit, "s").join(" ")}`;
    parts.samplingNote.textContent = unstable ? `⚠ Unstable: ${reach}; choose Exact, or sample faster.` : `${short(1 / dt, 4)} Hz, Nyquist ${short(Math.PI / dt, 4)} rad/s. ${reach}.`;
  }

  showNumbers() {
    const stale = this.root.classList.contains("pf-stale");
    const keys = this.numbers.size ? [...this.numbers.keys()] : Object.keys(SHORT_NAMES);
    keys.forEach((key, place) => {
      let card = this.cards.get(key);
      if (!card) this.cards.set(key, (card = this.numberCard(key)));
      if (this.parts.numbers.children[place] !== card.element) this.parts.numbers.insertBefore(card.element, this.parts.numbers.children[place] ?? null);
      const number = this.numbers.get(key);
      const own = this.preview?.has(key) ?? false;
      const live = stale && own;
      const value = live || !number ? (this.preview?.get(key) ?? null) : number.value;
      const note = number?.note ?? "";
      const unit = this.unitOf(key, number);
      const [full, shownUnit] = value === null && /^no (upper |lower )?limit/.test(note) ? ["∞", ""] : inUnit(value, unit);
      const text = full.length > 6 ? inUnit(value, unit, 3)[0] : full; // what a card has room for
      write(card.value, text);
      write(card.unit, text === "∞" || text === "–" ? "" : shownUnit);
      card.element.setAttribute("data-value", value === null ? "" : String(value));
      card.element.classList.toggle("pf-waiting", stale && !own);
      card.element.classList.toggle("pf-bad", /^unstable|is unstable/.test(note) && !live);
      card.note = note;
      card.name = number?.label ?? SHORT_NAMES[key] ?? key;
    });
    for (const [key, card] of this.cards) {
      if (keys.includes(key)) continue;
      card.element.remove();
      this.cards.delete(key);
    }
    if (this.explained) this.explain(this.explained);
  }

  /** Unit of a figure; what is in the unit of f says so before one is named. @param {string} key @param {any} number */
  unitOf(key, number) {
    if (IN_UNIT_OF_F.includes(key)) return number?.unit || this.unit();
    return number?.unit ?? { bandwidth: "rad/s", settling: "s", euler_dt: "s", noise_gain: "1/s" }[key] ?? "";
  }

  numberCard(key) {
    const value = h("span", { class: "pf-value" });
    const unit = h("span", { class: "pf-unit" });
    const element = h("div", { class: "pf-number", tabindex: 0, role: "group", "aria-label": SHORT_NAMES[key] ?? key, "data-test": `number-${key}` }, h("span", { class: "pf-name" }, SHORT_NAMES[key] ?? key), h("span", { class: "pf-figure" }, value, unit));
    const card = { element, value, unit, note: "", name: key };
    for (const name of ["pointerenter", "focus"]) element.addEventListener(name, () => this.explain((this.explained = key)));
    for (const name of ["pointerleave", "blur"]) element.addEventListener(name, () => (this.explained = null));
    return card;
  }

  explain(key) {
    const card = this.cards.get(key);
    if (!card) return;
    const meaning = MEANINGS[key] ?? "";
    const note = card.note ? ` (${card.note})` : "";
    this.parts.explain.replaceChildren(h("b", {}, `${card.name}. `), `${meaning}${note}`);
  }

  showMessages(messages) {
    this.parts.messages.replaceChildren(...messages.map((text) => h("li", {}, `⚠ ${text}`)));
  }

  // -- charts -----------------------------------------------------------------------------------------------------

  drawBode() {
    const { curves, palette } = this;
    const lines = [];
    const angles = [];
    this.pins.forEach((pin, i) => {
      const style = { colour: palette.pin, width: 1.5, dash: PIN_DASHES[i] };
      for (const key of ["F", "E"]) if (this.shown[key]) lines.push({ x: pin.curves.omega, y: pin.curves[key].db, ...style });
      if (this.shown.F) angles.push({ x: pin.curves.omega, y: pin.curves.F.phase, ...style });
    });
    // The sampled F first: where the two agree F is seen, where they part both are.
    for (const key of ["S", "E", "F"]) {
      const { colour, dash } = CURVES[key];
      if (!this.shown[key] || !curves[key]) continue;
      const x = key === "S" ? curves.below : curves.omega;
      const style = { x, colour: palette[colour], dash, width: 2.25 };
      lines.push({ ...style, y: curves[key].db });
      if (key !== "E") angles.push({ ...style, y: curves[key].phase });
    }
    const most = Math.max(3, ...lines.flatMap(({ y }) => (y.length ? [largest(y)] : [])));
    const nyquist = Math.PI / this.state.sampling.dt;
    const marks = [{ x: nyquist, text: "Nyquist" }];
    Object.assign(this.magnitude, { x: this.range, y: this.held("db", -70, 10 * Math.ceil((most + 3) / 10)), series: lines, marks });
    const [low, high] = [Math.min(-90, ...angles.map(({ y }) => smallest(y))), Math.max(0, ...angles.map(({ y }) => largest(y)))];
    Object.assign(this.phase, { x: this.range, y: this.held("phase", 45 * Math.floor(low / 45 - 0.1), 45 * Math.ceil(high / 45 + 0.1)), series: angles, marks: [{ x: nyquist, text: "" }] });
    this.magnitude.draw(palette);
    this.phase.draw(palette);
    for (const kind of /** @type {("error" | "estimate")[]} */ (Object.keys(LIMIT_KINDS))) this.drawLimit(kind);
    for (const chart of [this.magnitude, this.phase]) chart.cursor(this.cursorAt);
    this.readFrequency();
  }

  /** Ranges of a vertical axis; during a drag they only grow. @param {string} name @param {number} low @param {number} high */
  held(name, low, high) {
    this.ranges ??= {};
    const before = this.ranges[name];
    if (this.dragging && before) [low, high] = [Math.min(low, before[0]), Math.max(high, before[1])];
    return (this.ranges[name] = [low, high]);
  }

  readFrequency() {
    const { readout } = this.parts;
    const w = this.cursorAt;
    if (w === null) {
      write(readout, "Point at a curve to read it.");
      return;
    }
    const value = (curve) => {
      const gain = Math.hypot(curve.re[0], curve.im[0]);
      return `${short(20 * Math.log10(gain), 3)} dB (${short(gain, 3)})`;
    };
    const k = this.curves.omega.findIndex((omega) => omega >= w);
    const parts = [
      `ω ${short(w, 3)} rad/s, ${short(w / (2 * Math.PI), 3)} Hz`,
      `F ${value(response(this.filter, [w]))} ∠ ${short(this.curves.F.phase[Math.max(k, 0)], 3)}°`,
      `1−F ${value(errorResponse(this.filter, [w]))}`,
    ];
    const { dt, method } = this.state.sampling;
    if (this.curves.S && w <= Math.PI / dt) parts.push(`sampled ${value(sampledResponse(this.filter, dt, method, [w]).F)}`);
    readout.replaceChildren(...parts.map((text) => h("span", {}, text)));
  }

  /** @param {"error" | "estimate"} kind */
  drawLimit(kind) {
    const limit = this.state.limits?.[kind];
    const button = this.parts[`limit-${kind}`];
    button.setAttribute("aria-pressed", String(Boolean(limit)));
    let handle = this.limitHandles.get(kind);
    if (!limit) {
      handle?.element.remove();
      this.limitHandles.delete(kind);
      button.classList.remove("pf-violated");
      return;
    }
    if (!handle) this.limitHandles.set(kind, (handle = this.limitHandle(kind)));
    const { below, text } = LIMIT_KINDS[kind];
    const chart = this.magnitude;
    const left = MARGIN.left;
    const right = chart.width - MARGIN.right;
    const x = Math.min(Math.max(chart.px(limit.omega), left), right);
    const y = Math.min(Math.max(chart.py(20 * Math.log10(limit.level)), chart.top), chart.height - chart.bottom);
    const [from, to] = below ? [left, x] : [x, right];
    const top = Math.max(y - 15, chart.top);
    handle.band.setAttribute("d", `M${from} ${top}H${to}V${y}H${from}z`);
    handle.edge.setAttribute("d", `M${from} ${y}H${to}`);
    handle.knob.setAttribute("transform", `translate(${x} ${y})`);
    const excess = this.excess(kind);
    const violated = excess > 1e-9;
    handle.element.classList.toggle("pf-violated", violated);
    button.classList.toggle("pf-violated", violated);
    const words = `${short(Math.abs(excess), 2)} dB ${violated ? "over" : "to spare"}`;
    handle.label.textContent = violated ? `⚠ ${words}` : words;
    const room = 7 * words.length + 26;
    const leftwards = below ? x - room > left : x + room > right;
    handle.label.setAttribute("x", String(leftwards ? x - 12 : x + 12));
    // One above its band, one below: where the corners are close the words still do not meet.
    const above = below && y - 20 > chart.top + 8;
    handle.label.setAttribute("y", String(above ? y - 20 : Math.min(y + 17, chart.height - chart.bottom - 6)));
    handle.label.setAttribute("text-anchor", leftwards ? "end" : "start");
    handle.knob.setAttribute("aria-valuetext", `${text} ${below ? "up to" : "from"} ${short(limit.omega, 3)} rad/s below ${short(20 * Math.log10(limit.level), 3)} dB: ${words}`);
    handle.knob.setAttribute("aria-valuenow", String(limit.omega));
  }

  limitHandle(kind) {
    const band = g("path", { class: "pf-limit-band" });
    const edge = g("path", { class: "pf-limit-edge" });
    const label = g("text", { class: "pf-limit-label" });
    const knob = g("g", { class: "pf-limit-knob", tabindex: 0, role: "slider", "aria-label": `Limit of ${LIMIT_KINDS[kind].text}; arrow keys move its corner, Delete removes it`, "aria-valuemin": 0, "aria-valuemax": 1e6, "data-test": `limit-${kind}-handle` }, g("circle", { r: 15, class: "pf-hit" }), g("circle", { r: 6 }));
    const element = g("g", { class: "pf-limit" }, band, edge, label, knob);
    const set = (omega, db) => {
      this.state.limits = { ...this.state.limits, [kind]: { omega: Math.min(Math.max(omega, 1e-4), 1e6), level: 10 ** (Math.min(Math.max(db, -120), 40) / 20) } };
      this.rebuilt();
    };
    knob.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      event.stopPropagation();
      knob.focus({ preventScroll: true });
      knob.setPointerCapture(event.pointerId);
      this.begin();
      const move = (next) => {
        const box = this.magnitude.overlay.getBoundingClientRect();
        this.moveTime ??= performance.now();
        set(Number(this.magnitude.xAt(next.clientX - box.left).toPrecision(4)), this.magnitude.yAt(next.clientY - box.top));
      };
      const end = () => {
        knob.removeEventListener("pointermove", move);
        knob.removeEventListener("pointerup", end);
        knob.removeEventListener("pointercancel", end);
        this.commit("");
      };
      knob.addEventListener("pointermove", move);
      knob.addEventListener("pointerup", end);
      knob.addEventListener("pointercancel", end);
    });
    knob.addEventListener("keydown", (event) => {
      if (event.key === "Delete" || event.key === "Backspace") {
        event.preventDefault();
        this.toggleLimit(kind);
        return;
      }
      const ways = { ArrowLeft: [1 / 1.05, 0], ArrowRight: [1.05, 0], ArrowUp: [1, 0.5], ArrowDown: [1, -0.5] };
      const way = ways[event.key];
      if (!way) return;
      event.preventDefault();
      const limit = this.state.limits[kind];
      const times = event.shiftKey ? 5 : 1;
      this.begin();
      set(limit.omega * way[0] ** times, 20 * Math.log10(limit.level) + way[1] * times);
      this.commit("limit");
    });
    this.magnitude.overlay.append(element);
    return { element, band, edge, label, knob };
  }

  drawStep() {
    const { palette, stepCurves } = this;
    const lines = this.pins.flatMap((pin, i) => [{ x: pin.step.t, y: pin.step.F, colour: palette.pin, dash: PIN_DASHES[i], width: 1.5 }, { x: pin.step.t, y: pin.step.E, colour: palette.pin, dash: PIN_DASHES[i], width: 1 }]);
    lines.push({ x: stepCurves.t, y: stepCurves.F, colour: palette.F, width: 2.25 }, { x: stepCurves.t, y: stepCurves.E, colour: palette.E, dash: DASHES.dash, width: 2 });
    const [low, high] = [Math.min(0, ...lines.map(({ y }) => smallest(y))), Math.max(1, ...lines.map(({ y }) => largest(y)))];
    const room = 0.06 * (high - low);
    // Milliseconds where they read better.
    const scale = this.duration < 1 ? 1e3 : 1;
    this.stepChart.settings.xLabel = scale === 1 ? "t, s" : "t, ms";
    Object.assign(this.stepChart, { x: [0, this.duration * scale], y: this.held("step", low - room, high + room), series: lines.map((line) => ({ ...line, x: line.x.map((t) => t * scale) })) });
    this.stepChart.draw(palette);
    this.stepChart.cursor(this.stepAt ?? null);
    const at = this.stepAt === null || this.stepAt === undefined ? null : Math.round((this.stepAt / scale / this.duration) * (stepCurves.t.length - 1));
    this.parts.stepReadout.textContent = at === null || !(at >= 0 && at < stepCurves.t.length) ? "" : `t ${inUnit(stepCurves.t[at], "s").join(" ")}   estimate ${short(stepCurves.F[at], 3)}   error ${short(stepCurves.E[at], 3)}`;
  }

  showLog() {
    const { parts, log } = this;
    parts.drop.hidden = Boolean(log);
    parts.logBody.hidden = !log;
    parts.forget.hidden = !log;
    parts.channel.hidden = !log || log.channels.length < 2;
    parts.logSummary.textContent = log ? `${log.name}: ${log.samples} samples, ${inUnit(log.dt, "s").join(" ")}${log.has_label ? "" : ", no label"}` : "";
    if (log) parts.channel.replaceChildren(...log.channels.map((name, i) => h("option", { value: i }, name)));
    parts.rmse.replaceChildren();
    this.showLearning();
  }

  showLearning() {
    const { parts, log } = this;
    const running = this.job !== null;
    parts.learn.disabled = running || !log?.has_label;
    parts.learn.title = log && !log.has_label ? "Learning needs a label: the true f, in a column label_x" : "";
    parts.cancel.disabled = !running;
    parts.learning.classList.toggle("pf-running", running);
    if (log && !log.has_label && !running) this.learnMessage("This log has no label to learn from: add columns label_x.");
    this.costChart.element.hidden = this.curve.length < 1;
  }

  learnMessage(text) {
    this.parts.learnMessage.textContent = text;
  }

  showEstimate() {
    const found = this.estimate;
    const entries = [
      ["RMSE of f̂", found?.rmse, "Root mean square of label − f̂ over the log"],
      ["of the model alone", found?.rmse_model, "Root mean square of label − f_θ over the log"],
      ["Wiener filter, held out", found?.wiener, WIENER],
    ].filter(([, value]) => typeof value === "number");
    this.parts.logAll.disabled = !this.logWindow;
    this.parts.rmse.replaceChildren(...entries.map(([text, value, title]) => h("div", { title }, h("dt", {}, text), h("dd", {}, `${short(value)} ${this.unit()}`))));
    const messages = [...(found?.messages ?? [])];
    if (typeof found?.wiener === "number") messages.push(WIENER);
    if (messages.length) this.parts.rmse.append(h("p", { class: "pf-note" }, messages.join(" ")));
    const lines = [["label", "label, the truth", "L", DASHES.solid], ["f_theta", "f_θ, the model", "M", DASHES.dot], ["f_hat", "f̂, the estimate", "F", DASHES.solid]].filter(([key]) => found?.[key]);
    this.parts.logLegend.replaceChildren(...lines.map(([, text, colour, dash]) => h("span", { class: "pf-legend" }, swatch(`pf-stroke-${colour}`, dash), text)));
  }

  drawLog() {
    const { palette, estimate } = this;
    const lines = [];
    if (estimate) {
      const [start, end] = this.logWhole;
      // Times since 1970, say, are shown from the first one on.
      this.logOrigin = Math.abs(start) > 100 * (end - start) ? start : 0;
      const x = this.logOrigin ? estimate.t.map((t) => t - this.logOrigin) : estimate.t;
      const wanted = this.logWindow?.map((t) => t - this.logOrigin);
      if (estimate.label) lines.push({ x, y: estimate.label, colour: palette.L, width: 3 });
      if (estimate.f_theta) lines.push({ x, y: estimate.f_theta, colour: palette.M, dash: DASHES.dot, width: 1.5 });
      lines.push({ x, y: estimate.f_hat, colour: palette.F, width: 1.5 });
      const [low, high] = [Math.min(...lines.map(({ y }) => smallest(y))), Math.max(...lines.map(({ y }) => largest(y)))];
      const room = 0.06 * (high - low || 1);
      Object.assign(this.logChart, { x: wanted && x[x.length - 1] > wanted[0] && x[0] < wanted[1] ? wanted : [x[0], x[x.length - 1]], y: [low - room, high + room] });
    }
    this.logChart.settings.xLabel = this.logOrigin ? `t − ${this.logOrigin}, s` : "t, s";
    this.logChart.settings.yLabel = this.state.assume.unit ? `f, ${this.state.assume.unit}` : "f";
    this.logChart.series = lines;
    this.logChart.draw(palette);
    this.logChart.cursor(this.logAt ?? null);
    const at = estimate && typeof this.logAt === "number" ? estimate.t.findIndex((t) => t >= this.logAt + this.logOrigin) : -1;
    const read = (key, name) => (estimate?.[key] ? `   ${name} ${short(estimate[key][at], 3)}` : "");
    this.parts.logReadout.textContent = at < 0 ? "" : `t ${short(estimate.t[at] - this.logOrigin, 4)} s${read("f_hat", "f̂")}${read("label", "label")}${read("f_theta", "f_θ")}`;
    if (!this.curve.length) return;
    const costs = this.curve.map(([, cost]) => cost).filter((cost) => cost > 0);
    const [low, high] = [Math.min(...costs), Math.max(...costs)];
    const last = this.curve[this.curve.length - 1][0];
    Object.assign(this.costChart, {
      x: [0, Math.max(last, 1)],
      y: [low / 1.15, Math.max(high * 1.15, low * 1.5)],
      series: [{ x: this.curve.map(([at]) => at), y: this.curve.map(([, cost]) => cost), colour: palette.E, width: 2.25 }],
    });
    this.costChart.draw(palette);
  }

  showPins() {
    const { pins } = this;
    this.parts.pinCard.hidden = !pins.length;
    this.plane.pinned = pins.flatMap((pin) => rootsOf(pin.design.poles));
    const row = (pin, i) => {
      const name = h("input", { type: "text", value: pin.name, maxlength: 40, "aria-label": "Name of the pinned design", "data-test": `pin-${i}-name` });
      name.addEventListener("change", () => (pin.name = name.value.trim() || pin.name));
      const use = this.button(`pin-${i}-use`, "Use", () => {
        this.begin();
        this.load(pin.design, { fit: true });
        this.commit("");
      }, { title: "Make it the current design" });
      const drop = this.button(`pin-${i}-unpin`, "✕", () => this.unpin(pin), { class: "pf-icon pf-quiet", "aria-label": "Unpin" });
      return h("div", { class: "pf-pin", "data-test": `pin-${i}` }, swatch("pf-stroke-pin", PIN_DASHES[i]), name, use, drop);
    };
    this.parts.pinTable = h("table", { class: "pf-table pf-compare", "data-test": "compare" });
    this.parts.pins.replaceChildren(...pins.map(row), this.parts.pinTable);
    this.showComparison();
  }

  showComparison() {
    if (!this.pins.length) return;
    const wanted = ["bandwidth", "settling", "noise_gain", "bound", "ratio_high", "delay_margin"];
    const cell = (numbers, key) => {
      const number = numbers?.find((each) => each.key === key);
      return h("td", {}, number ? inUnit(number.value, this.unitOf(key, number)).join(" ") : "…");
    };
    const now = this.answer?.numbers;
    const head = h("tr", {}, h("td"), h("th", { scope: "col" }, "now"), ...this.pins.map((pin, i) => h("th", { scope: "col" }, pin.name || String(i + 1))));
    const body = wanted.map((key) => h("tr", {}, h("th", { scope: "row" }, SHORT_NAMES[key]), cell(now, key), ...this.pins.map((pin) => cell(pin.numbers, key))));
    this.parts.pinTable.replaceChildren(h("thead", {}, head), h("tbody", {}, ...body));
  }

  // -- look, size, keys -------------------------------------------------------------------------------------------

  theme() {
    const asked = this.themeChoice ?? this.model.get?.("theme");
    const jupyter = document.body?.dataset?.jpThemeLight;
    const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    const theme = asked === "dark" || asked === "light" ? asked : jupyter ? (jupyter === "false" ? "dark" : "light") : system;
    this.root.setAttribute("data-theme", theme);
    const style = getComputedStyle(this.root);
    const read = (name) => style.getPropertyValue(`--pf-${name}`).trim();
    this.palette = { font: style.fontFamily, known: read("F") !== "" };
    for (const name of ["F", "E", "S", "L", "M", "pin", "grid", "faint", "muted", "card", "text"]) this.palette[name] = read(name) || "gray";
    this.paint();
  }

  nextTheme() {
    const order = [undefined, "light", "dark"];
    this.themeChoice = order[(order.indexOf(this.themeChoice) + 1) % 3];
    this.theme();
    this.say(`Colours: ${this.themeChoice ?? "as the system"}.`);
  }

  watchSize() {
    // A notebook renders before it puts the element on the page: only there has it a style.
    const sizes = new ResizeObserver(() => (this.palette.known ? this.paint() : this.theme()));
    for (const element of [this.root, this.plane.element, this.magnitude.element]) sizes.observe(element);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const change = () => this.theme();
    dark.addEventListener("change", change);
    const body = new MutationObserver(change);
    body.observe(document.body, { attributes: true, attributeFilter: ["data-jp-theme-light"] });
    this.model.on("change:theme", change);
    this.cleanups.push(() => sizes.disconnect(), () => dark.removeEventListener("change", change), () => body.disconnect(), () => this.model.off?.("change:theme", change));
  }

  keyboard() {
    const press = (event) => {
      // In the notebook around it the keys are the notebook's.
      if (!this.root.contains(event.target) && event.target !== document.body) return;
      if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
      const editing = event.target.matches?.("input[type=text], input[type=number]") && event.target.value !== event.target.defaultValue && this.typing === event.target;
      if (editing) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      event.stopPropagation();
      if (key === "y" || event.shiftKey) this.redo();
      else this.undo();
    };
    document.addEventListener("keydown", press, true);
    this.root.addEventListener("keydown", (event) => event.stopPropagation());
    this.root.addEventListener("input", (event) => (this.typing = event.target));
    this.root.addEventListener("change", () => (this.typing = null));
    this.cleanups.push(() => document.removeEventListener("keydown", press, true));
  }
}

/** The limits that are drawn here; others may have come with a file. @param {any} limits */
function knownLimits(limits) {
  const found = Object.keys(LIMIT_KINDS).filter((kind) => limits?.[kind]?.omega > 0 && limits[kind].level > 0);
  return found.length ? Object.fromEntries(found.map((kind) => [kind, { omega: limits[kind].omega, level: limits[kind].level }])) : null;
}

/** F, 1 - F and the sampled F over a range, in dB and degrees. @param {Filter} filter @param {number[]} range @param {number} dt @param {Method} method */
function responses(filter, [low, high], dt, method) {
  const nyquist = Math.PI / dt;
  const omega = frequencyGrid(filter, { low, high, points: CURVE_POINTS, extra: [nyquist] });
  const below = omega.filter((w) => w <= nyquist);
  const stable = method !== "euler" || dt < eulerLimit(filter);
  const S = stable && below.length > 1 ? polar(sampledResponse(filter, dt, method, below).F) : null;
  return { omega, below, F: polar(response(filter, omega)), E: polar(errorResponse(filter, omega)), S };
}

/** Step response with enough points for every swing. @param {Filter} filter @param {number} duration */
function stepCurve(filter, duration) {
  const swing = Math.max(...filter.sections.map(({ im }) => im));
  return stepResponse(filter, duration, Math.min(Math.max(STEP_POINTS, Math.ceil((20 * duration * swing) / (2 * Math.PI))), 3000));
}

/** @param {ArrayLike<number | null>} values */
function largest(values) {
  let most = -Infinity;
  for (let k = 0; k < values.length; k++) if (values[k] !== null && values[k] > most) most = values[k];
  return most;
}

/** @param {ArrayLike<number | null>} values */
function smallest(values) {
  let least = Infinity;
  for (let k = 0; k < values.length; k++) if (values[k] !== null && values[k] < least) least = values[k];
  return least;
}

/** A piece of a line for a legend. @param {string} className @param {number[]} dash */
function swatch(className, dash) {
  return g("svg", { class: "pf-swatch", viewBox: "0 0 30 8", "aria-hidden": "true" }, g("line", { x1: 1, y1: 4, x2: 29, y2: 4, class: className, "stroke-dasharray": dash.join(" ") || null }));
}

/** @param {{model: any, el: HTMLElement}} host @returns {() => void} */
function render({ model, el }) {
  const designer = new Designer(model, el);
  return () => designer.destroy();
}

export default { render };
