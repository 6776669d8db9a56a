/** Messages to Python and back: one of a kind in flight, the newest of the waiting ones next. */

/** @import { Complex } from "./mathematics/polynomials.js" */
/** @import { Numerator } from "./mathematics/filter.js" */
/** @import { Method } from "./mathematics/sampled.js" */

/**
 * @typedef {object} Assumptions
 * @property {number} slope
 * @property {number} noise
 * @property {number} ratio
 * @property {number} lag s
 * @property {number} delay s
 * @property {string} unit
 * @property {number} [ratio_spread] the ratio is between ratio/(1 + this) and ratio (1 + this)
 * @property {number} [lag_spread] s, to either side
 * @property {number} [delay_spread] s, to either side
 */
/** @typedef {{omega: number, level: number}} Limit */
/** @typedef {"error" | "estimate"} LimitKind  of |1 - F|, of |F| */
/** @typedef {Partial<Record<LimitKind, Limit>>} Limits */
/**
 * @typedef {object} DesignData
 * @property {Complex[]} poles
 * @property {Numerator} numerator
 * @property {{dt: number, method: Method}} sampling
 * @property {Assumptions} assume
 * @property {Limits | null} limits
 */
/** @typedef {{name: string, size?: number, sha256?: string, columns?: unknown}} Recorded  a recording, not its data */
/**
 * A session as it is kept; the schema is that of app/sessions.py.
 * @typedef {object} SessionData
 * @property {string} format
 * @property {number} version
 * @property {DesignData} design
 * @property {string} family
 * @property {{name: string, design: DesignData}[]} pins
 * @property {Recorded | null} recording
 * @property {Record<string, unknown>} views
 * @property {{past: DesignData[], future: DesignData[]}} history
 */
/** @typedef {{text: string, level: "good" | "warn" | "bad"}} Sentence */
/** @typedef {{key: string, label?: string, value: number | null, unit?: string, note?: string}} Figure */
/**
 * @typedef {object} LogSummary
 * @property {string} name
 * @property {string[]} channels
 * @property {number} samples
 * @property {number} dt
 * @property {boolean} has_label
 * @property {string} [unit_f] of f, as the columns or the user say
 * @property {string[]} [messages] what was done to read it, and what is odd about it
 */
/** @typedef {"x" | "label" | "g" | "f_theta" | "inertia"} RoleName */
/**
 * What a file holds that is to be opened as a log.
 * @typedef {object} Preview
 * @property {{name: string, size: number, format: string}} file
 * @property {{key: string, unit: string, numeric: boolean, first: string[]}[]} columns
 * @property {number} more_columns
 * @property {{column: string | null, unit: string, said: string, recognised: boolean, choices: Record<string, number>, even: boolean, step: number | null, fixed: boolean}} time
 * @property {Record<RoleName, string[]>} roles
 * @property {string[]} messages
 */
/** @typedef {{log: LogSummary, messages: string[]}} Opened */
/** @typedef {{name: string, mime: string, base64: string, written?: string, messages?: string[]}} Download */
/** @typedef {{kind: string, able: boolean, why: string}} Exportable */
/** @typedef {{name: string, exports: Exportable[], channels: number}} Exchange */
/**
 * A filter of a front; its figures for the assumed noise and slope.
 * @typedef {{design: DesignData, noise: number, bound: number, bandwidth: number, delay_margin: number | null}} FrontPoint
 */
/** @typedef {{state: string, message: string, done: number, certain: boolean, front: FrontPoint[]}} Front */
/** @typedef {{state: string, curve?: [number, number][], message?: string, design?: DesignData | null}} Job */
/** @typedef {(number | null)[]} Samples */
/**
 * @typedef {object} Estimate
 * @property {number[]} t
 * @property {Samples | null} f_hat null while Python runs over a long log
 * @property {boolean} [pending]
 * @property {string} [over] which samples the errors are over
 * @property {Samples | null} [f_theta]
 * @property {Samples | null} [label]
 * @property {number | null} [rmse]
 * @property {number | null} [rmse_model]
 * @property {number | null} [wiener]
 * @property {string[]} [messages]
 */
