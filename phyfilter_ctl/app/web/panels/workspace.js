/** The panels in their columns: they fill the window, and are moved, hidden and brought back. */

import { follow, h } from "../elements.js";
import { moved, placed, restored, SHARES, SLOTS, slotOf, usual, withShare, withShown } from "../state/layout.js";
import { dialog } from "./dialog.js";
import { button } from "./parts.js";

/** @import { Direction, Layout, Slot } from "../state/layout.js" */
/**
 * @typedef {object} Panel
 * @property {string} id
 * @property {string} name
 * @property {Slot} slot where it is usually
 * @property {HTMLElement} element a card
 * @property {number} [grows] how much of the room that is left it takes
 */
/**
 * @typedef {object} Surroundings
 * @property {(text: string) => void} say
 * @property {() => void} resized
 * @property {() => void} changed the layout is another
 */

const ARROWS = /** @type {Record<string, Direction>} */ ({
  ArrowLeft: "left",
  ArrowRight: "right",
  ArrowUp: "up",
  ArrowDown: "down",
});
const DIRECTIONS = Object.freeze({ left: "←", up: "↑", down: "↓", right: "→" });
/** @type {Record<Slot, string>} */
const PLACES = { left: "left column", middle: "middle column", right: "right column", below: "row below" };
const SHARE_STEP = 4; // % of the height, by a key

export class Workspace {
  /** @param {Panel[]} panels @param {Surroundings} around */
  constructor(panels, around) {
    this.panels = new Map(panels.map((panel) => [panel.id, panel]));
    this.around = around;
    this.usual = Object.fromEntries(panels.map(({ id, slot }) => [id, slot]));
    this.layout = usual(this.usual);
    const column = (/** @type {Slot} */ slot) =>
      h("div", { class: `pf-column pf-slot-${slot}`, "data-test": `slot-${slot}` });
    /** @type {Record<Slot, HTMLElement>} */
    this.columns = { left: column("left"), middle: column("middle"), right: column("right"), below: column("below") };
    const { left, middle, right, below } = this.columns;
    this.divider = this.makeDivider();
    const above = h("div", { class: "pf-above" }, middle, right);
    this.main = h("div", { class: "pf-main" }, above, this.divider, below);
    this.mark = h("div", { class: "pf-place", "aria-hidden": "true" });
    this.element = h("div", { class: "pf-workspace", "data-test": "workspace" }, left, this.main);
    for (const panel of panels) this.prepare(panel);
    this.show();
  }

  /** A handle in the panel's head. @param {Panel} panel */
  prepare(panel) {
    const { id, name, element, grows } = panel;
    element.setAttribute("data-panel", id);
    if (grows) {
      element.classList.add("pf-grows");
      element.style.setProperty("--pf-share-of-room", String(grows));
    }
    const grip = h(
      "button",
      {
        type: "button",
        class: "pf-grip",
        "data-test": `grip-${id}`,
        "aria-label": `Move ${name}: arrow keys, or drag; Delete hides it`,
        title: "Drag to another place; arrow keys move it, Delete hides it",
      },
      "⠿",
    );
    grip.addEventListener("keydown", (event) => this.press(event, panel, grip));
    grip.addEventListener("pointerdown", (event) => this.drag(event, panel, grip));
    element.querySelector(".pf-card-head")?.prepend(grip);
  }

  // -- the layout -------------------------------------------------------------------------------------------------

  /** @param {Layout} layout */
  set(layout) {
    this.layout = layout;
    this.show();
    this.around.changed();
    this.around.resized();
  }

  /** One that was kept; anything else is the usual one. @param {unknown} kept */
  restore(kept) {
    this.set(restored(kept, this.usual));
  }

  /** What a session keeps of it. */
  get part() {
    return { get: () => this.layout, set: (/** @type {unknown} */ kept) => this.restore(kept) };
  }

  /** @param {string} id @param {Direction} direction */
  move(id, direction) {
    // What has nothing to show counts as hidden, but is not.
    const next = moved({ ...this.layout, hidden: this.unseen }, id, direction);
    this.set({ ...next, hidden: this.layout.hidden });
    this.tell(id);
  }

  /** Panels that are hidden, or have nothing to show. */
  get unseen() {
    const empty = [...this.panels.values()].filter(({ element }) => element.hidden).map(({ id }) => id);
    return [...this.layout.hidden, ...empty];
  }

  /** @param {string} id @param {boolean} shown */
  reveal(id, shown) {
    this.set(withShown(this.layout, id, shown));
    this.around.say(`${this.panels.get(id)?.name} is ${shown ? "shown" : "hidden: “Panels” brings it back"}.`);
  }

  /** Where a panel is, in words. @param {string} id */
  tell(id) {
    const slot = slotOf(this.layout, id);
    const shown = this.layout.slots[slot].filter((each) => !this.unseen.includes(each));
    const place = `${shown.indexOf(id) + 1} of ${shown.length}`;
    this.around.say(`${this.panels.get(id)?.name}: ${PLACES[slot]}, ${place}.`);
  }

