/** A chart as a file: lines, axes, names and legend as SVG, its numbers as CSV. Text from data; it knows no page. */

import { shareOf } from "./scales.js";
import { linearTicks, logTicks } from "./ticks.js";

/** @import { Palette } from "./styles.js" */
/** @import { Range } from "./scales.js" */
/** @import { Tick } from "./ticks.js" */

/** @typedef {{name: string, unit: string, log: boolean, range: number[], degrees?: boolean}} Axis */
/** @typedef {(number | null)[]} Values */
/** @typedef {{name: string, x: number[], y: Values, at: number[] | null, colour: string, width: number, dash: number[]}} Line */
/**
 * What a chart's `data()` gives.
 * @typedef {object} ChartData
 * @property {string} title
 * @property {Axis} x
 * @property {Axis} y
 * @property {{name: string, unit: string} | null} parameter
 * @property {Line[]} series
 * @property {{x: number[], low: Values, high: Values, colour: string}[]} bands
 * @property {{x: number, text: string}[]} marks
 */

const EDGE = { left: 64, right: 22, top: 46, bottom: 48 };
const LETTER = 6.6; // px, of 12 px letters on average
const SWATCH = 34;
const ROW = 20;
const FAR = 4; // heights of the plot: beyond that a line is cut off by numbers, not by the frame

/** With its unit. @param {{name: string, unit: string}} quantity */
const titled = ({ name, unit }) => (unit ? `${name} [${unit}]` : name);

/** @param {unknown} text */
const escaped = (text) =>
  String(text).replace(
    /[&<>"]/g,
    (letter) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[letter] ?? "",
  );

const rounded = (/** @type {number} */ value) => String(Number(value.toFixed(2)));

/**
 * An SVG file that needs nothing else.
 * @param {ChartData} data @param {{width: number, height: number}} size of the plot in px @param {Palette} palette
 */
export function svgOf(data, size, palette) {
  const plot = new Plot(data, size);
  const { rows, place } = legendOf(data, size.width);
  const [width, height] = [size.width + EDGE.left + EDGE.right, size.height + EDGE.top + EDGE.bottom + rows * ROW + 8];
  const frame = `x="${EDGE.left}" y="${EDGE.top}" width="${size.width}" height="${size.height}"`;
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" ` +
      `font-family="sans-serif" font-size="12" role="img">`,
    `<title>${escaped(data.title)}</title>`,
    `<defs><clipPath id="plot"><rect ${frame}/></clipPath></defs>`,
    `<rect width="${width}" height="${height}" fill="${palette.card}"/>`,
    text(data.title, EDGE.left, 18, { fill: palette.text, "font-size": 14, "font-weight": 600 }),
    ...axes(data, plot, palette),
    `<g clip-path="url(#plot)" fill="none" stroke-linejoin="round">`,
    ...data.bands.map((band) => `<path d="${plot.band(band)}" fill="${band.colour}" fill-opacity="0.18"/>`),
    ...data.marks.map(({ x }) =>
      line(plot.px(x), EDGE.top, plot.px(x), plot.bottom, palette.muted, ' stroke-dasharray="3 4"'),
    ),
    ...data.series.map((series) => `<path d="${plot.path(series)}" ${pen(series)}/>`),
    "</g>",
    ...data.marks
      .filter(({ x, text: name }) => name && plot.px(x) >= EDGE.left && plot.px(x) <= plot.right)
      .map(({ x, text: name }) => {
        const right = plot.px(x) + 6 + LETTER * name.length > plot.right;
        const anchor = { fill: palette.muted, "text-anchor": right ? "end" : "start" };
        return text(name, plot.px(x) + (right ? -5 : 5), EDGE.top + 14, anchor);
      }),
    ...place.map(({ series, x, row }) => {
      const y = plot.bottom + EDGE.bottom + row * ROW + 4;
      const at = EDGE.left + x;
      return (
        `<path d="M${at} ${y - 4}h${SWATCH - 8}" fill="none" ${pen(series)}/>` +
        text(series.name, at + SWATCH - 2, y, { fill: palette.text })
      );
    }),
    "</svg>",
    "",
  ].join("\n");
}

/** Where things are on the picture. */
class Plot {
  /** @param {ChartData} data @param {{width: number, height: number}} size */
  constructor({ x, y }, { width, height }) {
    this.x = x;
    this.y = y;
    this.width = width;
    this.height = height;
    this.right = EDGE.left + width;
    this.bottom = EDGE.top + height;
  }

  /** @param {number} value */
  px(value) {
    return EDGE.left + shareOf(value, /** @type {Range} */ (this.x.range), this.x.log) * this.width;
  }

  /** @param {number} value */
  py(value) {
    const share = shareOf(value, /** @type {Range} */ (this.y.range), this.y.log);
    return EDGE.top + (1 - Math.min(Math.max(share, -FAR), 1 + FAR)) * this.height;
  }

  /** @param {number} x @param {number} y */
  point(x, y) {
    return `${rounded(this.px(x))} ${rounded(this.py(y))}`;
  }

  /** @param {Line} series */
  path({ x, y }) {
    let down = false;
    return x
      .flatMap((at, k) => {
        const value = y[k];
        const known = value !== null && !Number.isNaN(value) && Number.isFinite(this.px(at));
        const drawn = known ? [`${down ? "L" : "M"}${this.point(at, value)}`] : [];
        down = known;
        return drawn;
      })
      .join("");
  }

