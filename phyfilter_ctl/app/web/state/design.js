/** The design that is edited: poles, zeros, numerator, sampling, assumptions, limits. It knows no page. */

import { gainFor, heldGain, heldPole, scaled } from "../mathematics/edits.js";
import { bandwidth } from "../mathematics/figures.js";
import { filterOf, LIMITS, middle } from "../mathematics/filter.js";
import { roots } from "../mathematics/polynomials.js";
import { short } from "../numbers.js";
import { History } from "./history.js";
import { knownLimits, toggled } from "./limits.js";
import { complexOf, countOf, moved, newRoot, placed, rootsOf, sizeOf, written } from "./roots.js";

/** @import { Numerator } from "../mathematics/filter.js" */
/** @import { DesignData, LimitKind } from "../link.js" */
/** @import { Place, Root } from "./roots.js" */

/** @typedef {"pole" | "zero"} Kind */
/** @typedef {{kind: Kind, id: number}} Chosen */
/**
 * What a gesture may change.
 * @typedef {Pick<Design, "poles" | "zeros" | "numerator" | "sampling" | "assume" | "limits" | "family" | "chosen">} State
 */
/**
 * Who hears of changes.
 * @typedef {object} Listener
 * @property {(how: {fit: boolean}) => void} rebuilt the design is another; fit: all of it is to be seen
 * @property {(text: string) => void} committed a gesture is over, with the design as text
 * @property {() => void} chosen another root is selected
 * @property {(text: string) => void} warn
 */

const SINGLE = { re: -1, im: 0 }; // ways from the origin, for roots that are added
const PAIR = { re: -0.7, im: 0.7 };
const APART = 0.1; // of its size, from other roots
const SAME = 1e-6;

/** @type {Readonly<DesignData>} */
export const START = Object.freeze({
  poles: [
    [-20, 0],
    [-20, 0],
  ],
  numerator: { kind: "lowpass" },
  sampling: { dt: 0.002, method: "matched" },
  assume: {
    slope: 1,
    noise: 0.001,
    ratio: 1,
    lag: 0.02,
    delay: 0,
    unit: "",
    ratio_spread: 0,
    lag_spread: 0,
    delay_spread: 0,
  },
  limits: null,
});

