/** Poles and zeros as numbers that are typed. */

import { h, keepAt } from "../elements.js";
import { field, typed } from "../numbers.js";
import { sizeOf } from "../state/roots.js";
import { card, put, textInput } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Kind } from "../state/design.js" */
/** @import { Root } from "../state/roots.js" */

/** @typedef {ReturnType<Table["row"]>} Row */

const HEADS = [
  ["Pole or zero", ""],
  ["Re", "rad/s"],
  ["± Im", "rad/s"],
  ["ωₙ", "rad/s"],
  ["ζ", ""],
  ["Delete", ""],
];
const NAMES = /** @type {const} */ ({
  re: "real part",
  im: "imaginary part",
  wn: "natural frequency",
  zeta: "damping ratio",
});
const KEYS = /** @type {(keyof typeof NAMES)[]} */ (Object.keys(NAMES));
const KINDS = /** @type {Kind[]} */ (["pole", "zero"]);

export class Table {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.body = h("tbody");
    /** @type {Map<string, Row>} */
    this.rows = new Map();
    const head = h(
      "tr",
      {},
      ...HEADS.map(([text, unit], i) => {
        const seen = i > 0 && i < HEADS.length - 1; // the first and the last speak for themselves
        return h(
          "th",
          { scope: "col" },
          h("span", { class: seen ? "" : "pf-unseen" }, text),
          unit ? h("small", {}, ` ${unit}`) : null,
        );
      }),
    );
    this.element = card("Values", [
      h("table", { class: "pf-table", "data-test": "values" }, h("thead", {}, head), this.body),
    ]);
  }

  show() {
    const seen = new Set();
    for (const kind of KINDS) {
      this.app.design.roots(kind).forEach((root, index) => {
        const key = `${kind} ${root.id}`;
        let row = this.rows.get(key);
        if (!row) this.rows.set(key, (row = this.row(kind, root.id)));
        keepAt(this.body, row.element, seen.size);
        seen.add(key);
        this.fill(row, kind, root, index);
      });
    }
    for (const [key, row] of this.rows) {
      if (seen.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
  }

  /** @param {Row} row @param {Kind} kind @param {Root} root @param {number} index */
  fill(row, kind, root, index) {
    const { chosen, dragging } = this.app.design;
    const size = sizeOf(root);
    const values = { re: root.re, im: root.im, wn: size, zeta: size ? -root.re / size : null };
    for (const [i, name] of KEYS.entries()) {
      const [input, value] = [row.inputs[i], values[name]];
      put(input, value === null ? "" : field(value, 5), dragging);
      if (name === "zeta") input.disabled = !root.im;
      if (row.index !== index) input.setAttribute("data-test", `${kind}-${index}-${name}`);
    }
    if (row.index !== index) row.remove.setAttribute("data-test", `${kind}-${index}-delete`);
    row.index = index;
    row.element.classList.toggle("pf-selected", chosen?.kind === kind && chosen.id === root.id);
  }

  /** @param {Kind} kind @param {number} id */
  row(kind, id) {
    const { design } = this.app;
    const inputs = KEYS.map((name) => {
      const input = textInput({ "aria-label": `${kind}, ${NAMES[name]}` });
      input.addEventListener("focus", () => design.select(kind, id));
      input.addEventListener("change", () => {
        const wrong = design.type(kind, id, name, typed(input.value));
        input.setAttribute("aria-invalid", String(Boolean(wrong)));
        if (wrong) this.app.say(`The ${NAMES[name]} of a ${kind}: ${wrong}.`, "warn");
        else input.blur();
      });
      return input;
    });
    const drop = () => design.remove({ kind, id });
    const remove = h(
      "button",
      { type: "button", class: "pf-icon pf-quiet", "aria-label": `Delete this ${kind}`, onclick: drop },
      "✕",
    );
    const sign = h(
      "span",
      { class: `pf-sign pf-${kind}`, role: "img", "aria-label": kind },
      kind === "pole" ? "×" : "○",
    );
    const element = h(
      "tr",
      {},
      h("th", { scope: "row" }, sign),
      ...inputs.map((input) => h("td", {}, input)),
      h("td", {}, remove),
    );
    return { element, inputs, remove, index: -1 };
  }
}