/** @typedef {{ratio: number, lag: number, delay: number, L: Samples[]}} Corner */
/** @typedef {Record<"L" | "S" | "T" | "phase", Samples[]> & {corners: Corner[], members: number, unstable: number}} LoopBand */
/**
 * @typedef {object} LoopAnswer real and imaginary parts; least and largest magnitudes
 * @property {number[]} omega
 * @property {Samples[]} L
 * @property {Samples[]} S
 * @property {Samples[]} T
 * @property {string} note
 * @property {boolean} stable
 * @property {LoopBand | null} band
 * @property {string} message
 */
/**
 * @typedef {object} LocusAnswer
 * @property {number[]} at
 * @property {(Complex | null)[][]} branches
 * @property {Complex[]} now
 * @property {{at: number, omega: number, leaving: number}[]} limits
 * @property {string} message
 */
/** @typedef {{value: Samples, low?: Samples, high?: Samples}} Ranged */
/**
 * @typedef {object} ResponsesAnswer
 * @property {number[]} t
 * @property {Ranged} command
 * @property {Ranged} disturbance
 * @property {Ranged} noise
 * @property {number | null} noise_sd
 * @property {number | null} dt
 * @property {string} message
 */
/**
 * @typedef {object} Hello
 * @property {string} [version]
 * @property {DesignData} [design]
 * @property {string[]} [families]
 * @property {LogSummary | null} [log]
 * @property {string | null} [waiting] a file whose columns are to be asked about
 * @property {SessionData | null} [session] that Python was started with
 */
/**
 * What Python answers, by the op of the question; handling.py says what is asked.
 * @typedef {object} Answers
 * @property {Hello} hello
 * @property {{numbers: Figure[], verdict?: Sentence[], messages?: string[], frequency: {omega: number[], F: Samples[]}}} design
 * @property {{design: DesignData}} family
 * @property {{log: LogSummary | null}} log
 * @property {{log: null}} forget
 * @property {{received: number, size: number}} upload
 * @property {Preview} preview
 * @property {Opened} import
 * @property {Opened} example
 * @property {{dt: number, slope: number, noise: number, messages: string[]}} measured
 * @property {Estimate} estimate
 * @property {{job: number}} learn
 * @property {Job} job
 * @property {Job} cancel
 * @property {{text: string}} python
 * @property {Download} save
 * @property {{design: DesignData, messages?: string[]}} open
 * @property {Exchange} exports
 * @property {{session: SessionData}} session
 * @property {Download} export
 * @property {LoopAnswer} loop
 * @property {LocusAnswer} locus
 * @property {ResponsesAnswer} responses
 * @property {Download} report
 * @property {{compared: Figure[][]}} compare
 * @property {{job: number}} meet
 * @property {Front} front
 * @property {Front} unmeet
 */
/** @typedef {(reply: any) => void} Resolve */
/** @typedef {{id: number, resolve: Resolve, since: number, timer: ReturnType<typeof setTimeout>}} Flying */
/** @typedef {{id: number, op: string} & Record<string, unknown>} Question */
/** @typedef {{ok: false, error?: string, where?: string}} Refusal  where: the field that is to blame */
/**
 * @template Answer
 * @typedef {({ok: true} & Answer) | Refusal} Reply
 */
/**
 * What is used of anywidget's model; page.js has one of its own.
 * @typedef {object} Model
 * @property {(message: Question) => void} send
 * @property {(event: string, listener: (value: any) => void) => void} on
 * @property {(event: string, listener: (value: any) => void) => void} [off]
 * @property {(name: string) => unknown} [get]
 * @property {(name: string, value: unknown) => void} [set]
 * @property {() => void} [save_changes]
 * @property {() => Promise<{tab: string, at: number, data: any}[]>} [left] sessions of tabs that were closed; page only
 * @property {() => void} [putAside] keep the session among them; page only
 * @property {(address: string) => Promise<boolean>} [tryToken] go on with Python at another address; page only
 */
