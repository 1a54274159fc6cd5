// @ts-check
// A calibration while it runs: its objective as it falls, stop and resume.

import { complain, copy, get, send, toast } from "./api.js";
import { ROOT, at, make } from "./dom.js";
import { Plot } from "./plot.js";
import { digits, lasting, rms } from "./quantity.js";
import { count } from "./units.js";

/** @typedef {{name: string, label: string, mode: string, optimiser: string, experiments: number, unknowns: string[], unit: string, state: string, ended: boolean, reason: string, stage: string, evaluations: number, most: number | null, rate: number, left_s: number | null, at_most: boolean, share: number | null, best: number | null, start: number | null, started_utc: string, stored: number[], command: string}} Running */
/** @typedef {Running & {since: number, objective: (number | null)[], singles: {id: number, before: number | null, after: number | null}[]}} Live */

const AGAIN = 700; // [ms]
const LOST = 4000; // [ms] until it is asked again when there was no answer

const root = at("calibrating");
const name = root.dataset.name ?? "";
const address = `/calibrations/jobs/${encodeURIComponent(name)}`;
const plot = new Plot(at("objective"));
/** @type {number[]} */
let errors = [];
/** @type {number[]} */
let best = [];
let timer = 0;
let leaving = false;
/** @type {Live | null} */
let newest = null;

async function look() {
  clearTimeout(timer);
  try {
    const live = /** @type {Live} */ (await get(address, { since: errors.length }));
    if (live.since === errors.length) take(live);
    show(live);
    if (live.stored.length) return arrive(live);
    if (!live.ended || live.state === "done") timer = window.setTimeout(look, AGAIN);
  } catch (problem) {
    at("state").textContent = problem instanceof Error ? problem.message : String(problem);
    at("state").className = "tag fault";
    timer = window.setTimeout(look, LOST);
  }
}

/** @param {Live} live */
function take(live) {
  for (const error of live.objective) {
    const value = rms(error, live.unit) ?? Infinity;
    errors.push(value);
    best.push(Math.min(value, best.at(-1) ?? Infinity));
  }
}

/** @param {Live} live */
function arrive(live) {
  if (leaving) return;
  leaving = true;
  toast("The calibration has finished and is stored.");
  location.replace(`${ROOT}/calibrations/${live.stored.at(-1)}`);
}

/** @param {Live} live */
function show(live) {
  newest = live;
  const state = at("state");
  state.textContent = live.state;
  state.className = `tag ${live.state === "failed" ? "fault" : live.ended && live.state !== "done" ? "simulated" : "good"}`;
  at("reason").textContent = reasonOf(live);
  at("reason").hidden = !at("reason").textContent;
  /** @type {HTMLButtonElement} */ (at("stop")).hidden = live.ended;
  at("resume").hidden = !live.ended || live.state === "done";
  at("figures").replaceChildren(...figures(live).map(([title, value, unit]) => make(
    "div", {}, make("dt", {}, title), make("dd", {}, value, unit ? make("small", {}, ` ${unit}`) : null),
  )));
  /** @type {HTMLProgressElement} */
  const bar = /** @type {HTMLProgressElement} */ (at("bar"));
  bar.hidden = live.share === null || live.ended;
  bar.max = 1;
  bar.value = live.share ?? 0;
  draw(live);
  root.dataset.evaluations = String(live.evaluations);
  root.dataset.state = live.state;
}

/** @param {Live} live */
function reasonOf(live) {
  if (live.state === "lost") return "The process of this calibration ended unexpectedly. Finished evaluations are saved; Resume continues from there.";
  if (live.state === "cancelled" || live.state === "stopped") return "Stopped. Finished evaluations are saved; Resume continues from there.";
  return live.reason;
}

/** @param {Live} live @returns {[string, string, string?][]} */
function figures(live) {
  /** @type {[string, string, string?][]} */
  const found = [];
  if (live.start !== null) found.push(["before", digits(rms(live.start, live.unit)), "mm"]);
  if (live.best !== null) found.push(["best so far", digits(rms(live.best, live.unit)), "mm"]);
  if (live.mode === "each" || (live.mode === "campaign" && live.singles.length)) found.push(["experiments done", `${live.singles.length} of ${live.experiments}`]);
  if (live.evaluations) found.push(["evaluations", count(live.evaluations)]);
  if (live.rate > 0 && !live.ended) found.push(["rate", digits(+live.rate.toPrecision(3)), "evaluations/s"]);
  if (live.left_s !== null) found.push([live.at_most ? "time left, at most" : "time left", lasting(live.left_s)]);
  if (live.stage) found.push(["now", STAGES[live.stage] ?? live.stage]);
  return found;
}

/** @type {Record<string, string>} */
const STAGES = {
  nominal: "nominal values", "all together": "joint calibration", squares: "least squares",
  alone: "each experiment", verdicts: "intervals and verdicts", best: "best values", neighbours: "values of neighbours",
};

/** @param {Live} live */
function draw(live) {
  const started = rms(live.start, live.unit);
  if (errors.length) {
    const xs = errors.map((_, k) => k + 1);
    plot.show({
      title: `Mean error against evaluation: ${errors.length} evaluations, best ${digits(best.at(-1))} mm`,
      x: { label: "evaluation", whole: true, range: [0, Math.max(20, errors.length)] },
      y: { label: live.experiments > 1 ? "rms error, mean over experiments" : "rms error", unit: "mm", log: true },
      series: [
        { kind: "points", xs, ys: errors, name: "tried", label: "evaluation" },
        { kind: "step", xs, ys: best, name: "best", label: "best so far" },
      ],
      marks: started === null ? [] : [{ y: started, name: "before", label: "before" }],
      height: 300,
    });
  } else if (live.singles.length) {
    const xs = live.singles.map((_, k) => k + 1);
    plot.show({
      title: `Errors of ${live.singles.length} experiments before and after`,
      x: { label: "experiment", whole: true, range: [0, live.experiments + 1] },
      y: { label: "rms error", unit: "mm", log: true },
      series: [
        { kind: "points", xs, ys: live.singles.map((one) => rms(one.after, live.unit) ?? NaN), name: "found", label: "calibrated alone" },
        { kind: "crosses", xs, ys: live.singles.map((one) => rms(one.before, live.unit) ?? NaN), name: "tried", label: "before" },
      ],
      height: 300,
    });
  }
  at("waiting").hidden = errors.length + live.singles.length > 0;
}

/** @param {"stop" | "resume"} act */
async function change(act) {
  const button = /** @type {HTMLButtonElement} */ (at(act));
  button.disabled = true;
  try {
    await send(`${address}/${act}`);
    await look();
  } catch (problem) {
    complain(problem);
  } finally {
    button.disabled = false;
  }
}

at("stop").addEventListener("click", () => change("stop"));
at("resume").addEventListener("click", () => change("resume"));
at("copy-command").addEventListener("click", () => copy(newest?.command ?? "", "the command"));
void look();
