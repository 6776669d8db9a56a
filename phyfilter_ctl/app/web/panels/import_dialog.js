/** What is what in a file: its first rows, and a role for each of its columns. Python suggests, the user confirms. */

import { h, write } from "../elements.js";
import { short, typed } from "../numbers.js";
import { button, named, textInput } from "./parts.js";
import { inWords } from "../wording.js";

/** @import { App } from "../designer.js" */
/** @import { Answers, Preview, RoleName } from "../link.js" */

/** @type {Record<RoleName, string>} */
const ROLES = {
  x: "x, measured",
  label: "label, the true f",
  g: "g, known part of M x′",
  f_theta: "f_θ, the model",
  inertia: "M",
};
const NAMES = /** @type {RoleName[]} */ (Object.keys(ROLES));
const TIMES = { s: "seconds", ms: "milliseconds", us: "microseconds", ns: "nanoseconds" };
const SHOWN = 4; // rows beside each column
const MANY = 12; // columns from which on they can be searched

export class ImportDialog {
  /**
   * @param {App} app @param {Preview} preview
   * @param {(reply: Answers["import"], fields: Record<string, unknown>) => void} done it is open
   */
  constructor(app, preview, done) {
    this.app = app;
    this.done = done;
    this.preview = preview;
    /** Columns of each role, in the order in which they were chosen: the first of x goes with the first label. */
    this.roles = structuredClone(preview.roles);
    const { file } = preview;
    this.notes = h("p", { class: "pf-note", "data-test": "import-notes" });
    this.said = h("p", { class: "pf-import-time", role: "status", "data-test": "import-time-said" });
    this.pairs = h("p", { class: "pf-import-pairs", role: "status", "data-test": "import-pairs" });
    this.problem = h("p", { class: "pf-import-problem", role: "alert", "data-test": "import-problem" });
    this.time = h("select", { "data-test": "import-time", onchange: () => void this.retime(true) });
    this.unit = h("select", { "data-test": "import-time-unit", onchange: () => void this.retime(false) });
    this.constants = {
      inertia: text("import-inertia", "1"),
      unit_x: text("import-unit-x", "as it stands"),
      unit_f: text("import-unit-f", "as it stands"),
      step: text("import-step", "as recorded"),
    };
    this.search = h("input", {
      type: "search",
      "data-test": "import-search",
      "aria-label": "Columns whose name has",
      placeholder: "Search columns",
      oninput: () => this.filter(),
    });
    this.search.hidden = preview.columns.length <= MANY;
    this.rows = preview.columns.map((column) => this.row(column));
    const head = ["Column", "Unit", "Is", "First rows"].map((name, i) =>
      h("th", { scope: "col", colspan: i === 3 ? SHOWN : null }, name),
    );
    const table = h(
      "table",
      {},
      h("thead", {}, h("tr", {}, ...head)),
      h("tbody", {}, ...this.rows.map((r) => r.element)),
    );
    const title = h("h2", { id: "pf-import-title" }, `Open ${file.name}`);
    const size = h("p", { class: "pf-note" }, `${file.format}, ${short(file.size / 1e6, 3)} MB`);
    this.confirm = button("import-open", "Open the log", () => void this.send(), { class: "pf-primary" });
    const cancel = button("import-cancel", "Cancel", () => this.close());
    this.element = h(
      "dialog",
      { class: "pf-import", "data-test": "import", "aria-labelledby": "pf-import-title" },
      h("header", {}, title, size),
      h("div", { class: "pf-import-times" }, named("Times", this.time), named("Count", this.unit), this.said),
      this.search,
      h("div", { class: "pf-import-columns", tabindex: 0, role: "group", "aria-label": "Columns of the file" }, table),
      this.pairs,
      this.fields(),
      this.notes,
      this.problem,
      h("footer", { class: "pf-bar" }, this.confirm, cancel),
    );
    this.element.addEventListener("close", () => this.element.remove());
    this.element.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && event.target instanceof HTMLInputElement) void this.send();
    });
    this.show();
  }

  /** What no column holds. */
  fields() {
    const { inertia, unit_x, unit_f, step } = this.constants;
    const all = [
      named("Constant M", inertia, { title: "One number, one a channel, or a matrix row by row; empty: 1" }),
      named("Unit of x", unit_x, { title: "Such as mm/s; it is turned into SI. Empty: as its column says" }),
      named("Unit of f", unit_f, { title: "Of label, g and f_θ, such as N, m/s^2 or g. Empty: as their columns say" }),
      named("Resample every, s", step, { title: "A step in s, for uneven times; empty: every step as recorded" }),
    ];
    return h("div", { class: "pf-import-fields" }, ...all);
  }

  /** @param {Preview["columns"][number]} column */
  row(column) {
    const { key } = column;
    const choice = h("select", { "aria-label": `${key} is`, "data-test": `import-role-${key}` });
    choice.append(h("option", { value: "" }, "–"));
    for (const name of NAMES) choice.append(h("option", { value: name }, ROLES[name]));
    choice.disabled = !column.numeric;
    choice.addEventListener("change", () => this.choose(key, choice.value));
    const cells = Array.from({ length: SHOWN }, (_, k) => h("td", { class: "pf-import-cell" }, column.first[k] ?? ""));
    const name = h("th", { scope: "row" }, key);
    const element = h("tr", {}, name, h("td", {}, column.unit), h("td", {}, choice), ...cells);
    return { key, choice, element };
  }

  open() {
    this.app.root.append(this.element);
    this.element.showModal();
    (this.roles.x.length ? this.confirm : this.time).focus();
    this.app.say("");
  }

  close() {
    this.element.close();
  }

  /** A column has one role. @param {string} key @param {string} role */
  choose(key, role) {
    for (const name of NAMES) this.roles[name] = this.roles[name].filter((each) => each !== key);
    if (role) this.roles[/** @type {RoleName} */ (role)].push(key);
    this.show();
  }

  /** Another column of times, or another unit of them. @param {boolean} other */
  async retime(other) {
    const chosen = this.time.value ? { time: this.time.value } : {};
    const unit = other || !this.unit.value ? {} : { time_unit: this.unit.value };
    const reply = await this.app.link.ask("preview", { ...chosen, ...unit }, { latest: true });
    if (!reply) return;
    if (!reply.ok) {
      write(this.problem, inWords(reply));
      return;
    }
    this.preview = reply;
    if (other) for (const name of NAMES) this.roles[name] = this.roles[name].filter((key) => key !== this.time.value);
    this.show();
  }

  filter() {
    const wanted = this.search.value.toLowerCase();
    for (const { key, element, choice } of this.rows)
      element.hidden = !key.toLowerCase().includes(wanted) && !choice.value;
  }

  show() {
    const { time, messages, columns, more_columns } = this.preview;
    const keys = columns.map(({ key }) => key);
    this.time.replaceChildren(
      h("option", { value: "" }, time.step === null ? "choose a column" : "as the file says"),
      ...keys.map((key) => h("option", { value: key, selected: key === time.column }, key)),
    );
    this.time.disabled = time.fixed;
    const units = /** @type {(keyof typeof TIMES)[]} */ (Object.keys(TIMES));
    this.unit.replaceChildren(
      h("option", { value: "" }, "as the file says"),
      ...units.map((unit) => {
        const step = time.choices[unit];
        const text = step === undefined ? TIMES[unit] : `${TIMES[unit]}: steps of ${short(step)} s`;
        return h("option", { value: unit, selected: unit === time.unit }, text);
      }),
    );
    this.unit.disabled = !Object.keys(time.choices).length;
    const uneven = time.even
      ? ""
      : " The steps differ: the filter takes each as it is; resample for learning a long log.";
    write(this.said, time.said + uneven);
    this.said.classList.toggle("pf-warned", time.recognised);
    const more = more_columns ? [`${more_columns} further columns are not shown.`] : [];
    write(this.notes, [...messages, ...more].join(" "));
    for (const { key, choice, element } of this.rows) {
      choice.value = NAMES.find((name) => this.roles[name].includes(key)) ?? "";
      element.classList.toggle("pf-chosen", Boolean(choice.value));
    }
    this.pair();
  }

  /** Which column goes with which, in words. */
  pair() {
    const { x } = this.roles;
    const others = NAMES.filter((name) => name !== "x" && this.roles[name].length);
    const wrong = others.filter((name) => name !== "inertia" && this.roles[name].length !== x.length);
    const lines = x.map((key, i) => {
      const beside = others
        .filter((name) => this.roles[name][i] !== undefined)
        .map((name) => `${short_name(name)} ${this.roles[name][i]}`);
      return [`x ${key}`, ...beside].join(" with ");
    });
    const odd = wrong.map((name) => `${this.roles[name].length} columns of ${short_name(name)} for ${x.length} of x`);
    write(this.pairs, x.length ? `${[...lines, ...odd].join("; ")}.` : "Choose at least one column of x.");
    this.pairs.classList.toggle("pf-warned", !x.length || wrong.length > 0);
    this.constants.inertia.disabled = this.roles.inertia.length > 0;
  }

  /** What Python is asked to open; null where something typed is no number. */
  fieldsOf() {
    const { time } = this.preview;
    /** @type {Record<string, unknown>} */
    const fields = { x: this.roles.x };
    for (const name of NAMES) if (name !== "x" && this.roles[name].length) fields[name] = this.roles[name];
    if (this.time.value) fields.time = this.time.value;
    if (this.unit.value && Object.keys(time.choices).length) fields.time_unit = this.unit.value;
    for (const name of /** @type {const} */ (["unit_x", "unit_f"])) {
      const given = this.constants[name].value.trim();
      if (given) fields[name] = given;
    }
    const { inertia, step } = this.constants;
    const parts =
      inertia.value.trim() && !this.roles.inertia.length ? inertia.value.trim().split(/\s*[;\s]\s*|,\s+/) : [];
    const numbers = parts.map(typed);
    const every = step.value.trim() ? typed(step.value) : 1;
    const wrong = Number.isNaN(every)
      ? [step, `a step in s, got “${step.value}”`]
      : numbers.some(Number.isNaN)
        ? [inertia, `numbers for M, got “${inertia.value}”`]
        : null;
    for (const input of [inertia, step]) input.setAttribute("aria-invalid", String(wrong?.[0] === input));
    if (wrong) {
      write(this.problem, `Expected ${wrong[1]}.`);
      return null;
    }
    if (numbers.length) fields.inertia = numbers;
    if (step.value.trim()) fields.step = every;
    return fields;
  }

  async send() {
    const fields = this.fieldsOf();
    if (!fields || this.confirm.disabled) return;
    this.confirm.disabled = true;
    write(this.problem, "");
    const reply = await this.app.link.ask("import", fields);
    this.confirm.disabled = false;
    if (!reply?.ok) {
      write(this.problem, inWords(reply ?? { ok: false }));
      return;
    }
    this.close();
    this.done(reply, fields);
  }
}

/** @param {string} test @param {string} placeholder */
const text = (test, placeholder) => textInput({ "data-test": test, placeholder });

/** @param {RoleName} name */
const short_name = (name) => ROLES[name].split(",")[0];
