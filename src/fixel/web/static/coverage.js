// @ts-check
// What has been run: a plane of configurations and a table of shapes and layouts; a press selects.

import { complain, get } from "./api.js";
import { make, svg } from "./dom.js";
import { about, and, has, quoted, without } from "./filter.js";
import { condition, several } from "./units.js";

const SIZE = 300; // [px] of the plane
const LEFT = 46;
const BOTTOM = 40;
const HALF_DIGIT = 1e-9; // bounds are widened by it, for they are written with few digits

/**
 * @typedef {{name: string, edges: number[], centres: number[]}} Axis
 * @typedef {{x: Axis, y: Axis, number: number[][], shapes: string[], layouts: string[], table: number[][], axes: string[], without: number}} Covered
 */

export class Coverage {
  /**
   * @param {HTMLElement} host
   * @param {(filter: string) => void} choose is told the filter that a press asks for
   * @param {() => void} close
   */
  constructor(host, choose, close) {
    this.close = close;
    this.host = host;
    this.choose = choose;
    this.filter = "";
    /** @type {{x?: string, y?: string}} */
    this.axes = {};
    this.asked = "";
  }

  /** @param {string} filter @param {boolean} [anew] */
  async show(filter, anew = false) {
    this.filter = filter;
    // What a press here selects does not empty the rest of the picture.
    const own = [this.covered?.x.name ?? "", this.covered?.y.name ?? "", "shape", "layout"];
    const rest = without(filter, own);
    const question = JSON.stringify([rest, this.axes]);
    try {
      if (anew || question !== this.asked) {
        this.asked = question;
        const covered = /** @type {Covered} */ (await get("/coverage", { filter: rest, ...this.axes }));
        if (question !== this.asked) return; // something else is wanted meanwhile
        this.covered = covered;
      }
      this.#draw();
    } catch (problem) {
      if (question === this.asked) this.asked = ""; // asked again when it is next wanted
      complain(problem);
    }
  }

  #draw() {
    const covered = this.covered;
    if (!covered) return;
    const total = covered.number.flat().reduce((a, b) => a + b, 0);
    this.host.replaceChildren(
      make("div", { class: "coverage-head" }, make("h2", {}, "Coverage"),
        make("button", { type: "button", class: "quiet", "aria-label": "Close the coverage", onclick: this.close }, "\u2715")),
      make("div", { class: "axes" },
        this.#axis("across", "x", covered), this.#axis("up", "y", covered)),
      this.#plane(covered),
      make("p", { class: "remark" }, `${several(total, "experiment")} at ${several(covered.number.flat().filter(Boolean).length, "cell")}`
        + (covered.without ? `; ${several(covered.without, "experiment")} without these values` : "")
        + ". Click a cell to list its experiments."),
      covered.shapes.length ? this.#table(covered) : "",
    );
  }

