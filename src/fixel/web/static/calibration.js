// @ts-check
// One calibration: did the search end, what did it find, do the data determine it, where is it off.

import { complain, copy, get, numbers } from "./api.js";
import { ROOT, at, make } from "./dom.js";
import { Plot } from "./plot.js";
import { digits, rms, shown, verdictOf } from "./quantity.js";
import { several, shownIn } from "./units.js";

/** @typedef {{label: string, unit: string, value: number, best_fit: number, low: number | null, high: number | null, noise_value: number | null, noise_low: number | null, noise_high: number | null, bounds: [number, number] | null, before: number | null, verdict: string, reason: string}} Row */
/** @typedef {{id: number, key: string, before: number | null, after: number | null}} Residual */
/** @typedef {{error: number | null, point: number[], evaluations: number, good: boolean}} Start */
/** @typedef {{label: string, unit: string, values: number[], rises: (number | null)[], slice_values: number[], slice_rises: (number | null)[], low: number | null, high: number | null, threshold: number}} Curve */
/** @typedef {{id: number, name: string, unit: string, level: number | null, parameters: Row[], residuals: Residual[], worst: Residual[], objective: import("./api.js").Packed | null, starts: Start[], curves: Curve[], misfit: string[], noise: string, note: string, ended: string, siblings: {id: number, name: string}[], complete: boolean, command: string, python: string}} Calibration */

const MOST_BARS = 60;
const root = at("calibration");
const number = Number(root.dataset.calibration);
/** @type {Calibration} */
let one;

async function open() {
  one = await get(`/calibrations/${number}`);
  siblings();
  parameters();
  search();
  waterfall();
  profiles();
  residuals();
  at("misfit").hidden = one.misfit.length === 0;
  at("misfit").textContent = one.misfit.join(" ");
  at("note").textContent = [one.note, one.noise].filter(Boolean).join(". ");
  root.dataset.ready = "yes";
}

// --- parameters ------------------------------------------------------------------------------

function parameters() {
  at("rows").replaceChildren(...one.parameters.map((row, k) => {
    const [, unit] = shownIn(row.unit);
    const { sign, kind } = verdictOf(row.verdict);
    const noise = row.noise_value === null ? null
      : make("small", { class: "noise-alone" }, `noise alone: ${shown(row.noise_value, row.unit)}, ${interval(row.noise_low, row.noise_high, row.unit)}`);
    const reason = make("p", { id: `reason-${k}`, class: "reason", hidden: true }, row.reason);
    const button = make("button", {
      type: "button", class: `verdict-button tag ${kind}`, "aria-expanded": "false", "aria-controls": `reason-${k}`,
      onclick: () => {
        reason.hidden = !reason.hidden;
        button.setAttribute("aria-expanded", String(!reason.hidden));
      },
    }, `${sign} ${row.verdict}`);
    return make(
      "tr", {},
      make("th", { scope: "row" }, row.label, unit ? make("small", {}, `[${unit}]`) : null),
      make("td", { class: "number" }, make("strong", {}, shown(row.value, row.unit))),
      make("td", { class: "number interval" }, interval(row.low, row.high, row.unit), noise),
      make("td", { class: "span" }, strip(row)),
      make("td", {}, row.verdict ? button : "\u2013", reason),
    );
  }));
  const fitted = one.parameters.map((row) => `${row.label} ${shown(row.best_fit, row.unit)} ${shownIn(row.unit)[1]}`.trim());
  at("best-fit").textContent = `Simulations use the best fit of the search: ${fitted.join(", ")}.`;
  at("level").textContent = one.level === null ? "interval of unknown level" : `${+(100 * one.level).toPrecision(3)} % interval`;
}

/** @param {number | null} low @param {number | null} high @param {string} unit */
function interval(low, high, unit) {
  if (low === null && high === null) return "\u2013";
  return `${low === null ? "unbounded" : shown(low, unit)} to ${high === null ? "unbounded" : shown(high, unit)}`;
}

/** Where in its bounds a value is, and how far its interval goes. @param {Row} row */
function strip(row) {
  if (!row.bounds) return "";
  const [low, high] = row.bounds;
  /** @param {number} value */
  const place = (value) => `${(100 * Math.max(0, Math.min(1, (value - low) / (high - low)))).toFixed(1)}%`;
  const node = make("div", { class: "in-bounds", role: "img", "aria-label": `searched from ${shown(low, row.unit)} to ${shown(high, row.unit)}` });
  const from = row.low ?? (row.high === null ? null : low);
  const to = row.high ?? (row.low === null ? null : high);
  if (from !== null && to !== null) {
    const bar = make("span", { class: `bar-of${row.low === null ? " open-left" : ""}${row.high === null ? " open-right" : ""}` });
    bar.style.left = place(from);
    bar.style.right = `calc(100% - ${place(to)})`;
    node.append(bar);
  }
  if (row.before !== null) {
    const before = make("span", { class: "was" });
    before.style.left = place(row.before);
    node.append(before);
  }
  const dot = make("span", { class: "is" });
  dot.style.left = place(row.value);
  node.append(dot);
  return make("div", {}, node, make("div", { class: "ends" }, make("small", {}, shown(low, row.unit)), make("small", {}, shown(high, row.unit))));
}

// --- the search ------------------------------------------------------------------------------

