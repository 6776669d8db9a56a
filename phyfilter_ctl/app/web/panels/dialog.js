/** Questions in a window of their own; Esc is the first answer. */

import { h } from "../elements.js";
import { button } from "./parts.js";

let count = 0;

/**
 * Ask, and wait for the answer; the focus returns to where it was.
 * @param {HTMLElement} parent a part of the designer
 * @param {{test: string, title: string, body: Node[], answers: Record<string, string>}} what answers: the word that is
 * returned, and the text of its button; the first is the careful one
 * @returns {Promise<string>}
 */
export function dialog(parent, { test, title, body, answers }) {
  const [careful] = Object.keys(answers);
  const id = `pf-dialog-${++count}`;
  const element = h("dialog", { class: "pf-dialog", "aria-labelledby": id, "data-test": test });
  const buttons = Object.entries(answers).map(([answer, text], i) =>
    button(`${test}-${answer}`, text, () => element.close(answer), { class: i ? "" : "pf-primary" }),
  );
  element.append(h("h2", { id }, title), ...body, h("div", { class: "pf-answers" }, ...buttons));
  const before = document.activeElement;
  (parent.closest(".pf-designer") ?? parent).append(element);
  return new Promise((resolve) => {
    element.addEventListener("close", () => {
      element.remove();
      if (before instanceof HTMLElement || before instanceof SVGElement) before.focus();
      resolve(element.returnValue || careful);
    });
    element.showModal();
    buttons[0].focus();
  });
}
