/**
 * Interactive designer of a PhyFilter: a view in anywidget's format, `export default { render({ model, el }) }`.
 *
 * It talks to Python through `model.send(message)` and `model.on("msg:custom", reply)` only. While something is dragged
 * it draws
 * what mathematics/ computes (equal to the library's to 1e-9); Python's answer follows and replaces the figures.
 *
 * The page of `phyfilter-ctl app` loads these modules as they are. A notebook takes one module: app/modules.py joins
 * them, so they
 * keep to `import { a, b } from "./other.js"` and to `export` before a declaration.
 *
 * Units: rad/s, s. Polynomials ascend: a[0] is a_0. Complex numbers are [re, im].
 */

import { h } from "./elements.js";
import { keepTaken, take, takeDropped } from "./files.js";
import { lookAt } from "./importing.js";
import { Link } from "./link.js";
import { response } from "./mathematics/filter.js";
import { Bode } from "./panels/bode.js";
import { Figures } from "./panels/figures.js";
import { Header } from "./panels/header.js";
import { Keeping } from "./panels/keeping.js";
import { AssumptionKnobs, NumeratorKnobs, SamplingKnobs } from "./panels/knobs.js";
import { LogCard } from "./panels/log_card.js";
import { Meet } from "./panels/meet.js";
import { Pins } from "./panels/pins.js";
import { PlaneCard } from "./panels/plane_card.js";
import { Start } from "./panels/start.js";
import { Status } from "./panels/status.js";
import { StepCard } from "./panels/step_card.js";
import { Table } from "./panels/table.js";
import { Workspace } from "./panels/workspace.js";
import { Size } from "./plots/size.js";
import { Design } from "./state/design.js";
import { Preview } from "./state/preview.js";
import { Session } from "./state/session.js";
import { Views } from "./state/views.js";
import { Theme } from "./theme.js";
import { Typing } from "./typing.js";
import { inWords } from "./wording.js";

/** @import { Answers, LogSummary, Model, Reply, SessionData } from "./link.js" */
/** @import { Answer } from "./panels/pins.js" */
/** @import { Level } from "./panels/status.js" */
/** @import { Palette } from "./plots/styles.js" */
/** @import { Slot } from "./state/layout.js" */

/**
 * What the panels have of the whole.
 * @typedef {object} App
 * @property {HTMLElement} root
 * @property {Link} link
 * @property {Design} design
 * @property {Views} views which views of the loop are open, and what Python says for them
 * @property {Session} session what is kept; a panel has its own state kept by `session.part`
 * @property {Preview} preview
 * @property {Answer} answer
 * @property {boolean} stale whether the design is another than Python's last answer is for
 * @property {string[]} problems what is wrong with the design, in sentences
 * @property {Palette} palette
 * @property {(text: string, level?: Level) => void} say
 * @property {<T>(reply: Reply<T> | null) => reply is {ok: true} & T} ok whether it is an answer; if not that is said
 * @property {() => void} paint draw what has changed at the next frame
 * @property {(log: LogSummary | null) => void} openLog
 * @property {(session: SessionData, name: string) => Promise<void>} openSession
 */

const PREVIEW_AGREES = 1e-6;
const ESTIMATE_EVERY = 200; // ms, in a drag
const MOST_MEASURES = 5000;
const MEASURES = /** @type {const} */ (["drag-to-preview", "drag-to-answer"]);

