/**
 * The loop that the margins speak of, opened between the command and the actuator:
 *
 *     L = mu Act e^(-s delay) F/(1 - F),    mu = M_hat/M,    Act = 1/(lag s + 1)
 *
 * sampled with the command held over the step where the filter runs so; else continuous, with one step more of delay
 * for hold and average.
 */

import { errorResponse, response } from "./filter.js";
import { div, mul } from "./polynomials.js";
import { eulerLimit, recursionResponse, turnedLess } from "./sampled.js";

/** @import { Complex } from "./polynomials.js" */
/** @import { Curve, Filter } from "./filter.js" */
/** @import { Method } from "./sampled.js" */
/** @typedef {{dt: number, method: Method}} Sampling */
/** @typedef {{ratio: number, lag: number, delay: number}} Around  what is around the filter; s */
/** @typedef {{L: Curve, S: Curve, T: Curve}} LoopCurves */

const FEW_STEPS = 50; // of delay; as in Python
const SHORT = 0.05; // h/lag below which 1 - e^(-h/lag) - ... is summed

/**
 * Whether the loop is taken as it runs, sampled.
 * @param {Filter} filter @param {Sampling} sampling @param {Around} around
 */
export function runsSampled(filter, { dt, method }, { delay }) {
  return (method !== "euler" || dt < eulerLimit(filter)) && delay <= FEW_STEPS * dt;
}

/**
 * L, S = 1/(1 + L) and T = L/(1 + L), sampled up to the Nyquist frequency.
 * @param {Filter} filter @param {Sampling} sampling @param {Around} around @param {ArrayLike<number>} omega
 * @returns {LoopCurves}
 */
export function loopCurves(filter, sampling, around, omega) {
  const parts = runsSampled(filter, sampling, around)
    ? sampledParts(filter, sampling, around, omega)
    : continuousParts(filter, sampling, around, omega);
  const size = omega.length;
  const curve = () => ({ re: new Float64Array(size), im: new Float64Array(size) });
  const curves = { L: curve(), S: curve(), T: curve() };
  for (let k = 0; k < size; k++) {
    const { Q, P } = parts(k);
    /** @type {Complex} */
    const closed = [Q[0] + P[0], Q[1] + P[1]];
    put(curves.L, k, div(P, Q));
    put(curves.S, k, div(Q, closed));
    put(curves.T, k, div(P, closed));
  }
  return curves;
}

/** @param {Curve} curve @param {number} k @param {Complex} value */
function put(curve, k, [re, im]) {
  curve.re[k] = re;
  curve.im[k] = im;
}

/**
 * Q = 1 - F and P = mu Act e^(-s delay) F.
 * @param {Filter} filter @param {Sampling} sampling @param {Around} around @param {ArrayLike<number>} omega
 */
function continuousParts(filter, { dt }, { ratio, lag, delay }, omega) {
  const F = response(filter, omega);
  const E = errorResponse(filter, omega);
  return (/** @type {number} */ k) => {
    const turn = -omega[k] * (delay + dt);
    const act = div([ratio * Math.cos(turn), ratio * Math.sin(turn)], [1, omega[k] * lag]);
    return { Q: /** @type {Complex} */ ([E.re[k], E.im[k]]), P: mul(act, [F.re[k], F.im[k]]) };
  };
}

/**
 * Q = 1 - F_d/z and P = mu F_d H, H from the held command to what it does over the step that ends, per step.
 * @param {Filter} filter @param {Sampling} sampling @param {Around} around @param {ArrayLike<number>} omega
 */
function sampledParts(filter, { dt, method }, { ratio, lag, delay }, omega) {
  const { F, E } = recursionResponse(filter, dt, method, omega);
  const whole = Math.floor(delay / dt);
  const plant = held(lag, dt, (delay / dt - whole) * dt);
  return (/** @type {number} */ k) => {
    const theta = omega[k] * dt;
    const delta = turnedLess(theta);
    const back = /** @type {Complex} */ ([Math.cos(theta), -Math.sin(theta)]); // 1/z
    const f = /** @type {Complex} */ ([F.re[k], F.im[k]]);
    const less = mul(delta, back); // 1 - 1/z
    const missing = mul(f, less);
    const Q = /** @type {Complex} */ ([E.re[k] + missing[0], E.im[k] + missing[1]]);
    // The newer command acts on the last part of the step, the older one before.
    /** @type {(newer: number, older: number) => Complex} */
    const driven = (newer, older) => [newer + older * back[0], older * back[1]];
    const own = driven(plant.newer, plant.older);
    let change = own;
    if (lag) {
      const state = div(driven(plant.stateNewer, plant.stateOlder), [delta[0] - plant.kept, delta[1]]);
      change = [own[0] + plant.moved * state[0], own[1] + plant.moved * state[1]];
    }
    const late = -theta * (whole + 1);
    const H = mul(change, [(ratio / dt) * Math.cos(late), (ratio / dt) * Math.sin(late)]);
    return { Q, P: mul(f, H) };
  };
}

/**
 * A lag behind the hold, exact: over a step its state a is kept but for `kept` a, and moves the velocity of a unit mass
 * by `moved` a; the newer command, which acts over the last h - part of the step, and the older one add the rest.
 * @param {number} lag s @param {number} h s @param {number} part s
 */
function held(lag, h, part) {
  const rest = h - part;
  if (!lag) return { kept: 0, moved: 0, stateNewer: 0, stateOlder: 0, newer: rest, older: part };
  const gone = (/** @type {number} */ t) => -Math.expm1(-t / lag); // of a state after t
  const newer = slow(rest, lag);
  const older = slow(part, lag) + gone(part) * lag * gone(rest);
  return {
    kept: -gone(h),
    moved: lag * gone(h),
    stateNewer: gone(rest),
    stateOlder: gone(part) * Math.exp(-rest / lag),
    newer,
    older,
  };
}

/** t - lag (1 - e^(-t/lag)): what a unit command moves the velocity in t, from rest. @param {number} t @param {number} lag */
function slow(t, lag) {
  const x = t / lag;
  if (x > SHORT) return t + lag * Math.expm1(-x);
  let term = (x * x) / 2;
  let sum = term;
  for (let i = 3; i < 12; i++) {
    term *= -x / i;
    sum += term;
  }
  return lag * sum;
}
