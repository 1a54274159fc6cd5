// @ts-check
// Sets of parameters against one experiment; moving a slider simulates at once.

import { complain, copy, get, send, toast } from "./api.js";
import { calibratedOf } from "./offered.js";
import { Charts, inStep, usualPanels } from "./charts.js";
import { at, make } from "./dom.js";
import { Motion } from "./motion.js";
import { Player } from "./player.js";
import { deg, fixed, mm, shownIn } from "./units.js";
import { STYLES, stylesOf, swatch } from "./view.js";

/** @typedef {{name: string, unit: string, meaning: string, low: number, high: number, nominal: number}} Slider */
/** @typedef {{id: string, label: string, kind: string, parameters: Record<string, number>, motion: string, error_mm2: number | null, unseen: string[]}} Offered */
/**
 * @typedef {object} Answer
 * @property {import("./motion.js").PackedMotion} motion
 * @property {number | null} position_rms_m
 * @property {number | null} final_position_m
 * @property {number | null} final_angle_rad
 * @property {number | null} error_mm2
 * @property {string} contact_mode
 * @property {string} measured_contact_mode
 * @property {string} command
 * @property {string} python
 */
/**
 * A set on the page.
 * @typedef {object} ShownSet
 * @property {string} id
 * @property {string} label
 * @property {Record<string, number>} parameters
 * @property {string} motion
 * @property {string} [stored] number of a stored simulation, which is shown as it was kept
 * @property {Answer | null} answer
 * @property {Motion | null} shown
 * @property {string[]} [unseen] what no experiment of the calibration has
 */

const LIVE = "adjusted";
const MOST = STYLES.length; // sets that can be told apart
const USUAL_SLIDERS = 4;
const STALE = 150; // [ms] after which an answer that nobody wants any more is not waited for

const root = at("compare");
const number = Number(root.dataset.experiment);
const player = new Player(at("player"));
const charts = new Charts(at("charts"));
inStep(player, charts);

/** @type {Slider[]} */
let sliders = [];
/** @type {Offered[]} */
let offered = [];
/** @type {ShownSet[]} the adjusted one first */
let sets = [];
/** @type {Motion | null} */
let measured = null;
let pinned = 0;

const address = `/experiments/${number}/comparison`;
const live = () => sets[0];

// --- simulating -----------------------------------------------------------------------------

/**
 * @param {ShownSet} set
 * @param {AbortSignal} [signal]
 */
async function simulated(set, signal) {
  const { parameters, motion, stored } = set;
  const answer = /** @type {Answer} */ (await (stored
    ? get(`/experiments/${number}/simulations/${stored}`, {}, signal)
    : send(address, { parameters, motion }, "POST", signal)));
  set.answer = answer;
  set.shown = new Motion({ ...answer.motion, id: set.id, label: set.label });
}

let asked = 0; // [ms] when the newest values were set
let busy = false;
/** @type {AbortController | null} */
let controller = null;
let sentAt = 0;

/** Simulates with the values of now: one request at a time, the newest values next. */
async function refresh() {
  if (busy) {
    if (performance.now() - sentAt > STALE) controller?.abort();
    return;
  }
  busy = true;
  while (asked) {
    const since = asked;
    asked = 0;
    controller = new AbortController();
    sentAt = performance.now();
    try {
      await simulated(live(), controller.signal);
      show();
      const took = performance.now() - since;
      root.dataset.roundTrip = took.toFixed(1);
      at("speed-of-it").textContent = `simulated and drawn in ${took.toFixed(0)} ms`;
      at("speed-of-it").className = "tag good";
    } catch (problem) {
      const aborted = problem instanceof DOMException && problem.name === "AbortError";
      if (!aborted) {
        at("speed-of-it").textContent = problem instanceof Error ? problem.message : String(problem);
        at("speed-of-it").className = "tag fault";
      }
    }
  }
  busy = false;
}

function changed() {
  asked ||= performance.now();
  void refresh();
}

// --- what is shown --------------------------------------------------------------------------

function show() {
  const motions = [];
  if (measured) motions.push(measured);
  for (const set of sets) if (set.shown) motions.push(set.shown);
  player.setMotions(motions, { keepTime: true });
  charts.show(usualPanels(at("charts"), motions, player.object), [player.start, player.end]);
  table(stylesOf(at("player"), motions));
  const unseen = [...new Set(sets.flatMap((set) => set.unseen ?? []))].map((text) => `Unseen by the calibration: ${text}`);
  at("not-seen").replaceChildren(...unseen.map((text) => make("p", {}, text)));
  at("not-seen").hidden = !unseen.length;
}

