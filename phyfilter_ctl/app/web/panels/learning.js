/** Learning a filter from the log, in a job of Python's. */

import { h } from "../elements.js";
import { LIMITS } from "../mathematics/filter.js";
import { Chart } from "../plots/chart.js";
import { button, named } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Job, LogSummary } from "../link.js" */

const POLL = 250; // ms between looks at a job
const NEEDS_LABEL = "Learning needs a label: the true f, in a column label_x";

export class Learning {
  /** @param {App} app @param {() => void} learned called when a learned design is in place */
  constructor(app, learned) {
    this.app = app;
    this.learned = learned;
    /** @type {LogSummary | null} */
    this.log = null;
    /** @type {number | null} */
    this.job = null;
    /** @type {[number, number][]} improvements and their cost */
    this.curve = [];
    this.closed = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    this.chart = new Chart({
      test: "cost-plot",
      label: "Cost while learning",
      height: 150,
      logY: true,
      xLabel: "improvements",
      yLabel: "RMSE",
    });
    const orders = Array.from({ length: LIMITS.order }, (_, i) =>
      h("option", { value: i + 1, selected: i === 1 }, String(i + 1)),
    );
    this.order = h("select", { "data-test": "learn-order", "aria-label": "Order to learn" }, ...orders);
    const forms = [h("option", { value: "lowpass" }, "low-pass"), h("option", { value: "general" }, "general")];
    this.form = h("select", { "data-test": "learn-form", "aria-label": "Form to learn" }, ...forms);
    this.learnButton = button("learn", "Learn from the log", () => void this.learn(), { class: "pf-primary" });
    this.cancelButton = button("cancel", "Cancel", () => void this.cancel());
    this.message = h("p", { class: "pf-note", "data-test": "learn-message" });
    const buttons = h("div", { class: "pf-bar" }, this.learnButton, this.cancelButton);
    this.element = h(
      "div",
      { class: "pf-learning" },
      h("h3", {}, "Learn"),
      named("Order up to", this.order),
      named("Form", this.form),
      buttons,
      this.message,
      this.chart.element,
    );
  }

  /** Another log, or none. @param {LogSummary | null} log */
  open(log) {
    this.log = log;
    this.curve = [];
    this.message.textContent = "";
    this.show();
  }

  show() {
    const running = this.job !== null;
    const unlabelled = this.log !== null && !this.log.has_label;
    this.learnButton.disabled = running || !this.log?.has_label;
    this.learnButton.title = unlabelled ? NEEDS_LABEL : "";
    this.cancelButton.disabled = !running;
    this.element.classList.toggle("pf-running", running);
    if (unlabelled && !running) this.message.textContent = "This log has no label to learn from: add columns label_x.";
    this.chart.element.hidden = this.curve.length < 1;
  }

  draw() {
    if (!this.curve.length) return;
    const { palette } = this.app;
    const costs = this.curve.map(([, cost]) => cost).filter((cost) => cost > 0);
    const [low, high] = [Math.min(...costs), Math.max(...costs)];
    const last = this.curve[this.curve.length - 1][0];
    Object.assign(this.chart, {
      x: [0, Math.max(last, 1)],
      y: [low / 1.15, Math.max(high * 1.15, low * 1.5)],
      series: [
        {
          name: "RMSE",
          x: this.curve.map(([at]) => at),
          y: this.curve.map(([, cost]) => cost),
          colour: palette.E,
          width: 2.25,
        },
      ],
    });
    this.chart.draw(palette);
  }

  async learn() {
    const { app } = this;
    const reply = await app.link.ask("learn", { order: Number(this.order.value), form: this.form.value });
    if (!app.ok(reply)) return;
    this.job = reply.job;
    this.curve = [];
    this.message.textContent = "learning …";
    this.show();
    this.poll();
  }

  poll() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(), POLL);
  }

  async look() {
    if (this.job === null || this.closed) return;
    const reply = await this.app.link.ask("job", { job: this.job });
    if (this.job === null || this.closed) return;
    if (!this.app.ok(reply)) {
      this.job = null;
      this.show();
      return;
    }
    this.progress(reply);
    if (reply.state === "running") this.poll();
  }

  /** @param {Job} job */
  progress({ state, curve, message, design }) {
    this.curve = curve ?? [];
    this.message.textContent = message ?? state;
    if (state !== "running") {
      this.job = null;
      if (state === "done" && design) {
        const { assume, limits } = this.app.design;
        this.app.design.adopt({ ...design, assume, limits });
        this.app.say("The learned design is in place; undo brings the one before back.");
        this.learned();
      }
      if (state === "failed") this.app.say(message ?? state, "error");
    }
    this.show();
    this.app.paint();
  }

  async cancel() {
    const { job } = this;
    if (job === null) return;
    const reply = await this.app.link.ask("cancel", { job });
    if (!this.app.ok(reply) || this.job !== job) return;
    if (reply.state === "running") this.message.textContent = "stopping …";
    else this.progress(reply);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
  }
}
