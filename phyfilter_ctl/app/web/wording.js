/** What Python refuses, in the words of the page: fields by the names that they have here. */

/** @import { Refusal } from "./link.js" */

/** Fields by how their names begin; the first that fits. @type {[RegExp, string][]} */
const NAMES = [
  [/^design\.poles/, "Poles"],
  [/^design\.numerator/, "Numerator"],
  [/^design\.sampling\.dt/, "Step"],
  [/^design\.sampling/, "Sampling"],
  [/^design\.assume/, "Assumptions"],
  [/^design\.limits/, "Limits"],
  [/^(cutoff|band)$/, "Bandwidth"],
  [/^(order|damping|type|channel|channels|name|unit)$/, ""],
  [/^window$/, "Part of the recording"],
];
/** Parts of a sentence that name what a program calls. @type {[RegExp, string][]} */
const PROGRAM = [
  [/[;,] use method='(\w+)'/, ": choose the $1 method"],
  [/; start one with op learn/, ""],
  [/^low, high: /, "Edges of the band: "],
];

/** @param {Refusal} refusal */
export function inWords({ error, where }) {
  let text = error || "Python gave no reason.";
  if (where && text.startsWith(`${where}: `)) {
    text = text.slice(where.length + 2);
    const found = NAMES.find(([pattern]) => pattern.test(where));
    const name = found ? found[1] || where : "";
    if (name) text = `${name}: ${text}`;
  }
  for (const [pattern, words] of PROGRAM) text = text.replace(pattern, words);
  return text.charAt(0).toUpperCase() + text.slice(1) + (/[.?!…]$/.test(text) ? "" : ".");
}
