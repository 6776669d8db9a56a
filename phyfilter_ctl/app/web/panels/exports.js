/** What a design leaves as: FMUs, C, packages for targets, the filter file. */

import { h } from "../elements.js";
import { download } from "../files.js";
import { confirmExport } from "./confirm.js";
import { button, named } from "./parts.js";
import { Popover } from "../popover.js";

/** @import { App } from "../designer.js" */
/** @import { Exchange } from "../link.js" */

const MOST_CHANNELS = 12;
/** @type {Record<string, Record<string, string>>} */
const GROUPS = {
  "Models and code": { fmu2: "FMU 2", fmu3: "FMU 3", c: "C99", toml: "Filter file" },
  Report: { html: "HTML", pdf: "PDF" },
  "Packages for": {
    arduino: "Arduino",
    ardupilot: "ArduPilot",
    cmake: "CMake",
    crazyflie: "Crazyflie",
    px4: "PX4",
    ros2: "ROS 2",
    rust: "Rust",
    zephyr: "Zephyr",
  },
};
/** @type {Record<string, string>} */
const NAMES = Object.assign({}, ...Object.values(GROUPS));

export class Exports {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Why a kind cannot be had. @type {Map<string, string>} */
    this.refused = new Map();
    this.name = h("input", {
      type: "text",
      maxlength: 60,
      spellcheck: "false",
      "data-test": "export-name",
      "aria-label": "Name of what is exported",
    });
    this.channels = h("input", {
      type: "number",
      min: 1,
      max: MOST_CHANNELS,
      value: 1,
      "aria-label": "Channels of the export",
      "data-test": "channels",
    });
    /** Whether the number was chosen here; else it is that of the design or of the open log. */
    this.chosen = false;
    this.channels.addEventListener("change", () => {
      this.chosen = true;
      void this.ask();
    });
    this.why = h("ul", { class: "pf-refusals", "data-test": "export-refusals", role: "status" });
    this.buttons = new Map(
      Object.keys(NAMES).map((kind) => [kind, button(`export-${kind}`, NAMES[kind], () => void this.take(kind))]),
    );
    const groups = Object.entries(GROUPS).map(([title, kinds]) =>
      h(
        "div",
        { class: "pf-kinds", role: "group", "aria-label": title },
        h("span", { class: "pf-group-name" }, title),
        ...Object.keys(kinds).map((kind) => /** @type {HTMLElement} */ (this.buttons.get(kind))),
      ),
    );
    const fields = [
      named("Name", this.name),
      named("Channels of x", this.channels, { title: "One filter for each channel" }),
    ];
    this.popover = new Popover("export", "Export", [...fields, ...groups, this.why], {
      given: { class: "pf-primary", title: "FMU, C, filter file, packages for targets" },
      opened: () => void this.ask(),
    });
    this.element = this.popover.element;
    app.session.part("exports", { get: () => this.get(), set: (kept) => this.set(kept) });
    for (const each of [this.name, this.channels]) each.addEventListener("change", () => app.session.changed());
  }

  /** Number of channels, as Python takes it. */
  count() {
    const count = Math.min(Math.max(Math.round(Number(this.channels.value)) || 1, 1), MOST_CHANNELS);
    this.channels.value = String(count);
    return count;
  }

  /** Number of channels that was chosen; null: Python takes that of the design, of the open log, or 1. */
  asked() {
    return this.chosen ? this.count() : null;
  }

  /** What Python can make of the design as it is. */
  async ask() {
    const { app } = this;
    const reply = await app.link.ask(
      "exports",
      { design: app.design.data(), channels: this.asked() },
      { latest: true },
    );
    if (app.ok(reply)) this.show(reply);
  }

  /** @param {Exchange} exchange */
  show({ name, exports, channels }) {
    this.name.placeholder = name;
    if (!this.chosen) this.channels.value = String(channels);
    this.refused = new Map(exports.filter(({ able }) => !able).map(({ kind, why }) => [kind, why]));
    for (const [kind, each] of this.buttons) {
      each.setAttribute("aria-disabled", String(this.refused.has(kind)));
      each.title = this.refused.get(kind) ?? "";
    }
    /** @type {Map<string, string[]>} */
    const reasons = new Map();
    for (const [kind, why] of this.refused) reasons.set(why, [...(reasons.get(why) ?? []), NAMES[kind]]);
    this.why.replaceChildren(
      ...[...reasons].map(([why, kinds]) => h("li", {}, h("b", {}, `${kinds.join(", ")}: `), why)),
    );
  }

  /** @param {string} kind */
  async take(kind) {
    const { app } = this;
    const why = this.refused.get(kind);
    if (why) {
      app.say(`${NAMES[kind]}: ${why}`, "warn");
      return;
    }
    this.popover.close();
    if (!(await confirmExport(app))) return;
    const asked = { design: app.design.data(), name: this.name.value.trim() };
    app.say(kind.startsWith("fmu") ? "Building the FMU …" : "Writing …");
    const reply = ["html", "pdf"].includes(kind)
      ? await app.link.ask("report", { ...asked, format: kind })
      : kind === "toml"
        ? await app.link.ask("save", asked)
        : await app.link.ask("export", { ...asked, kind, channels: this.asked() });
    if (app.ok(reply)) download(app, reply);
  }

  // -- kept in the session ----------------------------------------------------------------------------------------

  get() {
    return { name: this.name.value, channels: this.asked() };
  }

  /** @param {any} kept */
  set(kept) {
    this.name.value = typeof kept?.name === "string" ? kept.name.slice(0, 60) : "";
    this.chosen = Number(kept?.channels) > 1;
    this.channels.value = String(Number(kept?.channels) || 1);
    this.count();
  }
}
