/** The top: what is designed, in a line; history, files and exports. */

import { g, h, show, write } from "../elements.js";
import { download, picker } from "../files.js";
import { inUnit, short } from "../numbers.js";
import { Exports } from "./exports.js";
import { button, group } from "./parts.js";

/** @import { App } from "../designer.js" */
export class Header {
  /** @param {App} app @param {{pin: () => void, theme: () => void, save: () => void, arrange: () => void}} does */
  constructor(app, does) {
    this.app = app;
    const { design } = app;
    this.version = h("small", {});
    this.summary = h("p", { class: "pf-summary", "data-test": "summary" });
    this.busy = h("span", { class: "pf-busy", role: "status", "data-test": "busy", hidden: true }, "Python is busy");
    this.undo = button("undo", "↶", () => design.undo(), {
      class: "pf-icon",
      title: "Undo, Ctrl+Z",
      "aria-label": "Undo",
    });
    this.redo = button("redo", "↷", () => design.redo(), {
      class: "pf-icon",
      title: "Redo, Ctrl+Shift+Z",
      "aria-label": "Redo",
    });
    this.exports = new Exports(app);
    this.code = h("pre", { "data-test": "python-text", tabindex: 0 });
    const close = button("python-close", "Close", () => (this.codeBox.hidden = true), { "data-esc": true });
    this.codeBox = h("section", { class: "pf-card pf-code", hidden: true, "aria-label": "Python" }, this.code, close);
    const title = h("h1", {}, "PhyFilter designer", this.version);
    const brand = h("div", { class: "pf-brand" }, logo(), h("div", {}, title, this.summary));
    this.element = h("header", { class: "pf-header" }, brand, this.tools(does));
  }

  /** @param {{pin: () => void, theme: () => void, save: () => void, arrange: () => void}} does */
  tools(does) {
    const named = (/** @type {string} */ label) => ({ role: "group", "aria-label": label });
    const open = h(
      "label",
      { class: "pf-file", "data-test": "open" },
      "Open",
      picker(this.app, ".toml,.json", "open-file", "Open a session or a filter file"),
    );
    const save = button("save", "Save filter", () => void this.save(), { title: "The filter as a TOML file" });
    const session = button("save-session", "Save session", does.save, {
      title: "All of it as a file: design, history, limits, pinned designs; without Python too",
    });
    const python = button("python", "Copy as Python", () => void this.copyPython());
    const pin = button("pin", "Pin", does.pin, { title: "Keep this design to compare with, in a colour of its own" });
    const theme = button("theme", "◐", does.theme, {
      class: "pf-icon",
      title: "Light, dark or as the system",
      "aria-label": "Change between light and dark",
    });
    const panels = button("panels-open", "Panels", does.arrange, {
      "aria-haspopup": "dialog",
      title: "Show, hide and move panels",
    });
    return h(
      "div",
      { class: "pf-tools" },
      group(named("History"), this.undo, this.redo),
      group(named("Compare"), pin),
      group(named("File"), open, session, save, python),
      this.exports.element,
      group(named("View"), panels, theme),
    );
  }

  show() {
    const { filter, history, sampling } = this.app.design;
    this.undo.disabled = !history.past.length;
    this.redo.disabled = !history.future.length;
    const kind = filter.dcGain !== 0 ? "" : "band-pass, ";
    const cutoff = short(this.app.design.cutoff(), 3);
    const step = inUnit(sampling.dt, "s").join(" ");
    write(this.summary, `${kind}order ${filter.order}, type ${filter.type}, ${cutoff} rad/s, h = ${step}`);
  }

  /** @param {number | null} since when the oldest open question was asked */
  showBusy(since) {
    show(this.busy, since !== null);
    if (since === null) return;
    const seconds = (performance.now() - since) / 1000;
    write(this.busy, seconds < 1 ? "Python is busy" : `Python is busy, ${seconds.toFixed(0)} s`);
  }

  // -- handing over -----------------------------------------------------------------------------------------------

  async copyPython() {
    const { app } = this;
    const reply = await app.link.ask("python", { design: app.design.data() });
    if (!app.ok(reply)) return;
    this.code.textContent = reply.text;
    this.codeBox.hidden = false;
    try {
      await navigator.clipboard.writeText(reply.text);
      app.say("Copied as Python.");
    } catch {
      const range = document.createRange();
      range.selectNodeContents(this.code);
      getSelection()?.removeAllRanges();
      getSelection()?.addRange(range);
      app.say("The clipboard is closed to this page: the text is selected, copy it by hand.", "warn");
    }
  }

  async save() {
    const { app } = this;
    const reply = await app.link.ask("save", { design: app.design.data() });
    if (app.ok(reply)) download(app, reply);
  }
}

function logo() {
  const curve = g("path", { d: "M7 10h7c6 0 5 12 12 12", class: "pf-logo-curve" });
  const pole = g("path", { d: "M7 19l5 5m0-5l-5 5", class: "pf-logo-pole" });
  return g(
    "svg",
    { viewBox: "0 0 32 32", class: "pf-logo", "aria-hidden": "true" },
    g("rect", { width: 32, height: 32, rx: 8 }),
    curve,
    pole,
  );
}
