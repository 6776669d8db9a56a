/** Kept designs: each has a name, a colour and a dash, in every chart and in the s-plane, and its figures in a table. */

import { h } from "../elements.js";
import { filterOf } from "../mathematics/filter.js";
import { roots } from "../mathematics/polynomials.js";
import { inUnit, short } from "../numbers.js";
import { kept, swatch } from "../plots/styles.js";
import { START } from "../state/design.js";
import { rootsOf } from "../state/roots.js";
import { SHORT_NAMES, unitOf } from "./figures.js";
import { button, card } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { DesignData, Figure } from "../link.js" */
/** @import { Ghosts } from "../plots/plane.js" */
/** @import { Pin } from "../state/preview.js" */

/** @typedef {{text: string, numbers: Figure[] | null}} Answer  Python's last, and the design it is for */

const MOST = 12;
const LONGEST_NAME = 40;
const COMPARED = ["bandwidth", "settling", "noise_gain", "bound", "ratio_low", "ratio_high", "delay_margin"];

export class Pins {
  /** @param {App} app @param {() => void} changed called when the kept designs are others */
  constructor(app, changed) {
    this.app = app;
    this.changed = changed;
    /** @type {Pin[]} */
    this.list = [];
    this.rows = h("div", { class: "pf-pins" });
    this.table = h("table", { class: "pf-table pf-compare", "data-test": "compare" });
    const compared = h(
      "div",
      { class: "pf-compared", tabindex: 0, role: "group", "aria-label": "Differences" },
      this.table,
    );
    app.session.pins = { get: () => this.get(), set: (pins) => this.set(pins) };
    app.session.part("pin-styles", {
      get: () => this.list.map(({ style }) => style),
      set: (styles) => this.restyle(styles),
    });
    this.element = card("Compare", [this.rows, compared], { test: "pins" });
    this.show();
  }

  /** Keep the design as it is. @param {Answer} answer */
  pin(answer) {
    const design = this.app.design.data();
    const key = JSON.stringify(design);
    if (this.list.length >= MOST) {
      this.app.say(`${MOST} designs are kept: drop one first.`, "warn");
      return;
    }
    const same = this.list.find((pin) => pin.key === key);
    if (same) {
      this.app.say(`This design is kept already, as “${same.name}”.`, "warn");
      return;
    }
    const pin = this.add(this.freeName(), design, this.freeStyle());
    pin.numbers = key === answer.text ? answer.numbers : null;
    this.all();
    this.app.say(`Kept as “${pin.name}”: it stays behind in its own colour.`);
  }

  /** @param {string} name @param {DesignData} design @param {number} style @returns {Pin} */
  add(name, design, style) {
    const held = structuredClone(design);
    const pin = { style, name, key: JSON.stringify(held), design: held, filter: filterOf(held), numbers: null };
    this.list.push(pin);
    return pin;
  }

  freeName() {
    const taken = new Set(this.list.map(({ name }) => name));
    let number = 1;
    while (taken.has(`Design ${number}`)) number++;
    return `Design ${number}`;
  }

  /** The least that no kept design has. */
  freeStyle() {
    const taken = new Set(this.list.map(({ style }) => style));
    let style = 0;
    while (taken.has(style)) style++;
    return style;
  }

  /** @param {Pin} pin */
  unpin(pin) {
    this.list = this.list.filter((other) => other !== pin);
    this.all();
  }

  /** The list is another one. */
  all() {
    this.show();
    this.changed();
    this.app.session.changed();
    void this.ask();
  }

  /** Python's figures for the designs that have none. */
  async ask() {
    const missing = this.list.filter(({ numbers }) => !numbers);
    if (!missing.length) return;
    const reply = await this.app.link.ask(
      "compare",
      { designs: missing.map(({ design }) => design) },
      { latest: true },
    );
    if (!reply || !this.app.ok(reply)) return;
    missing.forEach((pin, i) => (pin.numbers = reply.compared[i]));
    this.compare(this.app.answer.numbers);
  }

  /** Python's answer for the design that is edited. @param {Answer} answer */
  answered(answer) {
    this.compare(answer.numbers);
  }

