// The design as gestures leave it, without a page, for test_design_state.py: node design.mjs folder-of-the-modules < stories.json
//
// A story is a list of gestures, [name of a method, ...what it is given]; the answer has for each story the design, what was
// warned of, and every committed text.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const { Design } = await import(pathToFileURL(join(process.argv[2], "state/design.js")).href);
const quiet = () => {};

function after(gestures) {
  const warned = [];
  const committed = [];
  const design = new Design({
    rebuilt: quiet,
    chosen: quiet,
    committed: (text) => committed.push(text),
    warn: (text) => warned.push(text),
  });
  const returned = [];
  for (const [name, ...given] of gestures) {
    // A root is named by its place in the list, as its number is not known here.
    const ids = given.map((value) => (value?.root ? design.roots(value.root)[value.at].id : value));
    returned.push(design[name](...ids) ?? null);
  }
  return { data: design.data(), warned, committed, returned, family: design.family };
}

process.stdout.write(JSON.stringify(JSON.parse(readFileSync(0, "utf8")).map(after)));
