/** Where the panels are: three columns and a row below them. A layout is a value; each function makes another. */

/** @typedef {"left" | "middle" | "right" | "below"} Slot */
/** @typedef {"left" | "right" | "up" | "down"} Direction */
/**
 * @typedef {object} Layout
 * @property {Record<Slot, string[]>} slots panels by name, hidden ones in their place too
 * @property {string[]} hidden
 * @property {number} share of the height that the row below has, in %
 */

export const SLOTS = /** @type {Slot[]} */ (["left", "middle", "right", "below"]);
export const SHARES = Object.freeze({ least: 15, most: 70, usual: 38 });

/** The usual one. @param {Record<string, Slot>} panels where each is usually @returns {Layout} */
export function usual(panels) {
  /** @type {Layout} */
  const layout = { slots: { left: [], middle: [], right: [], below: [] }, hidden: [], share: SHARES.usual };
  for (const [id, slot] of Object.entries(panels)) layout.slots[slot].push(id);
  return layout;
}

/**
 * One that was kept, which may be of another version: unknown panels are left out, new ones are where they usually are.
 * @param {any} given @param {Record<string, Slot>} panels @returns {Layout}
 */
export function restored(given, panels) {
  const layout = usual(panels);
  const wanted = given?.slots;
  if (!wanted || typeof wanted !== "object") return layout;
  const seen = new Set();
  for (const slot of SLOTS) {
    const ids = Array.isArray(wanted[slot]) ? wanted[slot] : [];
    layout.slots[slot] = ids.filter((id) => id in panels && !seen.has(id) && seen.add(id));
  }
  for (const [id, slot] of Object.entries(panels)) if (!seen.has(id)) layout.slots[slot].push(id);
  const hidden = Array.isArray(given.hidden) ? given.hidden : [];
  layout.hidden = Object.keys(panels).filter((id) => hidden.includes(id));
  return withShare(layout, Number(given.share) || SHARES.usual);
}

/** @param {Layout} layout @param {string} id */
export const slotOf = (layout, id) =>
  /** @type {Slot} */ (SLOTS.find((slot) => layout.slots[slot].includes(id)) ?? "left");

/**
 * A panel in another place.
 * @param {Layout} layout @param {string} id @param {Slot} slot @param {number} place among the others of the slot
 * @returns {Layout}
 */
export function placed(layout, id, slot, place) {
  const slots = { ...layout.slots };
  for (const each of SLOTS) slots[each] = slots[each].filter((other) => other !== id);
  slots[slot].splice(place, 0, id);
  return { ...layout, slots };
}

/**
 * A panel one step further: past the next one that is shown, or over the edge into the row below and back.
 * @param {Layout} layout @param {string} id @param {Direction} direction @returns {Layout}
 */
export function moved(layout, id, direction) {
  const slot = slotOf(layout, id);
  const ids = layout.slots[slot];
  const at = ids.indexOf(id);
  if (direction === "left" || direction === "right") {
    const columns = SLOTS.slice(0, 3);
    const column = slot === "below" ? 1 : columns.indexOf(slot);
    const next = columns[column + (direction === "right" ? 1 : slot === "below" ? 0 : -1)];
    return next ? placed(layout, id, next, Math.min(at, layout.slots[next].length)) : layout;
  }
  const shown = (/** @type {string} */ other) => !layout.hidden.includes(other);
  if (direction === "up") {
    const before = ids.findIndex((other, i) => shown(other) && !ids.slice(i + 1, at).some(shown));
    if (before >= 0 && before < at) return placed(layout, id, slot, before);
    return slot === "below" ? placed(layout, id, "middle", layout.slots.middle.length) : layout;
  }
  const after = ids.slice(at + 1).findIndex(shown);
  if (after >= 0) return placed(layout, id, slot, at + 1 + after);
  return slot === "below" ? layout : placed(layout, id, "below", 0);
}

/** @param {Layout} layout @param {string} id @param {boolean} show @returns {Layout} */
export function withShown(layout, id, show) {
  const hidden = layout.hidden.filter((other) => other !== id);
  return { ...layout, hidden: show ? hidden : [...hidden, id] };
}

/** @param {Layout} layout @param {number} share in % @returns {Layout} */
export const withShare = (layout, share) => ({
  ...layout,
  share: Math.round(Math.min(Math.max(share, SHARES.least), SHARES.most)),
});
