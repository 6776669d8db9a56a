/** Limits that are drawn into the Bode plot. */

import { errorResponse, response } from "../mathematics/filter.js";

/** @import { Filter } from "../mathematics/filter.js" */
/** @import { Limit, LimitKind, Limits } from "../link.js" */
/** @import { Curves } from "./preview.js" */

// What each limit holds down, and where: |1 - F| below its frequency, |F| above it.
export const LIMIT_KINDS = /** @type {const} */ ({
  error: { text: "|1−F|", curve: "E", below: true, start: { share: 0.15, level: 0.3 } },
  estimate: { text: "|F|", curve: "F", below: false, start: { share: 6, level: 0.3 } },
});

export const KINDS = /** @type {LimitKind[]} */ (Object.keys(LIMIT_KINDS));

/**
 * The limits that are drawn here; others may have come with a file.
 * @param {Limits | null | undefined} limits @returns {Limits | null}
 */
export function knownLimits(limits) {
  /** @type {Limits} */
  const found = {};
  for (const kind of KINDS) {
    const limit = limits?.[kind];
    if (limit && limit.omega > 0 && limit.level > 0) found[kind] = { omega: limit.omega, level: limit.level };
  }
  return Object.keys(found).length ? found : null;
}

/**
 * With a limit where there was none, in proportion to the bandwidth; or without it.
 * @param {Limits | null} limits @param {LimitKind} kind @param {number} cutoff rad/s
 */
export function toggled(limits, kind, cutoff) {
  const next = { ...limits };
  if (next[kind]) delete next[kind];
  else {
    const { share, level } = LIMIT_KINDS[kind].start;
    next[kind] = { omega: Number((share * cutoff).toPrecision(3)), level };
  }
  return Object.keys(next).length ? next : null;
}

/**
 * How far a curve is above its limit in dB; negative: below.
 * @param {Filter} filter @param {Curves} curves @param {LimitKind} kind @param {Limit} limit
 */
export function excess(filter, curves, kind, limit) {
  const { curve, below } = LIMIT_KINDS[kind];
  const { omega } = curves;
  const { db } = curves[curve];
  const at = (curve === "E" ? errorResponse : response)(filter, [limit.omega]);
  let worst = 20 * Math.log10(Math.hypot(at.re[0], at.im[0]));
  for (let k = 0; k < omega.length; k++)
    if (below ? omega[k] <= limit.omega : omega[k] >= limit.omega) worst = Math.max(worst, db[k]);
  return worst - 20 * Math.log10(limit.level);
}
