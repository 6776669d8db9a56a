/** The Bode plot, with limits that are drawn into it. */

import { assign, h, write } from "../elements.js";
import { errorResponse, response } from "../mathematics/filter.js";
import { sampledResponse } from "../mathematics/sampled.js";
import { short } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { LimitHandle } from "../plots/limit_handle.js";
import { CURVES, kept, swatch } from "../plots/styles.js";
import { excess, KINDS, LIMIT_KINDS } from "../state/limits.js";
import { spanOf } from "../state/views.js";
import { LOOP_CURVES, LOOP_KEYS, LOOP_WORDS, LoopPlane, loopBode, topOf } from "./loop_plots.js";
import { button, card, segments } from "./parts.js";
import { tabs } from "./tabs.js";

/** @import { App } from "../designer.js" */
/** @import { Curve } from "../mathematics/filter.js" */
/** @import { LimitKind } from "../link.js" */
/** @import { Series } from "../plots/chart.js" */
/** @import { Pin } from "../state/preview.js" */

const LOWEST = -70; // dB
const MOST_LOOP = 60; // dB; an integrator has no largest value
const VIEWS = /** @type {const} */ ({
  filter: { text: "F, 1 − F", title: "The filter: from the residual to the estimate, and to its error" },
  loop: { text: "L, S, T", title: "The loop with the assumed lag, delay and M̂/M" },
  nyquist: { text: "Nyquist", title: "L in the complex plane, with −1 and the circle that it stays out of" },
  nichols: { text: "Nichols", title: "L in phase and magnitude, with circles of equal |T|" },
});
const CURVE_KEYS = /** @type {(keyof typeof CURVES)[]} */ (Object.keys(CURVES));

