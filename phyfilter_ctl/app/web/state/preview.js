/** What the designer draws before Python has answered: curves and figures of the design and of the kept ones. */

import { frequencyGrid, polar, settlingTime, stepResponse } from "../mathematics/figures.js";
import { errorResponse, response } from "../mathematics/filter.js";
import { eulerLimit, noiseGain, sampledResponse } from "../mathematics/sampled.js";
import { loopIsStable } from "../mathematics/stability.js";
import { nice } from "../numbers.js";
import { sizeOf } from "./roots.js";

/** @import { Filter } from "../mathematics/filter.js" */
/** @import { Method } from "../mathematics/sampled.js" */
/** @import { DesignData, Figure } from "../link.js" */
/** @import { Design } from "./design.js" */

/** @typedef {{db: Float64Array, phase: Float64Array}} Polar */
/**
 * @typedef {object} Curves
 * @property {Float64Array} omega
 * @property {Float64Array} below those below Nyquist's
 * @property {Polar} F
 * @property {Polar} E 1 - F
 * @property {Polar | null} S the sampled F, below Nyquist's; null where it is unstable
 */
/** @typedef {{t: Float64Array, F: Float64Array, E: Float64Array}} Step */
/**
 * @typedef {object} Pin
 * @property {number} style colour and dashes, see plots/styles.js
 * @property {string} name
 * @property {string} key the design as text
 * @property {DesignData} design
 * @property {Filter} filter
 * @property {Figure[] | null} numbers Python's, once it was asked
 * @property {Curves} [curves]
 * @property {Step} [step]
 * @property {string} [range] that the curves are for
 * @property {number} [duration] that the step response is for
 */

const CURVE_POINTS = 360;
const STEP_POINTS = 320;
const MOST_STEP_POINTS = 3000;
const NONE = new Float64Array(0); // before the first curve

export class Preview {
  /** @param {Design} design */
  constructor(design) {
    this.design = design;
    /** The design or the pins have changed since the curves were computed. */
    this.stale = true;
    /** Of the frequency axis. @type {[number, number] | null} */
    this.range = null;
    /** Of the time axis in s. */
    this.duration = 0;
    /** @type {Curves} */
    this.curves = { omega: NONE, below: NONE, F: { db: NONE, phase: NONE }, E: { db: NONE, phase: NONE }, S: null };
    /** @type {Step} */
    this.step = { t: NONE, F: NONE, E: NONE };
    /** @type {Map<string, number | null>} */
    this.figures = new Map();
    /** Whether the loop is stable with f̂ fed back. @type {boolean | null} */
    this.stable = null;
  }

  /** Curves anew, where the design or an axis has changed. @param {Pin[]} pins */
  update(pins) {
    const before = this.range?.join();
    const range = (this.range = this.wantedRange());
    if (!this.stale && range.join() === before) return;
    this.stale = false;
    const { filter, sampling, assume } = this.design;
    this.curves = responses(filter, range, sampling.dt, sampling.method);
    const settling = settlingTime(filter);
    this.duration = this.wantedDuration(settling);
    this.step = stepCurve(filter, this.duration);
    for (const pin of pins) follow(pin, range, this.duration);
    const gain = noiseGain(filter, sampling.dt, sampling.method);
    const figures = {
      bandwidth: this.design.bandwidth(),
      settling,
      noise_gain: gain,
      euler_dt: eulerLimit(filter),
      noise: gain === null ? null : gain * assume.noise,
    };
    this.figures = new Map(Object.entries(figures));
    this.stable = gain === null ? false : loopIsStable(filter, assume, sampling.dt);
  }

  /** Whole decades around poles, limits and Nyquist; during a drag the axis only grows. @returns {[number, number]} */
  wantedRange() {
    const { poles, zeros, sampling, limits, dragging } = this.design;
    const sizes = [...poles, ...zeros].map(sizeOf).filter((size) => size > 0);
    const drawn = Object.values(limits ?? {})
      .map(({ omega }) => omega)
      .filter((omega) => omega > 0);
    const fast = Math.max(...sizes);
    const low = 10 ** Math.floor(Math.log10(Math.min(...sizes, ...drawn) / 8));
    const high =
      10 **
      Math.ceil(
        Math.log10(Math.max(8 * fast, 2 * Math.max(...drawn, 0), Math.min((1.2 * Math.PI) / sampling.dt, 100 * fast))),
      );
    return dragging && this.range ? [Math.min(low, this.range[0]), Math.max(high, this.range[1])] : [low, high];
  }

  /**
   * The axis follows in steps, and during a drag only where it must: a curve on a moving axis cannot be read.
   * @param {number | null} settling
   */
  wantedDuration(settling) {
    const slow = Math.min(...this.design.filter.sections.map(({ re }) => -re));
    const wanted = 1.5 * (settling || 4 / slow);
    const kept = this.design.dragging && this.duration && wanted < 1.3 * this.duration && wanted > 0.25 * this.duration;
    return kept ? this.duration : nice(wanted * 0.999);
  }
}

/**
 * F, 1 - F and the sampled F over a range, in dB and degrees.
 * @param {Filter} filter @param {[number, number]} range @param {number} dt @param {Method} method @returns {Curves}
 */
function responses(filter, [low, high], dt, method) {
  const nyquist = Math.PI / dt;
  const omega = frequencyGrid(filter, { low, high, points: CURVE_POINTS, extra: [nyquist] });
  const below = omega.filter((w) => w <= nyquist);
  const stable = method !== "euler" || dt < eulerLimit(filter);
  const S = stable && below.length > 1 ? polar(sampledResponse(filter, dt, method, below).F) : null;
  return { omega, below, F: polar(response(filter, omega)), E: polar(errorResponse(filter, omega)), S };
}

/** A kept design's curves anew, where an axis has changed. @param {Pin} pin @param {[number, number]} range @param {number} duration */
function follow(pin, range, duration) {
  const { filter, design } = pin;
  if (pin.range !== range.join()) pin.curves = responses(filter, range, design.sampling.dt, design.sampling.method);
  if (pin.duration !== duration) pin.step = stepCurve(filter, duration);
  Object.assign(pin, { range: range.join(), duration });
}

/** Step response with enough points for every swing. @param {Filter} filter @param {number} duration @returns {Step} */
function stepCurve(filter, duration) {
  const swing = Math.max(...filter.sections.map(({ im }) => im));
  return stepResponse(
    filter,
    duration,
    Math.min(Math.max(STEP_POINTS, Math.ceil((20 * duration * swing) / (2 * Math.PI))), MOST_STEP_POINTS),
  );
}
