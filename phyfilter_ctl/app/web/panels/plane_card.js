/** The s-plane with its tools. */

import { h, write } from "../elements.js";
import { Plane } from "../plots/plane.js";
import { sizeOf } from "../state/roots.js";
import { button, card, group } from "./parts.js";
import { PlaneOverlays } from "./plane_overlays.js";

/** @import { App } from "../designer.js" */

const FAR_APART = 15; // ratio from which the slowest poles crowd at the origin
const HINT = "Drag a pole ×; double-click adds one";
const STEP = 1.5; // of a zoom

export class PlaneCard {
  /** @param {App} app */
  constructor(app) {
    this.design = app.design;
    this.hovered = "";
    const hover = (/** @type {string} */ text) => {
      this.hovered = text;
      this.showText();
    };
    const plane = new Plane(app.design, { say: (text) => app.say(text, "warn"), hover, refit: () => app.paint() });
    this.plane = plane;
    this.overlays = new PlaneOverlays(app, plane);
    this.readout = h("p", { class: "pf-readout", "data-test": "plane-readout" }, HINT);
    this.delete = button("delete", "Delete", () => app.design.remove(), { title: "Delete the selected one, Del" });
    const log = button(
      "plane-log",
      "log",
      () => {
        plane.view.log = !plane.view.log;
        log.setAttribute("aria-pressed", String(plane.view.log));
        plane.fit();
      },
      { "aria-pressed": "false", title: "Distance from the origin in decades; directions stay" },
    );
    const out = button("zoom-out", "−", () => plane.zoom(STEP), {
      class: "pf-icon",
      "aria-label": "Zoom out",
      title: "Zoom out, or Ctrl and the wheel",
    });
    const into = button("zoom-in", "+", () => plane.zoom(1 / STEP), {
      class: "pf-icon",
      "aria-label": "Zoom in",
      title: "Zoom in, or Ctrl and the wheel",
    });
    const fit = button("fit", "Fit", () => plane.fit(), { title: "Show all poles and zeros" });
    this.element = card(
      "Poles and zeros",
      [plane.element, h("div", { class: "pf-below-plane" }, this.readout), this.tools(), this.overlays.element],
      {
        side: [group({}, out, into, fit, log)],
        className: "pf-plane-card",
      },
    );
  }

  tools() {
    const { design } = this;
    const pole = button("add-pole", "+ pole", () => design.add("pole"), { title: "Or double-click the plane" });
    const pair = button("add-pair", "+ pair", () => design.add("pair"), { title: "Two conjugate poles" });
    const zero = button("add-zero", "+ zero", () => design.add("zero"), {
      title: "A zero of F; or double-click with Alt",
    });
    return h(
      "div",
      { class: "pf-bar" },
      group({}, pole, pair, zero),
      group({ class: "pf-group pf-right" }, this.delete),
    );
  }

  /** Where the mouse is; else what can be done. */
  showText() {
    const sizes = this.design.poles.map(sizeOf);
    const apart = !this.plane.view.log && Math.max(...sizes) > FAR_APART * Math.min(...sizes);
    write(this.readout, this.hovered || (apart ? "Poles far apart: “log” shows each" : HINT));
  }

  show() {
    const { sampling, chosen } = this.design;
    this.plane.euler = sampling.method === "euler" ? sampling.dt : null;
    this.plane.draw();
    this.overlays.draw();
    this.showText();
    this.delete.disabled = !chosen;
  }
}