  show() {
    const { slots, hidden, share } = this.layout;
    for (const slot of SLOTS) {
      const column = this.columns[slot];
      const elements = slots[slot].flatMap((id) => this.panels.get(id)?.element ?? []);
      // What stands already keeps its focus and its scroll.
      elements.forEach((element, i) => {
        if (column.children[i] !== element) column.insertBefore(element, column.children[i] ?? null);
      });
      column.classList.toggle(
        "pf-unshown",
        slots[slot].every((id) => hidden.includes(id)),
      );
    }
    for (const [id, { element }] of this.panels) element.classList.toggle("pf-unshown", hidden.includes(id));
    this.main.style.setProperty("--pf-share", `${share}%`);
    this.divider.setAttribute("aria-valuenow", String(share));
  }

  // -- by hand ----------------------------------------------------------------------------------------------------

  /** @param {KeyboardEvent} event @param {Panel} panel @param {HTMLElement} grip */
  press(event, { id }, grip) {
    const direction = ARROWS[event.key];
    if (!direction && event.key !== "Delete") return;
    event.preventDefault();
    if (direction) this.move(id, direction);
    else this.reveal(id, false);
    grip.focus();
  }

  /** @param {PointerEvent} event @param {Panel} panel @param {HTMLElement} grip */
  drag(event, { id, element }, grip) {
    if (event.button) return;
    /** @type {{slot: Slot, place: number} | null} */
    let target = null;
    const move = (/** @type {PointerEvent} */ at) => {
      this.element.classList.add("pf-arranging");
      element.classList.add("pf-lifted");
      target = this.placeAt(id, at.clientX, at.clientY) ?? target;
      if (target) this.showMark(id, target);
    };
    const over = () => {
      this.element.classList.remove("pf-arranging");
      element.classList.remove("pf-lifted");
      this.mark.remove();
    };
    const end = () => {
      over();
      if (!target) return;
      this.set(placed(this.layout, id, target.slot, target.place));
      this.tell(id);
    };
    follow(grip, event, move, end, over);
  }

  /** The others of a slot, as they stand. @param {string} id @param {Slot} slot */
  others(id, slot) {
    return this.layout.slots[slot].filter((each) => each !== id).map((each) => this.panels.get(each)?.element);
  }

  /** @param {string} id @param {number} x @param {number} y */
  placeAt(id, x, y) {
    for (const slot of SLOTS) {
      const { left, right, top, bottom } = this.columns[slot].getBoundingClientRect();
      if (x < left || x > right || y < top || y > bottom) continue;
      const boxes = this.others(id, slot).map((element) => element?.getBoundingClientRect());
      const after = boxes.findIndex((box) => box?.height && y < (box.top + box.bottom) / 2);
      return { slot, place: after < 0 ? boxes.length : after };
    }
    return null;
  }

  /** @param {string} id @param {{slot: Slot, place: number}} target */
  showMark(id, { slot, place }) {
    this.columns[slot].insertBefore(this.mark, this.others(id, slot)[place] ?? null);
  }

  makeDivider() {
    const divider = h("div", {
      class: "pf-divider",
      role: "separator",
      tabindex: 0,
      "aria-orientation": "horizontal",
      "aria-label": "Height of the row below",
      "aria-valuemin": SHARES.least,
      "aria-valuemax": SHARES.most,
      "data-test": "divider",
      title: "Drag, or arrow keys; double-click for the usual height",
    });
    const share = (/** @type {number} */ value) => this.set(withShare(this.layout, value));
    divider.addEventListener("keydown", (event) => {
      const step = event.key === "ArrowUp" ? SHARE_STEP : event.key === "ArrowDown" ? -SHARE_STEP : 0;
      if (!step && event.key !== "Home") return;
      event.preventDefault();
      share(step ? this.layout.share + step : SHARES.usual);
    });
    divider.addEventListener("pointerdown", (event) => {
      const { top, bottom } = this.main.getBoundingClientRect();
      const move = (/** @type {PointerEvent} */ at) => share((100 * (bottom - at.clientY)) / (bottom - top));
      const before = this.layout.share;
      const giveUp = () => share(before);
      follow(divider, event, move, () => {}, giveUp);
    });
    divider.addEventListener("dblclick", () => share(SHARES.usual));
    return divider;
  }

  // -- the list ---------------------------------------------------------------------------------------------------

  /** What is shown and where, with buttons: what the handles do, without dragging. */
  async arrange() {
    const rows = [...this.panels.values()].map(({ id, name }) => {
      const shown = h("input", { type: "checkbox", "data-test": `show-${id}` });
      shown.checked = !this.layout.hidden.includes(id);
      shown.addEventListener("change", () => this.reveal(id, shown.checked));
      const buttons = Object.entries(DIRECTIONS).map(([direction, text]) =>
        button(`move-${id}-${direction}`, text, () => this.move(id, /** @type {Direction} */ (direction)), {
          class: "pf-icon",
          "aria-label": `Move ${name} ${direction}`,
        }),
      );
      return h("li", {}, h("label", {}, shown, name), h("div", { class: "pf-group" }, ...buttons));
    });
    const list = h("ul", { class: "pf-panels", "data-test": "panels-list" }, ...rows);
    const answers = { close: "Close", usual: "Usual arrangement" };
    const answer = await dialog(this.element, { test: "panels", title: "Panels", body: [list], answers });
    if (answer !== "usual") return;
    this.restore(null);
    this.around.say("The panels are arranged as usual.");
  }
}
