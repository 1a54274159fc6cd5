// @ts-check
// A long table of which only what is seen exists: rows are fetched by the page and drawn by the screen.

import { get } from "./api.js";
import { ROOT, make, svg } from "./dom.js";
import { condition, deg, fixed, mm, s } from "./units.js";

/**
 * @typedef {object} Row
 * @property {number} id
 * @property {string} dataset
 * @property {string} name
 * @property {boolean} real
 * @property {string | null} shape
 * @property {string | null} layout
 * @property {number} duration_s
 * @property {number} moved_m
 * @property {number} turned_rad
 * @property {string} contacts
 * @property {Record<string, string | number>} conditions
 * @property {string} content
 * @property {number | null} before_mm
 * @property {number | null} after_mm
 * @property {{name: string, detail: string, fault: boolean}[]} flags
 * @property {number} notes
 * @property {boolean} deleted
 */
/** @typedef {{filter: string, sort: string, descending: boolean}} Question */

const PAGE = 100; // rows fetched at once
const SPARE = 6; // rows drawn beyond the screen
// Shown elsewhere, or of no use for telling runs apart.
const UNTOLD = /^(shape|layout|axis|step|repetition|truth_.*)$/;

/** @type {{key: string, label: string, unit?: string, title?: string, sort?: string, beside?: {label: string, sort: string}}[]} */
export const COLUMNS = [
  { key: "select", label: "" },
  { key: "run", label: "Run" },
  { key: "name", label: "Experiment", sort: "name" },
  { key: "shape", label: "Shape", sort: "shape", beside: { label: "layout", sort: "layout" } },
  { key: "contacts", label: "Contacts", sort: "contacts", title: "Fixels that the object touches at the end" },
  { key: "moved", label: "Moved", unit: "mm", sort: "moved" },
  { key: "turned", label: "Turned", unit: "deg", sort: "turned" },
  { key: "duration", label: "Time", unit: "s", sort: "duration" },
  { key: "before", label: "Error", unit: "mm", sort: "before", title: "Error before calibration, from the newest stored simulation with nominal values" },
  { key: "after", label: "calibrated", unit: "mm", sort: "after", title: "Error after calibration, from the newest calibration of this experiment" },
  { key: "marks", label: "Flags", sort: "flags" },
];

/** Rows of a question, fetched as they are wanted; fires "came" when some have come. */
export class Rows extends EventTarget {
  constructor() {
    super();
    /** @type {Map<number, Row[]>} */
    this.pages = new Map();
    this.asked = new Set();
    this.total = 0;
    this.faulty = 0;
    /** @type {string | null} */
    this.meant = null;
    this.stop = new AbortController();
  }

  /** @param {Question} question @returns {Promise<void>} */
  async ask(question) {
    this.stop.abort();
    const stop = new AbortController();
    this.stop = stop;
    this.question = question;
    const first = await get("/experiments", { ...question, limit: PAGE, offset: 0 }, stop.signal);
    if (stop.signal.aborted) return;
    this.pages = new Map([[0, first.experiments]]);
    this.asked = new Set([0]);
    this.total = first.total;
    this.faulty = first.faulty;
    this.meant = first.meant ?? null;
    this.dispatchEvent(new Event("came"));
  }

  /** @param {number} index @returns {Row | undefined} */
  at(index) {
    const page = Math.floor(index / PAGE);
    if (!this.asked.has(page)) this.#fetch(page);
    return this.pages.get(page)?.[index - page * PAGE];
  }

  /** @param {number} page */
  async #fetch(page) {
    this.asked.add(page);
    const stop = this.stop;
    try {
      const found = await get("/experiments", { ...this.question, limit: PAGE, offset: page * PAGE }, stop.signal);
      if (stop.signal.aborted) return;
      this.pages.set(page, found.experiments);
      this.dispatchEvent(new Event("came"));
    } catch {
      this.asked.delete(page); // asked for again when it is next on the screen
    }
  }
}

/** Which rows are drawn: those on the screen and some beyond. */
export class Window {
  /**
   * @param {HTMLElement} scroll
   * @param {HTMLElement} body of the table
   * @param {(index: number) => HTMLTableRowElement} draw
   */
  constructor(scroll, body, draw) {
    this.scroll = scroll;
    this.body = body;
    this.draw = draw;
    this.total = 0;
    /** @type {Map<number, HTMLTableRowElement>} */
    this.drawn = new Map();
    this.above = make("tr", { class: "spacer", "aria-hidden": "true" });
    this.below = make("tr", { class: "spacer", "aria-hidden": "true" });
    scroll.addEventListener("scroll", () => this.update(), { passive: true });
    new ResizeObserver(() => this.update()).observe(scroll);
  }

  /** Of a row [px]. */
  get height() {
    return parseFloat(getComputedStyle(this.scroll).getPropertyValue("--row")) || 60;
  }

  /** Draws everything anew. @param {number} total */
  reset(total) {
    this.total = total;
    this.drawn.clear();
    this.body.replaceChildren(this.above, this.below);
    this.update();
  }

  /** Draws one row anew, if it is drawn. @param {number} index */
  redraw(index) {
    const old = this.drawn.get(index);
    if (!old) return;
    const node = this.draw(index);
    old.replaceWith(node);
    this.drawn.set(index, node);
  }

