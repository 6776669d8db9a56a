/** Pinned designs: they stay behind in grey, beside their figures. */

import { h } from "../elements.js";
import { filterOf } from "../mathematics/filter.js";
import { inUnit } from "../numbers.js";
import { PIN_DASHES, swatch } from "../plots/styles.js";
import { START } from "../state/design.js";
import { SHORT_NAMES, unitOf } from "./figures.js";
import { button, card } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { DesignData, Figure } from "../link.js" */
/** @import { Pin } from "../state/preview.js" */

/** @typedef {{text: string, numbers: Figure[] | null}} Answer  Python's last, and the design it is for */

const COMPARED = ["bandwidth", "settling", "noise_gain", "bound", "ratio_high", "delay_margin"];

export class Pins {
  /** @param {App} app @param {() => void} changed called when the pinned designs are others */
  constructor(app, changed) {
    this.app = app;
    this.changed = changed;
    /** @type {Pin[]} */
    this.list = [];
    this.rows = h("div", { class: "pf-pins" });
    this.table = h("table");
    this.element = card("Compare", [this.rows], { test: "pins" });
    app.session.pins = {
      get: () => this.list.map(({ name, design }) => ({ name, design })),
      set: (pins) => this.restore(pins),
    };
    this.show();
  }

  /** Pin the design as it is. @param {Answer} answer */
  pin(answer) {
    const design = this.app.design.data();
    const key = JSON.stringify(design);
    const number = Math.max(0, ...this.list.map((pin) => pin.number)) + 1;
    const numbers = key === answer.text ? answer.numbers : null;
    this.list.push({ number, name: `Design ${number}`, key, design, filter: filterOf(design), numbers });
    if (this.list.length > PIN_DASHES.length) this.list.shift();
    this.show();
    this.changed();
    this.app.say(`Pinned as Design ${number}: it stays behind in grey.`);
  }

  /** The pinned designs of a session that is opened. @param {{name: string, design: DesignData}[]} pins */
  restore(pins) {
    this.list = pins.slice(-PIN_DASHES.length).map(({ name, design }, i) => {
      const whole = { ...structuredClone(START), ...design };
      const filter = filterOf(whole);
      return { number: i + 1, name, key: JSON.stringify(whole), design: whole, filter, numbers: null };
    });
    this.show();
    this.changed();
  }

  /** @param {Pin} pin */
  unpin(pin) {
    this.list = this.list.filter((other) => other !== pin);
    this.show();
    this.changed();
  }

  /** Python's answer, which may be one for a pinned design too. @param {Answer} answer */
  answered(answer) {
    for (const pin of this.list) if (!pin.numbers && pin.key === answer.text) pin.numbers = answer.numbers;
    this.compare(answer.numbers);
  }

  show() {
    this.element.hidden = !this.list.length;
    this.table = h("table", { class: "pf-table pf-compare", "data-test": "compare" });
    this.rows.replaceChildren(...this.list.map((pin, i) => this.row(pin, i)), this.table);
    this.compare(this.app.answer.numbers);
  }

  /** @param {Pin} pin @param {number} i */
  row(pin, i) {
    const name = h("input", {
      type: "text",
      value: pin.name,
      maxlength: 40,
      "aria-label": "Name of the pinned design",
      "data-test": `pin-${i}-name`,
    });
    name.addEventListener("change", () => (pin.name = name.value.trim() || pin.name));
    const use = button(`pin-${i}-use`, "Use", () => this.app.design.adopt(pin.design), {
      title: "Make it the current design",
    });
    const drop = button(`pin-${i}-unpin`, "✕", () => this.unpin(pin), {
      class: "pf-icon pf-quiet",
      "aria-label": "Unpin",
    });
    return h(
      "div",
      { class: "pf-pin", "data-test": `pin-${i}` },
      swatch("pf-stroke-pin", PIN_DASHES[i]),
      name,
      use,
      drop,
    );
  }

  /** @param {Figure[] | null} now */
  compare(now) {
    if (!this.list.length) return;
    const cell = (/** @type {Figure[] | null} */ figures, /** @type {string} */ key) => {
      const figure = figures?.find((each) => each.key === key);
      return h("td", {}, figure ? inUnit(figure.value, unitOf(key, figure, this.app.design.unit)).join(" ") : "…");
    };
    const names = this.list.map((pin, i) => h("th", { scope: "col" }, pin.name || String(i + 1)));
    const head = h("tr", {}, h("td"), h("th", { scope: "col" }, "now"), ...names);
    const rows = COMPARED.map((key) => {
      const pinned = this.list.map((pin) => cell(pin.numbers, key));
      return h("tr", {}, h("th", { scope: "row" }, SHORT_NAMES[key]), cell(now, key), ...pinned);
    });
    this.table.replaceChildren(h("thead", {}, head), h("tbody", {}, ...rows));
  }
}
