// @ts-check
// A calibration to begin: which experiments, which parameters, which search.

import { complain, get, send, toast } from "./api.js";
import { ROOT, at, input, make, settled } from "./dom.js";
import { several, shownIn } from "./units.js";

/** @typedef {{name: string, unit: string, meaning: string, low: number, high: number, start: number, usual: boolean}} Unknown */
/** @typedef {{experiments: number, faulty: number, unknowns: Unknown[], optimisers: {name: string, meaning: string}[]}} Offer */

const LIMITED = ["pattern-search", "nelder-mead"]; // searches that take a largest number of evaluations
const form = /** @type {HTMLFormElement} */ (at("form"));
const ids = (form.dataset.experiments ?? "").split(",").map(Number).filter((id) => id > 0);
/** @type {Map<string, Unknown>} */
const known = new Map();
let newest = 0;

async function offer() {
  newest += 1;
  const own = newest;
  const search = new URLSearchParams({ filter: input("filter").value });
  for (const id of ids) search.append("experiments", String(id));
  try {
    const answer = /** @type {Offer} */ (await get(`/calibrations/offer?${search}`));
    if (own !== newest) return;
    const left = answer.faulty ? `; ${answer.faulty} more are skipped because their data have faults` : "";
    at("matching").textContent = `${several(answer.experiments, "experiment")} selected${left}.`;
    at("matching").className = answer.experiments ? "remark" : "remark bad";
    if (known.size === 0 && answer.unknowns.length) fill(answer);
    /** @type {HTMLButtonElement} */ (at("begin")).disabled = answer.experiments === 0;
  } catch (problem) {
    if (own !== newest) return;
    at("matching").textContent = problem instanceof Error ? problem.message : String(problem);
    at("matching").className = "remark bad";
  }
}

/** @param {Offer} answer */
function fill(answer) {
  for (const one of answer.unknowns) known.set(one.name, one);
  at("usual").replaceChildren(...answer.unknowns.filter((one) => one.usual).map(row));
  at("others").replaceChildren(...answer.unknowns.filter((one) => !one.usual).map(row));
  at("optimiser").replaceChildren(...answer.optimisers.map(({ name, meaning }) =>
    make("option", { value: name }, `${name}: ${meaning}`)));
  form.dataset.ready = "yes";
}

/** @param {Unknown} one */
function row(one) {
  const [factor, unit] = shownIn(one.unit);
  /** @param {string} kind @param {number} value */
  const field = (kind, value) => make("td", {}, make("input", {
    type: "number", step: "any", name: `${one.name}.${kind}`, value: +(factor * value).toPrecision(5),
    "aria-label": `${kind} of ${one.name}${unit && ` in ${unit}`}`,
  }));
  const box = make("input", { type: "checkbox", name: one.name, checked: one.usual, id: `fit-${one.name}` });
  const line = make(
    "tr", { "data-name": one.name },
    make("th", { scope: "row" }, make("label", { for: box.id }, box, " ", one.name), make("small", {}, one.meaning)),
    field("low", one.low), field("high", one.high), field("start", one.start),
    make("td", { class: "unit-of" }, unit),
  );
  box.addEventListener("change", () => line.classList.toggle("off", !box.checked));
  line.classList.toggle("off", !one.usual);
  return line;
}

function unknowns() {
  const found = [];
  for (const line of form.querySelectorAll("tr[data-name]")) {
    const name = /** @type {HTMLElement} */ (line).dataset.name ?? "";
    const one = known.get(name);
    if (!one || !input(`fit-${name}`).checked) continue;
    const [factor] = shownIn(one.unit);
    /** @param {"low" | "high" | "start"} kind */
    const value = (kind) => {
      const field = /** @type {HTMLInputElement} */ (form.elements.namedItem(`${name}.${kind}`));
      // What nobody has changed stays as exact as it was.
      return field.value === field.defaultValue ? one[kind] : Number(field.value) / factor;
    };
    found.push({ name, low: value("low"), high: value("high"), start: value("start") });
  }
  return found;
}

/** @param {SubmitEvent} event */
async function begin(event) {
  event.preventDefault();
  const button = /** @type {HTMLButtonElement} */ (at("begin"));
  button.disabled = true;
  button.textContent = "Beginning\u2026";
  const optimiser = /** @type {HTMLSelectElement} */ (at("optimiser")).value;
  const mode = chosenMode();
  try {
    const begun = await send("/calibrations", {
      filter: ids.length ? "" : input("filter").value,
      experiments: ids,
      name: input("name").value || "calibration",
      mode,
      unknowns: unknowns(),
      optimiser,
      starts: Number(input("starts").value),
      seed: Number(input("seed").value),
      most_evaluations: LIMITED.includes(optimiser) ? limit("most") : null,
      budget_s: mode === "joint" ? limit("budget") : null,
      sample: limit("sample"),
      verdicts: input("verdicts").checked,
    });
    location.assign(begun.stored.length
      ? `${ROOT}/calibrations/${begun.stored.at(-1)}`
      : `${ROOT}/calibrations/running/${encodeURIComponent(begun.name)}`);
  } catch (problem) {
    complain(problem);
    button.disabled = false;
    button.textContent = "Begin";
  }
}

function chosenMode() {
  return /** @type {HTMLInputElement | null} */ (form.querySelector("input[name=mode]:checked"))?.value ?? "joint";
}

/** Number in a field that may be empty. @param {string} id */
function limit(id) {
  return input(id).value ? Number(input(id).value) : null;
}

function limited() {
  const optimiser = /** @type {HTMLSelectElement} */ (at("optimiser")).value;
  input("most").disabled = !LIMITED.includes(optimiser);
  input("budget").disabled = chosenMode() !== "joint";
}

form.addEventListener("submit", begin);
input("filter").addEventListener("input", settled(offer, 250));
form.addEventListener("change", limited);
if (ids.length) toast(`${several(ids.length, "experiment")} selected: ${ids.slice(0, 8).join(", ")}${ids.length > 8 ? "\u2026" : ""}`);
void offer().then(limited);
