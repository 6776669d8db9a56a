/** Zoom, pan and cursors of a chart, by mouse, touch and keys: one way for every chart. */

import { h } from "../elements.js";
import { shareOf, valueAt } from "./scales.js";

/** @import { Chart } from "./chart.js" */
/** @import { Range } from "./scales.js" */
/** @typedef {{x: Range | null, y: Range | null}} View  what is seen in place of all, by axis */
/** @typedef {{x: number, y: number}} Pixel */

export const KEYS =
  "Arrow keys move the cursor, with Shift the view; + and − zoom, Alt with up and down vertically; 0 shows all; " +
  "Enter marks a point to measure from, Escape clears it";
const WHEEL = 1.2; // of the view for a notch
const STEP = 1.5; // of it for a key or a button
const PAN = 0.1; // of the view for a key
const A_MOVE = 4; // px: less is a click
const LEAST = 1e-4; // of the whole axis that can fill the view
const LEAST_RATIO = 1.01; // of a logarithmic view
const ARROWS = /** @type {Record<string, [number, number]>} */ ({
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
});

export class Navigation {
  /** @param {Chart} chart */
  constructor(chart) {
    this.chart = chart;
    /** @type {Map<number, Pixel>} */
    this.pointers = new Map();
    /** @type {{at: Pixel, view: View, moved: boolean} | null} */
    this.grabbed = null;
    const { overlay } = chart;
    const { test } = chart.settings;
    const tool = (
      /** @type {string} */ name,
      /** @type {string} */ text,
      /** @type {string} */ words,
      /** @type {() => void} */ act,
    ) =>
      h(
        "button",
        {
          type: "button",
          "data-test": `${test}-${name}`,
          "aria-label": words,
          title: words,
          tabindex: -1,
          onclick: act,
        },
        text,
      );
    this.reset = tool("reset", "⤢", "Show all", () => this.showAll());
    this.reset.removeAttribute("tabindex");
    this.reset.hidden = true;
    this.tools = h(
      "div",
      { class: "pf-chart-tools", role: "group", "aria-label": `View of ${chart.settings.label}` },
      tool("out", "−", "Zoom out", () => this.zoom(STEP)),
      tool("in", "+", "Zoom in; or Ctrl and the wheel", () => this.zoom(1 / STEP)),
      this.reset,
    );
    /** Says the cursor to a screen reader: only what keys have moved. */
    this.spoken = h("span", { class: "pf-unseen", "data-test": "chart-spoken", "aria-live": "polite" });
    overlay.setAttribute("tabindex", "0");
    overlay.setAttribute("aria-label", `${chart.settings.label}. ${KEYS}.`);
    overlay.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    overlay.addEventListener("dblclick", () => this.showAll());
    overlay.addEventListener("pointerdown", (event) => this.down(event));
    overlay.addEventListener("pointermove", (event) => this.move(event));
    overlay.addEventListener("pointerup", (event) => this.up(event));
    overlay.addEventListener("pointercancel", (event) => this.up(event));
    overlay.addEventListener("pointerleave", () => this.leave());
    overlay.addEventListener("keydown", (event) => this.key(event));
  }

