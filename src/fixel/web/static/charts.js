// @ts-check
// Small line charts under one another, on one axis of time, with a cursor that all share.

import { make, svg } from "./dom.js";
import { column, valueAt } from "./motion.js";
import { roundNumber } from "./stage.js";
import { fixed } from "./units.js";
import { stylesOf } from "./view.js";

/** @typedef {import("./motion.js").Motion} Motion */
/**
 * @typedef {object} Series
 * @property {string} label
 * @property {string} colour of the line
 * @property {string} text colour of words
 * @property {number[]} dash
 * @property {ArrayLike<number>} time [s]
 * @property {ArrayLike<number>} values
 */
/** @typedef {{title: string, unit: string, series: Series[], digits?: number}} LinePanel */
/** @typedef {{title: string, strips: Series[]}} StripPanel rows of on and off */
/** @typedef {LinePanel | StripPanel} Panel */
/** @typedef {{series: Series, digits: number, node: HTMLElement}} Value */

const LEFT = 58; // [px] of the plot in a chart
const RIGHT = 10;
const HEIGHT = 96;
const AXIS = 26; // [px] more in the last chart, for the axis of time
const ROW = 16; // [px] of a strip

/** Fires "seek" with `detail` the time that was asked for by pressing into a chart. */
export class Charts extends EventTarget {
  /** @param {HTMLElement} host */
  constructor(host) {
    super();
    this.host = host;
    host.classList.add("charts");
    /** @type {Panel[]} */
    this.panels = [];
    /** @type {Value[]} values at the cursor */
    this.values = [];
    this.from = 0;
    this.to = 1;
    this.time = 0;
    this.width = 0;
    this.pointer = make("div", { class: "cursor", "aria-hidden": "true" });
    new ResizeObserver(() => {
      if (host.clientWidth !== this.width) this.draw();
    }).observe(host);
    this.#listen();
  }

  /** @param {Panel[]} panels @param {[number, number]} span first and last instant [s] */
  show(panels, span) {
    this.panels = panels;
    [this.from, this.to] = span[1] > span[0] ? span : [span[0], span[0] + 1];
    this.draw();
  }

  /** @param {number} time [s] */
  cursor(time) {
    this.time = time;
    this.pointer.style.transform = `translateX(${this.#x(time).toFixed(1)}px)`;
    for (const { series: { time: instants, values }, digits, node } of this.values) {
      const known = values.length > 2 || Array.from(instants).includes(time);
      node.textContent = fixed(known && values.length ? valueAt(instants, values, time) : NaN, digits);
    }
  }

  draw() {
    this.width = this.host.clientWidth;
    if (!this.width) return;
    this.values = [];
    this.host.replaceChildren(...this.panels.map((panel, k) => this.#chart(panel, k === this.panels.length - 1)), this.pointer);
    this.cursor(this.time);
  }

  /** @param {Panel} panel @param {boolean} last */
  #chart(panel, last) {
    const bottom = "strips" in panel ? panel.strips.length * ROW + 4 : HEIGHT - 4;
    const height = bottom + (last ? AXIS : 4);
    const series = "series" in panel ? panel.series : [];
    const values = series.map((one) => {
      const node = make("output", { title: one.label });
      node.style.color = one.text;
      this.values.push({ series: one, digits: "digits" in panel ? panel.digits ?? 1 : 1, node });
      return node;
    });
    const unit = "unit" in panel ? ` [${panel.unit}]` : "";
    return make("div", { class: "chart" },
      make("div", { class: "head" }, make("span", {}, panel.title + unit), ...values),
      svg("svg", { class: "panel", width: this.width, height, role: "img", "aria-label": described(panel) },
        ...this.#grid(bottom, last),
        ...("strips" in panel ? this.#strips(panel) : this.#lines(panel, bottom))));
  }

  /** @param {number} bottom @param {boolean} last */
  #grid(bottom, last) {
    const step = roundNumber((this.to - this.from) / 4);
    const drawn = [];
    for (let t = Math.ceil(this.from / step - 1e-9) * step; t <= this.to + 1e-9; t += step) {
      const x = Math.round(this.#x(t)) + 0.5;
      drawn.push(svg("path", { class: "grid", d: `M${x} 0V${bottom}` }));
      if (last && x < this.width - 34) drawn.push(svg("text", { x, y: bottom + 16, "text-anchor": "middle" }, +t.toPrecision(6)));
    }
    if (last) drawn.push(svg("text", { x: this.width - 2, y: bottom + 16, "text-anchor": "end" }, "t [s]"));
    return drawn;
  }

  /** @param {LinePanel} panel @param {number} bottom */
  #lines(panel, bottom) {
    const [low, high] = limits(panel.series);
    /** @param {number} value */
    const y = (value) => bottom - 4 - ((value - low) / (high - low)) * (bottom - 10);
    const step = roundNumber((high - low) / 2.2);
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    const drawn = [];
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) {
      const place = Math.round(y(value)) + 0.5;
      drawn.push(svg("path", { class: "grid", d: `M${LEFT} ${place}H${this.width - RIGHT}` }),
        svg("text", { x: LEFT - 6, y: place + 4, "text-anchor": "end" }, fixed(value, digits)));
    }
    const inner = svg("svg", { x: LEFT, width: Math.max(0, this.width - LEFT - RIGHT), height: bottom });
    for (const { time, values, colour, dash } of panel.series) {
      // Two poses are no measured line.
      const dots = time.length <= 2;
      const points = Array.from(time, (t, k) => [this.#x(t) - LEFT, y(values[k])]).filter(([, down]) => Number.isFinite(down));
      const d = points.map(([x, down], k) => `${dots || k === 0 ? "M" : "L"}${x.toFixed(1)} ${down.toFixed(1)}${dots ? "h0" : ""}`).join("");
      inner.append(svg("path", { class: dots ? "dots" : "line", d, stroke: colour, "stroke-dasharray": dash.join(" ") || null }));
    }
    return [...drawn, inner];
  }

  /** @param {StripPanel} panel */
  #strips(panel) {
    return panel.strips.flatMap(({ label, time, values, colour }, row) => {
      const top = row * ROW + 4;
      let d = "";
      let since = -1;
      for (let k = 0; k <= time.length; k += 1) {
        const on = k < time.length && values[k] > 0.5;
        if (on && since < 0) since = k;
        if (!on && since >= 0) {
          const x = this.#x(time[since]);
          d += `M${x.toFixed(1)} ${top + 5}h${Math.max(1.5, this.#x(time[Math.min(k, time.length - 1)]) - x).toFixed(1)}`;
          since = -1;
        }
      }
      return [svg("text", { x: LEFT - 6, y: top + 10, "text-anchor": "end" }, label),
        svg("path", { class: "grid", d: `M${LEFT} ${top + 9.5}H${this.width - RIGHT}` }),
        svg("path", { class: "strip", d, stroke: colour })];
    });
  }

  /** @param {number} time */
  #x(time) {
    return LEFT + ((time - this.from) / (this.to - this.from)) * (this.width - LEFT - RIGHT);
  }

  #listen() {
    /** @param {PointerEvent} event */
    const seek = (event) => {
      const frame = this.host.getBoundingClientRect();
      const share = (event.clientX - frame.left - LEFT) / (frame.width - LEFT - RIGHT);
      const time = this.from + Math.max(0, Math.min(1, share)) * (this.to - this.from);
      this.dispatchEvent(new CustomEvent("seek", { detail: time }));
    };
    this.host.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !(event.target instanceof Element) || !event.target.closest("svg")) return;
      this.host.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.host.addEventListener("pointermove", (event) => {
      if (this.host.hasPointerCapture(event.pointerId)) seek(event);
    });
  }
}

