/** Complex numbers and real polynomials. Complex numbers are [re, im]; polynomials ascend: a[0] is a_0. */

/** @typedef {[number, number]} Complex */

export const EPSILON = 2 ** -52;

/** @param {Complex} p @param {Complex} q @returns {Complex} */
export const add = (p, q) => [p[0] + q[0], p[1] + q[1]];
/** @param {Complex} p @param {Complex} q @returns {Complex} */
export const mul = (p, q) => [p[0] * q[0] - p[1] * q[1], p[0] * q[1] + p[1] * q[0]];
/** @param {Complex} p @param {Complex} q @returns {Complex} */
export const div = (p, q) => {
  const size = q[0] * q[0] + q[1] * q[1];
  return [(p[0] * q[0] + p[1] * q[1]) / size, (p[1] * q[0] - p[0] * q[1]) / size];
};

/** Product of two ascending polynomials. @param {number[]} p @param {number[]} q */
export function multiply(p, q) {
  const product = new Array(p.length + q.length - 1).fill(0);
  p.forEach((u, i) => q.forEach((v, j) => (product[i + j] += u * v)));
  return product;
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
  let guess = Array.from(
    { length: m },
    (_, k) => /** @type {Complex} */ ([Math.cos((2 * Math.PI * k) / m + 0.4), Math.sin((2 * Math.PI * k) / m + 0.4)]),
  );
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
