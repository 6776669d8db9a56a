/** Steps of undo and redo, as texts. */

const MOST_UNDO = 200;
const ONE_GESTURE = 700; // ms: the same again within this is one step

export class History {
  /** @param {string} now */
  constructor(now) {
    this.now = now;
    /** @type {string[]} */
    this.past = [];
    /** @type {string[]} */
    this.future = [];
    /** @type {{what: string, at: number} | null} */
    this.last = null;
  }

  /**
   * A step to a text; false where nothing has changed.
   * @param {string} text @param {string} what a name that a repeated gesture shares, or ""
   */
  commit(text, what) {
    if (text === this.now) return false;
    const repeated = what && what === this.last?.what && performance.now() - this.last.at < ONE_GESTURE;
    if (!repeated) this.past.push(this.now);
    if (this.past.length > MOST_UNDO) this.past.shift();
    this.future = [];
    this.now = text;
    this.last = { what, at: performance.now() };
    return true;
  }

  /** Begin from here. @param {string} now @param {string[]} past @param {string[]} future */
  reset(now, past, future) {
    this.now = now;
    this.past = past.slice(-MOST_UNDO);
    this.future = future.slice(-MOST_UNDO);
    this.last = null;
  }

  undo() {
    return this.travel(this.past, this.future);
  }

  redo() {
    return this.travel(this.future, this.past);
  }

  /** @param {string[]} from @param {string[]} to @returns {string | undefined} */
  travel(from, to) {
    const text = from.pop();
    if (text === undefined) return undefined;
    to.push(this.now);
    this.now = text;
    this.last = null;
    return text;
  }
}