/** Least and largest value of some series. @param {Series[]} series */
function ends(series) {
  const values = series.flatMap((one) => Array.from(one.values)).filter(Number.isFinite);
  return [values.reduce((a, b) => Math.min(a, b), Infinity), values.reduce((a, b) => Math.max(a, b), -Infinity)];
}

/** Ends of the axis of some series; what differs by rounding only is flat. @param {Series[]} series */
function limits(series) {
  const [low, high] = ends(series);
  if (!(low <= high)) return [0, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  const margin = high - low > 1e-9 * Math.max(1, size) ? 0.08 * (high - low) : Math.max(1e-3, 0.01 * size);
  return [low - margin, high + margin];
}

/** @param {Panel} panel */
function described(panel) {
  const series = "strips" in panel ? panel.strips : panel.series;
  const unit = "unit" in panel ? ` in ${panel.unit}` : "";
  const words = series.map((one) => {
    const [low, high] = ends([one]).map((value) => fixed(value, "digits" in panel ? panel.digits ?? 1 : 1));
    return "strips" in panel ? one.label : `${one.label} from ${low} to ${high}`;
  });
  return `${panel.title}${unit} against time in seconds: ${words.join("; ")}`;
}

/**
 * The usual charts of some motions of one object: x, y, angle, errors, tactile strips.
 * @param {HTMLElement} host
 * @param {Motion[]} motions
 * @param {string} object
 * @returns {Panel[]}
 */
export function usualPanels(host, motions, object) {
  const styles = stylesOf(host, motions);
  /** @param {Motion} motion */
  const style = (motion) => styles.get(motion.id) ?? { colour: "#0072b2", text: "#0063a0", dash: [] };
  const moved = motions.filter((motion) => motion.pose.has(object));
  /** @type {Panel[]} */
  const panels = /** @type {const} */ ([["x", "mm", 0, 1e3], ["y", "mm", 1, 1e3], ["angle", "deg", 2, 180 / Math.PI]])
    .map(([title, unit, axis, factor]) => ({
      title,
      unit,
      digits: 1,
      series: moved.map((motion) => ({
        label: motion.label, ...style(motion), time: motion.time, values: column(motion, object, axis, factor),
      })),
    }));
  const judged = motions.filter((motion) => motion.errors);
  if (judged.length) {
    panels.push(.../** @type {const} */ ([["position", "mm", 1e3], ["angle", "deg", 180 / Math.PI]]).map(([what, unit, factor]) => ({
      title: `${what} error`, unit, digits: 2, series: judged.map((motion) => ({
        label: motion.label, ...style(motion), time: motion.errors?.time ?? [],
        values: Float64Array.from(motion.errors?.[what] ?? [], (value) => factor * value),
      })),
    })));
  }
  const felt = motions.filter((motion) => motion.touch && motion.touch.names.length);
  const names = felt[0]?.touch?.names ?? [];
  const strips = names.flatMap((name, place) => felt.map((motion) => {
    const touch = /** @type {NonNullable<Motion["touch"]>} */ (motion.touch);
    const width = touch.names.length;
    return {
      label: motion === felt[0] ? name : "",
      ...style(motion),
      time: touch.time,
      values: Array.from(touch.time, (_, k) => touch.values[k * width + place]),
    };
  }));
  if (strips.length) panels.unshift({ title: "touch", strips });
  return panels;
}

/** Keep a player and charts at one time. @param {import("./player.js").Player} player @param {Charts} charts */
export function inStep(player, charts) {
  player.addEventListener("time", () => charts.cursor(player.time));
  charts.addEventListener("seek", (event) => {
    player.pause();
    player.seek(/** @type {CustomEvent<number>} */ (event).detail);
  });
}
