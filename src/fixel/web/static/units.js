// @ts-check
// From SI to what people read. Every function gives text with a true minus sign and no "-0".

const NONE = "\u2013"; // for what is not known

/**
 * @param {number | null | undefined} value
 * @param {number} digits behind the point
 * @returns {string}
 */
export function fixed(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `\u2212${text}` : text;
}

/** @param {number | null | undefined} metres @param {number} [digits] */
export const mm = (metres, digits = 1) => fixed(scaled(metres, 1e3), digits);

/** @param {number | null | undefined} radians @param {number} [digits] */
export const deg = (radians, digits = 1) => fixed(scaled(radians, 180 / Math.PI), digits);

/** @param {number | null | undefined} seconds @param {number} [digits] */
export const s = (seconds, digits = 2) => fixed(seconds, digits);

/** Thousands apart. @param {number} n */
export const count = (n) => Math.round(n).toString().replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");

/** "1 experiment", "2 experiments". @param {number} n @param {string} what */
export const several = (n, what) => `${count(n)} ${what}${n === 1 ? "" : "s"}`;

/** A size in decimal units. @param {number} size */
export function bytes(size) {
  let value = size;
  for (const unit of ["byte", "kB", "MB", "GB"]) {
    if (value < 1000) return `${unit === "byte" ? value : Number(value.toPrecision(3))} ${unit}`;
    value /= 1000;
  }
  return `${value.toPrecision(3)} TB`;
}

/**
 * A condition as it is written down: numbers short, with the unit its name ends with.
 * @param {string} name
 * @param {string | number} value
 * @returns {[string, string]} name without unit, value with it
 */
export function condition(name, value) {
  if (typeof value === "string") return [name, value];
  for (const [ending, si] of ENDINGS) {
    const [scale, unit] = shownIn(si);
    if (name.endsWith(ending)) return [name.slice(0, -ending.length), `${short(value * scale)} ${unit}`];
  }
  return [name, short(value)];
}

/** Units as people read them; the same as in units.py. @type {Record<string, [number, string]>} */
const UNITS = {
  m: [1e3, "mm"], "m/s": [1e3, "mm/s"], rad: [180 / Math.PI, "deg"], "rad/s": [180 / Math.PI, "deg/s"],
  "N m": [1e3, "N mm"], kg: [1e3, "g"], "-": [1, ""],
};
const ENDINGS = [["_rad_s", "rad/s"], ["_m_s", "m/s"], ["_rad", "rad"], ["_m", "m"], ["_s", "s"], ["_n", "N"], ["_kg", "kg"]];

/** Factor from SI and unit as it is shown. @param {string} unit @returns {[number, string]} */
export const shownIn = (unit) => UNITS[unit] ?? [1, unit];

/** At most four digits. @param {number} value */
export const short = (value) => String(Number(value.toPrecision(4))).replace("-", "\u2212");

/** @param {number | null | undefined} value @param {number} by */
function scaled(value, by) {
  return value === null || value === undefined ? null : value * by;
}
