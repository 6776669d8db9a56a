/** The loop in the frequency panel: L, S and T in Bode, L in Nyquist's and in Nichols' plane. */

import { largest, short } from "../numbers.js";
import { Chart } from "../plots/chart.js";
import { DASHES, kept } from "../plots/styles.js";
import { modulusOf } from "../state/views.js";

/** @import { App } from "../designer.js" */
/** @import { Band, Series } from "../plots/chart.js" */
/** @import { Pin } from "../state/preview.js" */
/** @import { Gains } from "../state/views.js" */
/** @import { Samples } from "../link.js" */

export const LOOP_CURVES = /** @type {const} */ ({
  L: { text: "L", title: "L: the loop, opened between command and actuator", colour: "F", dash: DASHES.solid },
  S: { text: "S", title: "S = 1/(1 + L): what the loop leaves of the residual", colour: "E", dash: DASHES.dash },
  T: { text: "T", title: "T = L/(1 + L): how far noise and M̂ act", colour: "S", dash: DASHES.dashdot },
});
export const LOOP_KEYS = /** @type {(keyof typeof LOOP_CURVES)[]} */ (Object.keys(LOOP_CURVES));
export const LOOP_WORDS = "L = M̂/M · Act · e^(−s delay) · F/(1 − F), opened between command and actuator: the ";
const M_CIRCLES = [12, 6, 3, 1, 0, -1, -3, -6, -12, -20]; // dB of |T|
const CIRCLE_POINTS = 181;
const REACH = 2.2; // of Nyquist's plane, up and down

const db = (/** @type {number | null} */ value) => (value === null ? null : 20 * Math.log10(value));

/**
 * Curves and bands of the Bode plot.
 * @param {App} app @param {Pin[]} pins @param {Record<"L" | "S" | "T", boolean>} shown
 */
export function loopBode(app, pins, shown) {
  const { palette, views } = app;
  /** @type {Series[]} */
  const lines = [];
  /** @type {Series[]} */
  const angles = [];
  for (const pin of pins) {
    if (!pin.curves) continue;
    const { colour, dash } = kept(pin.style);
    const { omega, polar } = views.gainsNow(pin);
    const style = { x: omega, colour: palette[colour], width: 1.5, dash };
    for (const key of LOOP_KEYS)
      if (shown[key]) lines.push({ ...style, name: `${key} of ${pin.name}`, y: polar[key].db });
    if (shown.L) angles.push({ ...style, name: `L of ${pin.name}`, y: polar.L.phase });
  }
  const { omega, polar } = views.gainsNow();
  for (const key of LOOP_KEYS) {
    if (!shown[key]) continue;
    const { colour, dash } = LOOP_CURVES[key];
    const style = { name: key, x: omega, colour: palette[colour], dash, width: 2.25 };
    lines.push({ ...style, y: polar[key].db });
    if (key === "L") angles.push({ ...style, y: polar.L.phase });
  }
  const answer = views.found.loop;
  const band = answer?.band;
  /** @type {Band[]} */
  const bands = [];
  /** @type {Band[]} */
  const turns = [];
  if (answer && band) {
    for (const key of LOOP_KEYS) {
      const [low, high] = band[key].map((values) => values.map(db));
      if (shown[key]) bands.push({ x: answer.omega, low, high, colour: palette[LOOP_CURVES[key].colour] });
    }
    const [low, high] = band.phase;
    if (shown.L) turns.push({ x: answer.omega, low, high, colour: palette.F });
  }
  return { lines, angles, bands, turns };
}

/** Nyquist's and Nichols' plane. */
export class LoopPlane {
  /** @param {App} app @param {(omega: number | null) => void} onCursor */
  constructor(app, onCursor) {
    this.app = app;
    this.chart = new Chart({
      test: "loop-plane",
      label: "Nyquist",
      height: 465,
      plane: true,
      parameter: { name: "ω", unit: "rad/s" },
      xLabel: "Re L",
      yLabel: "Im L",
      onCursor,
      changed: () => app.paint(),
    });
    this.element = this.chart.element;
    this.element.hidden = true;
    this.nichols = false;
  }

  /** @param {Pin[]} pins @param {boolean} nichols */
  draw(pins, nichols) {
    const { palette, views, design } = this.app;
    if (nichols !== this.nichols) this.chart.view = { x: null, y: null };
    this.nichols = nichols;
    const { settings } = this.chart;
    settings.label = nichols ? "Nichols" : "Nyquist";
    settings.xLabel = nichols ? "phase of L, °" : "Re L";
    settings.yLabel = nichols ? "magnitude of L, dB" : "Im L";
    this.chart.measure();
    const gains = views.gainsNow();
    const of = (/** @type {Gains} */ each) => points(each, nichols);
    /** @type {Series[]} */
    const series = nichols ? circlesOfT(palette.grid) : this.circles(gains);
    for (const corner of views.found.loop?.band?.corners ?? [])
      series.push({ ...cornerOf(corner.L, nichols), colour: palette.F, width: 0.8 });
    for (const pin of pins) {
      if (!pin.curves) continue;
      const { colour, dash } = kept(pin.style);
      series.push({ name: `L of ${pin.name}`, ...of(views.gainsNow(pin)), colour: palette[colour], width: 1.5, dash });
    }
    const curve = of(gains);
    if (!nichols) series.push({ x: curve.x, y: curve.y.map((value) => -value), colour: palette.F, width: 1 });
    series.push({ name: "L", ...curve, colour: palette.F, width: 2.25 });
    this.chart.series = series;
    this.chart.points = [
      { x: nichols ? -180 : -1, y: 0, text: nichols ? "−180°, 0 dB" : "−1" },
      ...(nichols ? [] : [this.closest(gains)]),
    ];
    this.home(nichols, gains, design.dragging);
    this.chart.draw(palette);
  }

