/** A recording: what the design makes of it, and learning from it. */

import { h } from "../elements.js";
import { picker } from "../files.js";
import { inUnit, largest, short, smallest } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { marking } from "../plots/marking.js";
import { DASHES, swatch } from "../plots/styles.js";
import { Learning } from "./learning.js";
import { button, card } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Estimate, LogSummary, Samples } from "../link.js" */
/** @import { Series } from "../plots/chart.js" */

const LOGS = ".csv,.txt,.tsv,.dat,.parquet,.arrow,.feather,.mat,.h5,.hdf5,.ulg,.bin,.bag,.mcap,.db3,.toml";
const AT_ONCE = 300_000; // samples: more are run over in the background
const PENDING = 200; // ms between looks at that
const LEAST_SAMPLES = 10; // that are drawn
const ROOM = 0.06; // above and below the curves, in parts of their height
const WIENER =
  "Wiener filter: about the least that a causal linear filter can reach. Every block of the log is scored by one " +
  "fitted to the others, so a filter learned from all of it can come out slightly below.";
const LINES = /** @type {const} */ ([
  { key: "label", name: "label", text: "label, the truth", colour: "L", dash: DASHES.solid, width: 3 },
  { key: "f_theta", name: "f_θ", text: "f_θ, the model", colour: "M", dash: DASHES.dot, width: 1.5 },
  { key: "f_hat", name: "f̂", text: "f̂, the estimate", colour: "F", dash: DASHES.solid, width: 1.5 },
]);
// In the order that they are read out.
const READ = [LINES[2], LINES[0], LINES[1]];

