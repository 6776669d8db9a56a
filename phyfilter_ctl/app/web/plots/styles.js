/** Lines as they are told apart without their colours. */

import { g } from "../elements.js";

/** @typedef {"F" | "E" | "S" | "L" | "M" | KeptColour | "grid" | "faint" | "muted" | "card" | "text"} Colour */
/** @typedef {typeof KEPT_COLOURS[number]} KeptColour  of a kept design */
/** @typedef {Record<Colour | "font", string>} Palette  colours of the style sheet, and its font */

/** @type {Record<"solid" | "dash" | "dot" | "dashdot", number[]>} */
export const DASHES = { solid: [], dash: [8, 4], dot: [2, 3], dashdot: [9, 3, 2, 3] };
// Kept designs, behind the current one: neither the colours nor the dashes of two neighbours are the same, and no pair of
// the two comes twice among forty.
const KEPT_DASHES = [
  [5, 4],
  [1, 3],
  [10, 3, 2, 3],
  [14, 4],
  [3, 2],
];
export const KEPT_COLOURS = /** @type {const} */ (["k0", "k1", "k2", "k3", "k4", "k5", "k6", "k7"]);

/** Colour and dashes of a kept design. @param {number} style @returns {{colour: KeptColour, dash: number[]}} */
export const kept = (style) => ({
  colour: KEPT_COLOURS[style % KEPT_COLOURS.length],
  dash: KEPT_DASHES[style % KEPT_DASHES.length],
});

export const CURVES = /** @type {const} */ ({
  F: { text: "F", title: "F: from the residual to the estimate", colour: "F", dash: DASHES.solid },
  E: { text: "1 − F", title: "1 − F: from the residual to the error of the estimate", colour: "E", dash: DASHES.dash },
  S: {
    text: "F sampled",
    title: "F as it runs, sampled, up to the Nyquist frequency",
    colour: "S",
    dash: DASHES.dashdot,
  },
});

/** A piece of a line for a legend. @param {string} className @param {number[]} dash */
export function swatch(className, dash) {
  const line = g("line", { x1: 1, y1: 4, x2: 29, y2: 4, class: className, "stroke-dasharray": dash.join(" ") || null });
  return g("svg", { class: "pf-swatch", viewBox: "0 0 30 8", "aria-hidden": "true" }, line);
}
