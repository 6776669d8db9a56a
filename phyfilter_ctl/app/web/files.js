/** Files that come in and go out. */

import { h } from "./elements.js";
import { openRecording } from "./importing.js";
import { short } from "./numbers.js";

/** @import { App } from "./designer.js" */
/** @import { Download } from "./link.js" */
/** @import { Taken } from "./plots/take_chart.js" */

/** Open a log, or a filter file. @param {App} app @param {File} file */
export async function take(app, file) {
  const name = file.name.slice(0, 200);
  if (/\.toml$/i.test(name)) {
    const text = await file.text();
    const reply = await app.link.ask("open", { name, text });
    if (!app.ok(reply)) return;
    app.design.adopt(reply.design);
    app.say((reply.messages ?? []).join(" ") || `Opened ${name}.`);
    return;
  }
  if (/\.json$/i.test(name)) {
    const reply = await app.link.ask("session", { text: await file.text() });
    if (app.ok(reply)) await app.openSession(reply.session, name);
    return;
  }
  await openRecording(app, file);
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

/** Charts that are taken away, under names that tell one design from another. @param {App} app */
export function keepTaken(app) {
  app.root.addEventListener("pf-take", async (event) => {
    if (!(event instanceof CustomEvent)) return;
    const { name, blob } = /** @type {Taken} */ (event.detail);
    const [stem, ending] = name.split(".");
    const bytes = new Uint8Array(await blob.arrayBuffer());
    handOver(app, `${stem}-${shortDigest(app.design.text())}.${ending}`, blob.type, bytes);
  });
}

/** Eight hexadecimal digits that another text hardly has (FNV-1a). @param {string} text */
function shortDigest(text) {
  let hash = 0x811c9dc5;
  for (let k = 0; k < text.length; k++) hash = Math.imul(hash ^ text.charCodeAt(k), 0x01000193) >>> 0;
  return hash.toString(16).padStart(8, "0");
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

/** Hand a file that Python made over to the browser. @param {App} app @param {Download} file */
export function download(app, { name, mime, base64, written, messages = [] }) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  handOver(app, name, mime, bytes, written ? `, and is ${written}` : "", messages);
}

/**
 * Hand a file over to the browser.
 * @param {App} app @param {string} name @param {string} mime @param {Uint8Array<ArrayBuffer>} bytes @param {string} [also]
 * @param {string[]} [messages] what the file states
 */
export function handOver(app, name, mime, bytes, also = "", messages = []) {
  const address = URL.createObjectURL(new Blob([bytes], { type: mime }));
  const link = h("a", { href: address, download: name });
  app.root.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
  const size = short(Math.max(bytes.length / 1000, 0.1), 3);
  app.say([`${name}, ${size} kB, is with your downloads${also}.`, ...messages].join(" "));
}