export class Bode {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {number | null} rad/s */
    this.cursorAt = null;
    this.shown = { F: true, E: true, S: true };
    this.shownLoop = { L: true, S: true, T: true };
    const onCursor = (/** @type {number | null} */ x) => {
      this.cursorAt = x;
      app.paint();
    };
    this.magnitude = new Chart({
      test: "bode-magnitude",
      label: "Magnitude",
      height: 290,
      logX: true,
      xLabel: "",
      xName: { name: "ω", unit: "rad/s" },
      yLabel: "magnitude, dB",
      onCursor,
      changed: () => app.paint(),
    });
    this.phase = new Chart({
      test: "bode-phase",
      label: "Phase",
      height: 175,
      logX: true,
      degrees: true,
      xLabel: "ω, rad/s",
      yLabel: "phase, °",
      onCursor,
      changed: () => app.paint(),
    });
    Chart.together(this.magnitude, this.phase);
    /** @type {Map<LimitKind, LimitHandle>} */
    this.handles = new Map();
    this.buttons = KINDS.map((kind) => {
      const { text } = LIMIT_KINDS[kind];
      const toggle = () => app.design.toggleLimit(kind);
      return button(`limit-${kind}`, `Limit ${text}`, toggle, {
        "aria-pressed": "false",
        title: `Draw a limit of ${text}, and drag its corner`,
      });
    });
    this.readout = h("p", { class: "pf-readout pf-line", "data-test": "readout" });
    this.units = segments("Unit of the frequency axes", "unit", { "rad/s": "rad/s", Hz: "Hz" }, (key) =>
      this.unit(key),
    );
    this.legends = {
      filter: h("div", { class: "pf-legends" }, ...CURVE_KEYS.map((key) => this.legend(key, CURVES[key], this.shown))),
      loop: h(
        "div",
        { class: "pf-legends" },
        ...LOOP_KEYS.map((key) => this.legend(key, LOOP_CURVES[key], this.shownLoop, "loop-")),
      ),
    };
    this.limitButtons = h("div", { class: "pf-group pf-right" }, ...this.buttons);
    const bar = h("div", { class: "pf-bar" }, this.legends.filter, this.legends.loop, this.limitButtons);
    this.units.show("rad/s");
    this.tabs = tabs("View of the frequency panel", "frequency", VIEWS, (frequency) => app.views.choose({ frequency }));
    this.plane = new LoopPlane(app, onCursor);
    this.note = h("p", { class: "pf-note", "data-test": "loop-note" });
    const charts = [this.magnitude.element, this.phase.element, this.plane.element];
    const body = [this.tabs.element, bar, ...charts, this.readout, this.note];
    this.element = card("Frequency", body, { side: [this.units.element] });
    app.views.listeners.push(() => this.showView());
    this.showView();
  }

  showView() {
    const { frequency } = this.app.views;
    const plane = frequency === "nyquist" || frequency === "nichols";
    this.tabs.show(frequency);
    this.magnitude.element.hidden = plane;
    this.phase.element.hidden = plane;
    this.plane.element.hidden = !plane;
    this.legends.filter.hidden = frequency !== "filter";
    this.legends.loop.hidden = frequency !== "loop";
    this.limitButtons.hidden = frequency !== "filter";
    this.note.hidden = frequency === "filter";
    for (const handle of this.handles.values()) handle.element.toggleAttribute("hidden", frequency !== "filter");
  }

  /** What the frequency axes count in; all else stays in rad/s. @param {"rad/s" | "Hz"} unit */
  unit(unit) {
    for (const chart of [this.magnitude, this.phase]) chart.xUnit = unit === "Hz" ? 2 * Math.PI : 1;
    this.phase.settings.xLabel = unit === "Hz" ? "frequency, Hz" : "ω, rad/s";
    this.magnitude.settings.xName = unit === "Hz" ? { name: "frequency", unit } : { name: "ω", unit };
    this.units.show(unit);
    this.app.paint();
  }

  /**
   * @template {string} Key
   * @param {Key} key @param {{text: string, title: string, colour: string, dash: number[]}} curve
   * @param {Record<Key, boolean>} shown @param {string} [view]
   */
  legend(key, { text, title, colour, dash }, shown, view = "") {
    const item = button(
      `legend-${view}${key}`,
      "",
      () => {
        shown[key] = !shown[key];
        item.setAttribute("aria-pressed", String(shown[key]));
        this.app.paint();
      },
      { class: "pf-legend", "aria-pressed": "true", title },
    );
    item.append(swatch(`pf-stroke-${colour}`, dash), text);
    return item;
  }

  /** @param {Pin[]} pins */
  draw(pins) {
    const { palette, preview, design, views } = this.app;
    if (!this.plane.element.hidden) {
      this.plane.draw(pins, views.frequency === "nichols");
      this.plane.chart.cursor(this.cursorAt);
      this.readLoop(this.plane.chart);
      return;
    }
    const own = views.frequency === "filter";
    const { lines, angles, bands, turns } = own
      ? { ...this.series(pins), bands: [], turns: [] }
      : loopBode(this.app, pins, this.shownLoop);
    const x = preview.range ?? [1, 10];
    const nyquist = Math.PI / design.sampling.dt;
    const most = topOf(lines, own ? Infinity : MOST_LOOP);
    this.magnitude.range(LOWEST, 10 * Math.ceil((most + 3) / 10), design.dragging);
    Object.assign(this.magnitude, { x, series: lines, bands, marks: [{ x: nyquist, text: "Nyquist" }] });
    // A delay turns L without end: no further than it matters.
    const [low, high] = spanOf(
      -90,
      0,
      angles.map(({ y }) => y),
    );
    const least = own ? low : Math.max(low, -540);
    this.phase.range(45 * Math.floor(least / 45 - 0.1), 45 * Math.ceil(high / 45 + 0.1), design.dragging);
    Object.assign(this.phase, { x, series: angles, bands: turns, marks: [{ x: nyquist, text: "" }] });
    this.magnitude.draw(palette);
    this.phase.draw(palette);
    KINDS.forEach((kind, i) => this.drawLimit(kind, this.buttons[i]));
    for (const chart of [this.magnitude, this.phase]) chart.cursor(this.cursorAt);
    if (own) this.read();
    else this.readLoop(this.magnitude);
  }

  /** The cursor of a view of the loop, and which loop it is. @param {Chart} chart */
  readLoop(chart) {
    const { loop } = this.app.views.found;
    write(this.readout, chart.reading() || "Point at a curve to read it; click to measure from there.");
    const warning = loop && !loop.stable ? "⚠ Unstable as it is. " : "";
    write(this.note, loop ? `${warning}${LOOP_WORDS}${loop.note}. ${loop.message}` : `${LOOP_WORDS}…`);
    this.note.classList.toggle("pf-violated", warning !== "");
  }

  /** Magnitudes and phases, from behind to the front. @param {Pin[]} pins */
  series(pins) {
    const { palette, preview } = this.app;
    /** @type {Series[]} */
    const lines = [];
    /** @type {Series[]} */
    const angles = [];
    pins.forEach(({ curves, name, style: number }) => {
      if (!curves) return;
      const { colour, dash } = kept(number);
      const style = { x: curves.omega, colour: palette[colour], width: 1.5, dash };
      const named = (/** @type {"F" | "E"} */ key) => `${CURVES[key].text} of ${name}`;
      for (const key of /** @type {const} */ (["F", "E"]))
        if (this.shown[key]) lines.push({ ...style, name: named(key), y: curves[key].db });
      if (this.shown.F) angles.push({ ...style, name: named("F"), y: curves.F.phase });
    });
    // The sampled F first: where the two agree F is seen, where they part both are.
    for (const key of /** @type {const} */ (["S", "E", "F"])) {
      const curve = preview.curves[key];
      if (!this.shown[key] || !curve) continue;
      const x = key === "S" ? preview.curves.below : preview.curves.omega;
      const { text: name, colour, dash } = CURVES[key];
      const style = { name, x, colour: palette[colour], dash, width: 2.25 };
      lines.push({ ...style, y: curve.db });
      if (key !== "E") angles.push({ ...style, y: curve.phase });
    }
    return { lines, angles };
  }

  /** What the curves are where the mouse is. */
  read() {
    const { filter, sampling } = this.app.design;
    const { curves } = this.app.preview;
    const w = this.cursorAt;
    if (w === null) {
      write(this.readout, "Point at a curve to read it; click to measure from there.");
      return;
    }
    const value = (/** @type {Curve} */ curve) => {
      const gain = Math.hypot(curve.re[0], curve.im[0]);
      return `${short(20 * Math.log10(gain), 3)} dB (${short(gain, 3)})`;
    };
    const k = curves.omega.findIndex((omega) => omega >= w);
    const parts = [
      `ω ${short(w, 3)} rad/s, ${short(w / (2 * Math.PI), 3)} Hz`,
      `F ${value(response(filter, [w]))} ∠ ${short(curves.F.phase[Math.max(k, 0)], 3)}°`,
      `1−F ${value(errorResponse(filter, [w]))}`,
    ];
    if (curves.S && w <= Math.PI / sampling.dt)
      parts.push(`sampled ${value(sampledResponse(filter, sampling.dt, sampling.method, [w]).F)}`);
    const from = this.magnitude.from;
    if (from !== null) parts.push(this.difference(from, w));
    this.readout.replaceChildren(...parts.map((text) => h("span", {}, text)));
  }

  /** What lies between the marked point and the cursor. @param {number} from rad/s @param {number} to rad/s */
  difference(from, to) {
    const { filter } = this.app.design;
    const db = (/** @type {Curve} */ { re, im }) =>
      20 * Math.log10(Math.hypot(re[1], im[1]) / Math.hypot(re[0], im[0]));
    const steps = [response, errorResponse].map((of) => short(db(of(filter, [from, to])), 3));
    return `from ${short(from, 3)} rad/s: ω × ${short(to / from, 3)}, F ${steps[0]} dB, 1−F ${steps[1]} dB`;
  }

  /** @param {LimitKind} kind @param {HTMLElement} toggle */
  drawLimit(kind, toggle) {
    const { design, preview } = this.app;
    const limit = design.limits?.[kind];
    assign(toggle, { "aria-pressed": String(Boolean(limit)) });
    let handle = this.handles.get(kind);
    if (!limit) {
      handle?.element.remove();
      this.handles.delete(kind);
      toggle.classList.remove("pf-violated");
      return;
    }
    if (!handle) this.handles.set(kind, (handle = new LimitHandle(design, this.magnitude, kind)));
    handle.element.toggleAttribute("hidden", this.app.views.frequency !== "filter");
    const violated = handle.draw(limit, excess(design.filter, preview.curves, kind, limit));
    toggle.classList.toggle("pf-violated", violated);
  }
}
