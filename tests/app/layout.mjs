// The panels' arrangement without a page, for test_layout.py: node layout.mjs folder-of-the-modules < steps.json
//
// A step is [name of a function of state/layout.js, ...what it is given after the layout]; the answer is every layout.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const layouts = await import(pathToFileURL(join(process.argv[2], "state/layout.js")).href);
const { panels, kept, steps } = JSON.parse(readFileSync(0, "utf8"));
const found = [kept === undefined ? layouts.usual(panels) : layouts.restored(kept, panels)];
for (const [name, ...given] of steps) found.push(layouts[name](found.at(-1), ...given));
process.stdout.write(JSON.stringify(found));