/** @implements {App} */
class Designer {
  /** @param {Model} model @param {HTMLElement} el */
  constructor(model, el) {
    // The attribute keeps JupyterLab's single-key shortcuts off the designer.
    this.root = h("div", {
      class: "pf-designer",
      tabindex: -1,
      "data-test": "designer",
      "data-lm-suppress-shortcuts": "true",
    });
    this.size = new Size(this.root);
    this.link = new Link(model, (since) => {
      this.header.showBusy(since);
      this.figures?.verdict.showBusy(since !== null);
    });
    this.design = new Design({
      rebuilt: ({ fit }) => this.rebuilt(fit),
      committed: (text) => this.committed(text),
      chosen: () => this.paint(),
      warn: (text) => this.say(text, "warn"),
    });
    this.session = new Session(this.design);
    /** @type {Views} */
    this.views = new Views(this);
    this.preview = new Preview(this.design);
    this.theme = new Theme(this.root, model, () => this.paint());
    /** @type {Answer} */
    this.answer = { text: "", numbers: null };
    /** @type {string | null} the design that Python is asked about */
    this.asking = null;
    this.greeted = false;
    this.closed = false;
    this.frame = 0;
    this.measured = 0;
    this.status = new Status();
    this.header = new Header(this, {
      pin: () => this.pins.pin(this.answer),
      save: () => this.keeping.save(),
      theme: () => this.say(`Colours: ${this.theme.next()}.`),
      arrange: () => void this.workspace?.arrange(),
    });
    /** @type {Figures} */
    this.figures = new Figures(this);
    this.start = new Start(this);
    this.numerator = new NumeratorKnobs(this);
    this.sampling = new SamplingKnobs(this);
    this.assumptions = new AssumptionKnobs(this);
    this.plane = new PlaneCard(this);
    this.table = new Table(this);
    this.pins = new Pins(this, () => this.repinned());
    this.meet = new Meet(this);
    this.bode = new Bode(this);
    this.step = new StepCard(this);
    this.log = new LogCard(this);
    this.keeping = new Keeping(this, model, { back: () => void this.greetAgain() });
    this.assemble();
    el.append(this.root);
    this.log.open(null);
    this.theme.apply();
    this.theme.watch();
    this.sizes = this.watchSizes();
    this.typing = new Typing(this.root);
    this.keyboard();
    this.restored = this.keeping.restore();
    this.rebuilt(true);
    void this.greet();
  }

  assemble() {
    const panel = (
      /** @type {string} */ id,
      /** @type {string} */ name,
      /** @type {Slot} */ slot,
      /** @type {{element: HTMLElement}} */ { element },
      /** @type {number} */ grows = 0,
    ) => ({ id, name, slot, element, grows });
    const panels = [
      panel("start", "Start from", "left", this.start),
      panel("numerator", "Numerator", "left", this.numerator),
      panel("sampling", "Sampling", "left", this.sampling),
      panel("assumptions", "Assume", "left", this.assumptions),
      panel("plane", "Poles and zeros", "middle", this.plane, 3),
      panel("values", "Values", "middle", this.table),
      panel("pins", "Compare", "middle", this.pins),
      panel("meet", "Meet my limits", "left", this.meet),
      panel("bode", "Frequency", "right", this.bode, 2),
      panel("step", "Step response", "right", this.step, 1),
      panel("log", "Recording", "below", this.log, 1),
    ];
    this.workspace = new Workspace(panels, {
      say: (text) => this.say(text),
      resized: () => this.paint(),
      changed: () => this.session.changed(),
    });
    this.session.part("layout", this.workspace.part);
    const { header, figures, workspace } = this;
    const rolled = h(
      "div",
      { class: "pf-scroll" },
      this.keeping.banner,
      header.element,
      header.codeBox,
      figures.element,
      workspace.element,
    );
    // Below everything: what comes and goes there moves nothing.
    this.status.element.insertBefore(this.header.busy, this.status.open);
    this.status.element.insertBefore(this.keeping.element, this.header.busy);
    this.root.append(rolled, this.status.element);
    takeDropped(this);
    keepTaken(this);
  }

  destroy() {
    this.keeping.close();
    this.link.close();
    this.closed = true;
    this.log.learning.close();
    this.meet.close();
    cancelAnimationFrame(this.frame);
    this.sizes.disconnect();
    this.theme.close();
    document.removeEventListener("keydown", this.press, true);
    this.root.remove();
  }

  get palette() {
    return this.theme.palette;
  }

  /** @returns {string[]} */
  get problems() {
    return this.figures.verdict.problems;
  }

