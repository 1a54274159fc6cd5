// @ts-check
// The domain: where held-out errors stay below a threshold, cell by cell, and what lies in a cell.

import { complain, copy, get } from "./api.js";
import { ROOT, at, input, make } from "./dom.js";
import { digits, several } from "./units.js";

/** @typedef {{name: string, unit: string, ticks: string[]}} Strip */
/** @typedef {{across: Strip, up: Strip | null, rows: number[][]}} Panel */
/** @typedef {{id: number, key: string, group: number, cell: number, error: number | null}} Held */
/** @typedef {{unit: string, low: number, high: number, groups: string[], panels: Panel[], texts: string[], centre: number, points: Held[], remarks: string[], simulated: boolean}} View */
/** @typedef {{colours: string[], colour: number[][], chance: (number | null)[][], percent: (number | null)[][], inside: number[][], figures: [string, string][], command: string}} Verdicts */
/** @typedef {Verdicts & {tau: number}} Shown */
/** @typedef {{proposals: {group: string, cell: number, where: string, bits: number, reason: string}[]}} Next */

/** Signs tell what colours tell. @type {Record<string, string>} */
const SIGNS = { trusted: "\u2713", doubtful: "?", "not trusted": "\u2715", "no data": "", predicted: "\u25cc" };
const BROWN = [140, 45, 4];
const PALE = [245, 240, 230];
const BLUE = [0, 95, 160];
const MOST_MARKS = 4; // experiments drawn one by one in a cell
const SETTLED = 350; // [ms] after which the next experiment is looked for
const STEPS = 1000;
const tau = input("tau");

const root = at("domain");
const address = `/domain/${encodeURIComponent(root.dataset.map ?? "")}`;
/** @type {View} */
let view;
/** @type {Shown | null} */
let shown = null;
/** @type {{group: number, cell: number} | null} */
let picked = null;

// --- asking ----------------------------------------------------------------------------------

async function load() {
  view = /** @type {View} */ (await get(address));
  at("board").hidden = false;
  at("simulated").hidden = !view.simulated;
  at("remarks").textContent = view.remarks.join(" ");
  input("slider").value = String(onSlider(Number(tau.value)));
  for (const id of /** @type {("low" | "high")[]} */ (["low", "high"])) at(id).textContent = `${digits(+view[id].toPrecision(3))} ${view.unit}`.trim();
  build();
  await refresh();
  root.dataset.ready = "yes";
}

let wanted = 0; // [ms] when the form was changed last
let busy = false;
let timer = 0;

const claim = () => /** @type {Record<string, string>} */ (Object.fromEntries(new FormData(/** @type {HTMLFormElement} */ (at("claim")))));

/** One request at a time, the newest one next. */
async function refresh() {
  wanted ||= performance.now();
  if (busy) return;
  busy = true;
  try {
    while (wanted) {
      const since = wanted;
      wanted = 0;
      const now = Number(tau.value);
      if (!(now > 0)) break;
      shown = { tau: now, .../** @type {Verdicts} */ (await get(`${address}/map`, claim())) };
      paint();
      root.dataset.roundTrip = (performance.now() - since).toFixed(1);
    }
  } catch (problem) {
    complain(problem);
  } finally {
    busy = false;
  }
  clearTimeout(timer);
  timer = window.setTimeout(suggest, SETTLED);
}

async function suggest() {
  /** @type {Next} */
  let next;
  try {
    next = await get(`${address}/next`, claim());
  } catch (problem) {
    complain(problem);
    return;
  }
  at("next").replaceChildren(...next.proposals.map((one) => make(
    "li", {},
    make("button", { type: "button", class: "quiet where", onclick: () => pick(view.groups.indexOf(one.group), one.cell, true) },
      one.group ? `${one.group}: ` : "", one.where),
    make("small", {}, `${one.reason}; expected information ${digits(+one.bits.toFixed(2))} bit`),
  )), make("li", { class: "after" }, make("small", {}, next.proposals.length ? "After recording, compute the map again: " : "No experiment is expected to add information. Compute the map again: "), make("code", {}, shown?.command ?? "")));
}

// --- controls --------------------------------------------------------------------------------

/** @param {number} value */
const onSlider = (value) => (STEPS * Math.log(value / view.low)) / Math.log(view.high / view.low);
/** @param {number} place */
const offSlider = (place) => +(view.low * (view.high / view.low) ** (place / STEPS)).toPrecision(3);

// --- the map ---------------------------------------------------------------------------------

/** @param {Strip} strip */
function named(strip) {
  const bare = strip.unit ? strip.name.replace(/_(m_s|rad_s|rad|m|s)$/, "") : strip.name;
  return bare.replaceAll("_", " ") + (strip.unit ? ` [${strip.unit}]` : "");
}