  /** @param {string} label @param {"x" | "y"} which @param {Covered} covered */
  #axis(label, which, covered) {
    const select = make("select", {
      "aria-label": `Axis ${label}`,
      onchange: () => {
        this.axes = { x: covered.x.name, y: covered.y.name, [which]: select.value };
        this.show(this.filter);
      },
    }, ...covered.axes.map((name) => make("option", { value: name, selected: name === covered[which].name }, titled(name))));
    return make("label", {}, `${label} `, select);
  }

  /** @param {Covered} covered */
  #plane(covered) {
    const { x, y, number } = covered;
    const most = Math.max(1, ...number.flat());
    const chosen = about(this.filter, x.name).length > 0 && about(this.filter, y.name).length > 0;
    const places = [];
    // Places may be of any width: each stands in a column and a row of its own.
    const width = (SIZE - LEFT - 6) / x.centres.length;
    const height = (SIZE - BOTTOM - 6) / y.centres.length;
    for (let i = 0; i < x.centres.length; i += 1) {
      for (let j = 0; j < y.centres.length; j += 1) {
        const n = number[i][j];
        if (!n) continue;
        const bounds = [...within(x, i), ...within(y, j)];
        const here = chosen && bounds.every((bound) => has(this.filter, bound));
        const words = `${several(n, "experiment")} at ${titled(x.name)} ${shown(x, i)}, ${titled(y.name)} ${shown(y, j)}`;
        const press = () => this.#toggle(here, [x.name, y.name], bounds);
        places.push(svg("rect", {
          x: LEFT + i * width + 0.5, y: 6 + (y.centres.length - 1 - j) * height + 0.5,
          width: Math.max(1, width - 1), height: Math.max(1, height - 1), rx: Math.min(3, width / 5),
          class: here ? "place here" : "place", "fill-opacity": (0.2 + 0.8 * Math.sqrt(n / most)).toFixed(2),
          role: "button", tabindex: x.centres.length * y.centres.length > 900 ? null : "0", "aria-label": words, "aria-pressed": String(here),
          onclick: press,
          onkeydown: (/** @type {KeyboardEvent} */ event) => {
            if (event.key === "Enter" || event.key === " ") {
              event.preventDefault();
              event.stopPropagation();
              press();
            }
          },
        }, svg("title", {}, words)));
      }
    }
    return svg("svg", { class: "plane", viewBox: `0 0 ${SIZE} ${SIZE}`, role: "group", "aria-label": `${titled(x.name)} against ${titled(y.name)}` },
      svg("rect", { class: "frame", x: LEFT, y: 6, width: SIZE - LEFT - 6, height: SIZE - BOTTOM - 6 }),
      ...places,
      ...ticks(x).map(([k, text]) => svg("text", { x: LEFT + (k + 0.5) * width, y: SIZE - BOTTOM + 16, "text-anchor": "middle" }, text)),
      ...ticks(y).map(([k, text]) => svg("text", { x: LEFT - 6, y: 6 + (y.centres.length - k - 0.5) * height + 4, "text-anchor": "end" }, text)),
      svg("text", { class: "axis", x: (LEFT + SIZE) / 2, y: SIZE - 4, "text-anchor": "middle" }, withUnit(x)),
      svg("text", { class: "axis", x: 10, y: (SIZE - BOTTOM) / 2, "text-anchor": "middle", transform: `rotate(-90 10 ${(SIZE - BOTTOM) / 2})` }, withUnit(y)));
  }

  /** @param {Covered} covered */
  #table({ shapes, layouts, table }) {
    const most = Math.max(1, ...table.flat());
    return make("table", { class: "matrix" },
      make("caption", {}, "Shapes and layouts"),
      make("thead", {}, make("tr", {}, make("td"), ...shapes.map((shape) => make("th", { scope: "col" }, shape)))),
      make("tbody", {}, ...layouts.map((layout, j) => make("tr", {}, make("th", { scope: "row" }, layout), ...shapes.map((shape, i) => {
        const bounds = [`shape=${quoted(shape)}`, `layout=${quoted(layout)}`];
        const here = bounds.every((bound) => has(this.filter, bound));
        const n = table[i][j];
        const button = make("button", {
          type: "button", "aria-pressed": String(here), disabled: !n, class: "cell", "aria-label": `${several(n, "experiment")}: ${shape}, ${layout}`,
          onclick: () => this.#toggle(here, ["shape", "layout"], bounds),
        }, n);
        button.style.setProperty("--share", String(Math.sqrt(n / most)));
        return make("td", {}, button);
      })))));
  }

  /** @param {boolean} here @param {string[]} subjects @param {string[]} bounds */
  #toggle(here, subjects, bounds) {
    const rest = without(this.filter, subjects);
    this.choose(here ? rest : and(rest, ...bounds));
  }
}

/** @param {Axis} axis @param {number} k */
const within = (axis, k) => [
  `${axis.name}>=${rounded(axis.edges[k] - HALF_DIGIT)}`, `${axis.name}<${rounded(axis.edges[k + 1] + HALF_DIGIT)}`,
];

/** @param {number} value */
const rounded = (value) => String(Number(value.toFixed(8)));

/** @param {string} name */
const titled = (name) => condition(name, 1)[0].replaceAll("_", " ");

/** @param {Axis} axis */
function withUnit(axis) {
  const unit = condition(axis.name, 1)[1].split(" ")[1];
  return unit ? `${titled(axis.name)} [${unit}]` : titled(axis.name);
}

/** @param {Axis} axis @param {number} k */
const shown = (axis, k) => condition(axis.name, Number(axis.centres[k].toPrecision(3)))[1];

/** At most six places, evenly. @param {Axis} axis @returns {[number, string][]} */
function ticks(axis) {
  const n = axis.centres.length;
  const every = Math.max(1, Math.ceil(n / 6));
  return axis.centres.map((_, k) => /** @type {[number, string]} */ ([k, shown(axis, k).split(" ")[0]])).filter(([k]) => k % every === 0);
}