export class LogCard {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {LogSummary | null} */
    this.log = null;
    this.channel = 0;
    /** @type {Estimate | null} */
    this.estimate = null;
    /** Of the whole log, for what is not there yet of a part. @type {Estimate | null} */
    this.overview = null;
    /** @type {Estimate | null} the one that is drawn */
    this.drawn = null;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.again = undefined;
    this.askedAt = 0;
    /** @type {[number, number] | null} times in s that are drawn, null: all */
    this.window = null;
    /** @type {[number, number] | null} first and last time */
    this.whole = null;
    /** Times since 1970, say, are shown from the first one on. */
    this.start = 0;
    /** @type {number | null} s, on the axis */
    this.cursorAt = null;
    const onCursor = (/** @type {number | null} */ t) => {
      this.cursorAt = t;
      app.paint();
    };
    const marked = (/** @type {number} */ low, /** @type {number} */ high) =>
      this.showPart(this.start + low, this.start + high);
    this.chart = new Chart({
      test: "log-plot",
      label: "Estimate on the log",
      height: 230,
      xLabel: "t, s",
      yLabel: "f",
      drag: "mark",
      onCursor,
      onWindow: (part) => (part ? marked(...part) : this.showWhole()),
      changed: () => app.paint(),
    });
    marking(this.chart, { able: () => this.estimate !== null, marked, all: () => this.showWhole() });
    this.learning = new Learning(app, () => void this.ask());
    this.summary = h("p", { class: "pf-log-summary", "data-test": "log" });
    // It scrolls where there is little room: the keyboard must reach it.
    this.rmse = h("div", {
      class: "pf-errors",
      tabindex: 0,
      role: "group",
      "aria-label": "Errors on the log",
      "data-test": "rmse",
    });
    this.legend = h("div", { class: "pf-legends" });
    this.readout = h("span", { class: "pf-readout" });
    this.drop = dropArea(app);
    this.channels = h("select", {
      "data-test": "channel",
      "aria-label": "Channel",
      onchange: () => this.choose(Number(this.channels.value)),
    });
    this.forget = button("forget", "Close the log", () => void this.close());
    this.all = button("log-whole", "Whole", () => this.showWhole(), {
      title: "Draw the whole log; or double-click the plot",
    });
    const bar = h("div", { class: "pf-bar" }, this.legend, this.readout, this.parts());
    const left = h("div", { class: "pf-log-left" }, bar, this.chart.element, this.rmse);
    this.body = h("div", { class: "pf-log-body" }, left, this.learning.element);
    this.measure = button("measured", "Use its step, slope and noise", () => void this.takeMeasured(), {
      title: "Take the log's sampling step, the largest slope of f and the noise of x as the design's assumptions",
    });
    this.notes = h("p", { class: "pf-note", "data-test": "log-notes" });
    left.append(this.notes);
    const side = [this.summary, this.channels, this.measure, this.forget];
    this.element = card("Log", [this.drop, this.body], { test: "log-card", side, className: "pf-log-card" });
  }

  /** Buttons for the part that is drawn. */
  parts() {
    const part = (
      /** @type {string} */ test,
      /** @type {string} */ text,
      /** @type {string} */ words,
      /** @type {number} */ factor,
      /** @type {number} */ shift,
    ) =>
      button(test, text, () => this.movePart(factor, shift), { class: "pf-icon", "aria-label": words, title: words });
    return h(
      "div",
      { class: "pf-group pf-right", role: "group", "aria-label": "Part of the log that is drawn" },
      part("log-earlier", "‹", "Earlier", 1, -0.5),
      part("log-later", "›", "Later", 1, 0.5),
      part("log-out", "−", "Draw a longer part", 2, 0),
      part("log-in", "+", "Draw a shorter part, or mark it in the plot", 0.5, 0),
      this.all,
    );
  }

  // -- which log, and what of it ----------------------------------------------------------------------------------

  /** @param {LogSummary | null} log */
  open(log) {
    this.log = log;
    this.channel = 0;
    this.estimate = null;
    this.overview = null;
    clearTimeout(this.again);
    this.window = null;
    this.whole = null;
    this.drop.hidden = log !== null;
    this.body.hidden = log === null;
    this.element.classList.toggle("pf-empty", log === null);
    this.forget.hidden = log === null;
    this.measure.hidden = log === null;
    this.notes.textContent = log?.messages?.join(" ") ?? "";
    this.channels.hidden = log === null || log.channels.length < 2;
    this.summary.textContent = log
      ? `${log.name}: ${log.samples} samples, ${inUnit(log.dt, "s").join(" ")}${log.has_label ? "" : ", no label"}`
      : "";
    if (log) this.channels.replaceChildren(...log.channels.map((name, i) => h("option", { value: i }, name)));
    this.rmse.replaceChildren();
    this.learning.open(log);
    if (log) void this.ask();
    this.app.paint();
  }

  async close() {
    const { app } = this;
    if (this.learning.job !== null) await this.learning.cancel();
    if (!app.ok(await app.link.ask("forget"))) return;
    app.session.opened(null, null);
    this.open(null);
  }

  /** @param {number} channel */
  choose(channel) {
    this.channel = channel;
    this.overview = null;
    void this.ask();
  }

  /** What the design estimates on the log. */
  async ask() {
    // Over a long log an estimate takes a second: it follows when the design is let go.
    if (this.app.design.dragging && this.long()) return;
    clearTimeout(this.again);
    this.askedAt = performance.now();
    const fields = {
      design: this.app.design.data(),
      channel: this.channel,
      ...(this.window ? { window: this.window } : {}),
    };
    const reply = await this.app.link.ask("estimate", fields, { latest: true });
    if (!reply || !this.log) return;
    this.estimate = this.app.ok(reply) ? reply : null;
    if (reply.ok) this.whole ??= [reply.t[0], reply.t[reply.t.length - 1]];
    if (!fields.window) this.overview = this.estimate;
    if (reply.ok && reply.pending) this.again = setTimeout(() => void this.ask(), PENDING);
    this.show();
    this.app.paint();
  }

  /** Whether what is drawn is more than Python runs over at once. */
  long() {
    const { log, window } = this;
    const share = window && this.whole ? (window[1] - window[0]) / (this.whole[1] - this.whole[0]) : 1;
    return log !== null && share * log.samples > AT_ONCE;
  }

  /** Draw a part of the log, or all of it. @param {number} low s @param {number} high s */
  showPart(low, high) {
    if (!this.whole || !this.log) return;
    const [first, last] = this.whole;
    const span = Math.min(Math.max(high - low, LEAST_SAMPLES * this.log.dt), last - first);
    const from = Math.min(Math.max((low + high - span) / 2, first), last - span);
    this.window = span >= 0.999 * (last - first) ? null : [from, from + span];
    this.app.paint(); // what is known already; what is asked for follows
    void this.ask();
  }

  showWhole() {
    if (this.whole) this.showPart(...this.whole);
  }

  /** Move or scale the part that is drawn. @param {number} factor @param {number} shift in parts of its width */
  movePart(factor, shift) {
    const part = this.window ?? this.whole;
    if (!part) return;
    const [low, high] = part;
    const middle = (low + high) / 2 + shift * (high - low);
    const half = (factor * (high - low)) / 2;
    this.showPart(middle - half, middle + half);
  }

  /** Sampling and assumptions of the design out of the log. */
  async takeMeasured() {
    const { app } = this;
    const reply = await app.link.ask("measured", { channel: this.channel });
    if (!app.ok(reply)) return;
    const { design } = app;
    const { sampling, assume, ...rest } = design.data();
    const { dt, slope, noise, messages } = reply;
    const taken = { sampling: { ...sampling, dt }, assume: { ...assume, slope, noise } };
    design.adopt({ ...rest, ...taken }, design.family);
    this.notes.textContent = messages.join(" ");
    app.say("Step, slope and noise are those of the log; undo brings the ones before back.");
  }

  // -- showing ----------------------------------------------------------------------------------------------------

  show() {
    const { estimate } = this;
    const { unit } = this.app.design;
    const figures = [
      { text: "RMSE of f̂", value: estimate?.rmse, title: "Root mean square of label − f̂ over the log" },
      {
        text: "of the model alone",
        value: estimate?.rmse_model,
        title: "Root mean square of label − f_θ over the log",
      },
      { text: "Wiener filter, held out", value: estimate?.wiener, title: WIENER },
    ].filter(({ value }) => typeof value === "number");
    this.all.disabled = !this.window;
    const list = h(
      "dl",
      { class: "pf-rmse" },
      ...figures.map(({ text, value, title }) =>
        h("div", { title }, h("dt", {}, text), h("dd", {}, `${short(value)} ${unit}`)),
      ),
    );
    this.rmse.replaceChildren(list);
    const messages = [...(estimate?.messages ?? [])];
    if (estimate?.pending) messages.push(`Running the filter over ${this.log?.samples} samples …`);
    if (figures.length && estimate?.over)
      messages.push(`RMSEs: ${this.log?.channels[this.channel]}, ${estimate.over}.`);
    if (typeof estimate?.wiener === "number") messages.push(WIENER);
    if (messages.length) this.rmse.append(h("p", { class: "pf-note" }, messages.join(" ")));
    const lines = LINES.filter(({ key }) => estimate?.[key]);
    this.legend.replaceChildren(
      ...lines.map(({ text, colour, dash }) =>
        h("span", { class: "pf-legend" }, swatch(`pf-stroke-${colour}`, dash), text),
      ),
    );
  }

  draw() {
    const { palette, design } = this.app;
    // In a drag only a new estimate changes anything here.
    if (design.dragging && this.drawn === this.estimate) return;
    this.drawn = this.estimate;
    const shown = this.covers(this.estimate) ? this.estimate : this.overview;
    const series = shown ? this.series(shown) : [];
    this.chart.settings.xLabel = this.start ? `t − ${this.start}, s` : "t, s";
    this.chart.settings.yLabel = design.assume.unit ? `f, ${design.assume.unit}` : "f";
    this.chart.series = series;
    this.chart.draw(palette);
    this.chart.cursor(this.cursorAt);
    this.read();
    this.learning.draw();
  }

  /** Whether samples reach over what is to be drawn. @param {Estimate | null} estimate */
  covers(estimate) {
    if (!estimate || !this.window) return estimate !== null;
    const { t } = estimate;
    const slack = 2 * (this.log?.dt ?? 0);
    return t[0] <= this.window[0] + slack && t[t.length - 1] >= this.window[1] - slack;
  }

  /** Curves of an estimate, on axes that hold them. @param {Estimate} estimate @returns {Series[]} */
  series(estimate) {
    const { palette } = this.app;
    const [first, last] = this.whole ?? [0, 0];
    this.start = Math.abs(first) > 100 * (last - first) ? first : 0;
    const x = this.start ? estimate.t.map((t) => t - this.start) : estimate.t;
    const wanted = this.window?.map((t) => t - this.start);
    const lines = LINES.flatMap(({ key, text, colour, dash, width }) => {
      const y = estimate[key];
      return y ? [{ name: text, x, y, colour: palette[colour], dash, width }] : [];
    });
    const [low, high] = [Math.min(...lines.map(({ y }) => smallest(y))), Math.max(...lines.map(({ y }) => largest(y)))];
    const room = ROOM * (high - low || 1);
    const inside = wanted && x[x.length - 1] > wanted[0] && x[0] < wanted[1];
    Object.assign(this.chart, { x: inside ? wanted : [x[0], x[x.length - 1]], y: [low - room, high + room] });
    return lines;
  }

  /** What the curves are where the mouse is. */
  read() {
    const { estimate, cursorAt } = this;
    const at = estimate && cursorAt !== null ? estimate.t.findIndex((t) => t >= cursorAt + this.start) : -1;
    if (!estimate || at < 0) {
      this.readout.textContent = "";
      return;
    }
    const value = (/** @type {Samples | null | undefined} */ samples, /** @type {string} */ name) =>
      samples ? `   ${name} ${short(samples[at], 3)}` : "";
    const values = READ.map(({ key, name }) => value(estimate[key], name)).join("");
    this.readout.textContent = `t ${short(estimate.t[at] - this.start, 4)} s${values}`;
  }
}

/** Where a log is dropped, or picked. @param {App} app */
function dropArea(app) {
  const words =
    "or pick a file: CSV and other tables, logs of PX4, ArduPilot, ROS or a Crazyflie. You say which column is what.";
  const file = picker(app, LOGS, "log-file", "Pick a recorded log");
  const title = h("strong", {}, "Drop a recorded log here");
  const area = h("label", { class: "pf-drop", "data-test": "drop" }, title, h("span", {}, words), file);
  const example = button("example", "Try a simulated flight", () => void openExample(app));
  return h("div", { class: "pf-drop-row" }, area, example);
}

/** @param {App} app */
async function openExample(app) {
  app.say("Simulating a flight …");
  const reply = await app.link.ask("example");
  if (!app.ok(reply)) return;
  app.openLog({ ...reply.log, messages: reply.messages });
  app.say(`Opened ${reply.log.name}.`);
}