/** @param {ReturnType<typeof stylesOf>} styles */
function table(styles) {
  const best = Math.min(...sets.map((set) => set.answer?.error_mm2 ?? Infinity));
  at("sets").replaceChildren(...sets.map((set) => {
    const answer = set.answer;
    const failed = answer && answer.error_mm2 === null;
    const mode = answer?.contact_mode ?? "";
    const same = answer && mode === answer.measured_contact_mode;
    const values = Object.entries(set.parameters).map(([name, value]) => {
      const [factor, unit] = unitOf(name);
      return `${name} ${+(factor * value).toPrecision(4)}${unit && ` ${unit}`}`;
    });
    return make(
      "tr", { "data-set": set.id, class: set === live() ? "now" : null },
      make("th", { scope: "row" },
        swatch(styles.get(set.id)), " ", set.label,
        make("small", {}, [set.motion === "dynamic" ? "" : set.motion, ...values].filter(Boolean).join(", ") || "values of the scene")),
      failed
        ? make("td", { colspan: 4, class: "bad", title: answer.motion.advice }, `stopped early: ${answer.motion.status}`)
        : make("td", {}, mm(answer?.position_rms_m, 2)),
      ...(failed ? [] : [
        make("td", {}, mm(answer?.final_position_m, 2)),
        make("td", {}, deg(answer?.final_angle_rad, 2)),
        make("td", { class: answer?.error_mm2 === best ? "best" : null }, fixed(answer?.error_mm2, 2)),
      ]),
      make("td", { class: answer?.measured_contact_mode ? (same ? "good" : "off") : null }, mode || "\u2013"),
      make("td", { class: "deeds" }, ...deeds(set)),
    );
  }));
}

/** @param {ShownSet} set */
function deeds(set) {
  if (set === live()) return [];
  return [
    make("button", { type: "button", class: "quiet", onclick: () => adopt(set), title: `Move the sliders to ${set.label}` }, "adjust"),
    make("button", {
      type: "button", class: "quiet", "aria-label": `Remove ${set.label}`, onclick: () => remove(set),
    }, "\u2715"),
  ];
}

/** @param {string} name @returns {[number, string]} */
function unitOf(name) {
  const unit = sliders.find((one) => one.name === name)?.unit ?? "-";
  return shownIn(unit);
}

// --- sliders --------------------------------------------------------------------------------

/** @param {Slider} slider */
function row(slider) {
  const [factor, unit] = unitOf(slider.name);
  const value = live().parameters[slider.name] ?? slider.nominal;
  const step = (factor * (slider.high - slider.low)) / 200;
  const limits = {
    min: `${factor * slider.low}`, max: `${factor * slider.high}`, step: "any", value: `${factor * value}`,
  };
  const name = slider.name;
  const range = make("input", { type: "range", id: `slide-${name}`, ...limits, title: slider.meaning });
  const field = make("input", {
    type: "number", step: "any", value: +(factor * value).toPrecision(5), "aria-label": `${name}${unit && ` in ${unit}`}`,
  });
  /** @param {number} shown */
  const set = (shown) => {
    if (!Number.isFinite(shown)) return;
    live().parameters[name] = shown / factor;
    changed();
  };
  range.addEventListener("input", () => {
    field.value = String(+Number(range.value).toPrecision(5));
    set(Number(range.value));
  });
  range.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!way) return;
    event.preventDefault();
    event.stopPropagation();
    range.value = String(Number(range.value) + way * step * (event.shiftKey ? 10 : 1));
    range.dispatchEvent(new Event("input"));
  });
  field.addEventListener("input", () => {
    range.value = field.value;
    if (field.value !== "") set(Number(field.value));
  });
  return make(
    "div", { class: "slider", "data-name": name },
    make("label", { for: `slide-${name}` }, name, make("small", {}, slider.meaning)),
    range, field, make("span", { class: "unit-of" }, unit),
  );
}

function build() {
  const chosen = sliders.filter((one, k) => k < USUAL_SLIDERS || one.name in live().parameters);
  at("sliders").replaceChildren(...chosen.map(row));
  const rest = sliders.filter((one) => !chosen.includes(one));
  at("add-slider").replaceChildren(
    make("option", { value: "" }, "another parameter\u2026"),
    ...rest.map((one) => make("option", { value: one.name, title: one.meaning }, one.name)),
  );
  const motions = /** @type {HTMLSelectElement} */ (at("motion"));
  // A calibration may have an engine with choices, which is not among the usual ones.
  if (![...motions.options].some((own) => own.value === live().motion)) {
    motions.append(make("option", { value: live().motion }, live().motion));
  }
  motions.value = live().motion;
}