  /** Where a pointer is, in px of the chart. @param {MouseEvent} event @returns {Pixel} */
  place(event) {
    const box = this.chart.overlay.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  // -- the view -----------------------------------------------------------------------------------------------------

  /** Shares of the plot from left to right and from bottom to top. @param {Pixel} at */
  shares(at) {
    const { chart } = this;
    const { width, height } = chart.inner;
    return { x: (at.x - chart.left) / width, y: 1 - (at.y - chart.top) / height };
  }

  /**
   * Another view: every axis stretched by a factor about a share of the plot, and moved.
   * @param {View} from @param {[number, number]} factors of the width, of the height
   * @param {{x: number, y: number}} about @param {{x: number, y: number}} [shift] in shares of the plot
   */
  stretch(from, factors, about, shift = { x: 0, y: 0 }) {
    const { chart } = this;
    const { logX = false, logY = false, plane = false, onWindow } = chart.settings;
    const changed = (
      /** @type {Range | null} */ seen,
      /** @type {Range} */ whole,
      /** @type {boolean} */ log,
      /** @type {number} */ factor,
      /** @type {number} */ at,
      /** @type {number} */ by,
      /** @type {boolean} */ inside,
    ) => {
      if (factor === 1 && by === 0) return seen;
      const range = seen ?? whole;
      const low = at * (1 - factor) - by;
      return held([valueAt(low, range, log), valueAt(low + factor, range, log)], whole, log, inside);
    };
    this.show({
      x: changed(from.x, chart.home.x, logX, factors[0], about.x, shift.x, !plane && !onWindow),
      y: changed(from.y, chart.home.y, logY, factors[1], about.y, shift.y, false),
    });
  }

  /** @param {View} view */
  show(view) {
    const { chart } = this;
    const { onWindow } = chart.settings;
    if (onWindow && view.x !== chart.view.x) onWindow(view.x);
    chart.view = { x: onWindow ? null : view.x, y: view.y };
    for (const peer of chart.peers) peer.view = { x: view.x, y: peer.view.y };
    for (const each of [chart, ...chart.peers]) {
      const zoomed = Boolean(each.view.x || each.view.y);
      each.navigation.reset.hidden = !zoomed;
      each.element.classList.toggle("pf-zoomed", zoomed);
    }
    chart.changed();
  }

  showAll() {
    if (this.reset.matches(":focus")) this.chart.overlay.focus(); // the button goes
    this.chart.settings.onWindow?.(null);
    this.show({ x: null, y: null });
  }

  /** About the cursor, if there is one. @param {number} factor @param {boolean} [upright] the vertical axis only */
  zoom(factor, upright = false) {
    const { chart } = this;
    const { plane = false } = chart.settings;
    const at = chart.cursorPixel();
    const about = at ? this.shares(at) : { x: 0.5, y: 0.5 };
    if (!plane) about.y = 0.5;
    this.stretch(chart.view, upright ? [1, factor] : [factor, plane ? factor : 1], about);
  }

  // -- mouse and touch ----------------------------------------------------------------------------------------------

  /** @param {WheelEvent} event */
  wheel(event) {
    // The bare wheel scrolls the page, but for a chart that was clicked; a pinch of a touchpad comes with ctrlKey.
    const { chart } = this;
    if (!event.ctrlKey && !event.metaKey && !chart.overlay.matches(":focus")) return;
    event.preventDefault();
    const delta = event.deltaY || event.deltaX; // with Shift some browsers turn it
    if (!delta) return;
    const factor = WHEEL ** Math.sign(delta);
    const { plane = false } = chart.settings;
    const upright = event.shiftKey;
    this.stretch(chart.view, upright ? [1, factor] : [factor, plane ? factor : 1], this.shares(this.place(event)));
  }

  /** @param {PointerEvent} event */
  down(event) {
    const { chart } = this;
    if (event.button !== 0) return;
    this.pointers.set(event.pointerId, this.place(event));
    if (this.pointers.size > 2) return;
    // A stretch that the panel draws moves under the fingers: they hold what they found.
    const view = chart.settings.onWindow ? { x: chart.x, y: chart.view.y } : chart.view;
    this.grabbed = { at: this.middle(), view, moved: this.pointers.size > 1 };
    this.spread = this.span();
    if (chart.settings.drag !== "mark" || this.pointers.size > 1) chart.overlay.setPointerCapture(event.pointerId);
  }

  /** @param {PointerEvent} event */
  move(event) {
    const { chart, grabbed, pointers } = this;
    const at = this.place(event);
    if (!pointers.has(event.pointerId) || !grabbed) {
      chart.settings.onCursor?.(chart.parameterAt(at));
      return;
    }
    pointers.set(event.pointerId, at);
    const pinch = pointers.size > 1;
    if (!pinch && chart.settings.drag === "mark") return;
    const middle = this.middle();
    grabbed.moved ||= Math.hypot(middle.x - grabbed.at.x, middle.y - grabbed.at.y) >= A_MOVE;
    if (!grabbed.moved) return;
    const before = this.shares(grabbed.at);
    const now = this.shares(middle);
    const ratio = pinch && this.spread ? this.spread / Math.max(this.span(), 1) : 1;
    const shift = { x: (now.x - before.x) * ratio, y: (now.y - before.y) * ratio };
    this.stretch(grabbed.view, [ratio, pinch && !chart.settings.plane ? 1 : ratio], before, shift);
  }

  /** @param {PointerEvent} event */
  up(event) {
    const { chart, grabbed } = this;
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) {
      this.grabbed = null;
      return;
    }
    this.grabbed = null;
    if (!grabbed || grabbed.moved || event.type !== "pointerup" || chart.settings.drag === "mark") return;
    this.measureFrom(chart.from === null ? chart.parameterAt(this.place(event)) : null);
  }