  get stale() {
    return this.root.classList.contains("pf-stale");
  }

  // -- Python -----------------------------------------------------------------------------------------------------

  /** What Python starts from: the filter it was given, or what was designed before a reload. */
  async greet() {
    this.say("Starting Python …");
    const reply = await this.link.ask("hello");
    this.greeted = true;
    if (!this.ok(reply)) {
      void this.ask();
      return;
    }
    if (Array.isArray(reply.families)) this.start.offer(reply.families);
    if (reply.version) this.header.version.textContent = reply.version;
    const untouched = !this.restored && this.design.history.past.length === 0 && !this.design.dragging;
    if (untouched && reply.session) this.session.take(reply.session);
    else if (untouched && reply.design) {
      this.design.load(reply.design, { fit: true });
      this.design.history.now = this.design.text();
    } else void this.ask(); // something was designed before, or while Python started
    this.openLog(reply.log ?? null);
    if (reply.waiting) void lookAt(this, null);
    const again = this.restored || (untouched && reply.session);
    const missing = reply.log ? "" : this.keeping.missing();
    this.say(
      `Ready. ${again ? `Your session goes on. ${missing}` : "Drag a pole, type a value, or start from a family."}`,
    );
  }

  /** Python was away: it may have been started again, and know nothing. */
  async greetAgain() {
    if (!this.greeted) return;
    const reply = await this.link.ask("hello");
    if (!this.ok(reply)) return;
    this.answer = { text: "", numbers: this.answer.numbers };
    void this.ask();
    const { file } = this.session;
    if (!reply.log && this.log.log && file) await take(this, file);
    else if (!reply.log && this.log.log) this.log.open(null);
    this.say(
      `Python answers again, and your work is as you left it. ${reply.log || file ? "" : this.keeping.missing()}`,
    );
  }

  /** @param {SessionData} session @param {string} name */
  async openSession(session, name) {
    await this.keeping.open(session, name);
  }

  /** @param {LogSummary | null} log */
  openLog(log) {
    const { session } = this;
    if (log && session.recording?.name !== log.name) session.recording = { name: log.name };
    this.log.open(log);
  }

  /** Ask Python about the design as it is; the newest question wins. */
  async ask() {
    // The design that Python holds comes first: a question would put this one in its place.
    if (!this.greeted) return;
    const design = this.design.data();
    const text = JSON.stringify(design);
    if (text === this.asking) return;
    this.root.classList.toggle("pf-stale", text !== this.answer.text);
    if (text === this.answer.text && !this.asking) return;
    this.asking = text;
    const asked = this.design.movedAt;
    const reply = await this.link.ask("design", { design }, { latest: true });
    if (this.asking === text) this.asking = null;
    if (!reply || this.closed) return;
    const current = text === this.design.text();
    if (reply.ok) this.answered(reply, text, current, asked);
    else if (current) this.ok(reply);
  }

  /**
   * @param {Answers["design"]} reply @param {string} text the design it is for @param {boolean} current
   * @param {number | null} asked when it was moved
   */
  answered(reply, text, current, asked) {
    this.answer = { text, numbers: reply.numbers };
    this.root.classList.toggle("pf-stale", !current);
    if (current) this.compare(reply);
    this.figures.answered(reply);
    this.pins.answered(this.answer);
    this.figures.show(); // the curves are the preview's: they stand already
    if (asked !== null) this.measure("drag-to-answer", asked);
    if (this.status.failed) this.say("");
    const due = !this.design.dragging || performance.now() - this.log.askedAt > ESTIMATE_EVERY;
    if (this.log.log && current && due) void this.log.ask();
    if (current) this.views.ask();
  }

  /** Python's curves are the truth: where the preview leaves them it says so. @param {Answers["design"]} reply */
  compare(reply) {
    const { omega, F } = reply.frequency;
    const { re, im } = response(this.design.filter, omega);
    let most = 0;
    let worst = 0;
    omega.forEach((_, k) => {
      const gain = Math.hypot(re[k], im[k]);
      most = Math.max(most, F[0][k] ?? 0);
      worst = Math.max(worst, Math.abs(gain - (F[0][k] ?? gain)));
    });
    if (worst > PREVIEW_AGREES * most)
      this.say("The preview of F differs from Python's by more than 1e-6: trust the figures, not the curves.", "warn");
  }

