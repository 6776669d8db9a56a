/** A stretch of an axis that is marked with the mouse. */

import { assign, follow, g } from "../elements.js";

/** @import { Chart } from "./chart.js" */

const A_STRETCH = 6; // px: less is a click

/**
 * @param {Chart} chart
 * @param {{able: () => boolean, marked: (low: number, high: number) => void, all: () => void}} does all: on a double-click
 */
export function marking(chart, { able, marked, all }) {
  const { overlay } = chart;
  const box = g("rect", { class: "pf-marked", visibility: "hidden" });
  overlay.append(box);
  overlay.addEventListener("dblclick", all);
  overlay.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !able()) return;
    const { left } = overlay.getBoundingClientRect();
    const start = chart.heldAt(event.clientX - left);
    let end = start;
    const move = (/** @type {PointerEvent} */ next) => {
      end = chart.heldAt(next.clientX - left);
      assign(box, {
        visibility: "visible",
        x: Math.min(start, end),
        width: Math.abs(end - start),
        y: chart.top,
        height: chart.inner.height,
      });
    };
    const hide = () => box.setAttribute("visibility", "hidden");
    const over = () => {
      hide();
      if (Math.abs(end - start) > A_STRETCH) marked(chart.xAt(Math.min(start, end)), chart.xAt(Math.max(start, end)));
    };
    follow(overlay, event, move, over, hide);
  });
}