  update() {
    const height = this.height;
    const from = Math.max(0, Math.floor(this.scroll.scrollTop / height) - SPARE);
    const to = Math.min(this.total, Math.ceil((this.scroll.scrollTop + this.scroll.clientHeight) / height) + SPARE);
    for (const [index, node] of this.drawn) {
      if (index < from || index >= to) {
        node.remove();
        this.drawn.delete(index);
      }
    }
    /** @type {Element} */
    let before = this.above;
    for (let index = from; index < to; index += 1) {
      let node = this.drawn.get(index);
      if (!node) {
        node = this.draw(index);
        this.drawn.set(index, node);
        before.after(node);
      }
      before = node;
    }
    this.above.style.height = `${from * height}px`;
    this.below.style.height = `${Math.max(0, this.total - to) * height}px`;
  }

  /** Scrolls until a row is seen. @param {number} index */
  reveal(index) {
    const height = this.height;
    const head = /** @type {HTMLElement | null} */ (this.scroll.querySelector("thead"))?.offsetHeight ?? 0;
    const top = index * height;
    if (top < this.scroll.scrollTop) this.scroll.scrollTop = top;
    const bottom = top + height + head + 8;
    if (bottom > this.scroll.scrollTop + this.scroll.clientHeight) {
      this.scroll.scrollTop = bottom - this.scroll.clientHeight;
    }
  }
}

/** Dots, filled where a fixel is touched. @param {string} contacts */
export function dots(contacts) {
  if (!contacts) return make("span", { class: "none" }, "\u2013");
  const touched = [...contacts].map((digit, k) => (digit === "1" ? k + 1 : 0)).filter(Boolean);
  const words = touched.length ? `touches fixel ${touched.join(" and ")}` : "touches no fixel";
  const picture = svg("svg", { class: "dots", viewBox: `0 0 ${14 * contacts.length} 14`, width: 14 * contacts.length, height: 14, role: "img", "aria-label": words });
  [...contacts].forEach((digit, k) => picture.append(svg("circle", { cx: 14 * k + 7, cy: 7, r: 4.5, "data-on": digit })));
  picture.append(svg("title", {}, words));
  return picture;
}

/** Tags of flags. @param {Row["flags"]} flags */
export const tags = (flags) =>
  flags.map(({ name, detail, fault }) => make("span", { class: fault ? "tag fault" : "tag", title: detail || null }, name));

/** What else was written down, in a few words. @param {Row["conditions"]} conditions */
export function told(conditions) {
  return Object.entries(conditions)
    .filter(([name, value]) => !UNTOLD.test(name) && value !== 0 && value !== "")
    .map(([name, value]) => condition(name, value))
    .map(([name, value]) => `${name.replaceAll("_", " ")} ${value}`)
    .join(" \u00b7 ");
}

/**
 * @param {Row} row
 * @param {number} index
 * @param {{selected: boolean, active: boolean}} state
 */
export function drawnRow(row, index, { selected, active }) {
  const key = `${row.dataset}/${row.name}`;
  const address = `${ROOT}/experiments/${row.id}`;
  const cells = {
    select: make("input", { type: "checkbox", "aria-label": `Select ${key}`, checked: selected, tabindex: "-1" }),
    run: make("img", { src: `${ROOT}/api/v1/experiments/${row.id}/thumbnail.svg?content=${row.content}`, alt: "", width: 84, height: 56, loading: "lazy", decoding: "async" }),
    name: make("span", { class: "named" },
      make("a", { href: address, tabindex: "-1" }, row.name),
      make("small", {},
        row.real ? "" : make("span", { class: "unreal", title: "Simulated, not recorded" }, "simulated \u00b7 "),
        [row.dataset, told(row.conditions)].filter(Boolean).join(" \u00b7 "))),
    shape: row.shape || row.layout
      ? make("span", { class: "named" }, row.shape ?? "\u2013", make("small", {}, row.layout ?? ""))
      : "\u2013",
    contacts: dots(row.contacts),
    moved: mm(row.moved_m),
    turned: deg(row.turned_rad),
    duration: s(row.duration_s, 1),
    before: fixed(row.before_mm, 2),
    after: fixed(row.after_mm, 2),
    marks: make("span", { class: "tags" },
      row.notes ? make("span", { class: "tag", title: `${row.notes} notes` }, `\u270e ${row.notes}`) : null,
      ...tags(row.flags)),
  };
  const node = make("tr", {
    "data-index": index, "data-id": row.id, "aria-rowindex": index + 2, "aria-selected": String(selected),
    class: [active ? "active" : "", row.flags.some((flag) => flag.fault) ? "faulty" : ""].join(" ").trim() || null,
  });
  for (const column of COLUMNS) {
    const content = /** @type {Record<string, any>} */ (cells)[column.key];
    node.append(make("td", { class: content === "\u2013" ? `${column.key} unknown` : column.key, "data-label": column.unit ? `${column.label} [${column.unit}]` : column.label }, content));
  }
  return node;
}

/** A row that has not come yet. @param {number} index */
export const awaited = (index) =>
  make("tr", { "data-index": index, class: "awaited" }, make("td", { colspan: COLUMNS.length }));