/** @typedef {"open" | "away" | "refused"} Connection  refused: Python was started again and has another token */

const BUSY_AFTER = 300; // ms
const LOST_AFTER = 60_000; // ms; a kernel that was restarted never answers
const READS_LONG = ["preview", "import"];
const LOST_READING = 600_000; // ms; a file of gigabytes

export class Link {
  /**
   * @param {Model} model
   * @param {(since: number | null) => void} onBusy called with when the oldest open question was asked
   */
  constructor(model, onBusy) {
    this.model = model;
    this.onBusy = onBusy;
    // Two views of one notebook model hear each other's replies: their numbers must not meet.
    this.next = Math.floor(Math.random() * 2 ** 30) * 2 ** 20 + 1;
    /** @type {Map<string, Flying | null>} */
    this.flying = new Map();
    /** @type {Map<string, {fields: Record<string, unknown>, resolve: Resolve}[]>} */
    this.waiting = new Map();
    this.receive = this.receive.bind(this);
    model.on("msg:custom", this.receive);
    this.clock = setInterval(() => this.watch(), 100);
  }

  close() {
    this.model.off?.("msg:custom", this.receive);
    clearInterval(this.clock);
    for (const entry of this.flying.values()) clearTimeout(entry?.timer);
  }

  /**
   * Ask Python. Resolves with the reply; with null where a newer question of the kind took its place.
   * @template {keyof Answers} Op
   * @param {Op} op @param {Record<string, unknown>} [fields] @param {{latest?: boolean}} [how]
   * @returns {Promise<Reply<Answers[Op]> | null>}
   */
  ask(op, fields = {}, { latest = false } = {}) {
    return new Promise((resolve) => {
      const queue = this.waiting.get(op) ?? [];
      if (latest) queue.splice(0).forEach((old) => old.resolve(null));
      queue.push({ fields, resolve });
      this.waiting.set(op, queue);
      this.send(op);
    });
  }

  /** @param {string} op */
  send(op) {
    const next = this.flying.get(op) ? undefined : this.waiting.get(op)?.shift();
    if (!next) return;
    const id = this.next++;
    const patience = READS_LONG.includes(op) ? LOST_READING : LOST_AFTER;
    const lost = () =>
      this.settle(op, id, {
        id,
        op,
        ok: false,
        error: `Python has not answered for ${patience / 1000} s: is it still running?`,
      });
    this.flying.set(op, { id, resolve: next.resolve, since: performance.now(), timer: setTimeout(lost, patience) });
    try {
      this.model.send({ id, op, ...next.fields });
    } catch (error) {
      this.settle(op, id, { id, op, ok: false, error: `the message could not be sent: ${error}` });
    }
  }

  /** @param {any} reply */
  receive(reply) {
    if (reply && typeof reply === "object") this.settle(reply.op, reply.id, reply);
  }

  /** @param {string | null} op @param {number} id @param {any} reply */
  settle(op, id, reply) {
    // A refusal may not know its op: the number decides.
    const kind = [...this.flying.keys()].find((name) => this.flying.get(name)?.id === id) ?? op;
    const entry = kind ? this.flying.get(kind) : null;
    if (!kind || !entry || entry.id !== id) return;
    clearTimeout(entry.timer);
    this.flying.set(kind, null);
    entry.resolve(reply);
    this.send(kind);
    this.watch();
  }

  watch() {
    const since = Math.min(...[...this.flying.values()].map((entry) => entry?.since ?? Infinity));
    this.onBusy(performance.now() - since > BUSY_AFTER ? since : null);
  }
}
