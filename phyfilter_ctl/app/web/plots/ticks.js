/** Ticks of an axis. */

import { nice, powerOfTen, short } from "../numbers.js";

/** @typedef {{value: number, text: string, minor: boolean}} Tick */

/** @param {number[]} range @param {number} count @param {boolean} [degrees] @returns {Tick[]} */
export function linearTicks([low, high], count, degrees = false) {
  const wanted = (high - low) / Math.max(count, 2);
  const step = degrees ? ([15, 30, 45, 90, 180, 360].find((value) => value >= wanted) ?? 720) : nice(wanted);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    ticks.push({ value: k * step, text: short(Number((k * step).toPrecision(10))), minor: false });
  }
  return ticks;
}

/** @param {number[]} range @param {number} size @returns {Tick[]} */
export function logTicks([low, high], size) {
  const ticks = [];
  const decades = Math.log10(high / low);
  if (decades < 0.7) return linearTicks([low, high], size / 20); // hardly a 1, 2 or 5 in it
  const every = Math.max(1, Math.ceil((decades * 46) / size));
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (let lead = 1; lead < 10; lead++) {
      const value = lead * 10 ** power;
      if (value < low * 0.9999 || value > high * 1.0001 || (lead > 1 && decades > 7)) continue;
      const major = lead === 1;
      const named = major ? power % every === 0 : decades < 1.6 && (lead === 2 || lead === 5);
      ticks.push({ value, text: named ? powerOfTen(value) : "", minor: !major });
    }
  }
  return ticks;
}