  /** What the s-plane shows of them. @returns {Ghosts[]} */
  ghosts() {
    return this.list.map(({ design, filter, style }) => ({
      roots: rootsOf(design.poles),
      zeros: rootsOf(design.numerator.kind === "zeros" ? design.numerator.zeros : roots(filter.b)),
      colour: kept(style).colour,
    }));
  }

  // -- the card ---------------------------------------------------------------------------------------------------

  show() {
    this.element.hidden = !this.list.length;
    this.rows.replaceChildren(...this.list.map((pin, i) => this.row(pin, i)));
    this.compare(this.app.answer.numbers);
  }

  /** @param {Pin} pin @param {number} i */
  row(pin, i) {
    const name = h("input", {
      type: "text",
      value: pin.name,
      maxlength: LONGEST_NAME,
      "aria-label": `Name of “${pin.name}”`,
      "data-test": `pin-${i}-name`,
    });
    name.addEventListener("change", () => {
      name.value = pin.name = name.value.trim() || pin.name;
      this.all();
    });
    const use = button(`pin-${i}-use`, "Use", () => this.app.design.adopt(pin.design), {
      title: "Make it the current design",
      "aria-label": `Use “${pin.name}”`,
    });
    const drop = button(`pin-${i}-unpin`, "✕", () => this.unpin(pin), {
      class: "pf-icon pf-quiet",
      "aria-label": `Drop “${pin.name}”`,
    });
    return h("div", { class: "pf-pin", "data-test": `pin-${i}` }, this.swatch(pin), name, use, drop);
  }

  /** @param {Pin} pin */
  swatch({ style }) {
    const { colour, dash } = kept(style);
    return swatch(`pf-stroke-${colour}`, dash);
  }

  /** Figures in columns; below those of a kept design by how much they differ from now. @param {Figure[] | null} now */
  compare(now) {
    if (!this.list.length) return;
    const heads = this.list.map((pin) => h("th", { scope: "col" }, this.swatch(pin), " ", pin.name));
    const head = h("tr", {}, h("td"), h("th", { scope: "col" }, "now"), ...heads);
    const rows = COMPARED.map((key) => {
      const of = (/** @type {Figure[] | null} */ figures) => figures?.find((each) => each.key === key);
      const current = of(now);
      const cells = this.list.map((pin) => this.cell(key, of(pin.numbers), current));
      return h("tr", {}, h("th", { scope: "row" }, SHORT_NAMES[key]), this.cell(key, current), ...cells);
    });
    this.table.replaceChildren(h("thead", {}, head), h("tbody", {}, ...rows));
  }

  /** @param {string} key @param {Figure | undefined} figure @param {Figure} [now] */
  cell(key, figure, now) {
    if (!figure) return h("td", {}, "…");
    const text = inUnit(figure.value, unitOf(key, figure, this.app.design.unit)).join(" ");
    return h("td", {}, text, now ? h("small", {}, difference(figure.value, now.value)) : null);
  }

  // -- kept in the session ----------------------------------------------------------------------------------------

  get() {
    return this.list.map(({ name, design }) => ({ name, design }));
  }

  /** @param {{name: string, design: DesignData}[]} pins */
  set(pins) {
    this.list = [];
    for (const { name, design } of pins.slice(0, MOST))
      this.add(String(name).slice(0, LONGEST_NAME), { ...structuredClone(START), ...design }, this.freeStyle());
    this.all();
  }

  /** Colours as they were. @param {any} styles */
  restyle(styles) {
    if (!Array.isArray(styles) || styles.length !== this.list.length) return;
    const sound = styles.every((style) => Number.isInteger(style) && style >= 0 && style < 1000);
    if (!sound || new Set(styles).size !== styles.length) return;
    this.list.forEach((pin, i) => (pin.style = styles[i]));
    this.all();
  }
}

/** A difference as people say it. @param {number | null} value @param {number | null} now */
export function difference(value, now) {
  if (value === null || now === null || now === 0) return value === now ? "=" : "";
  const ratio = value / now;
  if (Math.abs(ratio - 1) < 5e-5) return "=";
  if (ratio > 4 || ratio < 0.25) return `× ${short(ratio, 3)}`;
  return `${ratio > 1 ? "+" : ""}${short(100 * (ratio - 1), 3)} %`;
}
