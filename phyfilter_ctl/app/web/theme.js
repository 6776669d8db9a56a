/** Light or dark: as chosen here, as the host asks, as JupyterLab is, as the system is. */

import { KEPT_COLOURS } from "./plots/styles.js";

/** @import { Model } from "./link.js" */
/** @import { Palette } from "./plots/styles.js" */

/** @typedef {"light" | "dark" | undefined} Choice */

const ORDER = /** @type {Choice[]} */ ([undefined, "light", "dark"]);
const COLOURS = /** @type {const} */ ([
  ...["F", "E", "S", "L", "M", "grid", "faint", "muted", "card", "text"],
  ...KEPT_COLOURS,
]);

export class Theme {
  /** @param {HTMLElement} root @param {Model} model @param {() => void} changed */
  constructor(root, model, changed) {
    this.root = root;
    this.model = model;
    this.changed = changed;
    /** @type {Choice} */
    this.choice = undefined;
    /** False where the designer is not on the page yet, and has no style. */
    this.known = false;
    this.palette = readPalette(root).palette;
    this.system = matchMedia("(prefers-color-scheme: dark)");
    this.apply = this.apply.bind(this);
    this.jupyter = new MutationObserver(this.apply);
  }

  apply() {
    const asked = this.choice ?? this.model.get?.("theme");
    const jupyter = document.body?.dataset?.jpThemeLight;
    const system = this.system.matches ? "dark" : "light";
    const theme =
      asked === "dark" || asked === "light" ? asked : jupyter ? (jupyter === "false" ? "dark" : "light") : system;
    this.root.setAttribute("data-theme", theme);
    Object.assign(this, readPalette(this.root));
    this.changed();
  }

  /** Light, dark, as the system; the choice in words. */
  next() {
    this.choice = ORDER[(ORDER.indexOf(this.choice) + 1) % ORDER.length];
    this.apply();
    return this.choice ?? "as the system";
  }

  watch() {
    this.system.addEventListener("change", this.apply);
    this.jupyter.observe(document.body, { attributes: true, attributeFilter: ["data-jp-theme-light"] });
    this.model.on("change:theme", this.apply);
  }

  close() {
    this.system.removeEventListener("change", this.apply);
    this.jupyter.disconnect();
    this.model.off?.("change:theme", this.apply);
  }
}

/** Colours and font as the style sheet has them; a canvas knows no style sheet. @param {HTMLElement} root */
function readPalette(root) {
  const style = getComputedStyle(root);
  const colour = (/** @type {string} */ name) => style.getPropertyValue(`--pf-${name}`).trim();
  const colours = Object.fromEntries(COLOURS.map((name) => [name, colour(name) || "gray"]));
  return { known: colour("F") !== "", palette: /** @type {Palette} */ ({ ...colours, font: style.fontFamily }) };
}
