/** The line below everything that says what happens, and a list of what it said. */

import { h } from "../elements.js";
import { dialog } from "./dialog.js";
import { button } from "./parts.js";

/** @typedef {"" | "warn" | "error"} Level */

const MOST_KEPT = 100;

export class Status {
  constructor() {
    this.text = h("p", { class: "pf-status", role: "status", "aria-live": "polite", "data-test": "status" });
    this.failed = false;
    /** @type {{text: string, level: Level, at: Date}[]} */
    this.said = [];
    this.dismiss = button("status-dismiss", "✕", () => this.clear(), {
      class: "pf-icon pf-quiet",
      "aria-label": "Dismiss the message",
      hidden: true,
    });
    this.open = button("messages-open", "Messages", () => void this.list(), { "aria-haspopup": "dialog" });
    this.element = h("footer", { class: "pf-status-bar" }, this.text, this.dismiss, this.open);
  }

  /** @param {string} text @param {Level} [level] */
  say(text, level = "") {
    this.failed = level === "error";
    this.text.textContent = text;
    this.element.className = `pf-status-bar ${level ? `pf-${level}` : ""}`;
    this.dismiss.hidden = !text;
    if (!text) return;
    this.said.push({ text, level, at: new Date() });
    if (this.said.length > MOST_KEPT) this.said.shift();
  }

  clear() {
    this.say("");
    this.open.focus(); // the button that was pressed is gone
  }

  /** What was said, the newest first. */
  async list() {
    const names = { "": "", warn: "Warning. ", error: "Error. " };
    const rows = this.said
      .map(({ text, level, at }) =>
        h(
          "li",
          { class: level ? `pf-${level}` : "" },
          h("time", {}, at.toLocaleTimeString()),
          h("span", {}, names[level] + text),
        ),
      )
      .reverse();
    const body = h("ul", { class: "pf-said", "data-test": "messages-list", tabindex: 0 }, ...rows);
    await dialog(this.element, {
      test: "messages-dialog",
      title: "Messages",
      body: [body],
      answers: { close: "Close" },
    });
  }
}