  /** @param {boolean} nichols @param {Gains} gains @param {boolean} dragging */
  home(nichols, gains, dragging) {
    const { chart } = this;
    if (nichols) {
      const low = Math.min(-270, 90 * Math.floor(Math.min(...lowest(gains)) / 90));
      chart.x = dragging ? [Math.min(low, chart.home.x[0]), 0] : [low, 0];
      chart.range(-30, 30, false);
      return;
    }
    const { width, height } = chart.inner;
    const half = (REACH * width) / Math.max(height, 1);
    chart.x = [-0.4 - half, -0.4 + half];
    chart.range(-REACH, REACH, false);
  }

  /** The unit circle, and the one about -1 that L stays out of. @param {Gains} gains @returns {Series[]} */
  circles(gains) {
    const { palette } = this.app;
    const { distance } = modulusOf(gains);
    return [
      { ...circle(0, 1), colour: palette.muted, width: 1, dash: DASHES.dot },
      { ...circle(-1, Math.min(distance, 10)), colour: palette.E, width: 1.5, dash: DASHES.dash },
    ];
  }

  /** @param {Gains} gains */
  closest(gains) {
    const { distance, omega } = modulusOf(gains);
    return {
      x: -1,
      y: -Math.min(distance, 10),
      text: `${short(distance, 3)} from −1 at ${short(omega, 3)} rad/s`,
      plain: true,
    };
  }
}

/** Phase of L where its magnitude is drawn. @param {Gains} gains */
function lowest({ polar: { L } }) {
  return Array.from(L.phase).filter((value, k) => L.db[k] > -30 && Number.isFinite(value));
}

/** @param {Gains} gains @param {boolean} nichols */
function points({ omega, curves: { L }, polar }, nichols) {
  return nichols ? { at: omega, x: polar.L.phase, y: polar.L.db } : { at: omega, x: L.re, y: L.im };
}

/** @param {Samples[]} L @param {boolean} nichols */
function cornerOf([re, im], nichols) {
  if (!nichols) return { x: re.map(Number), y: im };
  const phase = re.map((value, k) => (Math.atan2(Number(im[k]), Number(value)) * 180) / Math.PI);
  const x = phase.map((value) => (value > 0 ? value - 360 : value));
  return { x: broken(x), y: re.map((value, k) => 20 * Math.log10(Math.hypot(Number(value), Number(im[k])))) };
}

/** A gap where the phase starts a new turn. @param {number[]} phase */
const broken = (phase) => phase.map((value, k) => (k && Math.abs(value - phase[k - 1]) > 180 ? NaN : value));

/** @param {number} middle @param {number} radius */
function circle(middle, radius) {
  const angles = Array.from({ length: CIRCLE_POINTS }, (_, k) => (2 * Math.PI * k) / (CIRCLE_POINTS - 1));
  return {
    x: angles.map((angle) => middle + radius * Math.cos(angle)),
    y: angles.map((angle) => radius * Math.sin(angle)),
  };
}

/** Where |T| is the same, in Nichols' plane: L = T/(1 - T). @param {string} colour @returns {Series[]} */
function circlesOfT(colour) {
  return M_CIRCLES.map((level) => {
    const M = 10 ** (level / 20);
    const x = [];
    const y = [];
    for (let k = 0; k < 2 * CIRCLE_POINTS; k++) {
      // Denser where T = M meets 1.
      const share = (k + 0.5) / (2 * CIRCLE_POINTS);
      const angle = 2 * Math.PI * (share - Math.sin(2 * Math.PI * share) / (2 * Math.PI));
      const [re, im] = [M * Math.cos(angle), M * Math.sin(angle)];
      const turned = Math.atan2(im, re) - Math.atan2(-im, 1 - re);
      const phase = (turned * 180) / Math.PI;
      x.push(phase - 360 * Math.ceil(phase / 360 - 1e-12));
      y.push(20 * Math.log10(M / Math.hypot(1 - re, im)));
    }
    return { x: broken(x), y, colour, width: 1, name: "" };
  });
}

/** How high the curves go, at most what is worth a look. @param {Series[]} lines @param {number} most */
export const topOf = (lines, most) => Math.min(most, Math.max(3, ...lines.map(({ y }) => (y.length ? largest(y) : 3))));
