/** Numerator, sampling and assumptions of the design. */

import { h, show, write } from "../elements.js";
import { heldGain } from "../mathematics/edits.js";
import { LIMITS } from "../mathematics/filter.js";
import { matching } from "../mathematics/matched.js";
import { eulerLimit } from "../mathematics/sampled.js";
import { field, inUnit, short } from "../numbers.js";
import { card, logSlider, named, numberField, put, segments } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Assumptions } from "../link.js" */
/** @import { Method } from "../mathematics/sampled.js" */

const TYPE_MEANINGS = ["constants", "ramps", "parabolas", "cubics"];

export class NumeratorKnobs {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    const { design } = app;
    const names = /** @type {const} */ ({ lowpass: "Low-pass", type: "Type k", zeros: "Free zeros" });
    this.kinds = segments("Numerator", "numerator", names, (kind) => design.setNumerator(kind));
    this.type = h("select", {
      "data-test": "type",
      "aria-label": "Type of 1 − F",
      onchange: () => design.setNumerator("type", Number(this.type.value)),
    });
    this.typeRow = named("Type", this.type);
    this.gain = numberField(app, "gain", "F(0)", "", (value) => {
      if (value === 0) return "Gain: expected a number other than 0.";
      design.setGain(value);
      return "";
    });
    this.note = h("p", { class: "pf-note" });
    this.element = card("Numerator", [this.kinds.element, this.typeRow, this.gain.element, this.note]);
  }

  show() {
    const { filter, numerator, dragging } = this.app.design;
    const kind = numerator.kind === "b" ? "zeros" : numerator.kind;
    this.kinds.show(kind);
    show(this.typeRow, kind === "type");
    const { order, type } = filter;
    if (this.type.length !== order)
      this.type.replaceChildren(
        ...Array.from({ length: order }, (_, i) => h("option", { value: i + 1 }, String(i + 1))),
      );
    if (numerator.kind === "type") this.type.value = String(numerator.type);
    show(this.gain.element, kind === "zeros");
    write(/** @type {Element} */ (this.gain.element.firstElementChild), filter.dcGain !== 0 ? "F(0)" : "|F| mid-band");
    put(this.gain.input, field(heldGain(filter)), dragging);
    const followed = `${TYPE_MEANINGS.slice(0, type).join(", ")}${type > 4 ? ", …" : ""} followed with no steady error`;
    write(this.note, `Type ${type}: ${type === 0 ? "a share of a constant residual stays" : followed}.`);
  }
}

/** @type {Partial<Record<Method, string>>} */
const MATCHES = {
  matched: " The zeros of 1 − F hold at the samples.",
  exact: " At the samples 1 − F vanishes for constants only: choose Matched to keep its other zeros.",
};
const CANNOT_MATCH = " Exact, as this order and step cannot keep the zeros of 1 − F at the samples: sample faster.";

export class SamplingKnobs {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    const { design } = app;
    this.dt = numberField(app, "dt", "Step h", "ms", (value) => this.typeStep(value / 1e3));
    const set = (/** @type {number} */ value) => {
      design.sampling.dt = value;
      design.rebuilt();
    };
    this.slider = logSlider(design, "dt-slider", "Step h", [LIMITS.dtMin, LIMITS.dtMax], set, "step");
    this.mark = h("span", { class: "pf-euler-mark", title: "Forward Euler is unstable right of here" });
    const names = /** @type {const} */ ({ matched: "Matched", exact: "Exact", euler: "Euler", tustin: "Tustin" });
    this.methods = segments("Method", "method", names, (method) =>
      design.edit(() => (design.sampling.method = method)),
    );
    this.note = h("p", { class: "pf-note", "data-test": "euler" });
    const track = h("div", { class: "pf-track" }, this.slider.element, this.mark);
    this.element = card("Sampling", [this.dt.element, track, this.methods.element, this.note], { test: "sampling" });
  }

  /** @param {number} value s */
  typeStep(value) {
    if (!(value >= LIMITS.dtMin && value <= LIMITS.dtMax))
      return `Step h: expected 0.01 to 1000 ms, got ${short(value * 1e3)} ms.`;
    const { design } = this.app;
    design.edit(() => (design.sampling.dt = value));
    return "";
  }

  show() {
    const { filter, sampling, dragging } = this.app.design;
    const { dt, method } = sampling;
    const limit = eulerLimit(filter);
    put(this.dt.input, field(dt * 1e3), dragging);
    this.slider.show(dt);
    this.methods.show(method);
    const share = Math.log(limit / LIMITS.dtMin) / Math.log(LIMITS.dtMax / LIMITS.dtMin);
    show(this.mark, share >= 0 && share <= 1);
    // The thumb's middle travels from half a thumb inside to half a thumb inside.
    this.mark.style.left = `calc(8px + ${(100 * share).toFixed(2)}% - ${(16 * share).toFixed(2)}px)`;
    const match = method === "exact" || method === "matched" ? matching(filter, dt).kept : false;
    const unstable = method === "euler" && !(dt < limit);
    this.note.classList.toggle("pf-violated", unstable);
    const reach = `Euler is stable below ${inUnit(limit, "s").join(" ")}`;
    const rate = `${short(1 / dt, 4)} Hz, Nyquist ${short(Math.PI / dt, 4)} rad/s. ${reach}.`;
    const meaning = match === null ? CANNOT_MATCH : match ? MATCHES[method] : "";
    write(this.note, unstable ? `⚠ Unstable: ${reach}; choose Matched, or sample faster.` : rate + meaning);
  }
}