/** Of numbers, not of names. @param {string} text */
const minus = (text) => text.replace(/(^|\s)-(?=[\d.])/g, "$1\u2212");

/** @type {Map<string, HTMLElement>} */
const squares = new Map();

function build() {
  squares.clear();
  const nodes = view.panels[0].up
    ? view.groups.map((group, g) => grid(group, view.panels[0], g))
    : view.panels.map((panel) => strips(panel));
  at("panels").replaceChildren(...nodes);
  at("panels").classList.toggle("strips", !view.panels[0].up);
  for (const table of at("panels").querySelectorAll("table")) table.addEventListener("keydown", step);
}

/** All groups along one axis, a row each. @param {Panel} panel */
function strips(panel) {
  return make(
    "table", { class: `map${panel.across.ticks.length > 14 ? " small" : ""}`, role: "grid", "aria-label": `along ${named(panel.across)}` },
    make("caption", {}, named(panel.across)),
    make("thead", {}, make("tr", {}, make("td", {}), ...panel.across.ticks.map((tick) => make("th", { scope: "col" }, minus(tick))))),
    make("tbody", {}, ...view.groups.map((group, g) => make(
      "tr", {}, make("th", { scope: "row" }, group || "all"), ...panel.rows[0].map((cell) => square(g, cell)),
    ))),
  );
}

/** One group over two axes. @param {string} group @param {Panel} panel @param {number} g */
function grid(group, panel, g) {
  const up = /** @type {Strip} */ (panel.up);
  return make(
    "table", { class: `map${panel.across.ticks.length > 10 ? " small" : ""}`, role: "grid", "aria-label": `${group || "all experiments"}: ${named(panel.across)} and ${named(up)}` },
    make("caption", {}, group || "all experiments", make("small", {}, ` ${named(up)} against ${named(panel.across)}`)),
    make("tbody", {}, ...panel.rows.map((row, k) => make(
      "tr", {}, make("th", { scope: "row" }, minus(up.ticks[k])), ...row.map((cell) => square(g, cell)),
    )).reverse()),
    make("tfoot", {}, make("tr", {}, make("td", {}), ...panel.across.ticks.map((tick) => make("th", { scope: "col" }, minus(tick))))),
  );
}

/** @param {number} g @param {number} cell */
function square(g, cell) {
  const node = make("td", { role: "gridcell", tabindex: -1, "data-group": g, "data-cell": cell, onclick: () => pick(g, cell) });
  node.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      pick(g, cell);
    }
  });
  // The centre is on every strip.
  const key = `${g} ${cell}`;
  const same = squares.get(key);
  if (same) twins.set(node, same);
  else squares.set(key, node);
  return node;
}

/** @type {WeakMap<HTMLElement, HTMLElement>} */
const twins = new WeakMap();

/** Arrow keys go from cell to cell. @param {KeyboardEvent} event */
function step(event) {
  const way = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] })[event.key];
  const here = event.target;
  if (!way || !(here instanceof HTMLTableCellElement)) return;
  event.preventDefault();
  const row = /** @type {HTMLTableRowElement} */ (here.parentElement);
  const to = way[1] ? /** @type {HTMLTableSectionElement} */ (row.parentElement).rows[row.sectionRowIndex + way[1]] : row;
  const node = to?.cells[here.cellIndex + way[0]];
  if (node?.dataset.cell === undefined) return;
  here.tabIndex = -1;
  node.tabIndex = 0;
  node.focus();
}

/** From brown over pale to blue; pale where little is known, so that what is decided stands out. @param {number} p */
function ramp(p) {
  const to = p < 0.5 ? BROWN : BLUE;
  const share = Math.abs(2 * p - 1) ** 2.5;
  return PALE.map((c, k) => Math.round(c + (to[k] - c) * share));
}

