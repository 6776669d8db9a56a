/**
 * Where poles are wanted in the s-plane: damping, overshoot, settling, natural frequency. Overshoot and settling are
 * taken as of one dominant pair of poles without zeros.
 */

/** @import { Place } from "./roots.js" */
/** @typedef {"damping" | "overshoot" | "settling" | "slowest" | "fastest"} RegionKey */
/** @typedef {Record<RegionKey, number | null>} Region  zeta; share; s; rad/s; rad/s */

/** @type {Record<RegionKey, {text: string, unit: string, factor: number, range: [number, number], title: string}>} */
export const REGION = {
  damping: { text: "Damping ζ ≥", unit: "", factor: 1, range: [0.01, 0.99], title: "Damping ratio of every pole" },
  overshoot: {
    text: "Overshoot ≤",
    unit: "%",
    factor: 100,
    range: [0.001, 0.95],
    title: "Of the step response, as of one dominant pair of poles without zeros: a bound of the damping",
  },
  settling: {
    text: "Settling ≤",
    unit: "ms",
    factor: 1e3,
    range: [1e-4, 1e4],
    title: "To 2 %, by the envelope e^(σ t) of one dominant pole: a bound of the real part",
  },
  slowest: {
    text: "Bandwidth |s| ≥",
    unit: "rad/s",
    factor: 1,
    range: [1e-3, 1e5],
    title: "Natural frequency of every pole",
  },
  fastest: {
    text: "Bandwidth |s| ≤",
    unit: "rad/s",
    factor: 1,
    range: [1e-3, 1e5],
    title: "Natural frequency of every pole",
  },
};
export const REGION_KEYS = /** @type {RegionKey[]} */ (Object.keys(REGION));
const SETTLED = Math.log(50); // 2 %

/** Nothing wanted, or what was kept of it. @param {any} [kept] @returns {Region} */
export function startRegion(kept) {
  const one = (/** @type {RegionKey} */ key) => {
    const value = kept?.[key];
    const [low, high] = REGION[key].range;
    return typeof value === "number" && value >= low && value <= high ? value : null;
  };
  return /** @type {Region} */ (Object.fromEntries(REGION_KEYS.map((key) => [key, one(key)])));
}

/** Least damping ratio: as given, and as the overshoot e^(-pi zeta/sqrt(1 - zeta^2)) asks. @param {Region} region */
export function dampingOf({ damping, overshoot }) {
  const log = overshoot === null ? 0 : -Math.log(overshoot);
  return Math.max(damping ?? 0, log ? log / Math.hypot(Math.PI, log) : 0);
}

/** Least -Re s in rad/s. @param {Region} region */
export const decayOf = ({ settling }) => (settling === null ? 0 : SETTLED / settling);

/** Whether a pole is where it is wanted, but for rounding. @param {Region} region @param {Place} pole */
export function inRegion(region, { re, im }) {
  const size = Math.hypot(re, im);
  const rounding = 1e-9;
  return (
    -re >= dampingOf(region) * size * (1 - rounding) &&
    -re >= decayOf(region) * (1 - rounding) &&
    size >= (region.slowest ?? 0) * (1 - rounding) &&
    size <= (region.fastest ?? Infinity) * (1 + rounding)
  );
}

/**
 * Outlines of what is not wanted, each a closed line of points in rad/s.
 * @param {Region} region @param {number} near rad/s @param {number} far rad/s, beyond all that is seen
 * @returns {Place[][]}
 */
export function outlines(region, near, far) {
  const sizes = Array.from({ length: 61 }, (_, k) => near * (far / near) ** (k / 60));
  /** @type {Place[][]} */
  const found = [];
  const both = (/** @type {Place[]} */ upper) =>
    found.push(
      upper,
      upper.map(({ re, im }) => ({ re, im: -im })),
    );
  const zeta = dampingOf(region);
  const sine = Math.sqrt(1 - zeta * zeta);
  if (zeta)
    both([
      { re: 0, im: 0 },
      { re: -zeta * far, im: sine * far },
      { re: 0, im: far },
    ]);
  const decay = decayOf(region);
  if (decay) {
    const edge = sizes.map((im) => ({ re: -decay, im }));
    both([{ re: 0, im: 0 }, { re: -decay, im: 0 }, ...edge, { re: 0, im: far }]);
  }
  const arc = (/** @type {number} */ size, /** @type {number} */ from, /** @type {number} */ to) =>
    Array.from({ length: 41 }, (_, k) => {
      const angle = from + ((to - from) * k) / 40;
      return { re: size * Math.cos(angle), im: size * Math.sin(angle) };
    });
  const [up, down] = [Math.PI / 2, (3 * Math.PI) / 2];
  if (region.slowest !== null) found.push(arc(region.slowest, up, down));
  if (region.fastest !== null) found.push([...arc(region.fastest, up, down), ...arc(far, down, up)]);
  return found;
}
