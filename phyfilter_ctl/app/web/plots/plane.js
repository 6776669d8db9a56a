/** The s-plane: poles and zeros that are dragged. */

import { assign, follow, g, h, write } from "../elements.js";
import { LIMITS } from "../mathematics/filter.js";
import { sizeOf, written } from "../state/roots.js";
import { short } from "../numbers.js";
import { dragged, led } from "./plane_gestures.js";
import { planeGrid, planeNames } from "./plane_grid.js";
import { PlaneView } from "./plane_view.js";
import { Size } from "./size.js";

/** @import { Design, Kind } from "../state/design.js" */
/** @import { Place, Root } from "../state/roots.js" */
/** @import { KeptColour } from "./styles.js" */
/** @import { Pixel } from "./plane_view.js" */

/** @typedef {{roots: Root[], zeros: Root[], colour: KeptColour}} Ghosts  poles and zeros of a kept design */
/** @typedef {ReturnType<typeof handleOf>} Handle  what is drawn of one root, or of its conjugate */
/**
 * @typedef {object} Surroundings
 * @property {(text: string) => void} say
 * @property {(text: string) => void} hover where the mouse is, or ""
 * @property {() => void} refit the view is another
 */

const BESIDE_AXIS = 12; // px: a root that is added this near is real
const A_MOVE = 2; // px: less is a click

let planes = 0;

export class Plane {
  /** @param {Design} design @param {Surroundings} around */
  constructor(design, around) {
    this.design = design;
    this.around = around;
    this.view = new PlaneView();
    const id = `pf-hatch-${++planes}`;
    this.unstable = g("rect", { class: "pf-unstable", fill: `url(#${id})` });
    this.grid = g("g", { class: "pf-plane-grid", "aria-hidden": "true" });
    this.names = g("g", { class: "pf-plane-grid", "aria-hidden": "true" });
    this.region = g("g", { class: "pf-region", "aria-hidden": "true" });
    this.locus = g("g", { class: "pf-locus", "aria-hidden": "true", "data-test": "locus-paths" });
    this.ghosts = g("g", { class: "pf-ghosts", "aria-hidden": "true" });
    this.handles = g("g", {});
    this.svg = g("svg", {
      class: "pf-plane",
      role: "group",
      "aria-label": "s-plane: poles and zeros",
      "data-test": "plane",
    });
    this.svg.append(
      g("defs", {}, hatching(id)),
      this.grid,
      this.unstable,
      this.region,
      this.names,
      this.locus,
      this.ghosts,
      this.handles,
    );
    this.element = h("div", { class: "pf-plane-box" }, this.svg);
    this.size = new Size(this.element);
    /** @type {Map<string, Handle>} */
    this.drawn = new Map();
    /** @type {Ghosts[]} */
    this.pinned = [];
    this.dragging = false;
    /** @type {number | null} step in s of forward Euler, where it is used */
    this.euler = null;
    this.gridKey = "";
    this.listen();
  }

  listen() {
    const onRoot = (/** @type {Event} */ event) =>
      event.target instanceof Element && event.target.closest(".pf-root") !== null;
    this.svg.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.svg.addEventListener("dblclick", (event) => {
      if (onRoot(event)) return;
      const at = this.where(event);
      const { re, im } = this.view.point(at);
      const real = Math.abs(at.y - this.view.origin.y) < BESIDE_AXIS;
      this.design.add(event.altKey ? "zero" : "pole", { re, im: real ? 0 : im });
    });
    this.svg.addEventListener("pointerdown", (event) => {
      if (!onRoot(event)) this.design.select(null);
    });
    this.svg.addEventListener("pointermove", (event) => this.hover(event));
    this.svg.addEventListener("pointerleave", () => this.around.hover(""));
  }

  get width() {
    return this.view.width;
  }

  measure() {
    const { width, height } = this.size.read();
    if (!width || (width === this.view.width && height === this.view.height)) return;
    Object.assign(this.view, { width, height });
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  }

