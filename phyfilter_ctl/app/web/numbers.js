/** Numbers as people read and type them. */

/** A number at so many significant digits, short. @param {number | null | undefined} value @param {number} [digits] */
export function short(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  let text =
    size < 1e-3 || size >= 1e6
      ? value.toExponential(Math.max(digits - 2, 0))
      : String(Number(value.toPrecision(digits)));
  if (text.includes("e")) text = text.replace(/\.?0*e/, "e").replace("e+", "e");
  return text.replace(/-/g, "−");
}

/** A size at two digits, rounded up or down: to the side that promises less. @param {number} value @param {boolean} up */
export function safe(value, up) {
  if (!(value > 0 && Number.isFinite(value))) return short(value, 2);
  const place = 10 ** (1 - Math.floor(Math.log10(value)));
  return short((up ? Math.ceil(value * place * (1 - 1e-9)) : Math.floor(value * place * (1 + 1e-9))) / place, 2);
}

/**
 * A value in a unit that reads well.
 * @param {number | null} value @param {string} unit @param {number} [digits] @returns {[string, string]}
 */
export function inUnit(value, unit, digits = 4) {
  if (value !== null && unit === "s" && value !== 0) {
    const size = Math.abs(value);
    if (size < 1e-3) return [short(value * 1e6, digits), "µs"];
    if (size < 1) return [short(value * 1e3, digits), "ms"];
  }
  return [short(value, digits), unit === "deg" ? "°" : unit];
}

/** What someone typed as a number; NaN if it is none. @param {string} text */
export function typed(text) {
  const plain = text.replace(",", ".").replace(/−/g, "-");
  return /^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*$/.test(plain) ? Number(plain) : NaN;
}

/** A number for an input field. @param {number} value @param {number} [digits] */
export const field = (value, digits = 6) => String(Number(value.toPrecision(digits)));

/** Numbers 1, 2, 5 times a power of ten, the first at or above the value. @param {number} value */
export function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const lead = value / power;
  return (lead <= 1 ? 1 : lead <= 2 ? 2 : lead <= 5 ? 5 : 10) * power;
}

/** A power of ten, or what is shorter. @param {number} value */
export function powerOfTen(value) {
  if (value >= 1e-3 && value < 1e6) return short(value);
  const digits = String(Math.round(Math.log10(value))).replace(
    /./g,
    (digit) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(digit)],
  );
  return `10${digits}`;
}

/** @param {ArrayLike<number | null>} values */
export function largest(values) {
  let most = -Infinity;
  for (let k = 0; k < values.length; k++) {
    const value = values[k];
    if (value !== null && value > most) most = value; // not NaN
  }
  return most;
}

/** @param {ArrayLike<number | null>} values */
export function smallest(values) {
  let least = Infinity;
  for (let k = 0; k < values.length; k++) {
    const value = values[k];
    if (value !== null && value < least) least = value;
  }
  return least;
}
