/** What the design amounts to, in words: Python's sentences, and what the preview sees before Python has answered. */

import { h, show, write } from "../elements.js";

/** @import { App } from "../designer.js" */
/** @import { Sentence } from "../link.js" */

const UNSTABLE = "Unstable with f̂ fed back, as far as the preview can tell.";

export class Verdict {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {Sentence[]} Python's last */
    this.sentences = [];
    this.text = h("p", { class: "pf-verdict", "data-test": "verdict" }, "…");
    this.late = h(
      "p",
      { class: "pf-late", "data-test": "late", hidden: true },
      "Of the design before: Python is busy.",
    );
    // Read out when a change is complete, not at every move of a drag.
    this.spoken = h("div", { class: "pf-unseen", "aria-live": "polite", "data-test": "verdict-spoken" });
    this.messages = h("ul", { class: "pf-messages", "data-test": "messages" });
    this.element = h("div", { class: "pf-verdict-box" }, this.text, this.late, this.messages, this.spoken);
  }

  /** @param {Sentence[]} sentences @param {string[]} messages */
  answered(sentences, messages) {
    this.sentences = sentences;
    this.messages.replaceChildren(...messages.map((text) => h("li", {}, `⚠ ${text}`)));
  }

  /** What is wrong with the design as it is now; empty where nothing is known to be. */
  get problems() {
    const { stale, preview } = this.app;
    if (stale && preview.stable === false) return [UNSTABLE];
    return this.sentences.filter(({ level }) => level === "bad").map(({ text }) => text);
  }

  /** @param {boolean} busy whether Python takes its time */
  showBusy(busy) {
    show(this.late, busy && this.app.stale);
  }

  show() {
    const { stale, preview, design } = this.app;
    const sentences = /** @type {Sentence[]} */ (
      stale && preview.stable === false ? [{ text: UNSTABLE, level: "bad" }] : this.sentences
    );
    const bad = sentences.some(({ level }) => level === "bad");
    this.element.classList.toggle("pf-bad-verdict", bad);
    this.text.classList.toggle("pf-waiting", stale);
    const shown = sentences.map(({ text }) => text).join(" ");
    if (this.text.textContent !== shown && sentences.length)
      this.text.replaceChildren(
        ...sentences.flatMap(({ text, level }, i) => [i ? " " : "", h("span", { class: `pf-is-${level}` }, text)]),
      );
    if (!stale && !design.dragging) write(this.spoken, shown);
  }
}
