/** The answer to a unit step. */

import { h, write } from "../elements.js";
import { inUnit } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { CURVES, DASHES, kept, swatch } from "../plots/styles.js";
import { spanOf } from "../state/views.js";
import { card } from "./parts.js";
import { tabs } from "./tabs.js";

/** @import { App } from "../designer.js" */
/** @import { Series } from "../plots/chart.js" */
/** @import { Pin } from "../state/preview.js" */

const ROOM = 0.06; // above and below the curves, in parts of their height
const VIEWS = /** @type {const} */ ({
  residual: { text: "Residual", title: "F alone: the estimate and its error after a unit step of the residual" },
  command: { text: "Command", title: "Closed loop: M̂ x′ after a unit step of the command" },
  disturbance: { text: "Disturbance", title: "Closed loop: what a unit step of the residual leaves of M x′" },
  noise: { text: "Noise", title: "Closed loop: the command after one sample of x that is off by the assumed noise" },
});
const LOOP_LINES = /** @type {const} */ ({
  command: {
    name: "M̂ x′",
    colour: "F",
    words: "Closed loop: M̂ x′, mean over each step, after a unit step of the command.",
  },
  disturbance: {
    name: "M x′",
    colour: "E",
    words: "Closed loop: M x′, mean over each step, that a unit step of the residual leaves.",
  },
  noise: {
    name: "command",
    colour: "S",
    words: "Closed loop: the command after one sample of x is off by the assumed noise.",
  },
});

export class StepCard {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {number | null} s */
    this.cursorAt = null;
    const onCursor = (/** @type {number | null} */ t) => {
      this.cursorAt = t;
      app.paint();
    };
    this.chart = new Chart({
      test: "step",
      label: "Step response",
      height: 210,
      xLabel: "t, s",
      yLabel: "",
      yName: { name: "step response", unit: "" },
      onCursor,
      changed: () => app.paint(),
    });
    this.readout = h("span", { class: "pf-readout", "data-test": "step-readout" });
    const item = (/** @type {"F" | "E"} */ key, /** @type {string} */ text) =>
      h("span", { class: "pf-legend" }, swatch(`pf-stroke-${CURVES[key].colour}`, CURVES[key].dash), text);
    this.legends = h("div", { class: "pf-legends" }, item("F", "estimate"), item("E", "error"));
    const bar = h("div", { class: "pf-bar" }, this.legends, this.readout);
    this.tabs = tabs("View of the time panel", "time", VIEWS, (time) => app.views.choose({ time }));
    this.note = h("p", { class: "pf-note", "data-test": "time-note" });
    this.element = card("Time responses", [this.tabs.element, bar, this.chart.element, this.note]);
    app.views.listeners.push(() => this.showView());
    this.showView();
  }

  showView() {
    const { time } = this.app.views;
    this.tabs.show(time);
    this.legends.hidden = time !== "residual";
    this.note.hidden = time === "residual";
    const { settings } = this.chart;
    settings.label = time === "residual" ? "Step response" : VIEWS[time].title;
    settings.yName = { name: time === "residual" ? "step response" : LOOP_LINES[time].name, unit: "" };
    this.chart.view = { x: null, y: null };
    this.chart.bands = [];
  }

  /** A response of the closed loop, as Python has it. @param {"command" | "disturbance" | "noise"} time */
  drawLoop(time) {
    const { palette, views, design } = this.app;
    const answer = views.found.responses;
    const { name, colour: key, words } = LOOP_LINES[time];
    const colour = palette[key];
    const { t, message, noise_sd: sd } = answer ?? { t: [], message: "", noise_sd: null };
    const { value = [], low, high } = answer?.[time] ?? {};
    const x = time === "noise" && answer?.dt ? t.map((each) => each - Number(answer.dt)) : t;
    this.chart.bands = low && high ? [{ x, low, high, colour }] : [];
    const wanted = time === "noise" ? [0, 0] : [0, 1];
    const [least, most] = spanOf(wanted[0], wanted[1], [value, low ?? [], high ?? []]);
    const room = ROOM * (most - least || 1);
    const end = x[x.length - 1] || 1;
    this.axis(end);
    this.chart.range(least - room, most + room, design.dragging);
    Object.assign(this.chart, { x: [0, end], series: [{ name, x, y: value, colour, width: 2.25 }] });
    const spread = `Standard deviation of the command: ${inUnit(sd, design.unit).join(" ")}.`;
    write(this.note, [words, ...(time === "noise" && sd !== null ? [spread] : []), message].join(" ").trim());
  }

  /** Milliseconds where they read better. @param {number} duration s */
  axis(duration) {
    this.chart.xUnit = duration < 1 ? 1e-3 : 1;
    this.chart.settings.xLabel = duration < 1 ? "t, ms" : "t, s";
  }

  /** @param {Pin[]} pins */
  draw(pins) {
    const { palette, views } = this.app;
    if (views.time === "residual") this.drawStep(pins);
    else this.drawLoop(views.time);
    this.chart.draw(palette);
    this.chart.cursor(this.cursorAt);
    write(this.readout, this.chart.reading());
  }

  /** @param {Pin[]} pins */
  drawStep(pins) {
    const { palette, preview, design } = this.app;
    const { step, duration } = preview;
    /** @type {Series[]} */
    const lines = pins.flatMap(({ step: pinned, name, style: number }) => {
      if (!pinned) return [];
      const { colour, dash } = kept(number);
      const style = { x: pinned.t, colour: palette[colour], dash };
      return [
        { ...style, name: `estimate of ${name}`, y: pinned.F, width: 1.5 },
        { ...style, name: `error of ${name}`, y: pinned.E, width: 1 },
      ];
    });
    lines.push(
      { name: "estimate", x: step.t, y: step.F, colour: palette.F, width: 2.25 },
      { name: "error", x: step.t, y: step.E, colour: palette.E, dash: DASHES.dash, width: 2 },
    );
    const [low, high] = spanOf(
      0,
      1,
      lines.map(({ y }) => y),
    );
    const room = ROOM * (high - low);
    this.axis(duration);
    this.chart.range(low - room, high + room, design.dragging);
    Object.assign(this.chart, { x: [0, duration], series: lines });
  }
}
