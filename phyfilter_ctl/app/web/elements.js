/** Elements of the page. */

/** @typedef {(event: any) => void} Listener */
/** @typedef {string | number | boolean | null | undefined | Listener} Given  an attribute, or a listener ("onclick") */

const SVG = "http://www.w3.org/2000/svg";

/**
 * An element. Text goes in as text, never as markup.
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag @param {Record<string, Given>} [given] attributes, listeners ("onclick") and "data-test"
 * @param {...(Node | string | null)} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function h(tag, given = {}, ...children) {
  return filled(document.createElement(tag), given, children);
}

/**
 * The same in SVG.
 * @template {keyof SVGElementTagNameMap} Tag
 * @param {Tag} tag @param {Record<string, Given>} [given] @param {...(Node | string | null)} children
 * @returns {SVGElementTagNameMap[Tag]}
 */
export function g(tag, given = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), given, children);
}

/**
 * @template {Element} Made
 * @param {Made} element @param {Record<string, Given>} given @param {(Node | string | null)[]} children
 * @returns {Made}
 */
function filled(element, given, children) {
  for (const [name, value] of Object.entries(given)) {
    if (value === undefined || value === null || value === false) continue;
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/** Text that may stand already. @param {Element} element @param {string} text */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Whether it is shown; it may be so already. @param {HTMLElement} element @param {boolean} shown */
export function show(element, shown) {
  if (element.hidden === shown) element.hidden = !shown;
}

/**
 * Several attributes at once. One that stands already is left: setting it again would have the browser lay out anew.
 * @param {Element} element @param {Record<string, string | number>} values
 */
export function assign(element, values) {
  for (const [name, value] of Object.entries(values)) {
    const text = String(value);
    if (element.getAttribute(name) !== text) element.setAttribute(name, text);
  }
}

/**
 * Let one list of children grow or shrink to these, and leave alone what stands in its place.
 * @param {Element} parent @param {Element} child @param {number} place
 */
export function keepAt(parent, child, place) {
  if (parent.children[place] !== child) parent.insertBefore(child, parent.children[place] ?? null);
}

/**
 * Hand a pointer's moves over until it is let go. Esc, or a browser that takes the pointer away, gives the gesture up.
 * @param {Element} element @param {PointerEvent} event @param {(event: PointerEvent) => void} move
 * @param {(last: PointerEvent) => void} end @param {() => void} cancel
 */
export function follow(element, event, move, end, cancel) {
  const { pointerId } = event;
  element.setPointerCapture(pointerId);
  const over = new AbortController();
  const { signal } = over;
  const on = (/** @type {string} */ name, /** @type {(event: any) => void} */ does) =>
    element.addEventListener(name, (next) => does(next), { signal });
  const givenUp = () => {
    over.abort();
    if (element.hasPointerCapture(pointerId)) element.releasePointerCapture(pointerId);
    cancel();
  };
  on("pointermove", move);
  on("pointerup", (last) => {
    over.abort();
    end(last);
  });
  on("pointercancel", givenUp);
  onEscape(givenUp, signal);
}

/** Before anyone else, as long as a gesture lasts. @param {() => void} does @param {AbortSignal} signal */
export function onEscape(does, signal) {
  const press = (/** @type {KeyboardEvent} */ event) => {
    if (event.key !== "Escape") return;
    event.preventDefault();
    event.stopImmediatePropagation();
    does();
  };
  window.addEventListener("keydown", press, { capture: true, signal });
}
