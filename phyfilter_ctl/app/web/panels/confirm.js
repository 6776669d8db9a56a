/** Before a filter is handed over: what is wrong with it is said, and has to be meant. */

import { h } from "../elements.js";
import { dialog } from "./dialog.js";

/** @import { App } from "../designer.js" */

const PATIENCE = 3000; // ms until Python is not waited for any longer

/**
 * Whether the design may be exported: at once where nothing is wrong, else as the person decides.
 * @param {App} app @returns {Promise<boolean>}
 */
export async function confirmExport(app) {
  const started = performance.now();
  while (app.stale && performance.now() - started < PATIENCE) await new Promise((resolve) => setTimeout(resolve, 20));
  const problems = [...app.problems];
  if (app.stale) problems.push("Python has not answered about this design yet.");
  if (!problems.length) return true;
  const list = h("ul", { class: "pf-problems" }, ...problems.map((text) => h("li", {}, text)));
  const answer = await dialog(app.root, {
    test: "confirm",
    title: "Export this design?",
    body: [list],
    answers: { back: "Back to the design", export: "Export all the same" },
  });
  return answer === "export";
}
