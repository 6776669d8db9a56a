/** Which views of the loop are open, what Python says for them, and what is drawn before it has. */

import { polar } from "../mathematics/figures.js";
import { loopCurves, runsSampled } from "../mathematics/loop.js";
import { largest, smallest } from "../numbers.js";
import { startRegion } from "./region.js";

/** @import { App } from "../designer.js" */
/** @import { DesignData, LocusAnswer, LoopAnswer, Reply, ResponsesAnswer } from "../link.js" */
/** @import { LoopCurves } from "../mathematics/loop.js" */
/** @import { Filter } from "../mathematics/filter.js" */
/** @import { Curves, Pin, Polar } from "./preview.js" */
/** @import { Region } from "./region.js" */
/** @typedef {"filter" | "loop" | "nyquist" | "nichols"} FrequencyView */
/** @typedef {"residual" | "command" | "disturbance" | "noise"} TimeView */
/** @typedef {"none" | "ratio" | "bandwidth"} Locus */
/** @typedef {{omega: Float64Array, curves: LoopCurves, polar: {L: Polar, S: Polar, T: Polar}}} Gains */
/** @typedef {{loop: LoopAnswer | null, responses: ResponsesAnswer | null, locus: LocusAnswer | null}} Found */
/** @typedef {"loop" | "responses" | "locus"} Op */

const FREQUENCY = ["filter", "loop", "nyquist", "nichols"];
const TIME = ["residual", "command", "disturbance", "noise"];
const LOCI = ["none", "ratio", "bandwidth"];
const ASK_EVERY = 150; // ms, in a drag
const AGREES = 1e-6;

export class Views {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {FrequencyView} */
    this.frequency = "filter";
    /** @type {TimeView} */
    this.time = "residual";
    /** @type {Locus} */
    this.locus = "none";
    /** @type {Region} */
    this.region = startRegion();
    /** @type {Found} */
    this.found = { loop: null, responses: null, locus: null };
    /** What was asked for each of them. @type {Map<Op, string>} */
    this.asked = new Map();
    this.askedAt = 0;
    /** @type {Curves | null} the curves of F beside which the gains were computed */
    this.beside = null;
    /** @type {Map<Filter, Gains>} */
    this.gains = new Map();
    /** Who shows what is chosen here. @type {(() => void)[]} */
    this.listeners = [];
    app.session.part("views", {
      get: () => ({ frequency: this.frequency, time: this.time, locus: this.locus, region: this.region }),
      set: (kept) => this.take(kept),
    });
  }

  /** As a session has kept it. @param {any} kept */
  take(kept) {
    const one = (/** @type {string[]} */ names, /** @type {any} */ name) => (names.includes(name) ? name : names[0]);
    this.frequency = one(FREQUENCY, kept?.frequency);
    this.time = one(TIME, kept?.time);
    this.locus = one(LOCI, kept?.locus);
    this.region = startRegion(kept?.region);
    this.changed();
  }

  /** @param {{frequency?: FrequencyView, time?: TimeView, locus?: Locus}} chosen */
  choose(chosen) {
    if (chosen.locus !== undefined && chosen.locus !== this.locus) this.found.locus = null;
    Object.assign(this, chosen);
    this.app.session.changed();
    this.changed();
  }

  changed() {
    for (const listener of this.listeners) listener();
    this.ask();
    this.app.paint();
  }

  // -- Python -------------------------------------------------------------------------------------------------------

  /** @returns {Op[]} */
  get needed() {
    return [
      ...(this.frequency === "filter" ? [] : [/** @type {const} */ ("loop")]),
      ...(this.time === "residual" ? [] : [/** @type {const} */ ("responses")]),
      ...(this.locus === "none" ? [] : [/** @type {const} */ ("locus")]),
    ];
  }

  /** Ask for the views that are open, in a drag now and then. */
  ask() {
    const { design } = this.app;
    if (design.dragging && performance.now() - this.askedAt < ASK_EVERY) return;
    this.askedAt = performance.now();
    const data = design.data();
    for (const op of this.needed) void this.askOne(op, data);
  }

  /** @param {Op} op @param {DesignData} design */
  async askOne(op, design) {
    const fields = op === "locus" ? { design, over: this.locus } : { design };
    const text = JSON.stringify(fields);
    if (this.asked.get(op) === text) return;
    this.asked.set(op, text);
    const reply = /** @type {Reply<object> | null} */ (await this.app.link.ask(op, fields, { latest: true }));
    if (!reply) return;
    if (!this.app.ok(reply)) {
      this.asked.delete(op);
      return;
    }
    Object.assign(this.found, { [op]: reply });
    if (op === "loop" && this.asked.get(op) === text)
      this.compare(/** @type {LoopAnswer & {ok: true}} */ (reply), design);
    this.app.paint();
  }

  /** Python's gains are the truth. @param {LoopAnswer} reply @param {DesignData} design */
  compare({ omega, S }, design) {
    if (JSON.stringify(design) !== this.app.design.text()) return;
    const { curves } = this.gainsOf(this.app.design.filter, design, Float64Array.from(omega));
    let worst = 0;
    let most = 0;
    omega.forEach((_, k) => {
      const [re, im] = [S[0][k] ?? 0, S[1][k] ?? 0];
      most = Math.max(most, Math.hypot(re, im));
      worst = Math.max(worst, Math.hypot(curves.S.re[k] - re, curves.S.im[k] - im));
    });
    if (worst > AGREES * most)
      this.app.say("The preview of the loop differs from Python's by more than 1e-6: trust the figures.", "warn");
  }

  // -- the browser --------------------------------------------------------------------------------------------------

  /** Gains of the design's loop, or of a kept design's. @param {Pin} [pin] @returns {Gains} */
  gainsNow(pin) {
    const { design, preview } = this.app;
    if (this.beside !== preview.curves) this.gains.clear();
    this.beside = preview.curves;
    const filter = pin?.filter ?? design.filter;
    let gains = this.gains.get(filter);
    if (!gains) {
      const data = pin?.design ?? design;
      const curves = pin?.curves ?? preview.curves;
      const sampled = runsSampled(filter, data.sampling, data.assume);
      gains = this.gainsOf(filter, data, sampled ? curves.below : curves.omega);
      this.gains.set(filter, gains);
    }
    return gains;
  }

  /**
   * @param {Filter} filter @param {Pick<DesignData, "sampling" | "assume">} design @param {Float64Array} omega
   * @returns {Gains}
   */
  gainsOf(filter, { sampling, assume }, omega) {
    const curves = loopCurves(filter, sampling, assume, omega);
    const L = polar(curves.L);
    // At low frequencies L turns by 90 degrees for every integrator: there its phase is counted from.
    const off = 360 * Math.round(((L.phase[0] ?? 0) + 90 * filter.type) / 360);
    if (off) L.phase = L.phase.map((value) => value - off);
    return { omega, curves, polar: { L, S: polar(curves.S), T: polar(curves.T) } };
  }
}

/** Least distance of L from -1 and where: the modulus margin, as far as the curve has points. @param {Gains} gains */
export function modulusOf({ omega, polar: { S } }) {
  const most = largest(S.db);
  const k = S.db.indexOf(most);
  return { distance: 10 ** (-most / 20), omega: omega[k] ?? NaN };
}

/** Least and largest of several curves, with what must be seen. @param {number} low @param {number} high @param {ArrayLike<number | null>[]} curves */
export function spanOf(low, high, curves) {
  return [Math.min(low, ...curves.map(smallest)), Math.max(high, ...curves.map(largest))];
}
