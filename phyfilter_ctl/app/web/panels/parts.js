/** Small parts that several panels are made of. */

import { assign, h, onEscape } from "../elements.js";
import { typed } from "../numbers.js";

/** @import { Given } from "../elements.js" */
/** @import { App } from "../designer.js" */
/** @import { Design } from "../state/design.js" */

/** @param {string} test @param {string} text @param {() => void} click @param {Record<string, Given>} [more] */
export function button(test, text, click, more = {}) {
  return h("button", { type: "button", "data-test": test, onclick: click, ...more }, text);
}

/** Buttons that belong together. @param {Record<string, Given>} given @param {...(Node | null)} items */
export const group = (given, ...items) => h("div", { class: "pf-group", ...given }, ...items);

/** @param {string} title @param {Node[]} body @param {{test?: string, side?: Node[], className?: string}} [more] */
export function card(title, body, { test, side = [], className = "" } = {}) {
  const head = h("header", { class: "pf-card-head" }, h("h2", {}, title), h("div", { class: "pf-side" }, ...side));
  return h("section", { class: `pf-card ${className}`, "data-test": test, "aria-label": title }, head, ...body);
}

/** A name before what it names. @param {string} name @param {Node} entry @param {Record<string, Given>} [more] */
export function named(name, entry, more = {}) {
  return h("label", { class: "pf-field", ...more }, h("span", { class: "pf-name" }, name), entry);
}

/**
 * One of a few, as buttons.
 * @template {string} Key @param {string} label @param {string} test @param {Record<Key, string>} names
 * @param {(key: Key) => void} choose
 */
export function segments(label, test, names, choose) {
  const keys = /** @type {Key[]} */ (Object.keys(names));
  const buttons = keys.map((key) =>
    button(`${test}-${key}`, names[key], () => choose(key), { "aria-pressed": "false" }),
  );
  return {
    element: h("div", { class: "pf-segments", role: "group", "aria-label": label }, ...buttons),
    show: (/** @type {string} */ chosen) =>
      buttons.forEach((each, i) => assign(each, { "aria-pressed": String(keys[i] === chosen) })),
  };
}

/**
 * A labelled number with its unit; `set` says what is wrong with a value, or "".
 * @param {App} app @param {string} test @param {string} label @param {string} unit
 * @param {(value: number) => string} set @param {string} [title]
 */
export function numberField(app, test, label, unit, set, title = "") {
  const input = textInput({ "data-test": test, "aria-label": unit ? `${label} in ${unit}` : label });
  input.addEventListener("change", () => {
    const value = typed(input.value);
    const wrong = Number.isNaN(value) ? `${label}: expected a number, got “${input.value}”.` : set(value);
    input.setAttribute("aria-invalid", String(Boolean(wrong)));
    if (wrong) app.say(wrong, "warn");
    else app.paint();
  });
  const unitText = h("span", { class: "pf-unit" }, unit);
  const entry = h("span", { class: "pf-entry" }, input, unitText);
  return { input, unitText, element: named(label, entry, { title: title || null }) };
}

/** @param {Record<string, Given>} given */
export function textInput(given) {
  return h("input", { type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false", ...given });
}

/** Write a value where nobody types. @param {HTMLInputElement} input @param {string} text @param {boolean} dragging */
export function put(input, text, dragging) {
  if (input === document.activeElement && !dragging) return;
  if (input.value !== text) input.value = text;
  input.removeAttribute("aria-invalid");
}

/**
 * A slider over decades.
 * @param {Design} design @param {string} test @param {string} label @param {[number, number]} range
 * @param {(value: number) => void} set @param {string} what
 */
export function logSlider(design, test, label, [low, high], set, what) {
  const element = h("input", {
    type: "range",
    min: 0,
    max: 1000,
    step: 1,
    "data-test": test,
    "aria-label": `${label}, coarse`,
  });
  /** @type {AbortController | null} of a pull, or of a burst of keys */
  let pull = null;
  let pulls = 0; // by a pointer
  let pulled = false; // by a pointer, which may have given up and still be down
  let given = false; // up
  let shown = "";
  const end = () => {
    pull?.abort();
    pull = null;
  };
  const giveUp = () => {
    end();
    given = pulled;
    design.cancel();
    element.value = shown;
  };
  element.addEventListener("pointerdown", () => {
    pulls += 1;
    pulled = true;
    given = false;
  });
  for (const name of ["pointerup", "pointercancel"])
    element.addEventListener(name, () => {
      if (given) element.value = shown;
      // The change that a pull ends with comes after it, and perhaps the next pull before that.
      const own = pulls;
      setTimeout(() => {
        if (own === pulls) pulled = given = false;
      });
    });
  element.addEventListener("input", () => {
    if (given) return;
    if (!pull) {
      pull = new AbortController();
      design.begin();
      onEscape(giveUp, pull.signal);
    }
    set(Number((low * (high / low) ** (Number(element.value) / 1000)).toPrecision(3)));
  });
  element.addEventListener("change", () => {
    if (given) element.value = shown;
    else if (pull) design.commit(pulled ? "" : what);
    end();
  });
  const show = (/** @type {number} */ value) => {
    if (element === document.activeElement && design.dragging) return;
    element.value = shown = String(Math.round((1000 * Math.log(value / low)) / Math.log(high / low)));
  };
  return { element, show };
}
