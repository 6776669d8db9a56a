/** A chart: curves on a canvas, what is touched on an SVG above it. */

import { assign, g, h } from "../elements.js";
import { linearTicks, logTicks } from "./ticks.js";

/** @import { Palette } from "./styles.js" */
/** @import { Tick } from "./ticks.js" */

const MARGIN = { left: 52, right: 24 };
const TOP = { named: 24, plain: 10 }; // px above the plot, with and without a name of the vertical axis
const BOTTOM = { named: 40, plain: 22 }; // px below the axis, with and without a name of it

/** @typedef {{colour: string, width?: number, dash?: number[]}} Stroke */
/** @typedef {Stroke & {x: ArrayLike<number>, y: ArrayLike<number | null>}} Series */
/** @typedef {{x: number, text: string}} Mark  a vertical line with a name */
/**
 * @typedef {object} Settings
 * @property {string} test
 * @property {string} label
 * @property {number} height px
 * @property {boolean} [logX]
 * @property {boolean} [logY]
 * @property {boolean} [degrees]
 * @property {string} xLabel
 * @property {string} yLabel
 * @property {(x: number | null) => void} [onCursor]
 */

export class Chart {
  /** @param {Settings} settings */
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
    this.ratio = 1;
    this.bottom = settings.xLabel ? BOTTOM.named : BOTTOM.plain;
    this.top = settings.yLabel ? TOP.named : TOP.plain;
    this.x = [0, 1];
    this.xUnit = 1; // what one of the numbers on the horizontal axis is of x
    this.y = [0, 1];
    this.ranged = false;
    /** @type {Series[]} */
    this.series = [];
    /** @type {Mark[]} */
    this.marks = [];
    this.overlay.addEventListener("pointermove", (event) => {
      const at = event.clientX - this.overlay.getBoundingClientRect().left;
      this.settings.onCursor?.(this.within(at) ? this.xAt(at) : null);
    });
    this.overlay.addEventListener("pointerleave", () => this.settings.onCursor?.(null));
  }

  /**
   * Range of the vertical axis; while something is dragged it only grows.
   * @param {number} low @param {number} high @param {boolean} dragging
   */
  range(low, high, dragging) {
    this.y = dragging && this.ranged ? [Math.min(low, this.y[0]), Math.max(high, this.y[1])] : [low, high];
    this.ranged = true;
  }

  /** Take the size of the page's box. */
  measure() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = window.devicePixelRatio || 1;
    if (!width || !height) return;
    if (width === this.width && height === this.height && ratio === this.ratio) return;
    [this.width, this.height, this.ratio] = [width, height, ratio];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
  }

  get inner() {
    return { width: this.right - MARGIN.left, height: this.height - this.top - this.bottom };
  }

  get left() {
    return MARGIN.left;
  }

  get right() {
    return this.width - MARGIN.right;
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

  /** Whether a place lies between the axis and the right edge. @param {number} at px */
  within(at) {
    return at >= MARGIN.left && at <= this.right;
  }

  /** A place held between them. @param {number} at px */
  heldAt(at) {
    return Math.min(Math.max(at, MARGIN.left), this.right);
  }

  /** @param {number | null} x */
  cursor(x) {
    const at = x === null ? NaN : this.px(x);
    const shown = this.within(at);
    this.cursorLine.setAttribute("visibility", shown ? "visible" : "hidden");
    if (shown) assign(this.cursorLine, { x1: at, x2: at, y1: this.top, y2: this.height - this.bottom });
  }

  /** @param {Palette} palette */
  draw(palette) {
    this.measure();
    const { width, height } = this;
    if (!width) return;
    const context = this.canvas.getContext("2d");
    if (!context) return;
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

  /** @param {CanvasRenderingContext2D} context @param {Palette} palette */
  grid(context, palette) {
    const { settings } = this;
    const range = this.x.map((x) => x / this.xUnit);
    const vertical = (
      settings.logX ? logTicks(range, this.inner.width) : linearTicks(range, this.inner.width / 80)
    ).map((tick) => ({ ...tick, value: tick.value * this.xUnit }));
    const rows = this.inner.height / (settings.degrees ? 26 : 34);
    const horizontal = settings.logY
      ? logTicks(this.y, this.inner.height)
      : linearTicks(this.y, rows, settings.degrees);
    this.gridLines(context, palette, vertical, horizontal);
    context.fillStyle = palette.muted;
    this.gridNumbers(context, vertical, horizontal);
    const bottom = this.height - this.bottom;
    context.textAlign = "center";
    context.textBaseline = "top";
    context.fillText(settings.xLabel, (MARGIN.left + this.right) / 2, bottom + 22);
    context.textAlign = "left";
    context.fillText(settings.yLabel, MARGIN.left, 4);
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {Palette} palette @param {Tick[]} vertical
   * @param {Tick[]} horizontal
   */
  gridLines(context, palette, vertical, horizontal) {
    const [bottom, right] = [this.height - this.bottom, this.right];
    const columns = vertical.map(({ value, minor }) => ({ at: Math.round(this.px(value)) + 0.5, minor }));
    const rows = horizontal.map(({ value, minor }) => ({ at: Math.round(this.py(value)) + 0.5, minor }));
    context.lineWidth = 1;
    for (const faint of [true, false]) {
      // One path for all lines of a colour: a drag draws this in every frame.
      context.strokeStyle = faint ? palette.faint : palette.grid;
      context.beginPath();
      for (const { at, minor } of columns) if (minor === faint) line(context, [at, this.top, at, bottom]);
      for (const { at, minor } of rows) if (minor === faint) line(context, [MARGIN.left, at, right, at]);
      context.stroke();
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {Tick[]} vertical @param {Tick[]} horizontal */
  gridNumbers(context, vertical, horizontal) {
    context.textAlign = "center";
    context.textBaseline = "top";
    let free = -Infinity;
    for (const { value, text } of vertical) {
      const at = Math.round(this.px(value)) + 0.5;
      const half = text ? context.measureText(text).width / 2 : 0;
      if (!text || at - half < free || at + half > this.width) continue;
      context.fillText(text, at, this.height - this.bottom + 6);
      free = at + half + 8;
    }
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const { value, text } of horizontal) {
      if (text) context.fillText(text, MARGIN.left - 7, Math.round(this.py(value)) + 0.5);
    }
  }

  /**
   * Text on a patch of ground, so that grid lines do not strike it through.
   * @param {CanvasRenderingContext2D} context @param {Palette} palette @param {string} text @param {number} x
   * @param {number} y
   */
  badge(context, palette, text, x, y) {
    if (!text) return;
    const { width } = context.measureText(text);
    const left = context.textAlign === "right" ? x - width : x;
    context.fillStyle = palette.card;
    context.fillRect(left - 3, y - 2, width + 6, 15);
    context.fillStyle = palette.muted;
    context.fillText(text, x, y);
  }

  /** @param {CanvasRenderingContext2D} context @param {Palette} palette @param {Mark} mark */
  mark(context, palette, { x, text }) {
    const at = this.px(x);
    if (!this.within(at)) return;
    context.setLineDash([3, 4]);
    stroke(context, palette.muted, [at, this.top, at, this.height - this.bottom]);
    context.setLineDash([]);
    const right = at + 6 + context.measureText(text).width > this.right;
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
    const [left, right] = this.settings.logX
      ? [this.x[0] / 1.2, 1.2 * this.x[1]]
      : [2 * this.x[0] - this.x[1], 2 * this.x[1] - this.x[0]];
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
