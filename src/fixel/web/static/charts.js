// @ts-check
// Small line charts under one another, on one axis of time, with a cursor that all share.

import { make } from "./dom.js";
import { column, valueAt } from "./motion.js";
import { colour, roundNumber } from "./stage.js";
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
    /** @type {{canvas: HTMLCanvasElement, values: HTMLElement[], panel: Panel}[]} */
    this.rows = [];
    this.from = 0;
    this.to = 1;
    this.time = 0;
    this.pointer = make("div", { class: "cursor", "aria-hidden": "true" });
    new ResizeObserver(() => this.draw()).observe(host);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    this.#listen();
  }

  /**
   * @param {Panel[]} panels
   * @param {[number, number]} span first and last instant [s]
   */
  show(panels, span) {
    const alike = this.#alike(panels);
    this.panels = panels;
    [this.from, this.to] = span[1] > span[0] ? span : [span[0], span[0] + 1];
    if (alike) {
      this.rows.forEach((row, k) => { row.panel = panels[k]; });
      this.draw();
      return;
    }
    this.rows = panels.map((panel, k) => this.#row(panel, k === panels.length - 1));
    this.host.replaceChildren(
      ...this.rows.map(({ canvas }) => /** @type {HTMLElement} */ (canvas.parentElement)),
      this.pointer,
    );
    this.draw();
    this.cursor(this.time);
  }

  /**
   * Whether these can be drawn where others were.
   * @param {Panel[]} panels
   */
  #alike(panels) {
    /** @param {Panel} panel */
    const key = (panel) => [panel.title, ...("strips" in panel ? panel.strips : panel.series)
      .map((one) => `${one.label} ${one.colour}`)].join();
    return panels.length === this.rows.length
      && panels.every((panel, k) => key(panel) === key(this.rows[k].panel));
  }

  /** @param {number} time [s] */
  cursor(time) {
    this.time = time;
    const x = this.#x(time, this.host.clientWidth);
    this.pointer.style.transform = `translateX(${x.toFixed(1)}px)`;
    for (const { values, panel } of this.rows) {
      const series = "series" in panel ? panel.series : [];
      series.forEach((one, k) => {
        const known = one.values.length > 2 || Array.from(one.time).includes(time);
        const value = known && one.values.length ? valueAt(one.time, one.values, time) : NaN;
        const digits = "digits" in panel ? panel.digits ?? 1 : 1;
        values[k].textContent = Number.isFinite(value) ? value.toFixed(digits).replace("-", "\u2212") : "\u2013";
      });
    }
  }

  draw() {
    this.rows.forEach(({ canvas, panel }, k) => {
      const last = k === this.rows.length - 1;
      const width = canvas.clientWidth;
      const height = canvas.clientHeight;
      if (!width || !height) return;
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      const context = canvas.getContext("2d");
      if (!context) return;
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.font = `12px ${getComputedStyle(canvas).fontFamily}`;
      const bottom = last ? height - AXIS : height - 4;
      this.#grid(context, width, bottom, last);
      if ("strips" in panel) this.#strips(context, panel, width);
      else this.#lines(context, panel, width, bottom);
    });
    this.cursor(this.time);
  }

  /**
   * @param {Panel} panel
   * @param {boolean} last
   */
  #row(panel, last) {
    const canvas = make("canvas", { role: "img", "aria-label": described(panel) });
    const lines = "strips" in panel ? panel.strips.length * ROW + 8 : HEIGHT;
    canvas.style.height = `${lines + (last ? AXIS : 0)}px`;
    const series = "series" in panel ? panel.series : [];
    const values = series.map((one) => {
      const node = make("output", { title: one.label });
      node.style.color = one.text;
      return node;
    });
    const unit = "unit" in panel ? ` [${panel.unit}]` : "";
    const head = make("div", { class: "head" }, make("span", {}, panel.title + unit), ...values);
    make("div", { class: "chart" }, head, canvas);
    return { canvas, values, panel };
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {number} width
   * @param {number} bottom
   * @param {boolean} last
   */
  #grid(context, width, bottom, last) {
    const step = roundNumber((this.to - this.from) / 4);
    context.strokeStyle = colour(this.host, "line", "#d7dce1");
    context.fillStyle = colour(this.host, "soft", "#59636d");
    context.lineWidth = 1;
    context.textAlign = "center";
    for (let t = Math.ceil(this.from / step - 1e-9) * step; t <= this.to + 1e-9; t += step) {
      const x = Math.round(this.#x(t, width)) + 0.5;
      context.beginPath();
      context.moveTo(x, 0);
      context.lineTo(x, bottom);
      context.stroke();
      if (last && x < width - 34) context.fillText(`${+t.toPrecision(6)}`, x, bottom + 16);
    }
    if (last) {
      context.textAlign = "right";
      context.fillText("t [s]", width - 2, bottom + 16);
    }
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {LinePanel} panel
   * @param {number} width
   * @param {number} bottom
   */
  #lines(context, panel, width, bottom) {
    const [low, high] = limits(panel.series);
    /** @param {number} value */
    const y = (value) => bottom - 4 - ((value - low) / (high - low)) * (bottom - 10);
    const step = roundNumber((high - low) / 2.2);
    context.textAlign = "right";
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) {
      const place = Math.round(y(value)) + 0.5;
      context.strokeStyle = colour(this.host, "line", "#d7dce1");
      context.beginPath();
      context.moveTo(LEFT, place);
      context.lineTo(width - RIGHT, place);
      context.stroke();
      context.fillStyle = colour(this.host, "soft", "#59636d");
      context.fillText(`${+value.toPrecision(4)}`.replace("-", "\u2212"), LEFT - 6, place + 4);
    }
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, width - LEFT - RIGHT, bottom);
    context.clip();
    for (const one of panel.series) {
      if (one.time.length <= 2) {
        // Two poses are no measured line.
        context.fillStyle = one.colour;
        for (let k = 0; k < one.time.length; k += 1) {
          context.beginPath();
          context.arc(this.#x(one.time[k], width), y(one.values[k]), 4, 0, 2 * Math.PI);
          context.fill();
        }
        continue;
      }
      context.beginPath();
      for (let k = 0; k < one.time.length; k += 1) {
        context.lineTo(this.#x(one.time[k], width), y(one.values[k]));
      }
      context.setLineDash(one.dash);
      context.strokeStyle = one.colour;
      context.lineWidth = 1.8;
      context.stroke();
    }
    context.restore();
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {StripPanel} panel
   * @param {number} width
   */
  #strips(context, panel, width) {
    panel.strips.forEach((one, row) => {
      const top = row * ROW + 4;
      context.textAlign = "right";
      context.fillStyle = colour(this.host, "soft", "#59636d");
      context.fillText(one.label, LEFT - 6, top + 10);
      context.fillStyle = colour(this.host, "line", "#d7dce1");
      context.fillRect(LEFT, top + 9, width - LEFT - RIGHT, 1);
      context.fillStyle = one.colour;
      let since = -1;
      for (let k = 0; k <= one.time.length; k += 1) {
        const on = k < one.time.length && one.values[k] > 0.5;
        if (on && since < 0) since = k;
        if (!on && since >= 0) {
          const x = this.#x(one.time[since], width);
          const end = this.#x(one.time[Math.min(k, one.time.length - 1)], width);
          context.fillRect(x, top, Math.max(1.5, end - x), 10);
          since = -1;
        }
      }
    });
  }

  /**
   * @param {number} time
   * @param {number} width
   */
  #x(time, width) {
    return LEFT + ((time - this.from) / (this.to - this.from)) * (width - LEFT - RIGHT);
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
      if (event.button !== 0 || !(event.target instanceof HTMLCanvasElement)) return;
      this.host.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.host.addEventListener("pointermove", (event) => {
      if (this.host.hasPointerCapture(event.pointerId)) seek(event);
    });
  }
}

