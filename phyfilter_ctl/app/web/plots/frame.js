/** Axes of a chart: grid, numbers, names, and vertical lines with a name. */

import { linearTicks, logTicks } from "./ticks.js";

/** @import { Chart, Mark, Place } from "./chart.js" */
/** @import { Palette } from "./styles.js" */
/** @import { Tick } from "./ticks.js" */

/** @param {Chart} chart @param {CanvasRenderingContext2D} context @param {Palette} palette */
export function grid(chart, context, palette) {
  const { settings } = chart;
  const range = chart.x.map((x) => x / chart.xUnit);
  const vertical = (
    settings.logX ? logTicks(range, chart.inner.width) : linearTicks(range, chart.inner.width / 80)
  ).map((tick) => ({ ...tick, value: tick.value * chart.xUnit }));
  const rows = chart.inner.height / (settings.degrees ? 26 : 34);
  const horizontal = settings.logY
    ? logTicks(chart.y, chart.inner.height)
    : linearTicks(chart.y, rows, settings.degrees);
  gridLines(chart, context, palette, vertical, horizontal);
  context.fillStyle = palette.muted;
  gridNumbers(chart, context, vertical, horizontal);
  const bottom = chart.height - chart.bottom;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillText(settings.xLabel, (chart.left + chart.right) / 2, bottom + 22);
  context.textAlign = "left";
  context.fillText(settings.yLabel, chart.left, 4);
}

/**
 * @param {Chart} chart @param {CanvasRenderingContext2D} context @param {Palette} palette @param {Tick[]} vertical
 * @param {Tick[]} horizontal
 */
function gridLines(chart, context, palette, vertical, horizontal) {
  const [bottom, right] = [chart.height - chart.bottom, chart.right];
  const columns = vertical.map(({ value, minor }) => ({ at: Math.round(chart.px(value)) + 0.5, minor }));
  const rows = horizontal.map(({ value, minor }) => ({ at: Math.round(chart.py(value)) + 0.5, minor }));
  context.lineWidth = 1;
  for (const faint of [true, false]) {
    // One path for all lines of a colour: a drag draws this in every frame.
    context.strokeStyle = faint ? palette.faint : palette.grid;
    context.beginPath();
    for (const { at, minor } of columns) if (minor === faint) line(context, [at, chart.top, at, bottom]);
    for (const { at, minor } of rows) if (minor === faint) line(context, [chart.left, at, right, at]);
    context.stroke();
  }
}

/** @param {Chart} chart @param {CanvasRenderingContext2D} context @param {Tick[]} vertical @param {Tick[]} horizontal */
function gridNumbers(chart, context, vertical, horizontal) {
  context.textAlign = "center";
  context.textBaseline = "top";
  let free = -Infinity;
  for (const { value, text } of vertical) {
    const at = Math.round(chart.px(value)) + 0.5;
    const half = text ? context.measureText(text).width / 2 : 0;
    if (!text || at - half < free || at + half > chart.width) continue;
    context.fillText(text, at, chart.height - chart.bottom + 6);
    free = at + half + 8;
  }
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const { value, text } of horizontal) {
    if (text) context.fillText(text, chart.left - 7, Math.round(chart.py(value)) + 0.5);
  }
}

/**
 * Text on a patch of ground, so that grid lines do not strike it through.
 * @param {CanvasRenderingContext2D} context @param {Palette} palette @param {string} text @param {number} x
 * @param {number} y
 */
function badge(context, palette, text, x, y) {
  if (!text) return;
  const { width } = context.measureText(text);
  const left = context.textAlign === "right" ? x - width : x;
  context.fillStyle = palette.card;
  context.fillRect(left - 3, y - 2, width + 6, 15);
  context.fillStyle = palette.muted;
  context.fillText(text, x, y);
}

/** @param {Chart} chart @param {CanvasRenderingContext2D} context @param {Palette} palette @param {Mark} mark */
export function mark(chart, context, palette, { x, text }) {
  const at = chart.px(x);
  if (!chart.within(at)) return;
  context.setLineDash([3, 4]);
  stroke(context, palette.muted, [at, chart.top, at, chart.height - chart.bottom]);
  context.setLineDash([]);
  const right = at + 6 + context.measureText(text).width > chart.right;
  context.textAlign = right ? "right" : "left";
  context.textBaseline = "top";
  // Above 0 dB, where the curves are seldom.
  badge(context, palette, text, right ? at - 5 : at + 5, chart.top + 3);
}

/**
 * A named place.
 * @param {Chart} chart @param {CanvasRenderingContext2D} context @param {Palette} palette @param {Place} place
 */
export function place(chart, context, palette, { x, y, text, plain }) {
  const [at, level] = [chart.px(x), chart.py(y)];
  if (!chart.within(at) || level < chart.top || level > chart.height - chart.bottom) return;
  context.lineWidth = 2;
  if (!plain) {
    stroke(context, palette.text, [at - 5, level - 5, at + 5, level + 5]);
    stroke(context, palette.text, [at - 5, level + 5, at + 5, level - 5]);
  }
  context.lineWidth = 1;
  context.textAlign = at + 9 + context.measureText(text).width > chart.right ? "right" : "left";
  context.textBaseline = "top";
  badge(context, palette, text, context.textAlign === "right" ? at - 9 : at + 9, level + 5);
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