export class Design {
  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    const { poles, numerator, sampling, assume, limits } = structuredClone(START);
    this.poles = rootsOf(poles);
    /** @type {Root[]} */
    this.zeros = [];
    /** @type {Numerator} */
    this.numerator = numerator;
    this.sampling = sampling;
    this.assume = assume;
    this.limits = limits;
    this.filter = filterOf(START);
    this.measured = { filter: this.filter, width: bandwidth(this.filter) };
    this.family = "custom";
    /** @type {Chosen | null} */
    this.chosen = null;
    this.history = new History(JSON.stringify(START));
    this.dragging = false;
    /** @type {{held: number, state: State} | null} the gain that the gesture keeps, and what it started from */
    this.before = null;
    /** What was warned of last. */
    this.warned = "";
    /** @type {number | null} when the gesture moved something that is not drawn yet */
    this.movedAt = null;
  }

  /** As messages have it. @returns {DesignData} */
  data() {
    const { numerator } = this;
    const held = numerator.kind === "zeros" ? { ...numerator, zeros: complexOf(this.zeros) } : { ...numerator };
    return {
      poles: complexOf(this.poles),
      numerator: held,
      sampling: { ...this.sampling },
      assume: { ...this.assume },
      limits: this.limits,
    };
  }

  text() {
    return JSON.stringify(this.data());
  }

  /** Unit of f, for texts. */
  get unit() {
    return this.assume.unit || "[f]";
  }

  /** @param {Kind} kind */
  roots(kind) {
    return kind === "pole" ? this.poles : this.zeros;
  }

  /**
   * Take over a design.
   * @param {Partial<DesignData> & Pick<DesignData, "poles">} given @param {{fit?: boolean, family?: string}} [how]
   */
  load(given, { fit = false, family } = {}) {
    const { poles, numerator, sampling, assume, limits } = structuredClone({
      ...START,
      ...given,
      limits: knownLimits(given.limits),
    });
    Object.assign(this, { numerator, sampling, assume, limits });
    this.poles = rootsOf(poles);
    this.zeros = numerator.kind === "zeros" ? rootsOf(numerator.zeros) : [];
    const [first] = this.poles;
    const equal = !first.im && this.poles.every(({ re, im }) => !im && re === first.re);
    this.family = family ?? (equal && numerator.kind !== "zeros" ? "binomial" : "custom");
    this.chosen = null;
    this.rebuilt({ fit });
  }

  /**
   * Take over a design as one step of undo.
   * @param {Partial<DesignData> & Pick<DesignData, "poles">} given @param {string} [family]
   */
  adopt(given, family) {
    this.begin();
    this.load(given, { fit: true, family });
    this.commit();
  }

  /** Something has changed. @param {{fit?: boolean}} [how] */
  rebuilt({ fit = false } = {}) {
    const { numerator } = this;
    if (numerator.kind === "type") numerator.type = Math.min(numerator.type, countOf(this.poles));
    if (numerator.kind !== "zeros") {
      const found = rootsOf(roots(filterOf(this.data()).b));
      this.zeros = found.map((root, i) => ({ ...root, id: this.zeros[i]?.id ?? root.id }));
    }
    this.filter = filterOf(this.data());
    this.listener.rebuilt({ fit });
  }

  // -- gestures ---------------------------------------------------------------------------------------------------

  /** What a drag or a gesture starts from. */
  begin() {
    this.dragging = true;
    const { poles, zeros, numerator, sampling, assume, limits, family, chosen } = this;
    const copies = { numerator: { ...numerator }, sampling: { ...sampling }, assume: { ...assume } };
    this.before = { held: heldGain(this.filter), state: { poles, zeros, limits, family, chosen, ...copies } };
  }

  /** The gesture is given up: everything is as it was before. */
  cancel() {
    if (!this.before) return;
    Object.assign(this, this.before.state);
    this.dragging = false;
    this.before = null;
    this.movedAt = null;
    this.rebuilt();
  }

  /** Something moves; the first move that is not drawn yet counts. */
  touch() {
    this.movedAt ??= performance.now();
  }

  /**
   * The gesture is over: one step of undo.
   * @param {string} [what] a burst of keys or of the wheel: the same again within a moment is still this step
   */
  commit(what = "") {
    this.dragging = false;
    this.before = null;
    const text = this.text();
    if (!this.history.commit(text, what)) return;
    this.listener.committed(text);
    const cancelling = this.cancelling();
    if (cancelling && cancelling !== this.warned) this.listener.warn(cancelling);
    this.warned = cancelling;
  }

  /** A change in one go. @param {() => void} work @param {{fit?: boolean}} [how] */
  edit(work, how = {}) {
    this.begin();
    work();
    this.rebuilt(how);
    this.commit();
  }

  undo() {
    this.cancel();
    this.travel(this.history.undo());
  }

  redo() {
    this.cancel();
    this.travel(this.history.redo());
  }

  /** @param {string | undefined} text */
  travel(text) {
    if (text !== undefined) this.load(JSON.parse(text), { fit: true });
  }

  // -- poles and zeros --------------------------------------------------------------------------------------------

  /** @param {Kind | null} kind @param {number} [id] */
  select(kind, id = 0) {
    this.chosen = kind ? { kind, id } : null;
    this.listener.chosen();
  }

  /** New poles or zeros, in a gesture. @param {Kind} kind @param {Root[]} list @param {{fit?: boolean}} [how] */
  change(kind, list, how = {}) {
    this.touch();
    this.replace(kind, list);
    this.rebuilt(how);
  }

  /** @param {Kind} kind @param {Root[]} list */
  replace(kind, list) {
    // Coefficients given as numbers mean nothing beside other poles: their zeros do.
    if (kind === "zero" || this.numerator.kind === "b") this.freeZeros();
    if (kind === "pole") this.poles = list;
    else this.zeros = list;
    this.regain();
    this.family = "custom";
  }

  /** N by its zeros, as they are. */
  freeZeros() {
    if (this.numerator.kind === "zeros") return;
    const lead = this.filter.b.reduce((last, value) => (value !== 0 ? value : last), 0);
    this.numerator = { kind: "zeros", zeros: complexOf(this.zeros), gain: lead || 1 };
  }

  regain() {
    if (this.numerator.kind !== "zeros") return;
    this.numerator.gain = gainFor(complexOf(this.poles), complexOf(this.zeros), this.before?.held || 1);
  }

  /** @param {Kind | "pair"} what @param {Place} [at] */
  add(what, at) {
    const kind = what === "zero" ? "zero" : "pole";
    const { re, im } = at ?? this.free(what === "pair" ? PAIR : SINGLE);
    const root = newRoot({ re, im: Math.abs(im) });
    const refused = this.refused(kind, root);
    if (refused) {
      this.listener.warn(refused);
      return;
    }
    this.edit(
      () => {
        this.replace(kind, [...this.roots(kind), kind === "zero" ? root : { ...root, ...heldPole(root.re, root.im) }]);
        this.chosen = { kind, id: root.id };
      },
      { fit: true },
    );
  }

  /** Where a root can be added beyond the fastest pole, on no other: a pole on a zero would cancel. @param {Place} way */
  free(way) {
    const roots = [...this.poles, ...this.zeros];
    const least = Math.max(...this.poles.map(sizeOf));
    for (let size = 1.5 * least; ; size *= 1.25) {
      const held = Math.min(size, LIMITS.fastest);
      const at = { re: way.re * held, im: way.im * held };
      const near = roots.some(({ re, im }) => Math.hypot(re - at.re, im - at.im) < APART * held);
      if (!near || held < size) return at;
    }
  }

  /** Where a pole stands on a zero, in a sentence, or "". */
  cancelling() {
    if (this.numerator.kind !== "zeros") return "";
    const on = this.zeros.find((zero) =>
      this.poles.some((pole) => Math.hypot(pole.re - zero.re, pole.im - zero.im) <= SAME * sizeOf(pole)),
    );
    return on ? `A pole and a zero stand on ${written(on)} rad/s and cancel: move one of them, or delete both.` : "";
  }

  /** Why a root cannot be added, or "". @param {Kind} kind @param {Root} root */
  refused(kind, root) {
    const taken = root.im ? 2 : 1;
    const order = countOf(this.poles);
    if (kind === "zero") {
      if (countOf(this.zeros) + taken <= order - 1) return "";
      const most = `F of order ${order} has at most ${order - 1} zero${order === 2 ? "" : "s"}`;
      return `${most}: add a pole first${root.im ? ", or put the zero on the real axis" : ""}.`;
    }
    if (order + taken > LIMITS.order) return `The highest order is ${LIMITS.order}: delete a pole first.`;
    return root.re >= 0 ? "A pole on or right of the imaginary axis makes F unstable: put it on the left." : "";
  }

  /** @param {Chosen | null} [which] */
  remove(which = this.chosen) {
    if (!which) return;
    const { kind } = which;
    const left = this.roots(kind).filter(({ id }) => id !== which.id);
    if (left.length === this.roots(kind).length) return;
    if (kind === "pole" && !left.length) {
      this.listener.warn("A filter has at least one pole.");
      return;
    }
    this.edit(
      () => {
        if (kind === "zero" || this.numerator.kind === "b") this.freeZeros();
        // F must stay strictly proper.
        if (kind === "pole" && this.numerator.kind === "zeros")
          while (countOf(this.zeros) >= countOf(left)) this.zeros = this.zeros.slice(0, -1);
        this.replace(kind, left);
        this.chosen = null;
      },
      { fit: true },
    );
  }

  /**
   * A root typed in the table; "" or why not.
   * @param {Kind} kind @param {number} id @param {"re" | "im" | "wn" | "zeta"} what @param {number} value
   */
  type(kind, id, what, value) {
    const list = this.roots(kind);
    const root = list.find((other) => other.id === id);
    const found = root ? placed(root, what, value) : "expected a number";
    if (!root || typeof found === "string") return String(found);
    const { to, second } = found;
    const leaves = what === "im" && to.im && !root.im;
    const partner = leaves ? list.find((other) => other.id !== id && !other.im) : null;
    if (leaves && !partner) return "a complex root needs a partner: add another real one first";
    let next = moved(list, id, to, partner?.id ?? null);
    if (second !== undefined)
      next = next.map((other, i) => (next[i - 1]?.id === id ? { ...other, re: second } : other));
    const size = sizeOf(to);
    if (kind === "pole" && !(to.re < 0))
      return `expected a real part below 0, got ${short(to.re)}: F would be unstable`;
    if (kind === "pole" && !(size >= LIMITS.slowest && size <= LIMITS.fastest)) {
      return `expected ${short(LIMITS.slowest)} to ${short(LIMITS.fastest)} rad/s, got ${short(size)}`;
    }
    this.begin();
    this.change(kind, next, { fit: true });
    this.commit();
    return "";
  }

  // -- coarse knobs -----------------------------------------------------------------------------------------------

  /** Bandwidth of F, null where it has none; found once for a filter, as several parts of a frame show it. */
  bandwidth() {
    if (this.measured.filter !== this.filter) this.measured = { filter: this.filter, width: bandwidth(this.filter) };
    return this.measured.width;
  }

  /** Bandwidth, or a natural frequency where F has none. */
  cutoff() {
    return this.bandwidth() ?? middle(this.filter);
  }

  /** Everything faster or slower, at once. @param {number} value rad/s */
  setCutoff(value) {
    const factor = value / this.cutoff();
    const sizes = this.poles.map((root) => sizeOf(root) * factor);
    if (!(Math.min(...sizes) >= LIMITS.slowest && Math.max(...sizes) <= LIMITS.fastest)) return;
    this.touch();
    const faster = (/** @type {Root} */ root) => ({ ...root, re: root.re * factor, im: root.im * factor });
    this.numerator = scaled(this.data(), factor).numerator;
    this.poles = this.poles.map(faster);
    this.zeros = this.zeros.map(faster);
    this.rebuilt({ fit: true });
  }

  /** @param {number} order */
  changeOrder(order) {
    const now = countOf(this.poles);
    if (order > now) this.add("pole");
    else if (order < now) {
      const fast = this.poles.reduce((best, root) => (sizeOf(root) > sizeOf(best) ? root : best));
      this.remove({ kind: "pole", id: fast.id });
    }
  }

  /** @param {"lowpass" | "type" | "zeros"} kind @param {number} [type] */
  setNumerator(kind, type = 2) {
    this.edit(() => {
      if (kind === "zeros") this.freeZeros();
      else
        this.numerator =
          kind === "type" ? { kind, type: Math.min(Math.max(type, 1), countOf(this.poles)) } : { kind: "lowpass" };
    });
  }

  /** F(0), or the gain mid-band. @param {number} value */
  setGain(value) {
    this.edit(() => {
      this.freeZeros();
      if (this.before) this.before.held = value;
      this.regain();
    });
  }

  /** @param {LimitKind} kind */
  toggleLimit(kind) {
    this.edit(() => (this.limits = toggled(this.limits, kind, this.cutoff())));
  }
}
