/** Axes: from a value to its share of the axis and back, even or logarithmic. */

/** @typedef {[number, number]} Range */

/** @param {number} value @param {Range} range @param {boolean} [log] */
export function shareOf(value, [low, high], log = false) {
  return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

/**
 * From values of an axis to places between its ends, for many values.
 * @param {Range} range @param {boolean | undefined} log @param {number} start @param {number} end px
 * @returns {(value: number) => number}
 */
export function placing([low, high], log, start, end) {
  const slope = (end - start) / (log ? Math.log(high / low) : high - low);
  return log ? (value) => start + slope * Math.log(value / low) : (value) => start + slope * (value - low);
}

/** @param {number} share @param {Range} range @param {boolean} [log] */
export function valueAt(share, [low, high], log = false) {
  return log ? low * (high / low) ** share : low + share * (high - low);
}

/**
 * A curve's value between its points, on a straight line; NaN outside and in gaps.
 * @param {ArrayLike<number>} x ascending @param {ArrayLike<number | null>} y @param {number} at
 */
export function between(x, y, at) {
  const k = firstFrom(x, at);
  const after = y[k];
  if (k >= x.length || after === null) return NaN;
  if (x[k] === at) return after;
  const before = k > 0 ? y[k - 1] : null;
  if (before === null) return NaN;
  return before + ((after - before) * (at - x[k - 1])) / (x[k] - x[k - 1]);
}

/** The first place whose value is not below. @param {ArrayLike<number>} x ascending @param {number} at */
export function firstFrom(x, at) {
  let low = 0;
  let high = x.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (x[middle] < at) low = middle + 1;
    else high = middle;
  }
  return low;
}
