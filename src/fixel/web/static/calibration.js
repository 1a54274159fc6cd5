// @ts-check
// One calibration: charts of its search, starts and profiles, and keys to its other sets.

import { complain, copy, get, numbers } from "./api.js";
import { ROOT, at, make } from "./dom.js";
import { Plot } from "./plot.js";
import { digits, rms, shown } from "./quantity.js";
import { shownIn } from "./units.js";

/** @typedef {{label: string, unit: string, value: number, low: number | null, high: number | null, noise_value: number | null, noise_low: number | null, noise_high: number | null}} Row */
/** @typedef {{error: number | null, point: number[], evaluations: number, good: boolean}} Start */
/** @typedef {{label: string, unit: string, values: number[], rises: (number | null)[], slice_values: number[], slice_rises: (number | null)[], low: number | null, high: number | null, threshold: number}} Curve */
/** @typedef {{unit: string, parameters: Row[], objective: import("./api.js").Packed | null, starts: Start[], curves: Curve[], command: string, python: string}} Calibration */

const root = at("calibration");
const number = Number(root.dataset.calibration);
/** @type {Calibration} */
let one;

async function open() {
  one = await get(`/calibrations/${number}`);
  search();
  waterfall();
  profiles();
  root.dataset.ready = "yes";
}

// --- the search ------------------------------------------------------------------------------

function search() {
  if (!one.objective) return;
  const errors = Array.from(numbers(one.objective), (error) => (Number.isFinite(error) ? rms(error, one.unit) ?? NaN : Infinity));
  /** @type {number[]} */
  const best = [];
  for (const error of errors) best.push(Math.min(error, best.at(-1) ?? Infinity));
  const xs = errors.map((_, k) => k + 1);
  new Plot(at("search-plot")).show({
    title: `Error against evaluation; the smallest is ${digits(best.at(-1))} mm`,
    x: { label: "evaluation", whole: true, range: [0, errors.length + 1] },
    y: { label: "rms error", unit: "mm", log: true },
    series: [
      { kind: "points", xs, ys: errors, name: "tried", label: "evaluation" },
      { kind: "step", xs, ys: best, name: "best", label: "best so far" },
    ],
  });
}

function waterfall() {
  const ends = one.starts;
  if (!ends.length) return;
  const xs = ends.map((_, k) => k + 1);
  const ys = ends.map((start) => rms(start.error, one.unit) ?? NaN);
  new Plot(at("starts-plot")).show({
    title: `Waterfall of ${ends.length} starts, from ${digits(ys[0])} mm to ${digits(ys.at(-1))} mm`,
    x: { label: "start, sorted by error", whole: true, range: [0.5, ends.length + 0.5] },
    y: { label: "rms error", unit: "mm", log: true },
    series: [
      { kind: "line", xs, ys, name: "thread" },
      { kind: "points", xs, ys: ys.map((y, k) => (ends[k].good ? y : NaN)), name: "found", label: "smallest error or nearly so" },
      { kind: "crosses", xs, ys: ys.map((y, k) => (ends[k].good ? NaN : y)), name: "worse", label: "worse" },
    ],
    tell: (k) => `${digits(ys[k])} mm after ${ends[k].evaluations} evaluations: ${one.parameters.map((row, j) => `${row.label} ${shown(ends[k].point[j], row.unit)}`).join(", ")}`,
  });
}

// --- what the data determine -----------------------------------------------------------------

function profiles() {
  at("profile-plots").replaceChildren(...one.curves.map((curve) => {
    const [factor, unit] = shownIn(curve.unit);
    const host = make("div", {});
    const [low, high] = [Math.min(...curve.values), Math.max(...curve.values)];
    const row = one.parameters.find(({ label }) => label === curve.label);
    /** @param {number | null | undefined} from @param {number | null | undefined} to */
    const band = (from, to) => ((from ?? null) === null && (to ?? null) === null ? []
      : [{ from: factor * (from ?? low), to: factor * (to ?? high), name: "inside" }]);
    requestAnimationFrame(() => new Plot(host).show({
      title: `Profile of ${curve.label}: increase of the objective when it is fixed at other values`,
      x: { label: curve.label, unit, range: around(curve, row, factor) },
      y: { label: "rise", range: [-0.1 * curve.threshold, 3 * curve.threshold] },
      series: [
        { kind: "line", xs: curve.values.map((v) => factor * v), ys: curve.rises.map((r) => r ?? NaN), name: "best", label: "others fitted" },
        { kind: "line", xs: curve.slice_values.map((v) => factor * v), ys: curve.slice_rises.map((r) => r ?? NaN), name: "slice", label: "others fixed" },
      ],
      marks: [
        { y: curve.threshold, name: "before", label: "threshold" },
        ...(row ? [{ x: factor * row.value, name: "best", label: "value" }] : []),
      ],
      bands: [...band(row?.low, row?.high), ...(row?.noise_value === null ? [] : band(row?.noise_low, row?.noise_high))],
      height: 190,
    }));
    return host;
  }));
}

/** Range of values to draw: where the rise can be seen, and the interval. @param {Curve} curve @param {Row | undefined} row @param {number} factor @returns {[number, number]} */
function around(curve, row, factor) {
  const near = curve.values.filter((_, k) => (curve.rises[k] ?? Infinity) < 4 * curve.threshold);
  const ends = [...near, curve.low ?? NaN, curve.high ?? NaN, row?.value ?? NaN, row?.low ?? NaN, row?.high ?? NaN].filter(Number.isFinite).map((value) => factor * value);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const margin = 0.35 * (high - low) || 1e-3;
  const every = curve.values.map((value) => factor * value);
  return [Math.max(low - margin, Math.min(...every)), Math.min(high + margin, Math.max(...every))];
}

document.addEventListener("keydown", (event) => {
  if (event.target instanceof Element && event.target.matches("input, select, textarea")) return;
  const id = { j: "next", k: "previous" }[event.key];
  if (id && !event.ctrlKey && !event.metaKey) document.getElementById(id)?.click();
});
const select = /** @type {HTMLSelectElement | null} */ (document.getElementById("siblings"));
select?.addEventListener("change", () => location.assign(`${ROOT}/calibrations/${select.value}`));
at("copy-command").addEventListener("click", () => copy(one.command, "the command"));
at("copy-python").addEventListener("click", () => copy(one.python, "the Python code"));
open().catch(complain);
