// @ts-check
// The table of experiments: filter, sort, select, mark.

import { complain, get, Refusal, toast, undoNewest } from "./api.js";
import { Coverage } from "./coverage.js";
import { ROOT, at, input, make, settled, typing } from "./dom.js";
import { and, about, has, quoted, without } from "./filter.js";
import { offerImport } from "./import.js";
import * as marks from "./marks.js";
import { Nominal } from "./nominal.js";
import { awaited, COLUMNS, drawnRow, Rows, Window } from "./rows.js";
import { count, several } from "./units.js";

const address = new URLSearchParams(location.search);
const question = {
  filter: address.get("filter") ?? "",
  sort: address.get("sort") ?? "id",
  descending: address.get("descending") === "true",
};
const rows = new Rows();
/** @type {Set<number>} */
const selected = new Set();
let active = 0;
let anchor = 0;

const shown = new Window(at("scroll"), at("rows"), (index) => {
  const row = rows.at(index);
  if (!row) return awaited(index);
  return drawnRow(row, index, { selected: selected.has(row.id), active: index === active });
});
const coverage = new Coverage(at("coverage"), (filter) => search(filter), () => at("show-coverage").click());
const nominal = new Nominal(() => ask({ keepPlace: true }));
const MOST_CHOSEN = 2000; // experiments that an address can name

// --- asking -------------------------------------------------------------------------------------

/** @param {{keepPlace?: boolean}} [options] */
async function ask({ keepPlace = false } = {}) {
  const given = new URLSearchParams();
  if (question.filter) given.set("filter", question.filter);
  if (question.sort !== "id") given.set("sort", question.sort);
  if (question.descending) given.set("descending", "true");
  history.replaceState(null, "", given.size ? `?${given}` : location.pathname);
  sessionStorage.setItem("fixel-list", given.toString());
  try {
    await rows.ask({ ...question });
    tell("");
  } catch (problem) {
    if (problem instanceof Refusal && problem.problem.status === 422) return tell(problem.message);
    return complain(problem);
  }
  if (!keepPlace) {
    active = 0;
    at("scroll").scrollTop = 0;
  }
  active = Math.max(0, Math.min(active, rows.total - 1));
  shown.reset(rows.total);
  describe();
  if (!at("coverage").hidden) coverage.show(question.filter, keepPlace);
  nominal.offer(question.filter).catch(complain);
}

/** @param {string} sentence why a filter cannot be */
function tell(sentence) {
  at("filter-problem").hidden = !sentence;
  at("filter-problem").textContent = sentence;
  input("filter").setAttribute("aria-invalid", String(Boolean(sentence)));
}

/** @param {string} filter */
function search(filter) {
  question.filter = filter.trim();
  if (input("filter").value.trim() !== question.filter) input("filter").value = question.filter;
  ask();
  picks();
}

function describe() {
  const faults = rows.faulty ? `, ${count(rows.faulty)} with a fault` : "";
  at("counted").textContent = several(rows.total, "experiment") + faults;
  at("clear").hidden = !question.filter;
  at("table").setAttribute("aria-rowcount", String(rows.total + 1));
  at("nothing").hidden = rows.total > 0;
  at("table").hidden = rows.total === 0;
  at("nothing-words").textContent = question.filter ? "No experiment matches." : "This project has no experiments yet. Import some:";
  at("nothing-commands").hidden = Boolean(question.filter);
  const meant = rows.total ? null : rows.meant;
  if (meant) at("nothing-words").append(" Did you mean ", make("button", { type: "button", class: "quiet", id: "meant", onclick: () => search(meant) }, meant), "?");
  const deleted = has(question.filter, "is:deleted");
  at("act-delete").hidden = deleted;
  at("act-restore").hidden = !deleted;
  at("act-calibrate").hidden = deleted;
  head();
  acts();
}

rows.addEventListener("came", () => {
  for (const [index, node] of shown.drawn) if (node.classList.contains("awaited")) shown.redraw(index);
});

// --- the head: sorting --------------------------------------------------------------------------

function head() {
  const line = make("tr", { "aria-rowindex": 1 });
  for (const column of COLUMNS) {
    const names = [column.sort, column.beside?.sort].filter(Boolean);
    const state = names.includes(question.sort) ? (question.descending ? "descending" : "ascending") : column.sort ? "none" : null;
    const content = column.key === "select"
      ? [make("input", { type: "checkbox", id: "all", "aria-label": "Select all that match", onchange: selectAll })]
      : column.sort
        ? [sorter(column.sort, column.label, column.unit, column.title), column.beside ? sorter(column.beside.sort, column.beside.label) : ""]
        : [make("span", {}, column.label)];
    line.append(make("th", { scope: "col", class: column.key, "aria-sort": state }, ...content));
  }
  at("head").replaceChildren(line);
  const all = input("all");
  all.checked = selected.size > 0 && selected.size >= rows.total;
  all.indeterminate = selected.size > 0 && !all.checked;
}

