/**
 * All that is kept of a session: what a file holds, what the browser keeps, what a notebook is saved with.
 *
 * A panel has its own state kept by registering it while it is made:
 *
 *     app.session.part("bode", { get: () => ({ unit: this.unit }), set: (kept) => this.choose(kept.unit) });
 *
 * and calls `app.session.changed()` when that state has changed without a gesture (a gesture is noticed by itself).
 */

import { filterOf } from "../mathematics/filter.js";
import { START } from "./design.js";

/** @import { DesignData, Recorded, SessionData } from "../link.js" */
/** @import { Design } from "./design.js" */

/**
 * State of a part: `get` gives what JSON holds, undefined for nothing; `set` gets what `get` gave, perhaps of an older
 * version, and may throw: the part is then left as it is.
 * @typedef {object} Part
 * @property {() => unknown} get
 * @property {(kept: any) => void} set
 */

export const FORMAT = "phyfilter-session";
export const VERSION = 1;
const DEEPEST = 3; // level from which the text of a file is not broken into lines
const LONGEST = 100; // characters that always stay on a line

export class Session {
  /** @param {Design} design */
  constructor(design) {
    this.design = design;
    /** @type {Map<string, Part>} */
    this.parts = new Map();
    /** Of parts that this version does not have. @type {Record<string, unknown>} */
    this.others = {};
    /** @type {Recorded | null} the recording that it was tried on */
    this.recording = null;
    /** @type {File | null} the same as it was given, for a Python that has forgotten it */
    this.file = null;
    /** @type {{get: () => SessionData["pins"], set: (pins: SessionData["pins"]) => void}} */
    this.pins = { get: () => [], set: () => {} };
    /** Hears that something is to be kept. */
    this.onChange = () => {};
  }

  /** Keep the state of a part too. @param {string} name @param {Part} part */
  part(name, part) {
    this.parts.set(name, part);
  }

  changed() {
    this.onChange();
  }

  /** A recording is open, or none is. @param {File | null} file @param {Recorded | null} recording */
  opened(file, recording) {
    this.file = file;
    this.recording = recording;
    this.changed();
  }

  /** @returns {SessionData} */
  data() {
    const { design } = this;
    const views = { ...this.others };
    for (const [name, part] of this.parts) {
      const kept = part.get();
      if (kept !== undefined) views[name] = kept;
    }
    const { past, now, future } = design.history;
    const steps = (/** @type {string[]} */ list) => list.map((text) => JSON.parse(text));
    return {
      format: FORMAT,
      version: VERSION,
      design: JSON.parse(now), // what a drag has not let go of yet is no step
      family: design.family,
      pins: this.pins.get(),
      recording: this.recording,
      views,
      history: { past: steps(past), future: steps(future) },
    };
  }

  /**
   * Go on with what was kept; "" or why not, and then nothing has changed.
   * @param {any} kept
   */
  take(kept) {
    const wrong = refusal(kept);
    if (wrong) return wrong;
    const { design } = this;
    design.load(kept.design, { fit: true, family: kept.family });
    const texts = (/** @type {unknown} */ list) => (Array.isArray(list) ? list : []).filter(sound).map(textOf);
    design.history.reset(design.text(), texts(kept.history?.past), texts(kept.history?.future));
    const pins = Array.isArray(kept.pins) ? kept.pins : [];
    this.pins.set(pins.filter((/** @type {any} */ pin) => sound(pin?.design)));
    this.recording = kept.recording ?? null;
    this.others = { ...kept.views };
    for (const [name, part] of this.parts) {
      if (!(name in this.others)) continue;
      try {
        part.set(this.others[name]);
      } catch (error) {
        console.info(`${name} is shown as usual: ${error}`);
      }
      delete this.others[name];
    }
    return "";
  }
}

/** Why something cannot be gone on with, or "". @param {any} kept */
function refusal(kept) {
  if (kept?.format !== FORMAT) return "This is no session of the designer.";
  if (!(kept.version <= VERSION))
    return `The session is of format ${kept.version}, and this designer reads up to ${VERSION}: update it.`;
  return sound(kept.design) ? "" : "The session holds no design that can be shown.";
}

/** Whether a design can be drawn. @param {DesignData} given */
function sound(given) {
  try {
    const { a, b } = filterOf({ ...START, ...given });
    const left = given.poles.every(([re, im]) => re < 0 && Number.isFinite(im));
    return left && given.sampling.dt > 0 && [...a, ...b].every(Number.isFinite);
  } catch {
    return false;
  }
}

/** As the history has it. @param {DesignData} given */
const textOf = ({ poles, numerator, sampling, assume, limits }) =>
  JSON.stringify({ poles, numerator, sampling, assume, limits });

/** JSON that people can read: outer levels in lines, what is inside on one. @param {unknown} value @param {number} [depth] @returns {string} */
export function readable(value, depth = 0) {
  const held = value && typeof value === "object" ? Object.entries(value) : [];
  const line = spaced(value);
  if (depth >= DEEPEST || !held.length || (depth && line.length <= LONGEST)) return line;
  const many = Array.isArray(value);
  const inside = "  ".repeat(depth + 1);
  const lines = held
    .filter(([, entry]) => entry !== undefined)
    .map(([key, entry]) => `${inside}${many ? "" : `${JSON.stringify(key)}: `}${readable(entry, depth + 1)}`);
  const [open, close] = many ? "[]" : "{}";
  return `${open}\n${lines.join(",\n")}\n${"  ".repeat(depth)}${close}`;
}

/** On one line, with spaces. @param {unknown} value @returns {string} */
function spaced(value) {
  if (Array.isArray(value)) return `[${value.map(spaced).join(", ")}]`;
  if (!value || typeof value !== "object") return JSON.stringify(value) ?? "null";
  const entries = Object.entries(value).filter(([, entry]) => entry !== undefined);
  return entries.length
    ? `{ ${entries.map(([key, entry]) => `${JSON.stringify(key)}: ${spaced(entry)}`).join(", ")} }`
    : "{}";
}
