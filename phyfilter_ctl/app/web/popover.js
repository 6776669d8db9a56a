/** A button and what it unfolds: closed by Escape, by a click elsewhere, or when something in it was chosen. */

import { h } from "./elements.js";

/** @import { Given } from "./elements.js" */

const ROOM = 8; // px to the edge of the designer
let made = 0;

export class Popover {
  /**
   * @param {string} test @param {string} text @param {Node[]} body
   * @param {{given?: Record<string, Given>, label?: string, opened?: () => void}} [how]
   */
  constructor(test, text, body, { given = {}, label = text, opened = () => {} } = {}) {
    const id = `pf-popover-${++made}`;
    this.opened = opened;
    this.button = h(
      "button",
      {
        type: "button",
        "data-test": test,
        "aria-expanded": "false",
        "aria-controls": id,
        onclick: () => this.toggle(this.body.hidden),
        ...given,
      },
      text,
    );
    this.body = h(
      "div",
      { id, class: "pf-popover", role: "group", "aria-label": label, hidden: true, "data-test": `${test}-menu` },
      ...body,
    );
    this.element = h("div", { class: "pf-popover-place" }, this.button, this.body);
    this.element.addEventListener("keydown", (event) => this.key(event));
    this.element.addEventListener("focusout", (event) => {
      if (event.relatedTarget instanceof Node && !this.element.contains(event.relatedTarget)) this.toggle(false);
    });
    this.elsewhere = (/** @type {Event} */ event) => {
      if (event.target instanceof Node && !this.element.contains(event.target)) this.toggle(false);
    };
  }

  /** @param {boolean} open */
  toggle(open) {
    if (open !== this.body.hidden) return;
    this.body.hidden = !open;
    this.button.setAttribute("aria-expanded", String(open));
    if (!open) {
      document.removeEventListener("pointerdown", this.elsewhere, true);
      return;
    }
    document.addEventListener("pointerdown", this.elsewhere, true);
    this.place();
    this.opened();
  }

  /** Close, with the focus back on the button. */
  close() {
    if (this.body.contains(document.activeElement)) this.button.focus();
    this.toggle(false);
  }

  /** Within the designer, whatever side of it the button is on. */
  place() {
    const frame = this.element.closest(".pf-designer")?.getBoundingClientRect();
    this.body.style.left = "0px";
    if (!frame) return;
    const { left, right } = this.body.getBoundingClientRect();
    const shift = Math.max(Math.min(0, frame.right - ROOM - right), frame.left + ROOM - left);
    this.body.style.left = `${shift}px`;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (this.body.hidden) return;
    if (event.key === "Escape") {
      event.preventDefault();
      event.stopPropagation();
      this.button.focus();
      this.toggle(false);
      return;
    }
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!by || event.target instanceof HTMLInputElement) return;
    const stops = [.../** @type {NodeListOf<HTMLElement>} */ (this.body.querySelectorAll("button, input"))];
    const next = stops.indexOf(/** @type {HTMLElement} */ (event.target)) + by;
    event.preventDefault();
    stops[(next + stops.length) % stops.length]?.focus();
  }
}
