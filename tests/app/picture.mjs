// A chart's data as SVG and CSV, for test_picture.py: node picture.mjs folder-of-the-modules < [data, ...]
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const load = (name) => import(pathToFileURL(join(process.argv[2], name)).href);
const { csvOf, svgOf } = await load("plots/picture.js");
const { kept } = await load("plots/styles.js");
const palette = { card: "#ffffff", text: "#111111", muted: "#555555", grid: "#dddddd", faint: "#eeeeee" };
const pictures = JSON.parse(readFileSync(0, "utf8")).map((data) => ({
  svg: svgOf(data, { width: 600, height: 300 }, palette),
  csv: csvOf(data),
}));
process.stdout.write(JSON.stringify({ pictures, styles: Array.from({ length: 40 }, (_, k) => kept(k)) }));
