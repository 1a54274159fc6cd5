// @ts-check
// A canvas that shows part of the world to scale: metres to pixels, panning and zooming, high
// resolution screens, a scale bar. The player and the scene editor draw on it.

/** @typedef {import("./motion.js").Shape} Shape */

const LEAST_SCALE = 1; // [px/m]
const MOST_SCALE = 1e9;
const MARGIN = 0.06; // of the width, about what is fitted in
const BAR_WIDTH = 110; // [px] at most

/** The largest of 1, 2, 5 times a power of ten that is not above a positive value. @param {number} value */
export function roundNumber(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const steps = [5, 2, 1].filter((step) => step * power <= value * (1 + 1e-9));
  return (steps[0] ?? 1) * power;
}

/** A value with the prefix of its unit that suits it. @param {number} value @param {string} unit @param {number} digits */
function prefixed(value, unit, digits) {
  const [factor, prefix] = value >= 1 || value === 0 ? [1, ""] : value >= 1e-3 ? [1e3, "m"] : [1e6, "\u00b5"];
  return `${+(value * factor).toPrecision(digits)} ${prefix}${unit}`;
}

/** @param {number} metres */
export const lengthText = (metres) => prefixed(metres, "m", 6);

/** @param {number} newtons */
export const forceText = (newtons) => prefixed(newtons, "N", 3);

/**
 * A colour of the page's palette.
 * @param {Element} element
 * @param {string} name of a custom property, without dashes
 * @param {string} otherwise
 */
export function colour(element, name, otherwise) {
  return getComputedStyle(element).getPropertyValue(`--${name}`).trim() || otherwise;
}

export class Stage {
  /** @param {HTMLCanvasElement} canvas @param {(context: CanvasRenderingContext2D, stage: Stage) => void} draw */
  constructor(canvas, draw) {
    this.canvas = canvas;
    this.draw = draw;
    const context = canvas.getContext("2d", { alpha: false });
    if (!context) throw new Error("this browser has no canvas");
    this.context = context;
    this.width = 1; // [px] of the page
    this.height = 1;
    this.scale = 1000; // [px/m]
    this.centre = [0, 0]; // [m]
    /** @type {number[]} */
    this.box = [-0.1, -0.1, 0.1, 0.1];
    this.fitted = true; // until somebody pans or zooms
    /** @type {((event: PointerEvent, world: [number, number]) => boolean) | null} takes a press, or leaves it to panning */
    this.press = null;
    this.scheduled = 0;
    /** @type {Map<number, [number, number]>} */
    this.pointers = new Map();
    this.drawn = 0; // pictures so far
    this.#listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.request());
    this.#measure();
  }

  resize() {
    this.#measure();
    if (this.fitted) this.fit();
    this.render();
  }

