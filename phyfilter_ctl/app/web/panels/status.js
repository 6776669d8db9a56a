/** The line at the bottom that says what happens. */

import { h } from "../elements.js";

/** @typedef {"" | "warn" | "error"} Level */

const WARNING_STAYS = 9000; // ms
const WORD_STAYS = 5000;

export class Status {
  constructor() {
    this.element = h("p", { class: "pf-status", role: "status", "aria-live": "polite", "data-test": "status" });
    this.failed = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
  }

  /** @param {string} text @param {Level} [level] */
  say(text, level = "") {
    this.failed = level === "error";
    this.element.textContent = text;
    this.element.className = `pf-status ${level ? `pf-${level}` : ""}`;
    clearTimeout(this.timer);
    // What went wrong stays until the next word.
    if (!this.failed)
      this.timer = setTimeout(() => this.element.classList.add("pf-past"), level ? WARNING_STAYS : WORD_STAYS);
  }

  close() {
    clearTimeout(this.timer);
  }
}