/** @param {string} name @param {string} label @param {string} [unit] @param {string} [title] */
function sorter(name, label, unit, title) {
  const arrow = name === question.sort ? (question.descending ? "\u25bc" : "\u25b2") : "";
  return make("button", { type: "button", class: "sort", title, onclick: () => sort(name) },
    label, unit ? ` [${unit}]` : "", make("span", { class: "arrow", "aria-hidden": "true" }, arrow));
}

/** First up, then down, then as they were. @param {string} name */
function sort(name) {
  if (question.sort !== name) Object.assign(question, { sort: name, descending: false });
  else if (!question.descending) question.descending = true;
  else Object.assign(question, { sort: "id", descending: false });
  ask();
}

// --- picks: what one often filters by --------------------------------------------------------------

/** @type {{datasets: Record<string, number>, flags: Record<string, number>, conditions: Record<string, {texts: Record<string, number>}>} | null} */
let words = null;

async function picks(anew = false) {
  if (anew || !words) words = await get("/vocabulary");
  if (!words) return;
  const usual = ["shape", "layout"];
  const texts = Object.entries(words.conditions)
    .filter(([name, { texts }]) => Object.keys(texts).length > 1 && name !== "axis")
    .sort(([a], [b]) => Number(usual.includes(b)) - Number(usual.includes(a)) || usual.indexOf(a) - usual.indexOf(b))
    .map(([name, { texts }]) => pick(name, `${name}=`, Object.keys(texts)));
  const states = ["clean", "faulty", "flagged", "noted", "real", "simulated", "deleted"];
  at("picks").replaceChildren(
    ...(Object.keys(words.datasets).length > 1 ? [pick("dataset", "dataset:", Object.keys(words.datasets))] : []),
    ...texts.slice(0, 3),
    ...(Object.keys(words.flags).length ? [pick("flag", "flag:", Object.keys(words.flags))] : []),
    pick("is", "is:", states),
  );
}

/** @param {string} name @param {string} before @param {string[]} values */
function pick(name, before, values) {
  const now = about(question.filter, name)[0]?.slice(before.length) ?? "";
  const label = name === "is" ? "state" : name;
  const select = make("select", {
    "aria-label": `Filter by this ${label}`, "data-pick": name, class: now ? "set" : null,
    onchange: () => {
      const rest = without(question.filter, [name]);
      search(select.value ? and(rest, `${before}${quoted(select.value)}`) : rest);
    },
  }, make("option", { value: "" }, label), ...values.map((value) => make("option", { value, selected: value === now }, value)));
  return select;
}

// --- selecting and acting --------------------------------------------------------------------------

function acts() {
  at("acts").hidden = selected.size === 0;
  at("chosen").textContent = `${count(selected.size)} selected`;
  const all = document.getElementById("all");
  if (all instanceof HTMLInputElement) {
    all.checked = selected.size > 0 && selected.size >= rows.total;
    all.indeterminate = selected.size > 0 && !all.checked;
  }
}

/** @param {number} index @param {boolean} on */
function select(index, on) {
  const row = rows.at(index);
  if (!row) return;
  if (on) selected.add(row.id);
  else selected.delete(row.id);
  shown.redraw(index);
}

async function selectAll() {
  if (selected.size) selected.clear();
  else for (const id of (await get("/experiments/ids", question)).ids) selected.add(id);
  shown.reset(rows.total);
  acts();
}

function selectNone() {
  selected.clear();
  shown.reset(rows.total);
  acts();
}

/** Opens the page on which a calibration of them is begun. @param {number[]} ids */
function calibrate(ids) {
  if (!ids.length || at("act-calibrate").hidden) return;
  // An address holds so many ids and no more; all that match are named by the filter.
  if (ids.length <= MOST_CHOSEN) location.assign(`${ROOT}/calibrations/new?experiments=${ids.sort((a, b) => a - b).join(",")}`);
  else if (ids.length === rows.total) location.assign(`${ROOT}/calibrations/new?${new URLSearchParams({ filter: question.filter })}`);
  else toast(`At most ${count(MOST_CHOSEN)} experiments can be selected one by one; filter the table and select all that match.`, { bad: true });
}

