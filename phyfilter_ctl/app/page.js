/** The designer as a page: the interface of an anywidget model on top of requests to the server it came from. */

import designer from "./designer.js";

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

/** @param {string} token */
function connect(token) {
  /** @type {Map<string, Set<Function>>} */
  const listeners = new Map();
  const state = new Map();
  const emit = (name, ...values) => [...(listeners.get(name) ?? [])].forEach((listener) => listener(...values));

  async function answer(message) {
    const failed = (error) => ({ id: message.id, op: message.op, ok: false, error });
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
    get: (name) => state.get(name),
    set: (name, value) => {
      state.set(name, value);
      emit(`change:${name}`);
    },
    save_changes: () => {},
    send: (message) => void answer(message).then((reply) => emit("msg:custom", reply, [])),
    on: (name, listener) => {
      if (!listeners.has(name)) listeners.set(name, new Set());
      listeners.get(name).add(listener);
    },
    off: (name, listener) => {
      if (listener) listeners.get(name)?.delete(listener);
      else listeners.delete(name);
    },
  };
}

const el = document.getElementById("designer");
const token = readToken();
if (token) {
  designer.render({ model: connect(token), el });
} else {
  el.id = "refused";
  el.textContent = "This page needs the whole address that phyfilter-ctl app printed, with its token at the end.";
}
