/** A chart: curves on a canvas, what is touched on an SVG above it. */

import { assign, g, h } from "../elements.js";
import { grid, mark, place } from "./frame.js";
import { Navigation } from "./navigation.js";
import { cursorWords, labelled, nearest, pointsAt } from "./reading.js";
import { firstFrom, placing, shareOf, valueAt } from "./scales.js";
import { Size } from "./size.js";
import { takeMenu } from "./take_chart.js";

/** @import { Palette } from "./styles.js" */
/** @import { View } from "./navigation.js" */
/** @import { Range } from "./scales.js" */

const MARGIN = { left: 52, right: 24 };
const TOP = { named: 24, plain: 10 }; // px above the plot, with and without a name of the vertical axis
const BOTTOM = { named: 40, plain: 22 }; // px below the axis, with and without a name of it

/** @typedef {{colour: string, width?: number, dash?: number[]}} Stroke */
/**
 * A curve. In a plane (Nyquist, say) its points belong to a parameter, such as a frequency.
 * @typedef {Stroke & {name?: string, x: ArrayLike<number>, y: ArrayLike<number | null>, at?: ArrayLike<number>}} Series
 */
/** @typedef {{colour: string, x: ArrayLike<number>, low: ArrayLike<number | null>, high: ArrayLike<number | null>}} Band */
/** @typedef {{name: string, unit: string}} Quantity */
/** @typedef {{x: number, y: number, text: string, plain?: boolean}} Place  plain: without a cross */
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
 * @property {Quantity} [xName] where the label does not say it
 * @property {Quantity} [yName]
 * @property {Quantity} [parameter] of the curves of a plane; without one they are functions of x
 * @property {boolean} [plane] whether x and y are alike: zoomed together
 * @property {"pan" | "mark"} [drag] what a drag does; "mark": something else, not the chart's own
 * @property {(x: number | null) => void} [onCursor] where the cursor is wanted: an x, or a value of the parameter
 * @property {(x: Range | null) => void} [onWindow] take a stretch of the axis, null all of it, in the chart's place
 * @property {() => void} [changed] the view is another: draw
 */

export class Chart {
  /** @param {Settings} settings */
  constructor(settings) {
    this.settings = settings;
    this.canvas = h("canvas", { "aria-hidden": "true" });
    /** Grid, numbers, names and marks, which a drag seldom changes. */
    this.ground = h("canvas");
    this.groundKey = "";
    this.overlay = g("svg", { class: "pf-overlay", role: "group", "aria-label": settings.label });
    this.cursorLine = g("line", { class: "pf-cursor", y1: 0, y2: 0, visibility: "hidden" });
    this.fromLine = g("line", { class: "pf-cursor pf-from", y1: 0, y2: 0, visibility: "hidden" });
    this.dots = g("g", { class: "pf-dots" });
    this.overlay.append(this.fromLine, this.cursorLine, this.dots);
    /** Where the cursor is, and the point that is measured from. @type {number | null} */
    this.at = null;
    /** @type {number | null} */
    this.from = null;
    /** Charts that show the same stretch of the horizontal axis. @type {Chart[]} */
    this.peers = [];
    /** What is seen while nothing is zoomed. @type {{x: Range, y: Range}} */
    this.home = { x: [0, 1], y: [0, 1] };
    /** @type {View} */
    this.view = { x: null, y: null };
    this.navigation = new Navigation(this);
    const { tools, spoken } = this.navigation;
    tools.prepend(takeMenu(this));
    this.element = h(
      "div",
      { class: "pf-chart", "data-test": settings.test },
      this.canvas,
      this.overlay,
      tools,
      spoken,
    );
    this.element.style.setProperty("--pf-height", `${settings.height}px`);
    this.size = new Size(this.element);
    this.width = 0;
    this.height = settings.height;
    this.ratio = 1;
    this.bottom = settings.xLabel ? BOTTOM.named : BOTTOM.plain;
    this.top = settings.yLabel ? TOP.named : TOP.plain;
    this.xUnit = 1; // what one of the numbers on the horizontal axis is of x
    this.ranged = false;
    /** @type {Palette | null} */
    this.palette = null;
    /** @type {Series[]} */
    this.series = [];
    /** @type {Mark[]} */
    this.marks = [];
    /** Behind the curves. @type {Band[]} */
    this.bands = [];
    /** Named places of a plane. @type {Place[]} */
    this.points = [];
  }

  /** What the horizontal axis shows. @returns {Range} */
  get x() {
    return this.view.x ?? this.home.x;
  }