/** The selected ones, or the one that the keys are on. */
const chosen = () => {
  const row = rows.at(active);
  return selected.size ? [...selected] : row ? [row.id] : [];
};

function changed() {
  selected.clear();
  ask({ keepPlace: true });
  picks(true).catch(complain);
}

at("act-flag").addEventListener("click", () => marks.flag([...selected], changed));
at("act-note").addEventListener("click", () => marks.note([...selected], changed));
at("act-calibrate").addEventListener("click", () => calibrate([...selected]));
at("act-delete").addEventListener("click", () => marks.remove([...selected], changed));
at("act-restore").addEventListener("click", () => marks.restore([...selected], changed));
at("act-none").addEventListener("click", selectNone);

at("rows").addEventListener("click", (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  const line = target.closest("tr");
  const index = Number(line?.dataset.index);
  if (!line || Number.isNaN(index)) return;
  const row = rows.at(index);
  if (!row) return;
  if (target.closest("td.select")) {
    const on = !selected.has(row.id);
    const [from, to] = event.shiftKey ? [Math.min(anchor, index), Math.max(anchor, index)] : [index, index];
    for (let k = from; k <= to; k += 1) select(k, on);
    anchor = index;
    move(index);
    acts();
  } else if (!target.closest("a")) {
    open(index, event.ctrlKey || event.metaKey);
  }
});

/** @param {number} index @param {boolean} [aside] in another tab */
function open(index, aside = false) {
  const row = rows.at(index);
  if (!row) return;
  if (aside) window.open(`${ROOT}/experiments/${row.id}`, "_blank", "noopener");
  else location.assign(`${ROOT}/experiments/${row.id}`);
}

/** @param {number} index */
function move(index) {
  const old = active;
  active = Math.max(0, Math.min(index, rows.total - 1));
  shown.redraw(old);
  shown.reveal(active);
  shown.redraw(active);
}

// --- keys -------------------------------------------------------------------------------------------

/** @type {Record<string, () => void>} */
const KEYS = {
  j: () => move(active + 1),
  k: () => move(active - 1),
  ArrowDown: () => move(active + 1),
  ArrowUp: () => move(active - 1),
  PageDown: () => move(active + 10),
  PageUp: () => move(active - 10),
  Home: () => move(0),
  End: () => move(rows.total - 1),
  Enter: () => open(active),
  x: () => {
    const row = rows.at(active);
    if (row) select(active, !selected.has(row.id));
    anchor = active;
    acts();
  },
  f: () => marks.flag(chosen(), changed),
  n: () => marks.note(chosen(), changed),
  c: () => calibrate(chosen()),
  Delete: () => (has(question.filter, "is:deleted") ? marks.restore(chosen(), changed) : marks.remove(chosen(), changed)),
  "/": () => input("filter").focus(),
  "?": () => /** @type {HTMLDialogElement} */ (at("keys")).showModal(),
  Escape: selectNone,
};

document.addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]")) return;
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing(event)) {
    if (undoNewest()) event.preventDefault();
    return;
  }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target === at("filter")) {
    if (event.key === "Escape" || event.key === "Enter") {
      event.preventDefault();
      input("filter").blur();
    }
    return;
  }
  const onButton = event.target instanceof Element && event.target.matches("button, a, summary, [role=button]");
  if (typing(event) && !(event.target instanceof HTMLInputElement && event.target.type === "checkbox")) return;
  if (onButton && (event.key === "Enter" || event.key === " ")) return;
  const act = KEYS[event.key];
  if (act) {
    event.preventDefault();
    act();
  }
});

// --- beginning -----------------------------------------------------------------------------------------

at("tools").addEventListener("submit", (event) => event.preventDefault());
input("filter").value = question.filter;
input("filter").addEventListener("input", settled(() => search(input("filter").value), 150));
at("clear").addEventListener("click", () => search(""));
at("show-keys").addEventListener("click", KEYS["?"]);
at("show-coverage").addEventListener("click", () => {
  const hidden = !at("coverage").hidden;
  at("coverage").hidden = hidden;
  at("show-coverage").setAttribute("aria-pressed", String(!hidden));
  localStorage.setItem("fixel-coverage", hidden ? "" : "shown");
  if (!hidden) coverage.show(question.filter);
});
if (localStorage.getItem("fixel-coverage") && innerWidth > 1000) at("show-coverage").click();
offerImport(changed);
ask();
picks().catch(complain);