function search() {
  const section = at("search");
  section.hidden = !one.objective;
  if (!one.objective) return;
  const errors = Array.from(numbers(one.objective), (error) => (Number.isFinite(error) ? rms(error, one.unit) ?? NaN : Infinity));
  /** @type {number[]} */
  const best = [];
  for (const error of errors) best.push(Math.min(error, best.at(-1) ?? Infinity));
  const xs = errors.map((_, k) => k + 1);
  const failed = errors.filter((error) => !Number.isFinite(error)).length;
  at("search-words").textContent = `${several(errors.length, "evaluation")}${failed ? `, ${failed} failed` : ""}; ${one.ended || "ended"}.`;
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
  const { starts } = one;
  at("starts").hidden = starts.length === 0;
  if (!starts.length) return;
  const good = starts.filter((start) => start.good).length;
  at("starts-words").textContent = good > 1
    ? `${good} of ${starts.length} searches reached the smallest error or nearly so.`
    : `Only one of ${starts.length} searches reached the smallest error; more starts may find a smaller one.`;
  const xs = starts.map((_, k) => k + 1);
  const ys = starts.map((start) => rms(start.error, one.unit) ?? NaN);
  new Plot(at("starts-plot")).show({
    title: `Waterfall of ${starts.length} starts, from ${digits(ys[0])} mm to ${digits(ys.at(-1))} mm`,
    x: { label: "start, sorted by error", whole: true, range: [0.5, starts.length + 0.5] },
    y: { label: "rms error", unit: "mm", log: true },
    series: [
      { kind: "line", xs, ys, name: "thread" },
      { kind: "points", xs, ys: ys.map((y, k) => (starts[k].good ? y : NaN)), name: "found", label: "smallest error or nearly so" },
      { kind: "crosses", xs, ys: ys.map((y, k) => (starts[k].good ? NaN : y)), name: "worse", label: "worse" },
    ],
    tell: (k) => `${digits(ys[k])} mm after ${starts[k].evaluations} evaluations: ${one.parameters.map((row, j) => `${row.label} ${shown(starts[k].point[j], row.unit)}`).join(", ")}`,
  });
}

// --- what the data determine -----------------------------------------------------------------

function profiles() {
  at("profiles").hidden = one.curves.length === 0;
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

// --- where it is off -------------------------------------------------------------------------

function residuals() {
  const values = one.residuals.map((each) => ({ ...each, before: rms(each.before, one.unit), after: rms(each.after, one.unit) }));
  const largest = Math.max(1e-9, ...values.flatMap((each) => [each.before ?? 0, each.after ?? 0]));
  at("worst").replaceChildren(...values.slice(0, one.worst.length).map((each, k) => make(
    "li", {},
    make("span", { class: "figure-of" }, digits(each.after), make("small", {}, " mm")),
    make("a", { href: `${ROOT}/experiments/${each.id}` }, each.key),
    make("a", { class: "button", href: `${ROOT}/compare?experiment=id:${each.id}`, "aria-label": `Compare ${each.key}` }, "Compare"),
    k === 0 ? make("span", { class: "tag fault" }, "largest") : null,
  )));
  at("bars").replaceChildren(...values.slice(0, MOST_BARS).map((each) => bar(each, largest)));
  const more = values.length - MOST_BARS;
  at("bars-more").textContent = more > 0 ? `and ${more} more with smaller errors` : "";
  const failed = values.filter((each) => each.after === null).length;
  const known = values.flatMap((each) => (each.after === null ? [] : [each.after])).sort((a, b) => a - b);
  const middle = known[Math.floor(known.length / 2)];
  at("residual-words").textContent = `Median ${digits(middle)} mm, largest ${digits(known.at(-1))} mm`
    + `${failed ? `; ${several(failed, "experiment")} could not be simulated` : ""}.`;
}

/** @param {{id: number, key: string, before: number | null, after: number | null}} each @param {number} largest */
function bar(each, largest) {
  const filled = make("span", { class: "now" });
  filled.style.width = `${(100 * (each.after ?? 0)) / largest}%`;
  const was = make("span", { class: "was" });
  was.style.left = `${(100 * (each.before ?? 0)) / largest}%`;
  was.hidden = each.before === null;
  return make(
    "tr", {},
    make("th", { scope: "row" }, make("a", { href: `${ROOT}/experiments/${each.id}` }, each.key)),
    make("td", { class: "track" }, make("div", { class: "track-of", "aria-hidden": "true" }, filled, was)),
    make("td", { class: "number" }, digits(each.before)),
    make("td", { class: "number" }, make("strong", {}, each.after === null ? "none" : digits(each.after))),
  );
}

// --- around it -------------------------------------------------------------------------------

function siblings() {
  const place = one.siblings.findIndex(({ id }) => id === number);
  at("siblings").hidden = one.siblings.length < 2;
  if (one.siblings.length < 2) return;
  const select = make("select", { "aria-label": "Parameter set of this calibration", onchange: () => location.assign(`${ROOT}/calibrations/${select.value}`) },
    ...one.siblings.map(({ id, name }) => make("option", { value: id, selected: id === number }, name)));
  /** @param {number} to @param {string} sign @param {string} words */
  const step = (to, sign, words) => (one.siblings[to]
    ? make("a", { class: "button", href: `${ROOT}/calibrations/${one.siblings[to].id}`, "aria-label": words, id: to < place ? "previous" : "next" }, sign)
    : null);
  at("siblings").replaceChildren(...[step(place - 1, "\u2190", "Previous set (k)"), select, step(place + 1, "\u2192", "Next set (j)")].filter((node) => node !== null));
}

document.addEventListener("keydown", (event) => {
  if (event.target instanceof Element && event.target.matches("input, select, textarea")) return;
  const id = { j: "next", k: "previous" }[event.key];
  if (id && !event.ctrlKey && !event.metaKey) document.getElementById(id)?.click();
});
at("copy-command").addEventListener("click", () => copy(one.command, "the command"));
at("copy-python").addEventListener("click", () => copy(one.python, "the Python code"));
open().catch(complain);
