/** The designer as a page: the interface of an anywidget model on top of requests to the server it came from. */

import designer from "./designer.js";

/** @import { Model, Question } from "./link.js" */

const KEY = "phyfilter-token";

/** The token of the address. It is kept for reloads of this tab and taken out of the address bar. */
function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEY);
}

/** @param {string} token @returns {Model} */
function connect(token) {
  /** @type {Map<string, Set<(value: any) => void>>} */
  const listeners = new Map();

  /** @param {Question} message @returns {Promise<unknown>} */
  async function answer(message) {
    const failed = (/** @type {string} */ error) => ({ id: message.id, op: message.op, ok: false, error });
    try {
      const response = await fetch("message", {
        method: "POST",
        headers: { "content-type": "application/json", "x-phyfilter-token": token },
        body: JSON.stringify(message),
      });
      const reply = await response.json();
      // A refusal is made before the message is read: it knows neither id nor op.
      return response.ok ? reply : failed(reply.error ?? `the server answers ${response.status}`);
    } catch {
      return failed("Python does not answer: is phyfilter-ctl app still running?");
    }
  }

  return {
    send: (message) =>
      void answer(message).then((reply) =>
        [...(listeners.get("msg:custom") ?? [])].forEach((listener) => listener(reply)),
      ),
    on: (event, listener) => {
      listeners.set(event, (listeners.get(event) ?? new Set()).add(listener));
    },
    off: (event, listener) => {
      listeners.get(event)?.delete(listener);
    },
  };
}

const el = /** @type {HTMLElement} */ (document.getElementById("designer"));
const token = readToken();
if (token) {
  designer.render({ model: connect(token), el });
} else {
  el.id = "refused";
  el.textContent = "This page needs the whole address that phyfilter-ctl app printed, with its token at the end.";
}
