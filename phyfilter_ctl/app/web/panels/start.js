/** Where a design starts from: a family of poles, its order and bandwidth. */

import { h, show, write } from "../elements.js";
import { LIMITS } from "../mathematics/filter.js";
import { field, short } from "../numbers.js";
import { countOf } from "../state/roots.js";
import { button, card, logSlider, named, numberField, put } from "./parts.js";

/** @import { App } from "../designer.js" */

/** @typedef {{family?: string, order?: number, band?: number[], damping?: number}} Wanted */

const DAMPING = 0.7;
/** @type {Record<string, string>} */
const FAMILY_NAMES = {
  binomial: "Binomial, no overshoot",
  butterworth: "Butterworth, flattest gain",
  bessel: "Bessel, flattest delay",
  itae: "ITAE, quick",
  damped: "Damped pairs",
  bandpass: "Band-pass",
};

export class Start {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {number | undefined} asked for by name */
    this.wantedDamping = undefined;
    /** @type {number[] | undefined} edges in rad/s */
    this.band = undefined;
    const { design } = app;
    this.family = h("select", {
      "data-test": "family",
      "aria-label": "Family",
      onchange: () => void this.ask({ family: this.family.value }),
    });
    this.offer(Object.keys(FAMILY_NAMES));
    this.order = h("output", { "data-test": "order" });
    this.cutoff = numberField(app, "cutoff", "Bandwidth", "rad/s", (value) => this.typeCutoff(value));
    this.slider = logSlider(
      design,
      "cutoff-slider",
      "Bandwidth",
      [0.1, 1e4],
      (value) => design.setCutoff(value),
      "speed",
    );
    this.damping = numberField(app, "damping", "Damping ζ", "", (value) => this.typeDamping(value));
    this.edges = ["Lower edge", "Upper edge"].map((label, i) =>
      numberField(app, i ? "band-high" : "band-low", label, "rad/s", (value) => this.typeEdge(i, value)),
    );
    const body = [
      named("Family", this.family, { class: "pf-field pf-wide" }),
      this.orderRow(),
      this.cutoff.element,
      this.slider.element,
      this.damping.element,
    ];
    this.element = card("Start from", [...body, ...this.edges.map(({ element }) => element)], { test: "knobs" });
  }

  orderRow() {
    const step = (/** @type {number} */ by) =>
      void this.ask({ order: countOf(this.app.design.poles) + by * (this.app.design.family === "bandpass" ? 2 : 1) });
    const less = button("order-less", "−", () => step(-1), { "aria-label": "Lower the order" });
    const more = button("order-more", "+", () => step(1), { "aria-label": "Raise the order" });
    return h(
      "div",
      { class: "pf-field" },
      h("span", { class: "pf-name" }, "Order"),
      h("span", { class: "pf-stepper" }, less, this.order, more),
    );
  }

  /** @param {string[]} names of families that Python knows */
  offer(names) {
    const entries = [["custom", "Custom"], ...names.map((name) => [name, FAMILY_NAMES[name] ?? name])];
    this.family.replaceChildren(...entries.map(([value, text]) => h("option", { value }, text)));
    this.family.value = this.app.design.family;
  }

  /** @param {number} value */
  typeCutoff(value) {
    if (!(value >= LIMITS.slowest && value <= LIMITS.fastest))
      return `Bandwidth: expected ${LIMITS.slowest} to 1e5 rad/s, got ${value}.`;
    const { design } = this.app;
    design.begin();
    design.setCutoff(value);
    design.commit();
    return "";
  }

  /** @param {number} value */
  typeDamping(value) {
    if (!(value >= 0.01 && value <= 1)) return `Damping ratio: expected 0.01 to 1, got ${value}.`;
    this.wantedDamping = value;
    void this.ask({ damping: value });
    return "";
  }

  /** @param {number} i @param {number} value */
  typeEdge(i, value) {
    const cutoff = this.app.design.cutoff();
    const band = [...(this.band ?? [cutoff / 2, cutoff * 2])];
    band[i] = value;
    if (!(band[0] > 0 && band[0] < band[1]))
      return `Band: expected 0 < lower < upper edge, got ${short(band[0])} and ${short(band[1])} rad/s.`;
    void this.ask({ band });
    return "";
  }

  /** Poles of a family, from Python. @param {Wanted} wanted */
  async ask(wanted) {
    const { app } = this;
    const { design } = app;
    const family = wanted.family ?? design.family;
    const order = Math.min(Math.max(Math.round(wanted.order ?? countOf(design.poles)), 1), LIMITS.order);
    if (family === "custom") {
      design.changeOrder(order);
      return;
    }
    const fields = this.question(family, order, wanted);
    const reply = await app.link.ask("family", fields, { latest: true });
    if (!reply) return;
    if (!app.ok(reply)) {
      app.paint();
      return;
    }
    const { sampling, assume, limits } = design;
    design.adopt({ ...reply.design, sampling, assume, limits }, family);
    app.say(`${FAMILY_NAMES[family] ?? family}, order ${fields.order}.`);
  }

  /** @param {string} family @param {number} order @param {Wanted} wanted */
  question(family, order, wanted) {
    const { design } = this.app;
    const cutoff = Math.min(Math.max(design.cutoff(), LIMITS.slowest), LIMITS.fastest);
    if (family === "bandpass") {
      this.band = wanted.band ?? this.band ?? [cutoff / 2, cutoff * 2];
      const even = order % 2 ? (order < LIMITS.order ? order + 1 : order - 1) : order;
      return { family, cutoff, band: this.band, order: even };
    }
    const damping = family === "damped" ? { damping: wanted.damping ?? this.wantedDamping ?? DAMPING } : {};
    const type = design.numerator.kind === "type" ? { type: Math.min(design.numerator.type, order) } : {};
    return { family, cutoff, ...damping, ...type, order };
  }

  show() {
    const { design } = this.app;
    const cutoff = design.cutoff();
    this.family.value = design.family;
    write(this.order, String(design.filter.order));
    put(this.cutoff.input, field(Number(cutoff.toPrecision(4))), design.dragging);
    this.slider.show(cutoff);
    show(this.damping.element, design.family === "damped");
    put(this.damping.input, field(this.wantedDamping ?? DAMPING), design.dragging);
    this.edges.forEach(({ element, input }, i) => {
      show(element, design.family === "bandpass");
      if (this.band) put(input, field(this.band[i]), design.dragging);
    });
  }
}
