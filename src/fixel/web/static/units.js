// @ts-check
// From SI to what people read. Every function gives text with a true minus sign and no "-0".

const NONE = "\u2013"; // for what is not known

/**
 * @param {number | null | undefined} value
 * @param {number} digits behind the point
 * @param {number} [factor]
 * @returns {string}
 */
export function fixed(value, digits, factor = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const text = Math.abs(factor * value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `\u2212${text}` : text;
}

/** @param {number | null | undefined} metres @param {number} [digits] */
export const mm = (metres, digits = 1) => fixed(metres, digits, 1e3);

/** @param {number | null | undefined} radians @param {number} [digits] */
export const deg = (radians, digits = 1) => fixed(radians, digits, 180 / Math.PI);

/** "1 experiment", "2 experiments". @param {number} n @param {string} what */
export const several = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;
