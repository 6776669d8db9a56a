/** The menu of a chart: take it away as SVG, PNG or CSV. */

import { h } from "../elements.js";
import { Popover } from "../popover.js";
import { csvOf, svgOf } from "./picture.js";

/** @import { Chart } from "./chart.js" */
/** @typedef {{name: string, blob: Blob}} Taken  what the event "pf-take" carries to the designer */

const SHARP = 2; // px of a PNG for one of the page
const FORMATS = /** @type {const} */ ({ svg: "SVG", png: "PNG", csv: "CSV" });

/** @param {Chart} chart */
export function takeMenu(chart) {
  const { test, label } = chart.settings;
  const formats = /** @type {(keyof typeof FORMATS)[]} */ (Object.keys(FORMATS));
  const items = formats.map((format) =>
    h(
      "button",
      { type: "button", "data-test": `${test}-${format}`, onclick: () => void take(format) },
      FORMATS[format],
    ),
  );
  const menu = new Popover(`${test}-take`, "⭳", [h("div", { class: "pf-formats" }, ...items)], {
    label: `Save ${label} as`,
    given: { "aria-label": `Save ${label} as a picture or a table`, title: "Save as SVG, PNG or CSV" },
  });

  /** @param {keyof typeof FORMATS} format */
  async function take(format) {
    const blob = await made(chart, format);
    menu.close();
    const detail = { name: `${slug(label)}.${format}`, blob };
    if (blob) menu.element.dispatchEvent(new CustomEvent("pf-take", { bubbles: true, detail }));
  }
  return menu.element;
}

/** @param {string} text */
const slug = (text) =>
  text
    .toLowerCase()
    .replace(/[^a-z0-9]+/g, "_")
    .replace(/^_+|_+$/g, "") || "chart";

/** @param {Chart} chart @param {keyof typeof FORMATS} format @returns {Promise<Blob | null>} */
async function made(chart, format) {
  const data = chart.data();
  if (format === "csv") return new Blob([csvOf(data)], { type: "text/csv;charset=utf-8" });
  if (!chart.palette) return null;
  const svg = svgOf(data, chart.inner, chart.palette);
  return format === "svg" ? new Blob([svg], { type: "image/svg+xml" }) : drawn(svg);
}

/** The same picture in pixels. @param {string} svg @returns {Promise<Blob | null>} */
async function drawn(svg) {
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg)}`;
  await image.decode();
  const canvas = h("canvas", { width: SHARP * image.width, height: SHARP * image.height });
  canvas.getContext("2d")?.drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}