  set x(range) {
    this.home.x = range;
  }

  /** @returns {Range} */
  get y() {
    return this.view.y ?? this.home.y;
  }

  set y(range) {
    this.home.y = range;
  }

  /** Let charts show one stretch of the horizontal axis together. @param {...Chart} charts */
  static together(...charts) {
    for (const chart of charts) chart.peers = charts.filter((other) => other !== chart);
  }

  /** Draw again, with whatever the panel lays over it. */
  changed() {
    if (this.settings.changed) this.settings.changed();
    else if (this.palette) {
      this.draw(this.palette);
      this.cursor(this.at);
    }
  }

  /**
   * Range of the vertical axis; while something is dragged it only grows.
   * @param {number} low @param {number} high @param {boolean} dragging
   */
  range(low, high, dragging) {
    const [least, most] = this.home.y;
    this.y = dragging && this.ranged ? [Math.min(low, least), Math.max(high, most)] : [low, high];
    this.ranged = true;
  }

  /** Take the size of the page's box. */
  measure() {
    const ratio = window.devicePixelRatio || 1;
    const { width, height } = this.size.read();
    if (!width || !height) return;
    if (width === this.width && height === this.height && ratio === this.ratio) return;
    [this.width, this.height, this.ratio] = [width, height, ratio];
    for (const canvas of [this.canvas, this.ground])
      Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
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
    return MARGIN.left + shareOf(value, this.x, this.settings.logX) * this.inner.width;
  }

  /** @param {number} value */
  py(value) {
    return this.top + (1 - shareOf(value, this.y, this.settings.logY)) * this.inner.height;
  }

  /** @param {number} at */
  xAt(at) {
    return valueAt((at - MARGIN.left) / this.inner.width, this.x, this.settings.logX);
  }

  /** @param {number} at */
  yAt(at) {
    return valueAt(1 - (at - this.top) / this.inner.height, this.y, this.settings.logY);
  }

  /** Whether a place lies between the axis and the right edge. @param {number} at px */
  within(at) {
    return at >= MARGIN.left && at <= this.right;
  }

  /** A place held between them. @param {number} at px */
  heldAt(at) {
    return Math.min(Math.max(at, MARGIN.left), this.right);
  }

  // -- cursors ------------------------------------------------------------------------------------------------------

  /** Show the cursor at an x, or at a value of the parameter. @param {number | null} at */
  cursor(at) {
    this.at = at;
    const { plane, parameter } = this.settings;
    for (const [line, value] of /** @type {const} */ ([
      [this.cursorLine, at],
      [this.fromLine, this.from],
    ])) {
      const x = value === null || parameter ? NaN : this.px(value);
      assign(line, { visibility: this.within(x) ? "visible" : "hidden" });
      if (this.within(x)) assign(line, { x1: x, x2: x, y1: this.top, y2: this.height - this.bottom });
    }
    if (!plane && !parameter) return;
    const dots = [at, this.from].flatMap((value) => (value === null ? [] : pointsAt(this, value)));
    this.dots.replaceChildren(
      ...dots.map(({ x, y, colour }) => g("circle", { cx: this.px(x), cy: this.py(y), r: 4, fill: colour })),
    );
  }

  /** Pixel of the cursor. */
  cursorPixel() {
    if (this.at === null) return null;
    const [point] = this.settings.parameter ? pointsAt(this, this.at) : [];
    if (point) return { x: this.px(point.x), y: this.py(point.y) };
    return this.settings.parameter ? null : { x: this.px(this.at), y: this.top + this.inner.height / 2 };
  }

  /** The x under a pixel, or the parameter of the nearest point of a curve. @param {{x: number, y: number}} at */
  parameterAt(at) {
    if (this.settings.parameter) return nearest(this, at);
    return this.within(at.x) ? this.xAt(at.x) : null;
  }

  /** The parameter so many steps on. @param {number} by */
  nextParameter(by) {
    const { parameter, logX } = this.settings;
    if (parameter) {
      const along = this.series.find((series) => series.at)?.at;
      if (!along?.length) return null;
      const at = this.at ?? along[Math.floor(along.length / 2)];
      let k = 0;
      for (let i = 1; i < along.length; i++) if (Math.abs(along[i] - at) < Math.abs(along[k] - at)) k = i;
      return along[Math.min(Math.max(k + by, 0), along.length - 1)];
    }
    const share = this.at === null ? 0.5 : shareOf(this.at, this.x, logX) + 0.01 * by;
    return valueAt(Math.min(Math.max(share, 0), 1), this.x, logX);
  }

