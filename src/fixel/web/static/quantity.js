// @ts-check
// Values of parameters and errors as people read them.

import { shownIn } from "./units.js";

/** At most four digits, a true minus sign. @param {number | null | undefined} value */
export function digits(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
  return String(+value.toPrecision(4)).replace("-", "\u2212");
}

/** A value without its unit. @param {number | null | undefined} value in SI @param {string} unit */
export const shown = (value, unit) => digits(value === null || value === undefined ? null : shownIn(unit)[0] * value);

/** Errors that are squares, as root mean squares in mm. @param {number | null | undefined} error @param {string} unit */
export function rms(error, unit) {
  if (error === null || error === undefined) return null;
  return unit === "mm^2" ? Math.sqrt(error) : error;
}

/** "3 s", "4 min", "2.5 h". @param {number | null | undefined} seconds */
export function lasting(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "\u2013";
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${+(seconds / 3600).toPrecision(2)} h`;
}
