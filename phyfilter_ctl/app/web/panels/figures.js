/** The verdict in words, the leading figures of the design, all of them on demand, and what each means. */

import { assign, h, keepAt, write } from "../elements.js";
import { inUnit } from "../numbers.js";
import { button } from "./parts.js";
import { Verdict } from "./verdict.js";

/** @import { App } from "../designer.js" */
/** @import { Answers, Figure } from "../link.js" */

/** @typedef {ReturnType<typeof makeCard>} Card */

/** @type {Record<string, string>} */
export const SHORT_NAMES = {
  bandwidth: "Bandwidth",
  settling: "Settling, 2 %",
  noise_gain: "Noise gain",
  noise: "Noise of f̂",
  euler_dt: "Euler limit",
  bound: "Error bound",
  bound_sampled: "Bound, sampled",
  ratio_low: "Least M̂/M",
  ratio_high: "Largest M̂/M",
  delay_margin: "Delay margin",
  phase_margin: "Phase margin",
};

const LEADING = ["bandwidth", "noise", "bound_sampled", "delay_margin"];
const IN_UNIT_OF_F = ["noise", "bound", "bound_sampled"];

/** @type {Record<string, string>} */
const MEANINGS = {
  bandwidth: "Residuals slower than this pass into the estimate; |F| has fallen to 71 % there.",
  settling: "Time after which the answer to a sudden, constant residual stays within 2 % of its end.",
  noise_gain:
    "Standard deviation of f̂ for white noise of standard deviation 1 on every sample of x. Smaller is quieter.",
  noise: "Standard deviation of f̂ that the assumed noise of x leaves.",
  euler_dt: "Forward Euler is unstable at this step and above. The other methods have no such limit.",
  bound: "Certified: with |γ′| below the assumed slope the error |f − f̂| ends below this, whatever the residual does.",
  bound_sampled: "The same bound for the filter as it runs, sampled, at the samples, and what it takes for granted.",
  ratio_low: "With f̂ fed back, the loop is stable from this modelled inertia over the true one ...",
  ratio_high: "... up to this one, with the assumed lag and delay.",
  delay_margin: "Further delay that the loop tolerates before it turns unstable.",
  phase_margin: "Phase lag that the loop tolerates in addition before it turns unstable.",
};

/** @type {Record<string, string>} */
const UNITS = { bandwidth: "rad/s", settling: "s", euler_dt: "s", noise_gain: "1/s" };

/**
 * Unit of a figure; what is in the unit of f says so before one is named.
 * @param {string} key @param {Figure | undefined} figure @param {string} unit of f
 */
export function unitOf(key, figure, unit) {
  if (IN_UNIT_OF_F.includes(key)) return figure?.unit || unit;
  return figure?.unit ?? UNITS[key] ?? "";
}

let count = 0;

export class Figures {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {Map<string, Figure>} Python's last */
    this.known = new Map();
    /** @type {Map<string, Card>} */
    this.cards = new Map();
    /** @type {string | null} */
    this.explained = null;
    this.verdict = new Verdict(app);
    this.leading = h("div", { class: "pf-numbers pf-leading", "data-test": "numbers" });
    this.others = h("div", {
      class: "pf-numbers",
      id: `pf-others-${++count}`,
      "data-test": "all-numbers",
      hidden: true,
    });
    this.more = button("all-figures", "All figures", () => this.unfold(this.others.hidden), {
      "aria-expanded": "false",
      "aria-controls": this.others.id,
    });
    this.explanation = h("p", {
      class: "pf-explain",
      id: `pf-explain-${count}`,
      role: "tooltip",
      "data-test": "explain",
      hidden: true,
    });
    const line = h("div", { class: "pf-line-of-figures" }, this.verdict.element, this.leading, this.more);
    this.element = h("section", { class: "pf-figures", "aria-label": "Verdict and figures" }, line, this.others);
    this.element.append(this.explanation);
  }

  /** @param {boolean} all whether every figure is shown */
  unfold(all) {
    this.others.hidden = !all;
    this.more.setAttribute("aria-expanded", String(all));
  }

  /** Python's answer. @param {Answers["design"]} reply */
  answered({ numbers, verdict, messages }) {
    this.known = new Map(numbers.map((figure) => [figure.key, figure]));
    this.verdict.answered(verdict ?? [], messages ?? []);
  }

  show() {
    const keys = this.known.size ? [...this.known.keys()] : Object.keys(SHORT_NAMES);
    const places = { leading: 0, others: 0 };
    for (const key of keys) {
      let card = this.cards.get(key);
      if (!card) this.cards.set(key, (card = this.card(key)));
      const group = LEADING.includes(key) ? "leading" : "others";
      keepAt(this[group], card.element, places[group]++);
      this.fill(card, key);
    }
    for (const [key, card] of this.cards) {
      if (keys.includes(key)) continue;
      card.element.remove();
      this.cards.delete(key);
    }
    this.verdict.show();
    if (this.explained) this.explain(this.explained);
  }

  /** Python's figure; until it answers the preview's, where there is one. @param {Card} card @param {string} key */
  fill(card, key) {
    const { stale, preview, design } = this.app;
    const figure = this.known.get(key);
    const own = preview.figures.has(key);
    const live = stale && own;
    const value = live || !figure ? (preview.figures.get(key) ?? null) : figure.value;
    const note = figure?.note ?? "";
    const unit = unitOf(key, figure, design.unit);
    const [full, shownUnit] =
      value === null && /^no (upper |lower )?limit/.test(note) ? ["∞", ""] : inUnit(value, unit);
    const text = full.length > 6 ? inUnit(value, unit, 3)[0] : full; // what a card has room for
    write(card.value, text);
    write(card.unit, text === "∞" || text === "–" ? "" : shownUnit);
    assign(card.element, { "data-value": value === null ? "" : String(value) });
    card.element.classList.toggle("pf-waiting", stale && !own);
    card.element.classList.toggle("pf-bad", /^unstable|is unstable/.test(note) && !live);
    card.note = note;
    card.name = figure?.label ?? SHORT_NAMES[key] ?? key;
  }

  /** @param {string} key */
  card(key) {
    const card = makeCard(key, this.explanation.id);
    const close = () => this.explain(null);
    for (const name of ["pointerenter", "focus"]) card.element.addEventListener(name, () => this.explain(key));
    for (const name of ["pointerleave", "blur"]) card.element.addEventListener(name, close);
    card.element.addEventListener("keydown", (event) => {
      if (event.key === "Escape") close();
    });
    return card;
  }

  /** What a figure means, below it. @param {string | null} key */
  explain(key) {
    this.explained = key;
    const card = key === null ? undefined : this.cards.get(key);
    this.explanation.hidden = !card;
    if (!card) return;
    const note = card.note ? ` (${card.note})` : "";
    this.explanation.replaceChildren(h("b", {}, `${card.name}. `), `${MEANINGS[key ?? ""] ?? ""}${note}`);
    this.explanation.style.top = `${card.element.offsetTop + card.element.offsetHeight + 4}px`;
  }
}

/** @param {string} key @param {string} described */
function makeCard(key, described) {
  const name = SHORT_NAMES[key] ?? key;
  const value = h("span", { class: "pf-value" });
  const unit = h("span", { class: "pf-unit" });
  const given = {
    class: "pf-number",
    tabindex: 0,
    role: "group",
    "aria-label": name,
    "aria-describedby": described,
    "data-test": `number-${key}`,
  };
  const element = h(
    "div",
    given,
    h("span", { class: "pf-name" }, name),
    h("span", { class: "pf-figure" }, value, unit),
  );
  return { element, value, unit, note: "", name: key };
}
