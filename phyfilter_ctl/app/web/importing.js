/** A file on its way to Python, piece by piece, and what is to be asked about it. */

import { short } from "./numbers.js";
import { ImportDialog } from "./panels/import_dialog.js";

/** @import { App } from "./designer.js" */
/** @import { Answers } from "./link.js" */

const PIECE = 3_000_000; // bytes: a multiple of 3, so that the pieces' base64 has no ends between them
const A_LONG_FILE = 10 * PIECE;
// Of the question "import": a session's file may hold others.
const FIELDS = ["time", "time_unit", "x", "label", "g", "f_theta", "inertia", "unit_x", "unit_f", "step"];
const LARGEST_DIGESTED = 100_000_000; // bytes

/** Bytes of a part of a file as base64. @param {Blob} part @returns {Promise<string>} */
function base64(part) {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(String(reader.result).split(",")[1] ?? "");
    reader.onerror = () => reject(reader.error);
    reader.readAsDataURL(part);
  });
}

/** SHA-256 of a file; undefined where the browser gives none, and for files that it should not hold at once. @param {File} file */
async function digestOf(file) {
  if (!globalThis.crypto?.subtle || file.size > LARGEST_DIGESTED) return undefined;
  const bytes = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Send a recording of any size, and ask what is what in it; one that was open before is opened as it was. @param {App} app @param {File} file */
export async function openRecording(app, file) {
  const name = file.name.slice(0, 200);
  if (!file.size) {
    app.say(`${name} is empty: expected a header line and rows of numbers.`, "error");
    return;
  }
  for (let at = 0; at < file.size; at += PIECE) {
    const done = file.size > A_LONG_FILE ? ` ${short(at / 1e6, 3)} of ${short(file.size / 1e6, 3)} MB` : "";
    app.say(`Reading ${name} …${done}`);
    let data;
    try {
      data = await base64(file.slice(at, at + PIECE));
    } catch {
      app.say(`${name} cannot be read by the browser any more: was it moved or changed?`, "error");
      return;
    }
    if (!app.ok(await app.link.ask("upload", { name, size: file.size, at, data }))) return;
  }
  const { recording } = app.session;
  if (recording?.columns && recording.name === name && recording.size === file.size) {
    const kept = Object.entries(recording.columns);
    const fields = Object.fromEntries(kept.filter(([key]) => FIELDS.includes(key)));
    const reply = await app.link.ask("import", fields);
    if (reply?.ok) {
      await opened(app, reply, file, fields);
      return;
    }
  }
  await lookAt(app, file);
}

/** Ask about the file that Python has. @param {App} app @param {File | null} file where it is from the browser */
export async function lookAt(app, file) {
  const reply = await app.link.ask("preview");
  if (app.ok(reply)) new ImportDialog(app, reply, (answer, fields) => void opened(app, answer, file, fields)).open();
}

/**
 * A log that Python has opened, and what it has to say of it.
 * @param {App} app @param {Answers["import"]} reply @param {File | null} file @param {Record<string, unknown>} columns
 */
async function opened(app, { log, messages }, file, columns) {
  app.openLog({ ...log, messages });
  if (log.unit_f) {
    const { design } = app;
    const { assume, ...rest } = design.data();
    design.adopt({ ...rest, assume: { ...assume, unit: log.unit_f } }, design.family);
  }
  app.say(`Opened ${log.name}.`);
  if (!file) return;
  const sha256 = await digestOf(file);
  app.session.opened(file, { name: file.name.slice(0, 200), size: file.size, ...(sha256 ? { sha256 } : {}), columns });
}
