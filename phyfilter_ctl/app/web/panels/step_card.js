/** The answer to a unit step. */

import { h, write } from "../elements.js";
import { largest, smallest } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { CURVES, DASHES, kept, swatch } from "../plots/styles.js";
import { card } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Series } from "../plots/chart.js" */
/** @import { Pin } from "../state/preview.js" */

const ROOM = 0.06; // above and below the curves, in parts of their height

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
      yName: { name: "response to a unit step", unit: "" },
      onCursor,
      changed: () => app.paint(),
    });
    this.readout = h("span", { class: "pf-readout", "data-test": "step-readout" });
    const item = (/** @type {"F" | "E"} */ key, /** @type {string} */ text) =>
      h("span", { class: "pf-legend" }, swatch(`pf-stroke-${CURVES[key].colour}`, CURVES[key].dash), text);
    const bar = h(
      "div",
      { class: "pf-bar" },
      h("div", { class: "pf-legends" }, item("F", "estimate"), item("E", "error")),
      this.readout,
    );
    this.element = card("Answer to a unit step of the residual", [bar, this.chart.element]);
  }

  /** @param {Pin[]} pins */
  draw(pins) {
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
    const [low, high] = [
      Math.min(0, ...lines.map(({ y }) => smallest(y))),
      Math.max(1, ...lines.map(({ y }) => largest(y))),
    ];
    const room = ROOM * (high - low);
    // Milliseconds where they read better.
    this.chart.xUnit = duration < 1 ? 1e-3 : 1;
    this.chart.settings.xLabel = duration < 1 ? "t, ms" : "t, s";
    this.chart.range(low - room, high + room, design.dragging);
    Object.assign(this.chart, { x: [0, duration], series: lines });
    this.chart.draw(palette);
    this.chart.cursor(this.cursorAt);
    write(this.readout, this.chart.reading());
  }
}
