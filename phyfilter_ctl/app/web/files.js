/** Files that come in and go out. */

import { h } from "./elements.js";
import { short } from "./numbers.js";

/** @import { App } from "./designer.js" */
/** @import { Download } from "./link.js" */

const LARGEST_LOG = 20_000_000; // characters

/** Open a log, or a filter file. @param {App} app @param {File} file */
export async function take(app, file) {
  if (file.size > LARGEST_LOG) {
    app.say(`${file.name} has ${short(file.size / 1e6, 3)} MB, expected at most 20 MB: cut or thin the log.`, "error");
    return;
  }
  const text = await file.text();
  const name = file.name.slice(0, 200);
  if (/\.toml$/i.test(name)) {
    const reply = await app.link.ask("open", { name, text });
    if (!app.ok(reply)) return;
    app.design.adopt(reply.design);
    app.say((reply.messages ?? []).join(" ") || `Opened ${name}.`);
    return;
  }
  app.say(`Reading ${name} …`);
  const reply = await app.link.ask("log", { name, text });
  if (!app.ok(reply)) return;
  app.openLog(reply.log);
  app.say(`Read ${name}.`);
}

/**
 * An input that files are picked with.
 * @param {App} app @param {string} accept @param {string} test @param {string} label
 */
export function picker(app, accept, test, label) {
  const input = h("input", { type: "file", accept, "aria-label": label, "data-test": test });
  input.addEventListener("change", () => {
    const file = input.files?.[0];
    input.value = "";
    if (file) void take(app, file);
  });
  return input;
}

/** Files dropped anywhere on the designer. @param {App} app */
export function takeDropped(app) {
  const { root } = app;
  root.addEventListener("dragover", (event) => {
    event.preventDefault();
    root.classList.add("pf-dropping");
  });
  root.addEventListener("dragleave", (event) => {
    if (!root.contains(/** @type {Node | null} */ (event.relatedTarget))) root.classList.remove("pf-dropping");
  });
  root.addEventListener("drop", (event) => {
    event.preventDefault();
    root.classList.remove("pf-dropping");
    const file = event.dataTransfer?.files?.[0];
    if (file) void take(app, file);
  });
}

/** Hand a file over to the browser. @param {App} app @param {Download} file */
export function download(app, { name, mime, base64, written }) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const address = URL.createObjectURL(new Blob([bytes], { type: mime }));
  const link = h("a", { href: address, download: name });
  app.root.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
  const size = short(Math.max(bytes.length / 1000, 0.1), 3);
  app.say(`${name}, ${size} kB, is with your downloads${written ? `, and is ${written}` : ""}.`);
}
