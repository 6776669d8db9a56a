/**
 * The interface of an anywidget model on top of requests to the server that the page came from.
 *
 * The server may end and start again: then it has another token. A page that its browser opens at the new address tells
 * the others of that address, each of which tries the token that it is told before it believes it.
 */

/** @import { Connection, Model, Question } from "./link.js" */
/** @import { Shelf } from "./page_shelf.js" */

const TOKEN = "phyfilter-token";
const CHANNEL = "phyfilter-designer";
const AGAIN = 1000; // ms between questions whether Python is back

/** @param {string} text of an address, or a token */
const tokenIn = (text) => new URLSearchParams(text.slice(text.indexOf("#") + 1)).get("token") ?? text.trim();

/** The token of the address. It is kept for reloads of this tab and taken out of the address bar. */
export function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(TOKEN);
}

/** @implements {Model} */
export class PageModel {
  /** @param {string} token @param {string} tab @param {Shelf} shelf */
  constructor(token, tab, shelf) {
    this.token = token;
    this.tab = tab;
    this.shelf = shelf;
    /** @type {Connection} */
    this.connection = "open";
    this.told = false;
    this.looking = false;
    /** @type {unknown} */
    this.session = shelf.read();
    /** @type {Map<string, Set<(value: any) => void>>} */
    this.listeners = new Map();
    this.channel = new BroadcastChannel(CHANNEL);
    this.channel.onmessage = ({ data }) => {
      if (typeof data === "string" && this.connection !== "open") void this.tryToken(data);
    };
  }

  /** @param {string} event @param {(value: any) => void} listener */
  on(event, listener) {
    this.listeners.set(event, (this.listeners.get(event) ?? new Set()).add(listener));
  }

  /** @param {string} event @param {(value: any) => void} listener */
  off(event, listener) {
    this.listeners.get(event)?.delete(listener);
  }

  /** @param {string} event @param {unknown} value */
  trigger(event, value) {
    for (const listener of [...(this.listeners.get(event) ?? [])]) listener(value);
  }

  // -- what is kept -----------------------------------------------------------------------------------------------

  /** @param {string} name */
  get(name) {
    return name === "session" ? this.session : undefined;
  }

  /** @param {string} name @param {unknown} value */
  set(name, value) {
    if (name === "session") this.session = value;
  }

  /** Throws where the browser keeps nothing. */
  save_changes() {
    this.shelf.write(this.session);
  }

  /** Keep the session among those of tabs that were closed. */
  putAside() {
    this.shelf.putAside();
  }

  /** Sessions of tabs that were closed. */
  left() {
    return this.shelf.left();
  }

  // -- questions --------------------------------------------------------------------------------------------------

  /** @param {Question} message */
  send(message) {
    void this.answer(message).then((reply) => this.trigger("msg:custom", reply));
  }

  /** @param {Question} message @returns {Promise<unknown>} */
  async answer(message) {
    const failed = (/** @type {string} */ error) => ({ id: message.id, op: message.op, ok: false, error });
    try {
      const response = await this.request(message, this.token);
      const reply = await response.json();
      if (response.status === 401) this.become("refused");
      else this.become("open");
      // A refusal is made before the message is read: it knows neither id nor op.
      return response.ok ? reply : failed(reply.error ?? `the server answers ${response.status}`);
    } catch {
      this.become("away");
      return failed("Python does not answer: is phyfilter-ctl app still running?");
    }
  }

  /** @param {object} message @param {string} token */
  request(message, token) {
    return fetch("message", {
      method: "POST",
      headers: { "content-type": "application/json", "x-phyfilter-token": token, "x-phyfilter-tab": this.tab },
      body: JSON.stringify(message),
    });
  }

  // -- an end of the server, and another beginning ------------------------------------------------------------------

  /** @param {Connection} connection */
  become(connection) {
    const before = this.connection;
    this.connection = connection;
    if (connection === "open" && !this.told) {
      this.told = true;
      this.channel.postMessage(this.token); // it is Python's: it has answered
    }
    if (connection !== before) this.trigger("connection", connection);
    if (connection === "away") void this.look();
  }

  /** Whether Python is back, until it is. */
  async look() {
    if (this.looking) return;
    this.looking = true;
    while (this.connection === "away") {
      await new Promise((resolve) => setTimeout(resolve, AGAIN));
      await this.tryToken(this.token);
    }
    this.looking = false;
  }

  /** Go on with a token, or with the address that has it; false where Python does not know it. @param {string} given */
  async tryToken(given) {
    const token = tokenIn(given);
    try {
      const response = await this.request({ id: 0, op: "hello" }, token);
      await response.text();
      if (response.status === 401) {
        if (this.connection === "away") this.become("refused");
        return false;
      }
    } catch {
      return false;
    }
    this.token = token;
    sessionStorage.setItem(TOKEN, token);
    this.become("open");
    return true;
  }
}