/** @param {Series[]} series */
function limits(series) {
  let low = Infinity;
  let high = -Infinity;
  for (const { values } of series) {
    for (let k = 0; k < values.length; k += 1) {
      if (Number.isFinite(values[k])) {
        low = Math.min(low, values[k]);
        high = Math.max(high, values[k]);
      }
    }
  }
  if (!(low <= high)) return [0, 1];
  const margin = 0.08 * (high - low) || Math.max(1e-3, 0.01 * Math.abs(high));
  return [low - margin, high + margin];
}

/** @param {Panel} panel */
function described(panel) {
  const series = "strips" in panel ? panel.strips : panel.series;
  const unit = "unit" in panel ? ` in ${panel.unit}` : "";
  const ends = series.map((one) => {
    const [low, high] = limits([one]);
    return "strips" in panel ? one.label : `${one.label} from ${low.toPrecision(3)} to ${high.toPrecision(3)}`;
  });
  return `${panel.title}${unit} against time in seconds: ${ends.join("; ")}`;
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
    panels.push({
      title: "position error", unit: "mm", digits: 2, series: judged.map((motion) => ({
        label: motion.label, ...style(motion), time: motion.errors?.time ?? [],
        values: Float64Array.from(motion.errors?.position ?? [], (value) => 1e3 * value),
      })),
    }, {
      title: "angle error", unit: "deg", digits: 2, series: judged.map((motion) => ({
        label: motion.label, ...style(motion), time: motion.errors?.time ?? [],
        values: Float64Array.from(motion.errors?.angle ?? [], (value) => (value * 180) / Math.PI),
      })),
    });
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

/**
 * Keep a player and charts at one time.
 * @param {import("./player.js").Player} player
 * @param {Charts} charts
 */
export function inStep(player, charts) {
  player.addEventListener("time", () => charts.cursor(player.time));
  charts.addEventListener("seek", (event) => {
    player.pause();
    player.seek(/** @type {CustomEvent<number>} */ (event).detail);
  });
}