/**
 * Move the sliders to a set.
 * @param {{parameters: Record<string, number>, motion: string}} set
 */
function adopt(set) {
  live().parameters = { ...set.parameters };
  live().motion = set.motion;
  build();
  changed();
}

// --- sets -----------------------------------------------------------------------------------

/** @param {Omit<ShownSet, "answer" | "shown">} wanted */
async function add(wanted) {
  if (sets.some((set) => set.id === wanted.id)) {
    toast(`${wanted.label} is already shown.`);
    return;
  }
  if (sets.length >= MOST) {
    toast(`At most ${MOST} sets can be shown; remove one first.`, { bad: true });
    return;
  }
  const set = { ...wanted, answer: null, shown: null };
  await simulated(set);
  sets.push(set);
  show();
}

/** @param {ShownSet} set */
function remove(set) {
  const place = sets.indexOf(set);
  sets = sets.filter((one) => one !== set);
  show();
  toast(`Removed ${set.label}.`, {
    undo: async () => {
      sets.splice(Math.min(place, sets.length), 0, set);
      show();
    },
  });
}

function offer() {
  at("add-set").replaceChildren(
    make("option", { value: "" }, "select\u2026"),
    ...offered.map((one) => make("option", { value: one.id }, one.label
      + (one.error_mm2 === null ? "" : `, E ${one.error_mm2.toFixed(2)} mm\u00b2`))),
  );
}

at("add-slider").addEventListener("change", (event) => {
  const chosen = sliders.find((one) => one.name === /** @type {HTMLSelectElement} */ (event.target).value);
  if (!chosen) return;
  live().parameters[chosen.name] ??= chosen.nominal;
  build();
  at(`slide-${chosen.name}`).focus();
  changed();
});
at("motion").addEventListener("change", (event) => {
  live().motion = /** @type {HTMLSelectElement} */ (event.target).value;
  changed();
});
at("add-set").addEventListener("change", (event) => {
  const select = /** @type {HTMLSelectElement} */ (event.target);
  const one = offered.find(({ id }) => id === select.value);
  select.value = "";
  const stored = one?.kind === "simulation" ? one.id.replace("simulation-", "") : undefined;
  if (one) add({ ...one, stored, parameters: { ...one.parameters } }).catch(complain);
});
at("pin").addEventListener("click", () => {
  pinned += 1;
  const { parameters, motion } = live();
  add({ id: `pinned-${pinned}`, label: `set ${pinned}`, parameters: { ...parameters }, motion }).catch(complain);
});
at("reset").addEventListener("click", () => adopt({ parameters: {}, motion: "dynamic" }));
at("keep").addEventListener("click", async () => {
  const { parameters, motion } = live();
  try {
    const kept = await send(`/experiments/${number}/simulations`, { parameters, motion });
    toast(`Stored as simulation ${kept.id}.`);
    ({ sets: offered } = await get(address));
    offer();
  } catch (problem) {
    complain(problem);
  }
});
at("copy-command").addEventListener("click", () => copy(live().answer?.command ?? "", "the command"));
at("copy-python").addEventListener("click", () => copy(live().answer?.python ?? "", "the Python code"));

async function open() {
  const [story, desk] = await Promise.all([get(`/experiments/${number}/motion`), get(address)]);
  ({ sliders, sets: offered } = desk);
  sets = [{ id: LIVE, label: "adjusted", parameters: {}, motion: "dynamic", answer: null, shown: null }];
  player.show(story);
  measured = player.motions[0];
  // What a calibration changed is what one looks for: nominal values against calibrated ones.
  const calibrated = calibratedOf(offered);
  if (calibrated) Object.assign(live(), { parameters: { ...calibrated.parameters }, motion: calibrated.motion });
  const first = [offered[0], calibrated].flatMap((one) => (one ? [{ ...one, answer: null, shown: null }] : []));
  await Promise.all([live(), ...first].map((set) => simulated(set)));
  sets.push(...first);
  at("measured-mode").textContent = `measured ${live().answer?.measured_contact_mode || "unknown"}`;
  offer();
  build();
  show();
  root.dataset.ready = "yes";
}

open().catch(complain);