/**
 * @typedef {object} Row
 * @property {Exclude<keyof Assumptions, "unit">} key
 * @property {string} label
 * @property {(unit: string) => string} unit of the entry, by the unit of f
 * @property {number} factor of the entry over SI
 * @property {[number, number]} range in SI
 * @property {string} title
 */
const ms = () => "ms";
/** @type {Row[]} */
const ROWS = [
  {
    key: "slope",
    label: "Slope of γ ≤",
    unit: (f) => `${f}/s`,
    factor: 1,
    range: [0, 1e12],
    title: "How fast the residual γ = f − f_θ, what the model misses, may change: the error bound rests on it",
  },
  {
    key: "noise",
    label: "Noise of M x, sd",
    unit: (f) => `${f}·s`,
    factor: 1,
    range: [0, 1e12],
    title: "Standard deviation of the white noise on every sample of M x: that of x times the inertia",
  },
  {
    key: "ratio",
    label: "M̂/M",
    unit: () => "",
    factor: 1,
    range: [1e-3, 1e3],
    title: "Modelled inertia over the true one: the margins start from it",
  },
  {
    key: "lag",
    label: "Actuator lag",
    unit: ms,
    factor: 1e3,
    range: [0, 10],
    title: "Time constant between the command that cancels f̂ and its force",
  },
  { key: "delay", label: "Delay", unit: ms, factor: 1e3, range: [0, 10], title: "Further dead time in the loop" },
  {
    key: "ratio_spread",
    label: "M̂/M within ±",
    unit: () => "%",
    factor: 100,
    range: [0, 1e3],
    title:
      "How far M̂/M may be off: up to so much larger, or smaller by the same factor. Views of the loop show the band",
  },
  {
    key: "lag_spread",
    label: "Lag within ±",
    unit: ms,
    factor: 1e3,
    range: [0, 10],
    title: "How far the lag may be off; views of the loop show the band",
  },
  {
    key: "delay_spread",
    label: "Delay within ±",
    unit: ms,
    factor: 1e3,
    range: [0, 10],
    title: "How far the delay may be off; views of the loop show the band",
  },
];

export class AssumptionKnobs {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    const { design } = app;
    this.rows = ROWS.map((row) => ({
      ...row,
      entry: numberField(app, row.key, row.label, row.unit(design.unit), (value) => this.type(row, value), row.title),
    }));
    const change = () => design.edit(() => (design.assume.unit = this.unit.value.trim()));
    this.unit = h("input", {
      type: "text",
      maxlength: 40,
      placeholder: "m/s²",
      "data-test": "unit",
      "aria-label": "Unit of f",
      onchange: change,
    });
    const last = named("Unit of f", h("span", { class: "pf-entry" }, this.unit));
    this.element = card("Assume", [...this.rows.map(({ entry }) => entry.element), last], { test: "assume" });
  }

  /** @param {Row} row @param {number} value in the unit of the entry */
  type({ key, label, unit, factor, range: [low, high] }, value) {
    const { design } = this.app;
    const si = value / factor;
    const text = unit(design.unit);
    if (!(si >= low && si <= high))
      return `${label}: expected ${short(low * factor)} to ${short(high * factor)} ${text}, got ${short(value)}.`;
    design.edit(() => (design.assume[key] = si));
    return "";
  }

  show() {
    const { assume, unit, dragging } = this.app.design;
    for (const row of this.rows) {
      put(row.entry.input, field((assume[row.key] ?? 0) * row.factor), dragging);
      write(row.entry.unitText, row.unit(unit));
    }
    put(this.unit, assume.unit, dragging);
  }
}