  /** @param {ChartData["bands"][number]} band */
  band({ x, low, high }) {
    const known = x.flatMap((at, k) => (low[k] === null || high[k] === null ? [] : [{ at, k }]));
    const above = known.map(({ at, k }) => this.point(at, Number(high[k])));
    const below = known.map(({ at, k }) => this.point(at, Number(low[k]))).reverse();
    return known.length ? `M${[...above, ...below].join("L")}Z` : "";
  }
}

/** @param {Line} series */
const pen = ({ colour, width, dash }) =>
  `stroke="${colour}" stroke-width="${width}"${dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : ""}`;

/** @param {number} x1 @param {number} y1 @param {number} x2 @param {number} y2 @param {string} colour @param {string} [more] */
const line = (x1, y1, x2, y2, colour, more = "") =>
  `<path d="M${rounded(x1)} ${rounded(y1)}L${rounded(x2)} ${rounded(y2)}" stroke="${colour}" fill="none"${more}/>`;

/** @param {string} content @param {number} x @param {number} y @param {Record<string, string | number>} given */
const text = (content, x, y, given) => {
  const attributes = Object.entries(given).map(([name, value]) => ` ${name}="${value}"`);
  return `<text x="${rounded(x)}" y="${rounded(y)}"${attributes.join("")}>${escaped(content)}</text>`;
};

/** Grid, numbers and names. @param {ChartData} data @param {Plot} plot @param {Palette} palette */
function axes({ x, y }, plot, palette) {
  const { width, height, right, bottom } = plot;
  const columns = x.log ? logTicks(x.range, width) : linearTicks(x.range, width / 80);
  const rows = y.log ? logTicks(y.range, height) : linearTicks(y.range, height / 34, y.unit === "°");
  const colour = (/** @type {Tick} */ { minor }) => (minor ? palette.faint : palette.grid);
  const muted = { fill: palette.muted };
  return [
    ...columns.map((tick) => line(plot.px(tick.value), EDGE.top, plot.px(tick.value), bottom, colour(tick))),
    ...rows.map((tick) => line(EDGE.left, plot.py(tick.value), right, plot.py(tick.value), colour(tick))),
    ...spread(columns, plot).map(({ value, text: name }) =>
      text(name, plot.px(value), bottom + 16, { ...muted, "text-anchor": "middle" }),
    ),
    ...rows
      .filter(({ text: name }) => name)
      .map(({ value, text: name }) =>
        text(name, EDGE.left - 7, plot.py(value) + 4, { ...muted, "text-anchor": "end" }),
      ),
    text(titled(x), (EDGE.left + right) / 2, bottom + 36, { ...muted, "text-anchor": "middle" }),
    text(titled(y), EDGE.left, EDGE.top - 8, muted),
  ];
}

/** The numbers below the axis that have room. @param {Tick[]} ticks @param {Plot} plot */
function spread(ticks, plot) {
  let free = -Infinity;
  return ticks.filter(({ value, text: name }) => {
    const [at, half] = [plot.px(value), (LETTER * name.length) / 2];
    if (!name || at - half < free) return false;
    free = at + half + 6;
    return true;
  });
}

/** Names of the curves in rows. @param {ChartData} data @param {number} width */
function legendOf({ series }, width) {
  let [x, row] = [0, 0];
  const place = series
    .filter(({ name }) => name)
    .map((each) => {
      const long = SWATCH + LETTER * each.name.length + 14;
      if (x > 0 && x + long > width) [x, row] = [0, row + 1];
      const found = { series: each, x, row };
      x += long;
      return found;
    });
  return { place, rows: place.length ? row + 1 : 0 };
}

/** The numbers as a table; curves over the same x share its column, and the head has names and units. @param {ChartData} data */
export function csvOf({ x, y, parameter, series, bands }) {
  /** @type {{name: string, values: ArrayLike<number | null>}[]} */
  const columns = [];
  /** @type {number[] | null} */
  let shared = null;
  const over = (/** @type {number[]} */ at) => {
    if (shared?.length !== at.length || shared.some((value, k) => value !== at[k]))
      columns.push({ name: titled(x), values: at });
    shared = at;
  };
  series.forEach(({ name, x: at, y: values, at: along }, i) => {
    const called = name || `curve ${i + 1}`;
    if (parameter && along) {
      columns.push({ name: titled(parameter), values: along });
      columns.push({ name: titled({ ...x, name: `${called}, ${x.name}` }), values: at });
      columns.push({ name: titled({ ...y, name: `${called}, ${y.name}` }), values });
      return;
    }
    over(at);
    columns.push({ name: titled({ name: called, unit: y.unit }), values });
  });
  bands.forEach(({ x: at, low, high }, i) => {
    over(at);
    const of = (/** @type {string} */ end) => titled({ name: `band ${i + 1}, ${end}`, unit: y.unit });
    columns.push({ name: of("least"), values: low }, { name: of("largest"), values: high });
  });
  const length = Math.max(0, ...columns.map(({ values }) => values.length));
  const cell = (/** @type {number | null | undefined} */ value) =>
    value === null || value === undefined || !Number.isFinite(value) ? "" : String(value);
  const lines = [columns.map(({ name }) => quoted(name)).join(",")];
  for (let k = 0; k < length; k++) lines.push(columns.map(({ values }) => cell(values[k])).join(","));
  return `${lines.join("\r\n")}\r\n`;
}

/** @param {string} text */
const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text);
