/** The answer to a unit step. */

import { h } from "../elements.js";
import { inUnit, largest, short, smallest } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { CURVES, DASHES, PIN_DASHES, swatch } from "../plots/styles.js";
import { card } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Series } from "../plots/chart.js" */
/** @import { Pin } from "../state/preview.js" */

const ROOM = 0.06; // above and below the curves, in parts of their height

export class StepCard {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {number | null} in the unit of the axis */
    this.cursorAt = null;
    const onCursor = (/** @type {number | null} */ t) => {
      this.cursorAt = t;
      app.paint();
    };
    this.chart = new Chart({ test: "step", label: "Step response", height: 210, xLabel: "t, s", yLabel: "", onCursor });
    this.readout = h("span", { class: "pf-readout" });
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
    // Milliseconds where they read better.
    const scale = duration < 1 ? 1e3 : 1;
    const times = (/** @type {Float64Array} */ t) => t.map((value) => value * scale);
    /** @type {Series[]} */
    const lines = pins.flatMap((pin, i) => {
      if (!pin.step) return [];
      const style = { x: times(pin.step.t), colour: palette.pin, dash: PIN_DASHES[i] };
      return [
        { ...style, y: pin.step.F, width: 1.5 },
        { ...style, y: pin.step.E, width: 1 },
      ];
    });
    const x = times(step.t);
    lines.push(
      { x, y: step.F, colour: palette.F, width: 2.25 },
      { x, y: step.E, colour: palette.E, dash: DASHES.dash, width: 2 },
    );
    const [low, high] = [
      Math.min(0, ...lines.map(({ y }) => smallest(y))),
      Math.max(1, ...lines.map(({ y }) => largest(y))),
    ];
    const room = ROOM * (high - low);
    this.chart.settings.xLabel = scale === 1 ? "t, s" : "t, ms";
    this.chart.range(low - room, high + room, design.dragging);
    Object.assign(this.chart, { x: [0, duration * scale], series: lines });
    this.chart.draw(palette);
    this.chart.cursor(this.cursorAt);
    this.read(scale);
  }

  /** What the curves are where the mouse is. @param {number} scale of the axis over s */
  read(scale) {
    const { step, duration } = this.app.preview;
    const at = this.cursorAt === null ? -1 : Math.round((this.cursorAt / scale / duration) * (step.t.length - 1));
    const inside = at >= 0 && at < step.t.length;
    this.readout.textContent = inside
      ? `t ${inUnit(step.t[at], "s").join(" ")}   estimate ${short(step.F[at], 3)}   error ${short(step.E[at], 3)}`
      : "";
  }
}