  #measure() {
    const ratio = window.devicePixelRatio || 1;
    this.width = Math.max(1, this.canvas.clientWidth);
    this.height = Math.max(1, this.canvas.clientHeight);
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
  }

  /** Show all of a box. @param {number[]} [box] x and y of the lower left, x and y of the upper right [m] */
  fit(box) {
    if (box) this.box = box;
    const [x0, y0, x1, y1] = this.box;
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    const wanted = (1 - 2 * MARGIN);
    this.scale = Math.min(
      (wanted * this.width) / Math.max(x1 - x0, 1e-9),
      (wanted * this.height) / Math.max(y1 - y0, 1e-9),
    );
    this.fitted = true;
    this.request();
  }

  /** Draw before the next frame of the screen, once. */
  request() {
    if (this.scheduled) return;
    this.scheduled = requestAnimationFrame(() => this.render());
  }

  render() {
    cancelAnimationFrame(this.scheduled);
    this.scheduled = 0;
    const ratio = this.canvas.width / this.width;
    const context = this.context;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = colour(this.canvas, "card", "#ffffff");
    context.fillRect(0, 0, this.width, this.height);
    this.draw(context, this);
    this.drawn += 1;
  }

  /** @param {ArrayLike<number>} point [m] @returns {[number, number]} [px] */
  toScreen(point) {
    return [
      this.width / 2 + (point[0] - this.centre[0]) * this.scale,
      this.height / 2 - (point[1] - this.centre[1]) * this.scale,
    ];
  }

  /** @param {number} x [px] @param {number} y [px] @returns {[number, number]} [m] */
  toWorld(x, y) {
    return [
      this.centre[0] + (x - this.width / 2) / this.scale,
      this.centre[1] - (y - this.height / 2) / this.scale,
    ];
  }

  /** Where in the world an event happened. @param {MouseEvent} event */
  worldOf(event) {
    const frame = this.canvas.getBoundingClientRect();
    return this.toWorld(event.clientX - frame.left, event.clientY - frame.top);
  }

  /**
   * Zoom about a point that stays where it is.
   * @param {number} factor
   * @param {number} [x] [px]
   * @param {number} [y] [px]
   */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [wx, wy] = this.toWorld(x, y);
    this.scale = Math.max(LEAST_SCALE, Math.min(MOST_SCALE, this.scale * factor));
    this.centre = [
      wx - (x - this.width / 2) / this.scale,
      wy + (y - this.height / 2) / this.scale,
    ];
    this.fitted = false;
    this.request();
  }

  /** @param {number} dx [px] @param {number} dy [px] */
  pan(dx, dy) {
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.fitted = false;
    this.request();
  }

  /** Begin a path along an outline. @param {Shape} shape @param {ArrayLike<number>} pose */
  outline(shape, pose) {
    const { context, scale } = this;
    const [x, y] = this.toScreen(pose);
    context.beginPath();
    if (shape.disk_m !== null) {
      context.arc(x, y, shape.disk_m * scale, 0, 2 * Math.PI);
      return;
    }
    const c = Math.cos(pose[2]) * scale;
    const s = Math.sin(pose[2]) * scale;
    for (const [u, v] of shape.polygon_m ?? []) {
      context.lineTo(x + c * u - s * v, y - s * u - c * v);
    }
    context.closePath();
  }

  /**
   * An arrow from a point on the screen.
   * @param {number} x [px]
   * @param {number} y [px]
   * @param {number} dx [px]
   * @param {number} dy [px]
   */
  arrow(x, y, dx, dy) {
    const length = Math.hypot(dx, dy);
    if (length < 1) return;
    const { context } = this;
    const head = Math.min(9, 0.6 * length);
    const [u, v] = [dx / length, dy / length];
    const [ex, ey] = [x + dx, y + dy];
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(ex - 0.8 * head * u, ey - 0.8 * head * v);
    context.stroke();
    context.beginPath();
    context.moveTo(ex, ey);
    context.lineTo(ex - head * u - 0.45 * head * v, ey - head * v + 0.45 * head * u);
    context.lineTo(ex - head * u + 0.45 * head * v, ey - head * v - 0.45 * head * u);
    context.closePath();
    context.fill();
  }

  /** A filled circle about a point of the world. @param {ArrayLike<number>} point [m] @param {number} radius [px] */
  dot(point, radius) {
    const [x, y] = this.toScreen(point);
    this.context.beginPath();
    this.context.arc(x, y, radius, 0, 2 * Math.PI);
    this.context.fill();
  }

  /** A bar of a round length in the lower left corner, with its unit. */
  scaleBar() {
    const { context } = this;
    const metres = roundNumber(BAR_WIDTH / this.scale);
    const [x, y, width] = [14, this.height - 16, metres * this.scale];
    context.strokeStyle = context.fillStyle = colour(this.canvas, "ink", "#222222");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x, y - 4);
    context.lineTo(x, y);
    context.lineTo(x + width, y);
    context.lineTo(x + width, y - 4);
    context.stroke();
    this.text(lengthText(metres), x + width / 2, y - 7, "center");
  }

  /**
   * @param {string} words
   * @param {number} x [px]
   * @param {number} y [px] of the line they stand on
   * @param {CanvasTextAlign} [align]
   * @param {string} [weight]
   */
  text(words, x, y, align = "left", weight = "500") {
    const { context } = this;
    context.font = `${weight} 13px ${getComputedStyle(this.canvas).fontFamily}`;
    context.textAlign = align;
    context.textBaseline = "alphabetic";
    context.fillText(words, x, y);
  }

  #listen() {
    const { canvas, pointers } = this;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const frame = canvas.getBoundingClientRect();
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
      this.zoom(
        Math.exp(-0.0015 * lines * event.deltaY),
        event.clientX - frame.left,
        event.clientY - frame.top,
      );
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (pointers.size === 0 && this.press?.(event, this.worldOf(event))) return;
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      if (pointers.size === 2) this.#pinch(event, before);
      else this.pan(event.clientX - before[0], event.clientY - before[1]);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("lostpointercapture", (event) => pointers.delete(event.pointerId));
  }

  /** @param {PointerEvent} event @param {[number, number]} before */
  #pinch(event, before) {
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (!other) return;
    const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
    const is = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
    const frame = this.canvas.getBoundingClientRect();
    this.pan((event.clientX - before[0]) / 2, (event.clientY - before[1]) / 2);
    if (was > 0) {
      this.zoom(
        is / was,
        (event.clientX + other[0]) / 2 - frame.left,
        (event.clientY + other[1]) / 2 - frame.top,
      );
    }
  }
}
