// @ts-check
// What the player shows: everything on the plate to scale at one time, one motion or several.

import { svg } from "./dom.js";
import { lastBefore, placed } from "./motion.js";
import { Stage, colour, forceText, roundNumber } from "./stage.js";

/** @typedef {import("./motion.js").Motion} Motion */
/** @typedef {import("./motion.js").Thing} Thing */

const TYPICAL_ARROW = 0.16; // of the height of the view as fitted, for half of all forces
const LONGEST_ARROW = 2.2; // of that: a part that jams is pushed a hundred times as hard as one that slides

/** What sets simulated motions apart: a colour and a dash each. */
export const STYLES = [
  { name: "sim-1", otherwise: "#a03d78", dash: [7, 4] },
  { name: "sim-2", otherwise: "#00785a", dash: [2, 3] },
  { name: "sim-3", otherwise: "#a84a00", dash: [10, 3, 2, 3] },
  { name: "sim-4", otherwise: "#6a5acd", dash: [12, 4] },
  { name: "sim-5", otherwise: "#5c5c00", dash: [4, 2] },
  { name: "sim-6", otherwise: "#8c2d19", dash: [1, 2] },
];
const MEASURED = { name: "body", otherwise: "#0063a0", dash: [] };

/**
 * Colour and dash of every motion, by id; simulated ones keep theirs by their place.
 * @param {Element} element
 * @param {{id: string, kind: string}[]} motions
 * @returns {Map<string, {colour: string, text: string, dash: number[]}>}
 */
export function stylesOf(element, motions) {
  let simulated = 0;
  return new Map(motions.map(({ id, kind }) => {
    const style = kind === "measured" ? MEASURED : STYLES[simulated++ % STYLES.length];
    const line = colour(element, style.name, style.otherwise);
    return [id, { colour: line, text: colour(element, `${style.name}-text`, line), dash: style.dash }];
  }));
}

/** A short line as a motion is drawn. @param {{colour: string, dash: number[]} | undefined} style */
export const swatch = (style) => svg(
  "svg", { class: "line", viewBox: "0 0 28 8", "aria-hidden": "true" },
  svg("path", {
    d: "M1 4h26", stroke: style?.colour ?? "currentColor", "stroke-width": 3,
    "stroke-dasharray": (style?.dash ?? []).join(" "),
  }),
);

/** Draws motions on a canvas. */
export class TopView {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.time = 0; // [s]
    /** @type {Motion[]} */
    this.motions = [];
    /** @type {Thing[]} */
    this.things = [];
    this.object = "";
    /** @type {number[]} */
    this.reference = [0, 0];
    /** @type {Set<string>} ids of motions that are not drawn */
    this.hidden = new Set();
    /** @type {ReturnType<typeof stylesOf>} */
    this.styles = new Map();
    this.withForces = true;
    this.perNewton = 0; // [m/N]
    this.longest = 0; // [m]
    this.stage = new Stage(canvas, (context, stage) => this.#draw(context, stage));
  }

  /** @param {Motion[]} motions */
  setMotions(motions) {
    this.motions = motions;
    this.styles = stylesOf(this.stage.canvas, motions);
    const sizes = this.motions.flatMap((motion) => motion.forces).sort((a, b) => a - b);
    const [, y0, , y1] = this.stage.box;
    const usual = TYPICAL_ARROW * (y1 - y0);
    const typical = sizes[sizes.length >> 1] ?? 0;
    this.longest = LONGEST_ARROW * usual;
    this.perNewton = typical > 0 ? usual / typical : 0;
    this.stage.request();
  }

