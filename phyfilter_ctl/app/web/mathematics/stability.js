/** Whether the loop with f̂ fed back is stable: as much as a drag needs before Python has answered. */

import { fastest, slowest } from "./filter.js";

/** @import { Filter } from "./filter.js" */

const POINTS = 300;
const TURN = Math.PI / 6; // between two points
const MOST_POINTS = 6000;

/**
 * Whether c(s) (1 + lag s) + mu N(s) e^(-s delay) has no zero in the right half-plane, c = D - N: the phase along the
 * imaginary axis grows by a right angle for each of its degree, if and only if. The filter counts as continuous, its
 * sampling as one step more of delay. Null where the loop turns too often to count.
 * @param {Filter} filter @param {{ratio: number, lag: number, delay: number}} assume @param {number} dt
 * @returns {boolean | null}
 */
export function loopIsStable(filter, { ratio, lag, delay }, dt) {
  const { b, c, order } = filter;
  const late = delay + dt;
  const degree = order + (lag > 0 ? 1 : 0);
  /** @param {number} w @returns {[number, number]} */
  const value = (w) => {
    const [cr, ci] = along(c, w);
    const [br, bi] = along(b, w);
    const [turn, lean] = [Math.cos(w * late), Math.sin(w * late)];
    return [cr - lag * w * ci + ratio * (br * turn + bi * lean), ci + lag * w * cr + ratio * (bi * turn - br * lean)];
  };
  const coefficients = Math.max(...b.map((each, i) => Math.abs(ratio * each) ** (1 / (order - i))), 0);
  const low = 1e-3 * slowest(filter);
  // From here on the leading term outweighs all others.
  const high = 1e3 * Math.max(fastest(filter), coefficients, lag > 0 ? 1 / lag : 0);
  const factor = (high / low) ** (1 / POINTS);
  let [re, im] = value(0);
  let w = low;
  let phase = 0;
  let step = factor;
  for (let k = 0; w < high * factor; k++) {
    if (k > MOST_POINTS) return null;
    const [x, y] = value(w);
    const turned = Math.atan2(re * y - im * x, re * x + im * y);
    // A turn too far between two points could be one too many: go back half a step.
    if (Math.abs(turned) > TURN && step > 1 + 1e-9) {
      w /= step;
      step = Math.sqrt(step);
      w *= step;
      continue;
    }
    phase += turned;
    [re, im] = [x, y];
    step = Math.min(factor, step * step);
    w *= step;
  }
  return Math.abs(phase - (degree * Math.PI) / 2) < Math.PI / 2;
}

/** A polynomial at j w. @param {number[]} coefficients ascending @param {number} w @returns {[number, number]} */
function along(coefficients, w) {
  let x = 0;
  let y = 0;
  for (let i = coefficients.length - 1; i >= 0; i--) [x, y] = [coefficients[i] - w * y, w * x];
  return [x, y];
}