  /** Pixels of the mouse. @param {MouseEvent} event @returns {Pixel} */
  where(event) {
    const box = this.svg.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  /** Show all poles and zeros; with `needed` only where one is outside or all are tiny. @param {boolean} [needed] */
  fit(needed = false) {
    if (this.view.fit(this.design.poles, this.design.zeros, needed)) this.around.refit();
  }

  /** @param {number} factor */
  zoom(factor) {
    this.view.zoom(factor);
    this.around.refit();
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    // The bare wheel scrolls the page or the notebook, which are longer than a screen; a pinch comes with ctrlKey.
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    const decades = event.shiftKey && this.view.log;
    if (decades) this.view.widen(Math.sign(event.deltaY));
    this.zoom(decades ? 1 : 1.12 ** Math.sign(event.deltaY));
  }

  /** @param {PointerEvent} event */
  hover(event) {
    if (this.dragging || event.pointerType === "touch") return;
    this.around.hover(placeWords(this.view.point(this.where(event)), 3));
  }

  /** A root that moves, as it is held: not where the mouse is. @param {Kind} kind @param {number} id */
  tell(kind, id) {
    const root = this.design.roots(kind).find((other) => other.id === id);
    if (root) this.around.hover(placeWords(root, 4));
  }

  // -- drawing ----------------------------------------------------------------------------------------------------

  draw() {
    this.measure();
    if (!this.width) return;
    this.drawGrid();
    const seen = new Set();
    for (const kind of /** @type {Kind[]} */ (["zero", "pole"])) {
      this.design.roots(kind).forEach((root, index) => {
        for (const side of root.im ? [1, -1] : [1]) seen.add(this.drawHandle(kind, root, index, side));
      });
    }
    for (const [key, handle] of this.drawn) if (!seen.has(key)) this.drop(key, handle);
    this.ghosts.replaceChildren(
      ...this.pinned.flatMap(({ roots, zeros, colour }) => [
        ...bothHalves(roots).map((root) => this.ghost(root, colour, false)),
        ...bothHalves(zeros).map((root) => this.ghost(root, colour, true)),
      ]),
    );
  }

  /** A pole or zero of a kept design. @param {Place} root @param {KeptColour} colour @param {boolean} zero */
  ghost(root, colour, zero) {
    const { x, y } = this.view.pixel(root);
    const given = { class: `pf-stroke-${colour}` };
    return zero
      ? g("circle", { ...given, cx: x, cy: y, r: 4.5 })
      : g("path", { ...given, d: `M${x - 4} ${y - 4}l8 8m0 -8l-8 8` });
  }

  drawGrid() {
    const { width, height, log, radius, decades, origin } = this.view;
    const key = [width, height, log, radius, decades, this.euler].join();
    if (key === this.gridKey) return;
    this.gridKey = key;
    assign(this.unstable, { x: origin.x, width: width - origin.x, height });
    this.grid.replaceChildren(...planeGrid(this.view, this.euler));
    this.names.replaceChildren(...planeNames(this.view));
  }

  /** A root that has gone. @param {string} key @param {Handle} handle */
  drop(key, handle) {
    const focused = handle.element.contains(document.activeElement);
    handle.element.remove();
    this.drawn.delete(key);
    if (!focused) return;
    const other = this.svg.querySelector(".pf-root[tabindex]");
    if (other instanceof SVGElement) other.focus();
  }

  /**
   * @param {Kind} kind @param {Root} root @param {number} index @param {number} side 1, or -1 for the conjugate
   * @returns {string}
   */
  drawHandle(kind, root, index, side) {
    const key = `${kind} ${root.id} ${side}`;
    let handle = this.drawn.get(key);
    if (!handle) this.drawn.set(key, (handle = this.handle(kind, root.id, side)));
    const at = this.view.rim(this.view.pixel({ re: root.re, im: side * root.im }));
    assign(handle.element, { transform: `translate(${at.x.toFixed(2)} ${at.y.toFixed(2)})` });
    assign(handle.arrow, { visibility: at.outside ? "visible" : "hidden" });
    if (at.outside) handle.arrow.setAttribute("transform", `rotate(${((at.angle * 180) / Math.PI).toFixed(1)})`);
    const { chosen } = this.design;
    const selected = chosen !== null && chosen.kind === kind && chosen.id === root.id;
    handle.element.classList.toggle("pf-selected", selected);
    const twins = this.design
      .roots(kind)
      .filter((other) => Math.hypot(other.re - root.re, other.im - root.im) <= 1e-9 * sizeOf(root));
    write(handle.count, twins.length > 1 && twins[0].id === root.id ? `×${twins.length}` : "");
    write(handle.label, side > 0 && (at.outside || (selected && this.dragging)) ? written(root) : "");
    const leftmost = at.x < 0.42 * this.width;
    assign(handle.label, {
      "text-anchor": leftmost ? "start" : "end",
      x: leftmost ? 14 : -14,
      y: at.y < 40 ? 24 : -13,
    });
    const name = `${kind}-${index}`;
    if (handle.name !== name) handle.element.setAttribute("data-test", side > 0 ? name : `${name}-conjugate`);
    handle.name = name;
    if (side > 0) {
      const words = `${root.im ? `${kind} pair` : kind} ${index + 1}; arrow keys move it, Delete removes it`;
      assign(handle.element, {
        "aria-label": words,
        "aria-valuetext": `${written(root)} rad/s`,
        "aria-valuenow": sizeOf(root),
      });
    }
    return key;
  }

  /** @param {Kind} kind @param {number} id @param {number} side */
  handle(kind, id, side) {
    const handle = handleOf(kind);
    const { element } = handle;
    if (side > 0) {
      assign(element, {
        tabindex: 0,
        role: "slider",
        "aria-valuemin": LIMITS.slowest,
        "aria-valuemax": LIMITS.fastest,
      });
      element.addEventListener("focus", () => this.design.select(kind, id));
      element.addEventListener("blur", () => this.around.hover(""));
      element.addEventListener("keydown", (event) => this.key(event, kind, id));
    }
    element.addEventListener("pointerdown", (event) => this.grab(event, kind, id));
    this.handles.append(element);
    return handle;
  }

  // -- moving -----------------------------------------------------------------------------------------------------

  /** @param {PointerEvent} event @param {Kind} kind @param {number} id */
  grab(event, kind, id) {
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    this.design.select(kind, id);
    this.drawn.get(`${kind} ${id} 1`)?.element.focus({ preventScroll: true });
    this.design.begin();
    this.dragging = true;
    let started = false;
    const move = (/** @type {PointerEvent} */ next) => {
      started ||= Math.hypot(next.clientX - event.clientX, next.clientY - event.clientY) >= A_MOVE;
      const list = this.design.roots(kind);
      const root = list.find((other) => other.id === id);
      if (started && root)
        this.design.change(kind, dragged(this.view, kind, list, root, this.where(next), !next.altKey));
      this.tell(kind, id);
    };
    this.tell(kind, id);
    // On the plane, not on the handle: the handle may go when a pair splits or two roots join.
    const end = () => {
      this.dragging = false;
      this.around.hover("");
    };
    follow(
      this.svg,
      event,
      move,
      () => {
        end();
        this.design.commit();
      },
      () => {
        end();
        this.design.cancel();
      },
    );
  }

  /** @param {KeyboardEvent} event @param {Kind} kind @param {number} id */
  key(event, kind, id) {
    if (event.key === "Delete" || event.key === "Backspace") {
      event.preventDefault();
      this.design.remove();
      return;
    }
    const list = this.design.roots(kind);
    const root = list.find((other) => other.id === id);
    const next = root ? led(this.view, kind, list, root, event) : null;
    if (next === null) return;
    event.preventDefault();
    if (typeof next === "string") {
      this.around.say(next);
      return;
    }
    this.design.begin();
    this.design.change(kind, next);
    this.design.commit(`move ${kind} ${id}`);
    this.tell(kind, id);
  }
}

/** @param {Place} place @param {number} digits */
function placeWords({ re, im }, digits) {
  const size = Math.hypot(re, im);
  const place = im ? `${short(re, digits)} ${im < 0 ? "−" : "+"} ${short(Math.abs(im), digits)}j` : short(re, digits);
  return `${place}   ωₙ ${short(size, digits)} rad/s   ζ ${short(-re / size, digits - 1)}`;
}

/** @param {string} id */
function hatching(id) {
  const ground = g("rect", { width: 9, height: 9, class: "pf-hatch-ground" });
  const line = g("line", { x1: 0, y1: 0, x2: 0, y2: 9, class: "pf-hatch" });
  return g(
    "pattern",
    { id, width: 9, height: 9, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    ground,
    line,
  );
}

/** @param {Kind} kind */
function handleOf(kind) {
  const label = g("text", { class: "pf-root-label" });
  const count = g("text", { class: "pf-root-count", x: 9, y: -8 });
  const arrow = g("path", { class: "pf-rim", d: "M10 -4.5L16 0L10 4.5z", visibility: "hidden" });
  const cross = () => g("path", { class: "pf-mark", d: "M-6 -6L6 6M6 -6L-6 6" });
  const shape = kind === "pole" ? cross() : g("circle", { class: "pf-mark", r: 6.5 });
  const element = g(
    "g",
    { class: `pf-root pf-${kind}` },
    g("circle", { class: "pf-hit", r: 15 }),
    g("circle", { class: "pf-halo", r: 12 }),
    shape,
    arrow,
    count,
    label,
  );
  return { element, label, count, arrow, name: "" };
}

/** With the conjugates. @param {Root[]} list @returns {Place[]} */
const bothHalves = (list) => list.flatMap((root) => (root.im ? [root, { ...root, im: -root.im }] : [root]));