  /** @param {CanvasRenderingContext2D} context @param {Stage} stage */
  #draw(context, stage) {
    if (this.motions.length === 0) return;
    const shown = this.motions.filter((motion) => !this.hidden.has(motion.id));
    const touched = new Set(shown.flatMap((motion) => motion.contactsAt(this.time))
      .flatMap(({ body, other }) => [body, other]));
    this.things.forEach((thing, k) => {
      if (thing.role === "fixel") this.#solid(stage, thing, thing.pose, touched.has(k));
    });
    for (const motion of shown) this.#trail(context, stage, motion);
    for (const motion of shown) this.#moving(stage, motion);
    // Those of one motion: more would lie on each other.
    const pushed = shown.find((motion) => motion.contacts);
    if (this.withForces && pushed) this.#contacts(context, stage, pushed);
    context.setLineDash([]);
    stage.scaleBar();
    if (this.withForces && this.perNewton > 0) this.#forceKey(context, stage);
    context.fillStyle = colour(this.stage.canvas, "ink", "#222222");
    stage.text(`t = ${this.time.toFixed(2)} s`, stage.width - 14, 24, "right", "600");
  }

  /** @param {Stage} stage @param {Thing} thing @param {ArrayLike<number>} pose @param {boolean} touched */
  #solid(stage, thing, pose, touched) {
    const { context } = stage;
    const kind = thing.role === "pusher" ? ["pusher", "#e69f00"] : ["fixel", "#7f7f7f"];
    stage.outline(thing.shape, pose);
    context.setLineDash([]);
    context.fillStyle = touched && thing.role === "fixel"
      ? colour(this.stage.canvas, "touched", "#009e73")
      : colour(this.stage.canvas, kind[0], kind[1]);
    context.globalAlpha = thing.role === "pusher" ? 0.55 : 0.85;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour(this.stage.canvas, "ink", "#222222");
    context.lineWidth = 1;
    context.stroke();
  }

  /** Everything a motion moves. @param {Stage} stage @param {Motion} motion */
  #moving(stage, motion) {
    const shown = this.motions.filter((one) => !this.hidden.has(one.id));
    const first = shown[0];
    for (const thing of this.things) {
      if (thing.role === "fixel") continue;
      const pose = motion.poseAt(thing.name, this.time) ?? (motion === first ? thing.pose : null);
      if (!pose) continue;
      if (motion.ends && thing.name === this.object) {
        this.#ends(stage, thing, motion);
        continue;
      }
      if (thing.role === "pusher") {
        // One of them is enough; they differ by what nobody sees.
        const leader = shown.find((one) => one.pose.has(thing.name)) ?? first;
        if (motion === leader) this.#solid(stage, thing, pose, false);
        continue;
      }
      this.#part(stage, thing, motion, pose, { fill: motion === first ? 0.13 : 0.06 });
    }
  }

  /**
   * Outline of a part, and its reference point.
   * @param {Stage} stage
   * @param {Thing} thing
   * @param {Motion} motion
   * @param {ArrayLike<number>} pose
   * @param {{fill: number, line?: number, dash?: number[]}} style opacities, and a dash other than that of the motion
   */
  #part(stage, thing, motion, pose, { fill, line = 1, dash }) {
    const { context } = stage;
    const style = this.styles.get(motion.id);
    stage.outline(thing.shape, pose);
    context.setLineDash(dash ?? style?.dash ?? []);
    context.strokeStyle = context.fillStyle = style?.colour ?? "#0072b2";
    context.globalAlpha = fill;
    context.fill();
    context.globalAlpha = line;
    context.lineWidth = 2.5;
    context.stroke();
    context.globalAlpha = 1;
    stage.dot(placed(pose, thing.name === this.object ? this.reference : [0, 0]), 3.5);
  }

  /**
   * Start and end of a motion of which nothing else was measured.
   * @param {Stage} stage
   * @param {Thing} thing
   * @param {Motion} motion
   */
  #ends(stage, thing, motion) {
    const rows = /** @type {import("./motion.js").Numbers} */ (motion.pose.get(thing.name));
    const last = motion.time.length - 1;
    for (let k = 0; k <= last; k += 1) {
      const pose = rows.subarray(3 * k, 3 * k + 3);
      this.#part(stage, thing, motion, pose, k === last ? { fill: 0.13, dash: [] } : { fill: 0.03, line: 0.6, dash: [5, 4] });
    }
  }

  /**
   * Where the reference point has been.
   * @param {CanvasRenderingContext2D} context
   * @param {Stage} stage
   * @param {Motion} motion
   */
  #trail(context, stage, motion) {
    const rows = motion.pose.get(this.object);
    const now = motion.poseAt(this.object, this.time);
    if (!rows || !now || motion.ends) return;
    const style = this.styles.get(motion.id);
    const end = lastBefore(motion.time, this.time);
    context.beginPath();
    for (let k = 0; k <= end; k += 1) {
      const [x, y] = stage.toScreen(placed(rows.subarray(3 * k, 3 * k + 3), this.reference));
      context.lineTo(x, y);
    }
    const [x, y] = stage.toScreen(placed(now, this.reference));
    context.lineTo(x, y);
    context.setLineDash(style?.dash ?? []);
    context.strokeStyle = style?.colour ?? "#56b4e9";
    context.globalAlpha = 0.75;
    context.lineWidth = 1.5;
    context.stroke();
    context.globalAlpha = 1;
  }

  /**
   * Contact points, and the force on what is pushed; a dashed arrow is cut off.
   * @param {CanvasRenderingContext2D} context
   * @param {Stage} stage
   * @param {Motion} motion
   */
  #contacts(context, stage, motion) {
    const red = colour(this.stage.canvas, "force", "#d55e00");
    for (const { point, force } of motion.contactsAt(this.time)) {
      const [x, y] = stage.toScreen(point);
      const size = Math.hypot(force[0], force[1]) * this.perNewton;
      const cut = size > this.longest ? this.longest / size : 1;
      const length = cut * this.perNewton * stage.scale;
      context.strokeStyle = context.fillStyle = red;
      context.lineWidth = 2.5;
      context.setLineDash(cut < 1 ? [5, 3] : []);
      stage.arrow(x, y, length * force[0], -length * force[1]);
      context.setLineDash([]);
      context.beginPath();
      context.arc(x, y, 4.5, 0, 2 * Math.PI);
      context.fillStyle = colour(this.stage.canvas, "card", "#ffffff");
      context.fill();
      context.lineWidth = 2;
      context.stroke();
    }
  }

  /** An arrow of a round force, beside the scale bar. @param {CanvasRenderingContext2D} context @param {Stage} stage */
  #forceKey(context, stage) {
    const newtons = roundNumber(Math.max(1e-9, 70 / (this.perNewton * stage.scale)));
    const length = newtons * this.perNewton * stage.scale;
    const [x, y] = [stage.width - 14 - length, stage.height - 16];
    context.strokeStyle = context.fillStyle = colour(this.stage.canvas, "force", "#d55e00");
    context.lineWidth = 2.5;
    stage.arrow(x, y, length, 0);
    context.fillStyle = colour(this.stage.canvas, "force-text", "#a84300");
    stage.text(forceText(newtons), x + length, y - 8, "right");
  }
}