function paint() {
  if (!shown) return;
  const answer = shown;
  const drawn = input("points").checked;
  /** @type {Map<string, Held[]>} */
  const lying = new Map();
  for (const point of view.points) {
    const key = `${point.group} ${point.cell}`;
    lying.set(key, [...(lying.get(key) ?? []), point]);
  }
  for (const node of at("panels").querySelectorAll("td[data-cell]")) {
    if (!(node instanceof HTMLElement)) continue;
    const [g, c] = [Number(node.dataset.group), Number(node.dataset.cell)];
    const verdict = answer.colours[answer.colour[g][c]];
    const chance = answer.chance[g][c];
    const own = lying.get(`${g} ${c}`) ?? [];
    const within = own.filter((point) => point.error !== null && point.error <= answer.tau).length;
    node.className = verdict.replaceAll(" ", "-") + (answer.inside[g][c] ? " inside" : "") + (c === view.centre ? " centre" : "");
    node.classList.toggle("picked", picked?.group === g && picked.cell === c);
    const fill = chance === null ? null : ramp(chance);
    node.style.background = fill ? `rgb(${fill.join(" ")})` : "";
    node.style.color = fill ? ink(fill) : "";
    const percent = String(answer.percent[g][c] ?? "");
    node.replaceChildren(
      make("span", { class: "sign" }, SIGNS[verdict]),
      make("span", { class: "percent" }, percent),
      make("span", { class: "dots" }, drawn ? marks(within, own.length - within) : ""),
    );
    const words = `${view.groups[g] ? `${view.groups[g]}, ` : ""}${view.texts[c]}: ${verdict}`
      + `${chance === null ? "" : `, ${percent} % probable`}, ${several(own.length, "experiment")}${own.length ? `, ${within} within` : ""}`
      + `${c === view.centre ? ", the nominal" : ""}`;
    node.setAttribute("aria-label", words);
    node.title = words;
  }
  for (const table of at("panels").querySelectorAll("table")) {
    if (table.querySelector("td[tabindex='0']")) continue;
    const first = /** @type {HTMLElement | null} */ (table.querySelector("td.centre") ?? table.querySelector("td[data-cell]"));
    if (first) first.tabIndex = 0;
  }
  at("counts").replaceChildren(...answer.figures.map(([title, value]) => make("div", {}, make("dt", {}, title), make("dd", {}, value))));
  if (picked) cellOf(picked.group, picked.cell);
  root.dataset.tau = String(answer.tau);
}

/** Black or white, whichever can be read. @param {number[]} fill */
function ink(fill) {
  const [r, g, b] = fill.map((c) => {
    const share = c / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18 ? "#101418" : "#ffffff";
}

/** @param {number} within @param {number} above */
function marks(within, above) {
  if (within + above <= MOST_MARKS) return "\u2022".repeat(within) + "\u00d7".repeat(above);
  return [within ? `${within}\u2022` : "", above ? `${above}\u00d7` : ""].filter(Boolean).join(" ");
}

// --- a cell ----------------------------------------------------------------------------------

/** @param {number} g @param {number} cell @param {boolean} [focus] */
function pick(g, cell, focus = false) {
  picked = { group: Math.max(0, g), cell };
  paint();
  const node = squares.get(`${picked.group} ${cell}`);
  if (focus && node) {
    node.scrollIntoView({ block: "nearest" });
    node.focus();
  }
}

/** @param {number} g @param {number} c */
function cellOf(g, c) {
  if (!shown) return;
  const { tau: most } = shown;
  const verdict = shown.colours[shown.colour[g][c]];
  const percent = shown.percent[g][c];
  const own = view.points.filter((point) => point.group === g && point.cell === c)
    .sort((a, b) => (b.error ?? Infinity) - (a.error ?? Infinity));
  const unit = view.unit ? ` ${view.unit}` : "";
  const where = c === view.centre && view.panels.length > 2 ? "the nominal" : view.texts[c];
  at("cell-title").textContent = `${view.groups[g] ? `${view.groups[g]}: ` : ""}${where}`;
  at("cell").replaceChildren(
    make("p", {}, make("strong", {}, `${SIGNS[verdict]} ${verdict}`),
      percent === null ? "" : `, ${percent} % probable`),
    own.length
      ? make("ul", { class: "members" }, ...own.map((point) => make(
        "li", {},
        make("a", { href: `${ROOT}/experiments/${point.id}` }, point.key),
        make("span", { class: "number" }, point.error === null ? "failed" : `${digits(+point.error.toPrecision(3))}${unit}`,
          " ", make("span", { class: `tag ${point.error !== null && point.error <= most ? "good" : "fault"}` },
            point.error !== null && point.error <= most ? "\u2713 within" : "\u2715 above")),
      )))
      : make("p", { class: "remark" }, "This cell has no experiments and no verdict."),
  );
}

input("slider").addEventListener("input", () => {
  tau.value = String(offSlider(Number(input("slider").value)));
});
at("claim").addEventListener("submit", (event) => event.preventDefault());
at("claim").addEventListener("input", (event) => {
  if (event.target === tau && Number(tau.value) > 0) input("slider").value = String(onSlider(Number(tau.value)));
  void refresh();
});
input("points").addEventListener("change", paint);
at("copy-command").addEventListener("click", () => copy(shown?.command ?? "", "the command"));
document.getElementById("which")?.addEventListener("change", (event) => {
  location.assign(`${ROOT}/domain?map=${encodeURIComponent(/** @type {HTMLSelectElement} */ (event.target).value)}`);
});
load().catch((problem) => {
  at("trouble").textContent = problem instanceof Error ? problem.message : String(problem);
  at("trouble").hidden = false;
  root.dataset.ready = "yes";
});
