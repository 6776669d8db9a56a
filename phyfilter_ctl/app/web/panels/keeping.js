/** What is kept of the work, where, and what is to be done when Python has gone. */

import { h, write } from "../elements.js";
import { handOver } from "../files.js";
import { Popover } from "../popover.js";
import { readable } from "../state/session.js";
import { button, textInput } from "./parts.js";

/** @import { App } from "../designer.js" */
/** @import { Connection, Model, SessionData } from "../link.js" */

const SOON = 400; // ms after the last change
const GESTURES = ["pointerup", "keyup", "change", "click"];
const AWAY = {
  away: "Python does not answer. Your work is kept in this browser, not in Python: go on, or start phyfilter-ctl app again.",
  refused:
    "Python was started again, at another address. Your work is kept in this browser: paste the address that " +
    "phyfilter-ctl app printed, or open it in this browser.",
};

export class Keeping {
  /** @param {App} app @param {Model} model @param {{back: () => void}} does back: Python answers again */
  constructor(app, model, does) {
    this.app = app;
    this.model = model;
    this.back = does.back;
    this.page = model.left !== undefined;
    /** What was kept last. */
    this.text = JSON.stringify(model.get?.("session") ?? {});
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    this.words = h("span", { "data-test": "kept" });
    this.list = h("ul", { class: "pf-kept-list", "data-test": "kept-sessions" });
    this.others = new Popover("kept-others", "Other sessions", [this.list], {
      given: { class: "pf-quiet", title: "Sessions of tabs that were closed, kept in this browser" },
      opened: () => void this.showOthers(),
    });
    const others = this.page ? this.others.element : null;
    this.element = h("section", { class: "pf-kept", "aria-label": "What is kept" }, this.words, others);
    this.told = h("p", { "data-test": "away-text" });
    this.address = textInput({ "aria-label": "Address that phyfilter-ctl app printed", "data-test": "address" });
    this.address.placeholder = "127.0.0.1:8463/#token=…";
    this.address.inputMode = "url";
    const connect = button("connect", "Connect", () => void this.connect());
    this.address.addEventListener("keydown", (event) => {
      if (event.key === "Enter") void this.connect();
    });
    const asked = h("div", { class: "pf-away-address" }, this.address, connect);
    this.banner = h(
      "section",
      { class: "pf-away", role: "alert", "data-test": "away", hidden: true },
      this.told,
      asked,
    );
    this.say();
    this.listen();
  }

  listen() {
    const { app, model } = this;
    this.soon = this.soon.bind(this);
    this.keep = this.keep.bind(this);
    this.followed = this.followed.bind(this);
    this.connected = this.connected.bind(this);
    app.session.onChange = this.soon;
    for (const gesture of GESTURES) app.root.addEventListener(gesture, this.soon);
    window.addEventListener("pagehide", this.keep);
    model.on("change:session", this.followed);
    model.on("connection", this.connected);
  }

  close() {
    this.keep();
    clearTimeout(this.timer);
    window.removeEventListener("pagehide", this.keep);
    this.model.off?.("change:session", this.followed);
    this.model.off?.("connection", this.connected);
  }

  // -- keeping ----------------------------------------------------------------------------------------------------

  soon() {
    clearTimeout(this.timer);
    this.timer = setTimeout(this.keep, SOON);
  }

  keep() {
    clearTimeout(this.timer);
    const { model, app } = this;
    const data = app.session.data();
    const text = JSON.stringify(data);
    if (text === this.text || !model.set) return;
    this.text = text;
    try {
      model.set("session", data);
      model.save_changes?.();
      this.say();
    } catch {
      this.say("Not kept: this browser keeps nothing more for this page. Save the session as a file.");
    }
  }

  /** @param {string} [words] */
  say(words = this.page ? "Kept in this browser as you work." : "Kept with the notebook as you work.") {
    write(this.words, words);
  }

  /** Go on with what was kept before a reload; false where there is nothing. */
  restore() {
    const kept = /** @type {any} */ (this.model.get?.("session"));
    if (!kept?.format) return false;
    const wrong = this.app.session.take(kept);
    if (!wrong) this.text = JSON.stringify(this.app.session.data());
    else this.app.say(`What was kept cannot be shown: ${wrong}`, "warn");
    return !wrong;
  }

  /** Another view of the notebook's model, or Python, has changed the session. */
  followed() {
    const kept = /** @type {any} */ (this.model.get?.("session"));
    const text = JSON.stringify(kept);
    if (!kept?.format || text === this.text || this.app.design.dragging) return;
    this.text = text;
    this.app.session.take(kept);
  }

  // -- files ------------------------------------------------------------------------------------------------------

  /** The session as a file; made here, so Python need not answer. */
  save() {
    const text = readable(this.app.session.data());
    handOver(this.app, "session.json", "application/json", new TextEncoder().encode(`${text}\n`));
  }

  /** Go on with another session; this one stays among those that are kept. @param {SessionData} kept @param {string} name */
  async open(kept, name) {
    const { app, model } = this;
    model.putAside?.();
    const before = app.session.recording;
    const wrong = app.session.take(kept);
    if (wrong) {
      app.say(wrong, "error");
      return;
    }
    this.soon();
    const { recording } = app.session;
    if (before && !same(before, recording)) {
      await app.link.ask("forget");
      app.openLog(null);
      app.session.recording = recording;
    }
    app.say(`Opened ${name}. ${same(before, recording) ? "" : this.missing()}`.trim());
  }

  /** Which recording the session was tried on that is not open, in a sentence. */
  missing() {
    const { recording } = this.app.session;
    return recording ? `It was tried on the recording ${recording.name}: drop that here to go on with it.` : "";
  }

  async showOthers() {
    const { list } = this;
    const left = (await this.model.left?.()) ?? [];
    list.replaceChildren(
      ...left.map(({ at, data }, i) => {
        const name = `the session of ${new Date(at).toLocaleString()}`;
        const steps = data?.history?.past?.length ?? 0;
        const words = `${name.slice(4)}, order ${data?.design?.poles?.length ?? "–"}, ${steps} step${steps === 1 ? "" : "s"}`;
        const open = button(`kept-${i}`, "Open", () => void this.choose(data, name), { "aria-label": `Open ${words}` });
        return h("li", {}, words, open);
      }),
    );
    if (!left.length) list.append(h("li", {}, "There is no other: sessions of tabs that you close are kept here."));
  }

  /** @param {SessionData} data @param {string} name */
  async choose(data, name) {
    this.others.close();
    await this.open(data, name);
  }

  // -- Python ends and begins -------------------------------------------------------------------------------------

  /** @param {Connection} connection */
  connected(connection) {
    this.banner.hidden = connection === "open";
    if (connection === "open") this.back();
    else {
      write(this.told, AWAY[connection]);
      this.keep();
    }
  }

  async connect() {
    if (!(await this.model.tryToken?.(this.address.value)))
      this.app.say("Nothing answers to this address: copy it to its end, with the token.", "warn");
    else this.address.value = "";
  }
}

/** @param {{name: string, sha256?: string} | null} one @param {{name: string, sha256?: string} | null} other */
const same = (one, other) => one?.name === other?.name && one?.sha256 === other?.sha256;
