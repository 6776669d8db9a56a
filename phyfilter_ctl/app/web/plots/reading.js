/** What a cursor reads on a chart. */

import { short } from "../numbers.js";
import { between, firstFrom } from "./scales.js";

/** @import { Chart, Series } from "./chart.js" */

const REACH = 60; // px within which the pointer finds a curve

/** The number of a point of a curve at a value of the parameter, -1 where it has none. @param {Series} series @param {number} value */
function placeOf({ at = [] }, value) {
  if (!at.length || value < at[0] * (1 - 1e-9) || value > at[at.length - 1] * (1 + 1e-9)) return -1;
  const k = Math.min(firstFrom(at, value), at.length - 1);
  return k > 0 && value - at[k - 1] < at[k] - value ? k - 1 : k;
}

/** The curves' points at a value of the parameter. @param {Chart} chart @param {number} value */
export function pointsAt(chart, value) {
  return chart.series.flatMap((series) => {
    const k = placeOf(series, value);
    const y = k < 0 ? null : series.y[k];
    return y === null || Number.isNaN(y) ? [] : [{ name: series.name ?? "", x: series.x[k], y, colour: series.colour }];
  });
}

/** Parameter of the curve's point that is nearest to a pixel. @param {Chart} chart @param {{x: number, y: number}} at */
export function nearest(chart, at) {
  let best = REACH;
  let found = /** @type {number | null} */ (null);
  for (const series of chart.series) {
    if (!series.at) continue;
    for (let k = 0; k < series.at.length; k++) {
      const distance = Math.hypot(chart.px(series.x[k]) - at.x, chart.py(Number(series.y[k])) - at.y);
      if (distance < best) [best, found] = [distance, series.at[k]];
    }
  }
  return found;
}

/**
 * Names and values at the cursor; after them what they are more than at the marked point.
 * @param {Chart} chart @param {number} at @param {number | null} from
 */
export function cursorWords(chart, at, from) {
  const data = chart.settings;
  const x = data.parameter ?? data.xName ?? labelled(data.xLabel);
  const unit = data.parameter ? 1 : chart.xUnit;
  const values = valuesAt(chart, at);
  const parts = [
    `${x.name} ${short(at / unit, 4)} ${x.unit}`.trim(),
    ...values.map(({ name, text }) => `${name} ${text}`),
  ];
  if (from === null || from === at) return parts.join("   ");
  const before = new Map(valuesAt(chart, from).map(({ name, value }) => [name, value]));
  const steps = values.flatMap(({ name, value }) => {
    const old = before.get(name);
    return old === undefined || Number.isNaN(value - old) ? [] : [`Δ${name} ${short(value - old, 3)}`];
  });
  return [...parts, `Δ${x.name} ${short((at - from) / unit, 4)} ${x.unit}`.trim(), ...steps].join("   ");
}

/** @param {Chart} chart @param {number} at */
function valuesAt(chart, at) {
  if (chart.settings.parameter)
    return pointsAt(chart, at).flatMap(({ name, x, y }) =>
      name ? [{ name, value: y, text: `${short(x, 3)}, ${short(y, 3)}` }] : [],
    );
  return chart.series.flatMap(({ name, x, y }) => {
    const value = between(x, y, at);
    return name && !Number.isNaN(value) ? [{ name, value, text: short(value, 3) }] : [];
  });
}

/** A label "name, unit" in its parts. @param {string} label */
export function labelled(label) {
  const at = label.lastIndexOf(", ");
  return at < 0 ? { name: label, unit: "" } : { name: label.slice(0, at), unit: label.slice(at + 2) };
}
