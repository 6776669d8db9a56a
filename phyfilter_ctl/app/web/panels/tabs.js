/** One of several views, as tabs: arrow keys go from one to the next. */

import { h } from "../elements.js";

/**
 * @template {string} Key @param {string} label @param {string} test
 * @param {Record<Key, {text: string, title: string}>} names @param {(key: Key) => void} choose
 */
export function tabs(label, test, names, choose) {
  const keys = /** @type {Key[]} */ (Object.keys(names));
  const buttons = keys.map((key) =>
    h(
      "button",
      {
        type: "button",
        role: "tab",
        "data-test": `${test}-${key}`,
        title: names[key].title,
        onclick: () => choose(key),
      },
      names[key].text,
    ),
  );
  const element = h("div", { class: "pf-tabs", role: "tablist", "aria-label": label }, ...buttons);
  element.addEventListener("keydown", (event) => {
    const at = buttons.findIndex((each) => each === event.target);
    const last = buttons.length - 1;
    const to = /** @type {Record<string, number>} */ ({
      ArrowLeft: at ? at - 1 : last,
      ArrowRight: at === last ? 0 : at + 1,
      Home: 0,
      End: last,
    })[event.key];
    if (at < 0 || to === undefined) return;
    event.preventDefault();
    choose(keys[to]);
    buttons[to].focus();
  });
  return {
    element,
    show: (/** @type {Key} */ chosen) =>
      buttons.forEach((each, i) => {
        each.setAttribute("aria-selected", String(keys[i] === chosen));
        each.tabIndex = keys[i] === chosen ? 0 : -1;
      }),
  };
}
