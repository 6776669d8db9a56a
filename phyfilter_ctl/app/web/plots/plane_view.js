/** What of the s-plane is seen: where a point is in pixels, and back. */

import { nice } from "../numbers.js";
import { sizeOf } from "../state/roots.js";

/** @import { Place, Root } from "../state/roots.js" */

/** @typedef {{x: number, y: number}} Pixel */

const RIM = 20; // px
const SMALLEST = 2e-3; // rad/s
const LARGEST = 3e5;
const MOST_DECADES = 9;
// Of a root that sets the view, how many times further out another may be and still be shown with it.
const NEAR = 3;

export class PlaneView {
  constructor() {
    this.width = 0;
    this.height = 0;
    this.log = false;
    this.radius = 60; // rad/s
    this.decades = 3; // that the logarithmic view shows
  }

  get origin() {
    return { x: 0.76 * this.width, y: this.height / 2 };
  }

  /** Length in px of the view's radius. */
  get reach() {
    return 0.68 * this.width;
  }

  /**
   * Pixels of a point; in the logarithmic view the angle is kept, so damping rays stay straight.
   * @param {Place} point @returns {Pixel}
   */
  pixel({ re, im }) {
    const size = Math.hypot(re, im);
    const { log, radius, decades } = this;
    const share = log ? (size > 0 ? Math.max(0, 1 + Math.log10(size / radius) / decades) / size : 0) : 1 / radius;
    return { x: this.origin.x + re * share * this.reach, y: this.origin.y - im * share * this.reach };
  }

  /** The point under pixels. @param {Pixel} at @returns {Place} */
  point({ x, y }) {
    const [u, v] = [(x - this.origin.x) / this.reach, (this.origin.y - y) / this.reach];
    const { log, radius, decades } = this;
    if (!log) return { re: u * radius, im: v * radius };
    const share = Math.hypot(u, v) || 1e-9;
    const size = radius * 10 ** ((share - 1) * decades);
    return { re: (u / share) * size, im: (v / share) * size };
  }

  /** A point outside is shown at the rim, in its direction. @param {Pixel} at */
  rim({ x, y }) {
    const { x: ox, y: oy } = this.origin;
    const over = Math.max((ox - x) / (ox - RIM), (x - ox) / (this.width - RIM - ox), Math.abs(y - oy) / (oy - RIM));
    if (over <= 1) return { x, y, outside: false, angle: 0 };
    return { x: ox + (x - ox) / over, y: oy + (y - oy) / over, outside: true, angle: Math.atan2(y - oy, x - ox) };
  }

  /** How far out the outermost root is, 1 at the edge of what is comfortably seen. @param {Root[]} list */
  share(list) {
    const { x: ox, y: oy } = this.origin;
    const seen = (/** @type {Root} */ root) => {
      const { x, y } = this.pixel(root);
      return Math.max((ox - x) / (0.92 * ox), (x - ox) / (0.8 * (this.width - ox)), (oy - y) / (0.88 * oy));
    };
    return Math.max(...list.map(seen));
  }

  /** How far out the innermost one is, in parts of the reach. @param {Root[]} list */
  innermost(list) {
    const { x: ox, y: oy } = this.origin;
    const distance = (/** @type {Root} */ root) => Math.hypot(this.pixel(root).x - ox, this.pixel(root).y - oy);
    return Math.min(...list.map(distance)) / this.reach;
  }

  /**
   * Show all poles and zeros; with `needed` only where one is outside or all are tiny. True where the view has changed.
   * @param {Root[]} poles @param {Root[]} zeros @param {boolean} needed
   */
  fit(poles, zeros, needed) {
    if (!this.width || !poles.length) return false;
    const placed = zeros.filter(({ re, im }) => re || im);
    // A zero far out would press all the poles together: it stays at the rim.
    const near = this.log ? placed : placed.filter((zero) => this.share([zero]) <= NEAR * this.share(poles));
    const all = [...poles, ...near];
    const inside = this.share(all);
    if (needed && inside <= 1 && inside >= (this.log ? 0.6 : 0.25) && (!this.log || this.innermost(all) > 0.05))
      return false;
    if (this.log) this.fitDecades(all);
    else {
      const needs = this.radius * inside * 1.06;
      this.radius = Math.max(nice(needs) > 1.6 * needs ? 1.25 * needs : nice(needs), SMALLEST);
    }
    return true;
  }

  /** @param {Root[]} all */
  fitDecades(all) {
    const sizes = all.map(sizeOf);
    const spread = Math.log10(Math.max(...sizes) / Math.min(...sizes));
    this.decades = Math.min(Math.max(Math.ceil(spread + 1), 2), MOST_DECADES);
    // The share of the view moves by 1/decades for every decade of the radius.
    this.radius = Math.max(...sizes);
    for (let turn = 0; turn < 20 && this.share(all) > 0.97; turn++)
      this.radius *= 10 ** ((this.share(all) - 0.95) * this.decades + 0.02);
  }

  /** @param {number} factor */
  zoom(factor) {
    this.radius = Math.min(Math.max(this.radius * factor, SMALLEST), LARGEST);
  }

  /** @param {number} by */
  widen(by) {
    this.decades = Math.min(Math.max(this.decades + by, 1), MOST_DECADES);
  }
}