  /**
   * Whether a reply is an answer; if not that is said.
   * @template T
   * @param {Reply<T> | null} reply
   * @returns {reply is {ok: true} & T}
   */
  ok(reply) {
    if (reply === null) return false;
    if (!reply.ok) this.say(inWords(reply), "error");
    return reply.ok;
  }

  /** @param {string} text @param {Level} [level] */
  say(text, level) {
    this.status.say(text, level);
  }

  // -- changes of the design --------------------------------------------------------------------------------------

  /** @param {boolean} fit */
  rebuilt(fit) {
    if (fit) this.plane.plane.fit(true);
    this.preview.stale = true;
    this.paint();
    void this.ask();
  }

  /** @param {string} text */
  committed(text) {
    this.paint();
    void this.ask();
    if (this.log.log && text === this.answer.text) void this.log.ask();
  }

  repinned() {
    this.plane.plane.pinned = this.pins.ghosts();
    this.preview.stale = true;
    this.paint();
  }

  // -- drawing ----------------------------------------------------------------------------------------------------

  paint() {
    if (this.frame || this.closed) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.render();
      if (this.design.movedAt !== null) this.measure("drag-to-preview", this.design.movedAt);
      this.design.movedAt = null;
    });
  }

  render() {
    if (!this.root.isConnected || !this.size.read().width) return;
    const { plane } = this.plane;
    const first = !plane.width;
    plane.measure();
    if (first && plane.width) plane.fit();
    const pins = this.pins.list;
    this.preview.update(pins);
    // Canvases before text: text on a canvas makes the browser lay out whatever has changed, once for every change.
    this.step.draw(pins);
    this.meet.draw();
    if (this.log.log) this.log.draw();
    this.bode.draw(pins);
    const knobs = [this.start, this.numerator, this.sampling, this.assumptions];
    for (const panel of [this.plane, this.table, this.meet, ...knobs, this.header, this.figures]) panel.show();
  }

  /**
   * A benchmark reads them; a long session must not fill the browser with them.
   * @param {typeof MEASURES[number]} name @param {number} start
   */
  measure(name, start) {
    try {
      if (++this.measured % MOST_MEASURES === 0) MEASURES.forEach((each) => performance.clearMeasures(each));
      performance.measure(name, { start, end: performance.now() });
    } catch {
      // An old browser without the options: only the benchmark misses it.
    }
  }

  // -- size and keys ----------------------------------------------------------------------------------------------

  watchSizes() {
    // A notebook renders before it puts the element on the page: only there has it a style.
    const sizes = new ResizeObserver(() => (this.theme.known ? this.paint() : this.theme.apply()));
    for (const element of [this.root, ...this.root.querySelectorAll(".pf-plane-box, .pf-chart")])
      sizes.observe(element);
    return sizes;
  }

  keyboard() {
    this.press = this.press.bind(this);
    document.addEventListener("keydown", this.press, true);
    this.root.addEventListener("keydown", (event) => event.stopPropagation());
  }

  /** Undo and redo. @param {KeyboardEvent} event */
  press(event) {
    const { target } = event;
    // In the notebook around it the keys are the notebook's.
    if (!(target instanceof Node) || (!this.root.contains(target) && target !== document.body)) return;
    if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
    const key = event.key.toLowerCase();
    if ((key !== "z" && key !== "y") || this.typing.edits(target)) return;
    event.preventDefault();
    event.stopPropagation();
    if (key === "y" || event.shiftKey) this.design.redo();
    else this.design.undo();
  }
}

/** @param {{model: Model, el: HTMLElement}} host @returns {() => void} */
function render({ model, el }) {
  const designer = new Designer(model, el);
  return () => designer.destroy();
}

export default { render };
