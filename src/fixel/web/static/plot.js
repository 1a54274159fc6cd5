// @ts-check
// A small chart as SVG: points, lines and steps over a plain or logarithmic plane, read by pointing.

import { make, svg } from "./dom.js";
import { roundNumber } from "./stage.js";

/**
 * @typedef {object} Scale
 * @property {string} label
 * @property {string} [unit]
 * @property {boolean} [log]
 * @property {[number, number]} [range]
 * @property {boolean} [whole] whether only whole numbers are marked
 */
/**
 * @typedef {object} Shown
 * @property {"points" | "line" | "step" | "crosses"} kind
 * @property {ArrayLike<number>} xs
 * @property {ArrayLike<number>} ys what is not finite is left out
 * @property {string} name a class, for the colour
 * @property {string} [label] for the key
 */
/** @typedef {{x?: number, y?: number, name: string, label?: string}} Mark a line across */
/** @typedef {{from: number, to: number, name: string}} Band of x */
/**
 * @typedef {object} Plotted
 * @property {string} title for who does not see it
 * @property {Scale} x
 * @property {Scale} y
 * @property {Shown[]} series
 * @property {Mark[]} [marks]
 * @property {Band[]} [bands]
 * @property {number} [height] [px]
 * @property {(k: number) => string} [tell] of the nearest place of the first series
 */

const LEFT = 54; // [px] around the plane
const RIGHT = 12;
const TOP = 10;
const BOTTOM = 38;

/** A chart that fits its host, and is drawn again when shown again. */
export class Plot {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.host = host;
    host.classList.add("plot");
    /** @type {Plotted | null} */
    this.content = null;
    this.readout = make("output", { class: "readout", "aria-live": "off" });
    this.key = make("ul", { class: "plot-key" });
    this.frame = make("div", { class: "plot-frame" });
    host.replaceChildren(make("div", { class: "plot-head" }, this.key, this.readout), this.frame);
    this.width = 0;
    this.clip = `clip-${Math.random().toString(36).slice(2)}`;
    new ResizeObserver(() => {
      if (host.clientWidth !== this.width) this.#draw();
    }).observe(host);
    this.frame.addEventListener("pointermove", (event) => this.#point(event));
    this.frame.addEventListener("pointerleave", () => { this.readout.textContent = ""; });
  }

  /** @param {Plotted} content */
  show(content) {
    this.content = content;
    this.#draw();
  }

  #draw() {
    const content = this.content;
    const width = this.host.clientWidth;
    this.width = width;
    if (!content || width < 80) return;
    const height = content.height ?? 240;
    const [low, high] = content.x.range ?? spread(content.series.map((one) => one.xs), content.x.log);
    const marked = (content.marks ?? []).flatMap((mark) => (mark.y === undefined ? [] : [mark.y]));
    const [bottom, top] = content.y.range
      ?? spread([...content.series.map((one) => one.ys), marked], content.y.log);
    this.across = placed(low, high, LEFT, width - RIGHT, content.x.log);
    this.up = placed(bottom, top, height - BOTTOM, TOP, content.y.log);
    const { across, up } = this;
    const inside = svg("g", { "clip-path": `url(#${this.clip})` });
    for (const band of content.bands ?? []) {
      const [from, to] = [across(band.from), across(band.to)];
      inside.append(svg("rect", { class: band.name, x: from, y: TOP, width: Math.max(1, to - from), height: height - BOTTOM - TOP }));
    }
    for (const mark of content.marks ?? []) {
      const at = mark.x === undefined ? up(mark.y ?? 0) : across(mark.x);
      inside.append(mark.x === undefined
        ? svg("line", { class: mark.name, x1: LEFT, x2: width - RIGHT, y1: at, y2: at })
        : svg("line", { class: mark.name, y1: TOP, y2: height - BOTTOM, x1: at, x2: at }));
    }
    for (const one of content.series) inside.append(drawn(one, across, up));
    this.frame.replaceChildren(svg(
      "svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": content.title },
      svg("clipPath", { id: this.clip }, svg("rect", { x: LEFT - 5, y: 0, width: width - LEFT - RIGHT + 10, height: height - BOTTOM + 5 })),
      ...axes(content, [low, high], [bottom, top], across, up, width, height),
      inside,
    ));
    const named = [...content.series, ...(content.marks ?? [])].filter((one) => one.label);
    this.key.replaceChildren(...named.map((one) => make("li", {}, sample(one), one.label)));
  }

  /** @param {PointerEvent} event */
  #point(event) {
    const content = this.content;
    const first = content?.series.find((one) => one.xs.length);
    if (!content || !first || !this.across || !this.up) return;
    const box = this.frame.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    let best = -1;
    let least = Infinity;
    for (let k = 0; k < first.xs.length; k += 1) {
      const away = Math.abs(this.across(first.xs[k]) - x) + 0.02 * Math.abs(this.up(first.ys[k]) - y || 0);
      if (away < least) [best, least] = [k, away];
    }
    if (best < 0) return;
    const unit = content.y.unit ? ` ${content.y.unit}` : "";
    this.readout.textContent = content.tell?.(best)
      ?? `${content.x.label} ${digits(first.xs[best])}: ${digits(first.ys[best])}${unit}`;
  }
}

/** At most four digits, with a true minus sign. @param {number} value */
const digits = (value) => (Number.isFinite(value) ? String(+value.toPrecision(4)).replace("-", "\u2212") : "failed");

