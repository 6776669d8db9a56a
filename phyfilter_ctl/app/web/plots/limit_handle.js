/** A limit in the Bode plot: its band, and the corner that is dragged. */

import { assign, follow, g, write } from "../elements.js";
import { safe, short } from "../numbers.js";
import { LIMIT_KINDS } from "../state/limits.js";

/** @import { Limit, LimitKind } from "../link.js" */
/** @import { Design } from "../state/design.js" */
/** @import { Chart } from "./chart.js" */

const ROUNDING = 1e-9; // dB
const WAYS = /** @type {Record<string, [number, number]>} */ ({
  ArrowLeft: [1 / 1.05, 0],
  ArrowRight: [1.05, 0],
  ArrowUp: [1, 0.5],
  ArrowDown: [1, -0.5],
});

/** @param {number} level */
const db = (level) => 20 * Math.log10(level);

export class LimitHandle {
  /** @param {Design} design @param {Chart} chart @param {LimitKind} kind */
  constructor(design, chart, kind) {
    this.design = design;
    this.chart = chart;
    this.kind = kind;
    this.band = g("path", { class: "pf-limit-band" });
    this.shade = g("path", { class: "pf-limit-band pf-limit-shade" });
    this.edge = g("path", { class: "pf-limit-edge" });
    this.label = g("text", { class: "pf-limit-label" });
    const words = `Limit of ${LIMIT_KINDS[kind].text}; arrow keys move its corner, Delete removes it`;
    const given = {
      class: "pf-limit-knob",
      tabindex: 0,
      role: "slider",
      "aria-label": words,
      "aria-valuemin": 0,
      "aria-valuemax": 1e6,
      "data-test": `limit-${kind}-handle`,
    };
    this.knob = g("g", given, g("circle", { r: 15, class: "pf-hit" }), g("circle", { r: 6 }));
    this.element = g("g", { class: "pf-limit" }, this.shade, this.band, this.edge, this.label, this.knob);
    this.knob.addEventListener("pointerdown", (event) => this.grab(event));
    this.knob.addEventListener("keydown", (event) => this.key(event));
    chart.overlay.append(this.element);
  }

  /** Draw it; true where the curve is over it. @param {Limit} limit @param {number} excess dB */
  draw(limit, excess) {
    const { chart, kind } = this;
    const { below, text } = LIMIT_KINDS[kind];
    const x = Math.min(Math.max(chart.px(limit.omega), chart.left), chart.right);
    const y = Math.min(Math.max(chart.py(db(limit.level)), chart.top), chart.height - chart.bottom);
    const [from, to] = below ? [chart.left, x] : [x, chart.right];
    // Nearest to the limit the shade is deepest; all above it is where the curve must not be.
    const top = Math.max(y - 15, chart.top);
    this.band.setAttribute("d", `M${from} ${top}H${to}V${y}H${from}z`);
    this.shade.setAttribute("d", `M${from} ${chart.top}H${to}V${y}H${from}z`);
    this.edge.setAttribute("d", `M${from} ${y}H${to}`);
    this.knob.setAttribute("transform", `translate(${x} ${y})`);
    const violated = excess > ROUNDING;
    this.element.classList.toggle("pf-violated", violated);
    const words = `${safe(Math.abs(excess), violated)} dB ${violated ? "over" : "to spare"}`;
    write(this.label, violated ? `⚠ ${words}` : words);
    this.placeLabel(x, y, words, below);
    const where = `${below ? "up to" : "from"} ${short(limit.omega, 3)} rad/s`;
    assign(this.knob, {
      "aria-valuetext": `${text} ${where} below ${short(db(limit.level), 3)} dB: ${words}`,
      "aria-valuenow": limit.omega,
    });
    return violated;
  }

  /** @param {number} x @param {number} y @param {string} words @param {boolean} below */
  placeLabel(x, y, words, below) {
    const { chart } = this;
    const room = 7 * words.length + 26;
    const leftwards = below ? x - room > chart.left : x + room > chart.right;
    // One above its band, one below: where the corners are close the words still do not meet.
    const above = below && y - 20 > chart.top + 8;
    const level = above ? y - 20 : Math.min(y + 17, chart.height - chart.bottom - 6);
    assign(this.label, { x: leftwards ? x - 12 : x + 12, y: level, "text-anchor": leftwards ? "end" : "start" });
  }

  /** @param {number} omega rad/s @param {number} level dB */
  set(omega, level) {
    const { design } = this;
    const limit = {
      omega: Math.min(Math.max(omega, 1e-4), 1e6),
      level: 10 ** (Math.min(Math.max(level, -120), 40) / 20),
    };
    design.limits = { ...design.limits, [this.kind]: limit };
    design.rebuilt();
  }

  /** @param {PointerEvent} event */
  grab(event) {
    const { design, chart } = this;
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    this.knob.focus({ preventScroll: true });
    design.begin();
    const move = (/** @type {PointerEvent} */ next) => {
      const box = chart.overlay.getBoundingClientRect();
      design.touch();
      this.set(Number(chart.xAt(next.clientX - box.left).toPrecision(4)), chart.yAt(next.clientY - box.top));
    };
    follow(
      this.knob,
      event,
      move,
      () => design.commit(),
      () => design.cancel(),
    );
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const { design, kind } = this;
    if (event.key === "Delete" || event.key === "Backspace") {
      event.preventDefault();
      design.toggleLimit(kind);
      return;
    }
    const way = WAYS[event.key];
    const limit = design.limits?.[kind];
    if (!way || !limit) return;
    event.preventDefault();
    const times = event.shiftKey ? 5 : 1;
    design.begin();
    this.set(limit.omega * way[0] ** times, db(limit.level) + way[1] * times);
    design.commit(`limit ${kind}`);
  }
}
