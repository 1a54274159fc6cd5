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

/** @type {Record<string, {sign: string, kind: string}>} */
const VERDICTS = {
  identified: { sign: "\u2713", kind: "good" },
  "trades off": { sign: "\u21c4", kind: "off" },
  "not identified": { sign: "?", kind: "off" },
  "not excited": { sign: "\u2205", kind: "off" },
  "at bound": { sign: "\u21e5", kind: "fault" },
  effective: { sign: "\u2248", kind: "off" },
  "precise, but the model misfits": { sign: "\u2260", kind: "fault" },
  "at least": { sign: "\u2265", kind: "off" },
  "at most": { sign: "\u2264", kind: "off" },
  frozen: { sign: "\u2016", kind: "" },
};

/** Sign and colour of a verdict: never the colour alone. @param {string} verdict */
export const verdictOf = (verdict) =>
  VERDICTS[verdict.startsWith("trades") ? "trades off" : verdict] ?? { sign: "", kind: "" };