  /** What the curves are at the cursor, and how far from the marked point; "" without a cursor. */
  reading() {
    return this.at === null ? "" : cursorWords(this, this.at, this.from);
  }

  /** The chart as data: what it draws, with names and units, for a file. */
  data() {
    const { settings } = this;
    const inUnit = (/** @type {ArrayLike<number>} */ x) => Array.from(x, (value) => value / this.xUnit);
    return {
      title: settings.label,
      x: { ...(settings.xName ?? labelled(settings.xLabel)), log: Boolean(settings.logX), range: inUnit(this.x) },
      y: { ...(settings.yName ?? labelled(settings.yLabel)), log: Boolean(settings.logY), range: [...this.y] },
      parameter: settings.parameter ?? null,
      series: this.series.map(({ name = "", x, y, at, colour, width = 2, dash = [] }) => ({
        name,
        x: inUnit(x),
        y: Array.from(y),
        at: at ? Array.from(at) : null,
        colour,
        width,
        dash,
      })),
      bands: this.bands.map(({ x, low, high, colour }) => ({
        x: inUnit(x),
        low: Array.from(low),
        high: Array.from(high),
        colour,
      })),
      marks: this.marks.map(({ x, text }) => ({ x: x / this.xUnit, text })),
    };
  }

  // -- drawing ------------------------------------------------------------------------------------------------------

  /** @param {Palette} palette */
  draw(palette) {
    this.palette = palette;
    this.measure();
    const { width } = this;
    if (!width) return;
    const context = this.canvas.getContext("2d");
    if (!context) return;
    this.drawGround(palette);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.drawImage(this.ground, 0, 0);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, this.top, this.inner.width, this.inner.height);
    context.clip();
    for (const band of this.bands) this.band(context, band);
    for (const series of this.series) this.line(context, series);
    // Only then: to set a font is to lay out the page.
    if (this.points.length) context.font = `11px ${palette.font}`;
    for (const each of this.points) place(this, context, palette, each);
    context.restore();
  }

  /** What is behind the curves, where it is another than before. @param {Palette} palette */
  drawGround(palette) {
    const { width, height, ratio, x, y, xUnit, marks } = this;
    const { xLabel, yLabel } = this.settings;
    const colours = [palette.font, palette.grid, palette.faint, palette.muted, palette.card];
    const key = JSON.stringify([width, height, ratio, x, y, xUnit, marks, xLabel, yLabel, colours]);
    const context = this.ground.getContext("2d");
    if (!context || key === this.groundKey) return;
    this.groundKey = key;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = `11px ${palette.font}`;
    grid(this, context, palette);
    for (const each of marks) mark(this, context, palette, each);
  }

  /** @param {CanvasRenderingContext2D} context @param {Series} series */
  line(context, { x, y, colour, width = 2, dash = [] }) {
    context.beginPath();
    let down = false;
    const { parameter } = this.settings;
    const far = parameter ? 4000 : 50; // px outside; a canvas spends long on dashes
    const [low, high] = [-far, this.height + far];
    const [from, to] = parameter ? [0, x.length - 1] : this.inView(x);
    const across = placing(this.x, this.settings.logX, MARGIN.left, this.right);
    const up = placing(this.y, this.settings.logY, this.height - this.bottom, this.top);
    for (let k = from; k <= to; k++) {
      const value = y[k];
      if (value === null || Number.isNaN(value) || (parameter && Number.isNaN(x[k]))) {
        down = false;
        continue;
      }
      const level = Math.min(Math.max(up(value), low), high);
      const at = parameter ? Math.min(Math.max(across(x[k]), -far), this.width + far) : across(x[k]);
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

  /** First and last place of what is seen, with one beyond either edge. @param {ArrayLike<number>} x ascending */
  inView(x) {
    const last = x.length - 1;
    return [Math.max(firstFrom(x, this.x[0]) - 1, 0), Math.min(firstFrom(x, this.x[1]), last)];
  }

  /** @param {CanvasRenderingContext2D} context @param {Band} band */
  band(context, { x, low, high, colour }) {
    const held = (/** @type {number} */ value) => Math.min(Math.max(this.py(value), -50), this.height + 50);
    const [from, to] = this.inView(x);
    context.beginPath();
    for (let k = from; k <= to; k++) if (high[k] !== null) context.lineTo(this.px(x[k]), held(Number(high[k])));
    for (let k = to; k >= from; k--) if (low[k] !== null) context.lineTo(this.px(x[k]), held(Number(low[k])));
    context.globalAlpha = 0.18;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
  }
}