  leave() {
    if (!this.pointers.size && !this.chart.overlay.matches(":focus-visible")) this.chart.settings.onCursor?.(null);
  }

  /** Middle of the fingers. @returns {Pixel} */
  middle() {
    const all = [...this.pointers.values()];
    const sum = all.reduce((total, { x, y }) => ({ x: total.x + x, y: total.y + y }), { x: 0, y: 0 });
    return { x: sum.x / all.length, y: sum.y / all.length };
  }

  /** How far two fingers are apart. */
  span() {
    const [one, other] = this.pointers.values();
    return other ? Math.hypot(one.x - other.x, one.y - other.y) : 0;
  }

  // -- keys ---------------------------------------------------------------------------------------------------------

  /** @param {KeyboardEvent} event */
  key(event) {
    const { chart } = this;
    if (event.target !== chart.overlay || event.ctrlKey || event.metaKey) return;
    if (!this.pressed(event)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** Whether the key means something here. @param {KeyboardEvent} event @returns {boolean} */
  pressed({ key, shiftKey, altKey }) {
    const { chart } = this;
    const way = ARROWS[key];
    if (way && altKey && way[1]) this.zoom(STEP ** -way[1], true);
    else if (altKey) return false;
    else if (way && shiftKey) this.stretch(chart.view, [1, 1], { x: 0, y: 0 }, { x: -PAN * way[0], y: -PAN * way[1] });
    else if (way) this.step(way[0] || way[1]);
    else if (key === "Home" || key === "End") this.step(key === "Home" ? -Infinity : Infinity);
    else if (key === "+" || key === "=") this.zoom(1 / STEP);
    else if (key === "-" || key === "−") this.zoom(STEP);
    else if (key === "0") this.showAll();
    else if (key === "Enter") this.measureFrom(chart.from === null ? chart.at : null);
    else if (key === "Escape") return this.cancel();
    else return false;
    return true;
  }

  /** Move the cursor. @param {number} by steps */
  step(by) {
    const { chart } = this;
    const next = chart.nextParameter(by);
    if (next === null) return;
    chart.settings.onCursor?.(next);
    chart.cursor(next);
    this.spoken.textContent = chart.reading();
  }

  /** @param {number | null} parameter */
  measureFrom(parameter) {
    this.chart.from = parameter;
    for (const peer of this.chart.peers) peer.from = parameter;
    this.chart.changed();
  }

  /** Take back a drag, else the cursors; false where there is nothing. */
  cancel() {
    const { chart, grabbed } = this;
    if (grabbed?.moved) {
      this.pointers.clear();
      this.grabbed = null;
      this.show(grabbed.view);
      return true;
    }
    if (chart.from === null && chart.at === null) return false;
    chart.settings.onCursor?.(null);
    this.measureFrom(null);
    return true;
  }
}

/**
 * A range that leaves something to see: not thinner than a hair of the whole, not far beyond it.
 * @param {Range} range @param {Range} whole @param {boolean} log @param {boolean} inside not beyond it at all
 * @returns {Range | null} null: all
 */
function held(range, whole, log, inside) {
  let [low, high] = range.map((value) => shareOf(value, whole, log));
  const least = log ? Math.log(LEAST_RATIO) / Math.log(whole[1] / whole[0]) : LEAST;
  const most = inside ? 1 : 20;
  const span = Math.min(Math.max(high - low, least), most);
  const [first, last] = inside ? [0, 1] : [-9.5, 10.5];
  low = Math.min(Math.max((low + high - span) / 2, first), last - span);
  high = low + span;
  if (Math.abs(low) < 1e-9 && Math.abs(high - 1) < 1e-9) return null;
  return [valueAt(low, whole, log), valueAt(high, whole, log)];
}
