// @ts-check
// The table of experiments: keys, selection, marks of what is selected.

import { ROOT, complain, get, send, toast } from "./api.js";
import { at, input, typing } from "./dom.js";
import { offerImport } from "./import.js";
import * as marks from "./marks.js";
import { renew } from "./page.js";
import { several } from "./units.js";

const MOST_CHOSEN = 2000; // experiments that an address can name
const AT_ONCE = 20; // experiments that a request simulates; about a second
/** @type {Set<number>} */
const selected = new Set();
let active = 0;
let anchor = 0;
let simulates = ""; // progress of simulations with nominal values; empty while there are none

const rows = () => /** @type {HTMLTableRowElement[]} */ ([...document.querySelectorAll("#rows tr")]);
/** @param {HTMLElement | undefined} row */
const idOf = (row) => Number(row?.dataset.id);
const deleted = () => Boolean(at("list").dataset.deleted);

/** Shows what is selected, and the row that the keys are on. */
function paint() {
  const every = rows();
  active = Math.max(0, Math.min(active, every.length - 1));
  every.forEach((row, index) => {
    const on = selected.has(idOf(row));
    row.classList.toggle("active", index === active);
    row.setAttribute("aria-selected", String(on));
    /** @type {HTMLInputElement} */ (row.querySelector("input")).checked = on;
  });
  const all = document.getElementById("all");
  if (all instanceof HTMLInputElement) {
    all.checked = selected.size > 0 && selected.size >= Number(at("list").dataset.total);
    all.indeterminate = selected.size > 0 && !all.checked;
  }
  at("acts").hidden = selected.size === 0;
  const hidden = selected.size - every.filter((row) => selected.has(idOf(row))).length;
  at("chosen").textContent = `${selected.size} selected`;
  at("elsewhere").textContent = hidden ? `${hidden} not in these rows` : "";
  at("act-calibrate").hidden = deleted();
  at("act-delete").textContent = deleted() ? "Restore" : "Delete";
  at("simulating").textContent = simulates;
  const button = document.getElementById("simulate");
  if (button && simulates) button.textContent = "Stop";
}

/** The selected ones, or the one that the keys are on. */
function chosen() {
  const row = rows()[active];
  return selected.size ? [...selected] : row ? [idOf(row)] : [];
}

async function changed() {
  selected.clear();
  await renew();
}

/** Opens the page on which a calibration of them is begun. @param {number[]} ids */
function calibrate(ids) {
  if (!ids.length || deleted()) return;
  // An address holds so many ids and no more; all that match are named by the filter.
  if (ids.length <= MOST_CHOSEN) location.assign(`${ROOT}/run/calibrate?${new URLSearchParams(ids.sort((a, b) => a - b).map((id) => ["experiments", String(id)]))}`);
  else if (ids.length === Number(at("list").dataset.total)) location.assign(`${ROOT}/run/calibrate?${new URLSearchParams({ where: input("filter").value })}`);
  else toast(`At most ${MOST_CHOSEN} experiments can be selected one by one; filter the table and select all that match.`, { bad: true });
}

/** @param {number} index */
function move(index) {
  active = index;
  paint();
  rows()[active]?.scrollIntoView({ block: "nearest" });
}

/** @param {boolean} [aside] in another tab */
function open(aside = false) {
  const link = rows()[active]?.querySelector("a");
  if (link && aside) window.open(link.href, "_blank", "noopener");
  else link?.click();
}

/** Simulates those that have no simulation with nominal values, some at a time, until it is stopped. */
async function simulate() {
  const ids = (at("simulate").dataset.ids ?? "").split(",").map(Number);
  /** @type {string[]} */
  const reasons = [];
  let done = 0;
  simulates = "simulating";
  for (let k = 0; k < ids.length && simulates; k += AT_ONCE) {
    simulates = `simulated ${k} of ${ids.length}`;
    paint();
    const { stored, refused } = await send("/experiments/simulate", { ids: ids.slice(k, k + AT_ONCE) });
    done += stored.length;
    reasons.push(.../** @type {string[]} */ (Object.values(refused)));
  }
  const failed = reasons.length ? ` ${several(reasons.length, "experiment")} could not be simulated: ${reasons[0]}` : "";
  toast(`Simulated ${several(done, "experiment")} with nominal values.${failed}`);
}

const acts = {
  flag: () => marks.flag(chosen(), changed),
  note: () => marks.note(chosen(), changed),
  calibrate: () => calibrate(chosen()),
  delete: () => marks.remove(chosen(), changed, deleted()),
  none: () => {
    selected.clear();
    paint();
  },
};
for (const [name, act] of Object.entries(acts)) at(`act-${name}`).addEventListener("click", act);

at("scroll").addEventListener("change", async ({ target }) => {
  if (!(target instanceof HTMLInputElement) || target.id !== "all") return;
  if (selected.size) selected.clear();
  else for (const id of (await get("/experiments/ids", { filter: input("filter").value })).ids) selected.add(id);
  paint();
});
at("scroll").addEventListener("click", (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  const every = rows();
  const index = every.findIndex((row) => row.contains(target));
  if (index < 0 || target.closest("a")) return;
  active = index;
  if (!target.closest("td.select")) return open(event.ctrlKey || event.metaKey);
  const on = !selected.has(idOf(every[index]));
  const [from, to] = event.shiftKey ? [Math.min(anchor, index), Math.max(anchor, index)] : [index, index];
  for (const row of every.slice(from, to + 1)) selected[on ? "add" : "delete"](idOf(row));
  anchor = index;
  setTimeout(paint); // after the box has been ticked by the browser itself
});
document.addEventListener("click", ({ target }) => {
  if (!(target instanceof Element) || target.id !== "simulate") return;
  if (simulates) simulates = "";
  else {
    simulate().catch(complain).finally(() => {
      simulates = "";
      renew().catch(complain);
    });
  }
});

/** @type {Record<string, () => void>} */
const KEYS = {
  j: () => move(active + 1),
  k: () => move(active - 1),
  ArrowDown: () => move(active + 1),
  ArrowUp: () => move(active - 1),
  PageDown: () => move(active + 10),
  PageUp: () => move(active - 10),
  Home: () => move(0),
  End: () => move(rows().length - 1),
  Enter: () => open(),
  x: () => {
    const id = chosen().length ? idOf(rows()[active]) : 0;
    if (id) selected[selected.has(id) ? "delete" : "add"](id);
    anchor = active;
    paint();
  },
  "/": () => input("filter").focus(),
  Escape: acts.none,
};

document.addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]")) return;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const target = /** @type {Element} */ (event.target);
  if (target.id === "filter" && ["Escape", "Enter"].includes(event.key)) {
    event.preventDefault();
    return input("filter").blur();
  }
  if (typing(event)) return;
  if (target.matches("button, a, summary") && (event.key === "Enter" || event.key === " ")) return;
  if (!KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});

document.addEventListener("renewed", paint);
at("show-keys").addEventListener("click", () => /** @type {HTMLDialogElement} */ (at("keys")).showModal());
offerImport(changed);
paint();
