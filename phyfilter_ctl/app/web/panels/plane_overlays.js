/** What is laid over the s-plane: loci of the closed loop's poles, and the region where poles are wanted. */

import { h, show, write } from "../elements.js";
import { field, short } from "../numbers.js";
import { locusPaths, regionShades } from "../plots/plane_locus.js";
import { inRegion, REGION, REGION_KEYS, startRegion } from "../state/region.js";
import { named, numberField, put } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { LocusAnswer } from "../link.js" */
/** @import { Plane } from "../plots/plane.js" */
/** @import { RegionKey } from "../state/region.js" */
/** @import { Locus } from "../state/views.js" */

const LOCI = { none: "none", ratio: "over M̂/M", bandwidth: "over the bandwidth of F" };

export class PlaneOverlays {
  /** @param {App} app @param {Plane} plane */
  constructor(app, plane) {
    this.app = app;
    this.plane = plane;
    this.drawn = "";
    /** @type {LocusAnswer | null} that is drawn */
    this.answer = null;
    this.locus = h(
      "select",
      { "data-test": "locus", onchange: () => app.views.choose({ locus: /** @type {Locus} */ (this.locus.value) }) },
      ...Object.entries(LOCI).map(([key, text]) => h("option", { value: key }, text)),
    );
    this.note = h("p", { class: "pf-note", "data-test": "locus-note", hidden: true });
    this.fields = REGION_KEYS.map((key) => this.field(key));
    this.summary = h("summary", { "data-test": "region" }, "Region where poles are wanted");
    const words =
      "Overshoot and settling as of one dominant pair of poles without zeros. An empty field wants nothing.";
    const fields = h("div", { class: "pf-region-fields" }, ...this.fields.map(({ element }) => element));
    this.details = h("details", { class: "pf-region-card" }, this.summary, fields, h("p", { class: "pf-note" }, words));
    this.element = h("div", {}, named("Poles of the closed loop", this.locus), this.note, this.details);
    app.views.listeners.push(() => this.showView());
    this.showView();
  }

  showView() {
    this.locus.value = this.app.views.locus;
  }

  /** @param {RegionKey} key */
  field(key) {
    const { text, unit, factor, range, title } = REGION[key];
    const { views } = this.app;
    const set = (/** @type {number | null} */ value) => {
      views.region = { ...views.region, [key]: value };
      views.changed();
      this.app.session.changed();
    };
    const entry = numberField(
      this.app,
      `region-${key}`,
      text,
      unit,
      (value) => {
        const [low, high] = range.map((each) => each * factor);
        if (!(value >= low && value <= high))
          return `${text}: expected ${short(low)} to ${short(high)} ${unit}, got ${short(value)}.`;
        set(value / factor);
        return "";
      },
      title,
    );
    // Emptied: nothing is wanted. Before the field's own listener, which expects a number.
    entry.input.addEventListener(
      "change",
      (event) => {
        if (entry.input.value.trim()) return;
        event.stopImmediatePropagation();
        entry.input.removeAttribute("aria-invalid");
        set(null);
      },
      { capture: true },
    );
    return { key, ...entry };
  }

  /** Beside poles and zeros, in the plane. */
  draw() {
    const { app, plane } = this;
    const { view } = plane;
    const { region, locus, found } = app.views;
    for (const { key, input } of this.fields) {
      const value = region[key];
      put(input, value === null ? "" : field(value * REGION[key].factor), false);
    }
    this.count();
    const answer = locus === "none" ? null : found.locus;
    show(this.note, locus !== "none");
    write(this.note, answer ? this.words() : "…");
    const at = [view.width, view.height, view.log, view.radius, view.decades];
    if (view.width && (this.answer !== answer || this.drawn !== JSON.stringify([at, region]))) {
      this.answer = answer;
      this.drawn = JSON.stringify([at, region]);
      plane.region.replaceChildren(...regionShades(view, region));
      plane.locus.replaceChildren(...(answer ? locusPaths(view, answer, locus === "bandwidth" ? " ×" : "") : []));
    }
  }

  /** What the locus says. */
  words() {
    const { locus, found } = this.app.views;
    if (!found.locus) return "…";
    const { message, limits, at, now } = found.locus;
    if (message) return message;
    const what = locus === "ratio" ? "M̂/M" : "Bandwidth times";
    const ends = limits.map((each) => `${short(each.at, 4)} (${short(each.omega, 4)} rad/s)`);
    const lost = now.some(([re]) => re >= 0) ? "⚠ Unstable as it is. " : "";
    const range = `${what} ${short(at[0], 3)} to ${short(at[at.length - 1], 3)}`;
    const crossed = ends.length ? `the axis is crossed at ${ends.join(", ")}` : "the axis is not crossed";
    return `${lost}${range}: ${crossed}. Squares: the loop as it is, sampled poles z drawn at log(z)/h.`;
  }

  /** How many poles are where they are wanted. */
  count() {
    const { design, views } = this.app;
    const { region } = views;
    const wanted = JSON.stringify(region) !== JSON.stringify(startRegion());
    const poles = design.poles.flatMap((pole) => (pole.im ? [pole, pole] : [pole]));
    const outside = poles.filter((pole) => !inRegion(region, pole)).length;
    const words = outside ? `⚠ ${outside} of ${poles.length} poles outside` : "all poles inside";
    write(this.summary, `Region where poles are wanted${wanted ? `: ${words}` : ""}`);
    this.summary.classList.toggle("pf-violated", wanted && outside > 0);
  }
}
