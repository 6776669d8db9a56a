/** Filters that meet the drawn limits and the margins asked for: a search of Python's, and its front to pick from. */

import { h, show } from "../elements.js";
import { inUnit, largest, smallest } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { KINDS, LIMIT_KINDS } from "../state/limits.js";
import { button, card, named, numberField, put } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Front, FrontPoint } from "../link.js" */

const POLL = 250; // ms between looks at a search
const ROOM = 0.12; // around the points, in parts of the axis
/** @type {Record<string, string>} */
const TRADES = { noise: "noise against error", margin: "bandwidth against delay margin" };
/** @type {Record<string, string>} */
const FORMS = { lowpass: "poles", general: "poles and zeros" };

export class Meet {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.wish = { delay_margin: 0, low: 1, high: 1 };
    /** @type {number | null} */
    this.job = null;
    /** @type {FrontPoint[]} */
    this.front = [];
    this.chosen = -1;
    this.closed = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    const choice = (
      /** @type {string} */ test,
      /** @type {string} */ label,
      /** @type {Record<string, string>} */ names,
    ) =>
      h(
        "select",
        { "data-test": test, "aria-label": label, onchange: () => app.session.changed() },
        ...Object.entries(names).map(([value, text]) => h("option", { value }, text)),
      );
    this.form = choice("meet-form", "What is searched", FORMS);
    this.trade = choice("meet-trade", "What is traded", TRADES);
    this.fields = [
      this.field("delay_margin", "Delay margin", "s", (value) => value >= 0 && value <= 10, "0 to 10 s"),
      this.field("low", "Least M̂/M", "", (value) => value >= 1e-3 && value <= 1, "0.001 to 1"),
      this.field("high", "Largest M̂/M", "", (value) => value >= 1 && value <= 1e3, "1 to 1000"),
    ];
    this.asked = h("p", { class: "pf-note", "data-test": "meet-asked" });
    this.find = button("meet", "Find filters", () => void this.begin(), { class: "pf-primary" });
    this.stop = button("meet-cancel", "Cancel", () => void this.cancel());
    this.progress = h("progress", {
      max: 1,
      value: 0,
      "aria-label": "Search",
      "data-test": "meet-progress",
      hidden: true,
    });
    this.message = h("p", { class: "pf-note", role: "status", "data-test": "meet-message" });
    this.chart = new Chart({ test: "front", label: "Front", height: 190, xLabel: "", yLabel: "" });
    this.rows = h("div", { class: "pf-front", role: "group", "aria-label": "Filters of the front" });
    this.element = card(
      "Meet my limits",
      [
        this.asked,
        ...this.fields.map(({ element }) => element),
        named("Search", this.form),
        named("Trade", this.trade),
        h("div", { class: "pf-bar" }, this.find, this.stop, this.progress),
        this.message,
        this.chart.element,
        this.rows,
      ],
      { test: "meet-card" },
    );
    app.session.part("meet", {
      get: () => ({ ...this.wish, form: this.form.value, trade: this.trade.value }),
      set: (kept) => this.restore(kept),
    });
    this.show();
  }

  /**
   * @param {"delay_margin" | "low" | "high"} key @param {string} label @param {string} unit
   * @param {(value: number) => boolean} fits @param {string} expected
   */
  field(key, label, unit, fits, expected) {
    const field = numberField(this.app, `meet-${key}`, label, unit, (value) => {
      if (!fits(value)) return `${label}: expected ${expected}, got ${value}.`;
      this.wish[key] = value;
      this.app.session.changed();
      return "";
    });
    return { key, ...field };
  }

  /** @param {any} kept */
  restore(kept) {
    for (const { key } of this.fields) if (Number.isFinite(kept?.[key])) this.wish[key] = kept[key];
    if (kept?.form in FORMS) this.form.value = kept.form;
    if (kept?.trade in TRADES) this.trade.value = kept.trade;
    this.show();
  }

  show() {
    const { limits } = this.app.design;
    const drawn = KINDS.flatMap((kind) => {
      const limit = limits?.[kind];
      const where = LIMIT_KINDS[kind].below ? "up to" : "from";
      return limit
        ? [
            `${LIMIT_KINDS[kind].text} ≤ ${Number(limit.level.toPrecision(3))} ${where} ${Number(limit.omega.toPrecision(3))} rad/s`,
          ]
        : [];
    });
    const text = drawn.length ? `${drawn.join(", ")}; order and type as now.` : "Draw limits in the frequency panel.";
    if (this.asked.textContent !== text) this.asked.textContent = text;
    for (const { key, input } of this.fields) put(input, String(this.wish[key]), false);
    this.find.disabled = this.job !== null;
    this.stop.disabled = this.job === null;
    show(this.progress, this.job !== null);
    show(this.chart.element, this.front.length > 1);
  }

  // -- the search -------------------------------------------------------------------------------------------------

  async begin() {
    const { app, wish } = this;
    const { delay_margin, low, high } = wish;
    const reply = await app.link.ask("meet", {
      design: app.design.data(),
      trade: this.trade.value,
      form: this.form.value,
      delay_margin,
      ratios: [low, high],
    });
    if (!app.ok(reply)) return;
    this.job = reply.job;
    this.message.textContent = "Looking for filters …";
    this.follow();
    this.show();
  }

  follow() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(), POLL);
  }

  async look() {
    if (this.job === null || this.closed) return;
    const reply = await this.app.link.ask("front", { job: this.job });
    if (this.job === null || this.closed) return;
    if (this.app.ok(reply)) this.take(reply);
    else this.job = null;
    this.show();
    if (this.job !== null) this.follow();
  }

  async cancel() {
    if (this.job === null) return;
    const reply = await this.app.link.ask("unmeet", { job: this.job });
    if (this.app.ok(reply)) this.take(reply);
    this.show();
  }

  /** @param {Front} reply */
  take({ state, message, done, front }) {
    this.progress.value = done;
    if (state === "running") return;
    this.job = null;
    this.message.textContent = message;
    this.front = front;
    this.chosen = -1;
    this.rows.replaceChildren(...front.map((point, i) => this.row(point, i)));
    this.app.paint();
  }

  // -- the front --------------------------------------------------------------------------------------------------

  /** @param {FrontPoint} point @param {number} i */
  row(point, i) {
    const { unit } = this.app.design;
    const margin =
      point.delay_margin === null ? "any delay" : `${inUnit(point.delay_margin, "s", 3).join(" ")} more delay`;
    const words = [
      inUnit(point.bandwidth, "rad/s", 3).join(" "),
      `noise ${inUnit(point.noise, unit, 3).join(" ")}`,
      `error ${inUnit(point.bound, unit, 3).join(" ")}`,
      margin,
    ];
    return button(`front-${i}`, words.join(" · "), () => this.use(i), { "aria-pressed": "false" });
  }

  /** Make a filter of the front the design, which undo takes back. @param {number} i */
  use(i) {
    this.chosen = i;
    const { assume, limits } = this.app.design;
    this.app.design.adopt({ ...this.front[i].design, assume, limits });
    [...this.rows.children].forEach((row, k) => row.setAttribute("aria-pressed", String(k === i)));
    this.app.say("In place; undo brings the design before back.");
  }

  draw() {
    if (this.front.length < 2 || this.chart.element.hidden) return;
    const { palette, design } = this.app;
    const noise = this.trade.value === "noise";
    const x = this.front.map((point) => (noise ? point.bound : point.delay_margin) ?? NaN);
    const y = this.front.map((point) => (noise ? point.noise : point.bandwidth) ?? NaN);
    const { settings } = this.chart;
    settings.xLabel = noise ? `largest error, ${design.unit}` : "delay margin, s";
    settings.yLabel = noise ? `noise of f̂, ${design.unit}` : "bandwidth, rad/s";
    const wide = (/** @type {number[]} */ values) => {
      const [low, high] = [smallest(values), largest(values)];
      const room = ROOM * (high - low) || 1;
      return /** @type {[number, number]} */ ([low - room, high + room]);
    };
    const order = x.map((_, k) => k).sort((a, b) => x[a] - x[b]);
    const at = this.chosen < 0 ? [] : [{ x: x[this.chosen], text: "in place" }];
    Object.assign(this.chart, {
      x: wide(x),
      y: wide(y),
      marks: at,
      series: [{ name: "front", x: order.map((k) => x[k]), y: order.map((k) => y[k]), colour: palette.F, width: 2.25 }],
    });
    this.chart.draw(palette);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
  }
}