/**
 * @param {ArrayLike<number>[]} all
 * @param {boolean} [log]
 * @returns {[number, number]}
 */
function spread(all, log) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of all) {
    for (let k = 0; k < values.length; k += 1) {
      const value = values[k];
      if (!Number.isFinite(value) || (log && value <= 0)) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (!(low <= high)) return log ? [1, 10] : [0, 1];
  if (log) return [low / 1.15, high * 1.15];
  const margin = 0.05 * (high - low) || Math.max(0.5, Math.abs(0.1 * high));
  return [low - margin, high + margin];
}

/**
 * From values to pixels.
 * @param {number} low
 * @param {number} high
 * @param {number} from
 * @param {number} to
 * @param {boolean} [log]
 */
function placed(low, high, from, to, log) {
  const [a, b] = log ? [Math.log(low), Math.log(high)] : [low, high];
  /** @param {number} value */
  return (value) => from + (((log ? Math.log(Math.max(value, 1e-300)) : value) - a) / (b - a || 1)) * (to - from);
}

/**
 * @param {Shown} one
 * @param {(value: number) => number} across
 * @param {(value: number) => number} up
 */
function drawn(one, across, up) {
  const parts = [];
  let pen = false;
  /** Places that have a point already: of a hundred thousand, few can be told apart. */
  const taken = new Set();
  let last = "";
  for (let k = 0; k < one.xs.length; k += 1) {
    if (!Number.isFinite(one.ys[k]) || !Number.isFinite(one.xs[k])) {
      pen = false;
      continue;
    }
    const [x, y] = [across(one.xs[k]).toFixed(1), up(one.ys[k]).toFixed(1)];
    const place = `${Math.round(+x)} ${Math.round(+y)}`;
    if (one.kind === "points") {
      if (!taken.has(place)) parts.push(`M${x} ${y}h0`);
      taken.add(place);
    }
    else if (one.kind === "crosses") parts.push(`M${x} ${y}m-3.5-3.5l7 7m0-7l-7 7`);
    else if (!pen) parts.push(`M${x} ${y}`);
    else if (one.kind === "step" && place === last && k < one.xs.length - 1) continue;
    else parts.push(one.kind === "step" ? `H${x}V${y}` : `L${x} ${y}`);
    pen = true;
    last = place;
  }
  return svg("path", { class: `${one.kind} ${one.name}`, d: parts.join("") });
}

/** @param {Shown | Mark} one */
function sample(one) {
  const kind = "kind" in one ? one.kind : "mark";
  const d = { points: "M11 6h0", crosses: "M7.5 2.5l7 7m0-7l-7 7" }[/** @type {"points" | "crosses"} */ (kind)] ?? "M1 6H21";
  return svg("svg", { width: 22, height: 12, "aria-hidden": "true" }, svg("path", { class: `${kind} ${one.name}`, d }));
}

/**
 * @param {Plotted} content
 * @param {[number, number]} x
 * @param {[number, number]} y
 * @param {(value: number) => number} across
 * @param {(value: number) => number} up
 * @param {number} width
 * @param {number} height
 */
function axes(content, x, y, across, up, width, height) {
  const nodes = [];
  for (const value of ticks(y, content.y.log, (height - BOTTOM) / 46)) {
    const at = up(value);
    nodes.push(
      svg("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: at, y2: at }),
      svg("text", { x: LEFT - 7, y: at + 4, "text-anchor": "end" }, digits(value)),
    );
  }
  const wide = ticks(x, content.x.log, (width - LEFT) / 90);
  for (const value of content.x.whole ? wide.filter((v) => Number.isInteger(v)) : wide) {
    nodes.push(svg("text", { x: across(value), y: height - BOTTOM + 16, "text-anchor": "middle" }, digits(value)));
    nodes.push(svg("line", { class: "grid", x1: across(value), x2: across(value), y1: height - BOTTOM, y2: height - BOTTOM + 4 }));
  }
  /** @param {Scale} scale */
  const named = (scale) => (scale.unit ? `${scale.label} [${scale.unit}]` : scale.label);
  nodes.push(
    svg("line", { class: "axis", x1: LEFT, x2: width - RIGHT, y1: height - BOTTOM, y2: height - BOTTOM }),
    svg("text", { class: "name", x: (LEFT + width - RIGHT) / 2, y: height - 4, "text-anchor": "middle" }, named(content.x)),
    svg("text", { class: "name", x: 0, y: 0, "text-anchor": "middle", transform: `translate(12 ${(TOP + height - BOTTOM) / 2}) rotate(-90)` }, named(content.y)),
  );
  return nodes;
}

/**
 * Round values between two.
 * @param {[number, number]} range
 * @param {boolean | undefined} log
 * @param {number} about how many
 */
function ticks([low, high], log, about) {
  if (log && high / low > 3.5) {
    const every = [];
    for (let p = Math.floor(Math.log10(low)); p <= Math.log10(high); p += 1) {
      for (const k of high / low > 300 ? [1] : high / low > 30 ? [1, 3] : high / low > 12 ? [1, 2, 5] : [1, 2, 3, 5, 7]) {
        const value = +(k * 10 ** p).toPrecision(3);
        if (value >= low && value <= high) every.push(value);
      }
    }
    if (every.length > 1) return every;
  }
  const step = roundNumber((high - low) / Math.max(2, about));
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) found.push(+value.toPrecision(8));
  return found;
}
