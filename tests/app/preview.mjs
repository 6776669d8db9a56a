// What the designer's preview computes, for test_preview.py: node preview.mjs folder-of-the-modules < questions.json
//
// A question is {design, omega, below, loop, duration, points}, answered with every curve and figure of the preview, or {call, given},
// answered with what the exported function of that name returns.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const names = ["edits", "figures", "filter", "loop", "sampled"].map((name) => `mathematics/${name}.js`).concat("state/roots.js", "numbers.js");
const modules = await Promise.all(names.map((name) => import(pathToFileURL(join(process.argv[2], name)).href)));
const preview = Object.assign({}, ...modules);
const pair = ({ re, im }) => [Array.from(re), Array.from(im)];

function answer({ design, omega, below, loop, duration, points }) {
  const filter = preview.filterOf(design);
  const { dt, method } = design.sampling;
  const sampled = preview.sampledResponse(filter, dt, method, below);
  const step = preview.stepResponse(filter, duration, points);
  const F = preview.response(filter, omega);
  return {
    a: filter.a,
    b: filter.b,
    c: filter.c,
    type: filter.type,
    zeros: filter.zeros,
    F: pair(F),
    E: pair(preview.errorResponse(filter, omega)),
    phase: Array.from(preview.polar(F).phase),
    S: pair(sampled.F),
    SE: pair(sampled.E),
    loop: loop && Object.values(preview.loopCurves(filter, design.sampling, design.assume, loop)).map(pair),
    t: Array.from(step.t),
    step: Array.from(step.F),
    stepError: Array.from(step.E),
    noiseGain: preview.noiseGain(filter, dt, method),
    eulerLimit: preview.eulerLimit(filter),
    bandwidth: preview.bandwidth(filter),
    settling: preview.settlingTime(filter),
  };
}

const questions = JSON.parse(readFileSync(0, "utf8"));
const answers = questions.map((question) => (question.call ? (preview[question.call](...question.given) ?? null) : answer(question)));
process.stdout.write(JSON.stringify(answers));
