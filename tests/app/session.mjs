// What a session keeps, without a page, for test_session_state.py: node session.mjs folder-of-the-modules < {gestures, kept}
//
// The gestures are made in one session, whose text another one takes over; the answer has both, and what other `kept` texts
// are refused with.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const load = (name) => import(pathToFileURL(join(process.argv[2], name)).href);
const { Design } = await load("state/design.js");
const { Session, readable } = await load("state/session.js");
const quiet = () => {};

function opened() {
  const design = new Design({ rebuilt: quiet, chosen: quiet, committed: quiet, warn: quiet });
  const session = new Session(design);
  const view = { scale: "log" };
  session.part("plane", { get: () => ({ ...view }), set: (kept) => Object.assign(view, { scale: kept.scale.trim() }) });
  let pins = [];
  session.pins = { get: () => pins, set: (given) => (pins = given) };
  return { design, session, view };
}

const { gestures, kept } = JSON.parse(readFileSync(0, "utf8"));
const first = opened();
for (const [name, ...given] of gestures) first.design[name](...given);
first.session.pins.set([{ name: "before", design: first.design.data() }]);
first.session.recording = { name: "flight.csv", size: 12, sha256: "00" };
first.session.others = { later: { shown: true } };
first.view.scale = "linear";
const text = readable(first.session.data());
const second = opened();
const said = second.session.take(JSON.parse(text));
const again = readable(second.session.data());
second.design.undo();
const third = opened();
const refused = kept.map((data) => third.session.take(data));
process.stdout.write(
  JSON.stringify({
    text,
    again,
    said,
    undone: second.design.data(),
    view: second.view,
    refused,
    untouched: third.design.data(),
    history: third.design.history.past.length,
  }),
);
