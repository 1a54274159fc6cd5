// @ts-check
// The animated top view: everything on the plate to scale, one motion or several, and what plays it.
//
//     const player = new Player(document.getElementById("player"));
//     player.show(await getJson("/api/v1/experiments/12/motion"));
//     player.addEventListener("time", () => charts.cursor(player.time));

import { make, svg } from "./dom.js";
import { Motion, lastBefore, placed } from "./motion.js";
import { Stage, colour, forceText, roundNumber } from "./stage.js";

/** @typedef {import("./motion.js").MotionDocument} MotionDocument */
/** @typedef {import("./motion.js").Thing} Thing */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
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

const ICONS = {
  play: "M8 5v14l11-7z",
  pause: "M7 5h4v14H7zM13 5h4v14h-4z",
  back: "M6 5h2v14H6zM19 5v14l-9-7z",
  next: "M16 5h2v14h-2zM5 5v14l9-7z",
  fit: "M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z",
};

/** @param {keyof typeof ICONS} name */
const icon = (name) => svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));

/**
 * @param {keyof typeof ICONS} name
 * @param {string} label
 */
const iconButton = (name, label) =>
  make("button", { type: "button", class: "icon", "aria-label": label, title: label }, icon(name));

/** Whether a key press belongs to a field or button and not to the player. */
export function isTyping(/** @type {KeyboardEvent} */ event) {
  const target = /** @type {HTMLElement} */ (event.target);
  if (event.ctrlKey || event.metaKey || event.altKey) return true;
  if (target instanceof HTMLInputElement) return !["range", "checkbox", "radio"].includes(target.type);
  return target.matches?.("select, textarea, [contenteditable]") ?? false;
}

/** Plays motions; fires "time" when the shown moment changes and "state" when it starts or stops. */
export class Player extends EventTarget {
  /**
   * @param {HTMLElement} host becomes the player
   * @param {{autoplay?: boolean, keys?: boolean}} [options] keys: whether space and the arrows work
   *   on the whole page
   */
  constructor(host, options = {}) {
    super();
    this.host = host;
    this.time = 0; // [s]
    this.playing = false;
    this.speed = 1;
    /** @type {Motion[]} */
    this.motions = [];
    /** @type {Thing[]} */
    this.things = [];
    this.object = "";
    /** @type {number[]} */
    this.reference = [0, 0];
    /** @type {Set<string>} ids of motions that are not drawn */
    this.hidden = new Set();
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.autoplay = (options.autoplay ?? false) && !this.calm;
    this.perNewton = 0; // [m/N]
    this.longest = 0; // [m]
    this.last = 0; // [ms] of the frame before
    /** @type {ReturnType<typeof stylesOf>} */
    this.styles = new Map();
    this.#build();
    host.addEventListener("keydown", (event) => this.#key(event));
    if (options.keys ?? true) {
      document.addEventListener("keydown", (event) => {
        if (event.target === document.body) this.#key(event);
      });
    }
    /** For scripts of a page, and tests. */
    /** @type {any} */ (host).player = this;
  }

  // --- what is shown ------------------------------------------------------------------------

  /**
   * @param {MotionDocument} content
   * @param {{keepView?: boolean, keepTime?: boolean}} [keep]
   */
  show(content, keep = {}) {
    this.things = content.things;
    this.object = content.object;
    this.reference = content.reference_m;
    this.canvas.setAttribute("aria-label", `Top view to scale: ${content.title}`);
    this.setMotions(content.motions.map((packed) => new Motion(packed)), keep);
    if (!keep.keepView) this.stage.fit(content.box_m);
    else this.stage.box = content.box_m;
    this.#scaleForces();
    this.seek(keep.keepTime ? this.time : this.start);
    if (this.autoplay && !keep.keepTime) this.play();
  }

  /**
   * Other motions of the same things.
   * @param {Motion[]} motions
   * @param {{keepTime?: boolean}} [keep]
   */
  setMotions(motions, keep = {}) {
    this.motions = motions;
    this.styles = stylesOf(this.host, motions);
    this.start = Math.min(...motions.map((motion) => motion.span[0]));
    this.end = Math.max(...motions.map((motion) => motion.span[1]));
    this.scrubber.min = String(this.start);
    this.scrubber.max = String(this.end);
    this.#scaleForces();
    this.#legend();
    if (keep.keepTime) this.seek(this.time);
    this.stage.request();
  }

  /** @param {number} time [s] */
  seek(time) {
    this.time = Math.max(this.start ?? 0, Math.min(this.end ?? 0, time));
    this.scrubber.value = String(this.time);
    this.scrubber.setAttribute("aria-valuetext", `${this.time.toFixed(2)} s`);
    this.readout.textContent = `${this.time.toFixed(2)} s`;
    this.total.textContent = `of ${(this.end ?? 0).toFixed(2)} s`;
    this.stage.request();
    this.dispatchEvent(new Event("time"));
  }

  play() {
    if (this.playing || this.motions.length === 0) return;
    if (this.time >= this.end - 1e-9) this.seek(this.start);
    this.playing = true;
    this.last = 0;
    requestAnimationFrame((now) => this.#frame(now));
    this.#state();
  }

  pause() {
    this.playing = false;
    this.#state();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /**
   * To another frame of the first motion.
   * @param {number} frames
   */
  step(frames) {
    this.pause();
    const instants = this.motions[0]?.time;
    if (!instants) return;
    const here = lastBefore(instants, this.time + 1e-9);
    const on = here >= 0 && Math.abs(instants[here] - this.time) < 1e-9;
    const wanted = here + frames + (frames < 0 && !on ? 1 : 0);
    this.seek(instants[Math.max(0, Math.min(instants.length - 1, wanted))]);
  }

  /** @param {number} now [ms] */
  #frame(now) {
    if (!this.playing) return;
    // A tab that slept goes on where it was.
    const passed = this.last ? Math.min(0.25, (now - this.last) / 1000) : 0;
    this.last = now;
    let time = this.time + this.speed * passed;
    if (time >= this.end) {
      if (this.loop.checked) time = this.start;
      else this.playing = false;
    }
    this.seek(time);
    this.stage.render();
    if (this.playing) requestAnimationFrame((next) => this.#frame(next));
    else this.#state();
  }

  #state() {
    const label = this.playing ? "Pause (space)" : "Play (space)";
    this.button.replaceChildren(icon(this.playing ? "pause" : "play"));
    this.button.setAttribute("aria-label", label);
    this.button.title = label;
    this.host.dataset.state = this.playing ? "playing" : "paused";
    this.dispatchEvent(new Event("state"));
  }

  // --- controls -----------------------------------------------------------------------------

  #build() {
    const { host } = this;
    host.classList.add("player");
    host.setAttribute("role", "group");
    host.setAttribute("aria-label", "Animation");
    this.canvas = make("canvas", { role: "img", tabindex: "0", "aria-label": "Top view to scale" });
    this.button = iconButton("play", "Play (space)");
    const back = iconButton("back", "One frame back (left arrow)");
    const next = iconButton("next", "One frame on (right arrow)");
    const fit = iconButton("fit", "Show everything (double click, or 0)");
    this.scrubber = make("input", { type: "range", min: "0", max: "1", step: "any", "aria-label": "Time" });
    this.readout = make("output", { class: "time" }, "0.00 s");
    this.total = make("span", { class: "total" });
    const speed = make("select", { "aria-label": "Speed" });
    for (const value of SPEEDS) speed.append(make("option", { value: String(value) }, `${value}\u00d7`));
    speed.value = "1";
    this.loop = make("input", { type: "checkbox" });
    this.forces = make("input", { type: "checkbox" });
    this.forces.checked = true;
    this.legend = make("ul", { class: "legend", "aria-label": "Motions" });
    host.replaceChildren(
      make("div", { class: "view" }, this.canvas),
      make(
        "div", { class: "controls" }, this.button, back, next, this.scrubber,
        make("span", { class: "clock-text" }, this.readout, " ", this.total),
      ),
      make(
        "div", { class: "controls" },
        make("label", {}, speed),
        make("label", {}, this.loop, "loop"),
        make("label", { title: "On the part, in the first simulation that is shown. A dashed arrow is cut off: that force is larger." }, this.forces, "forces"),
        fit,
        this.legend,
      ),
    );
    this.stage = new Stage(this.canvas, (context, stage) => this.#draw(context, stage));
    this.button.addEventListener("click", () => this.toggle());
    back.addEventListener("click", () => this.step(-1));
    next.addEventListener("click", () => this.step(1));
    fit.addEventListener("click", () => this.stage.fit());
    this.scrubber.addEventListener("input", () => this.seek(Number(this.scrubber.value)));
    speed.addEventListener("change", () => { this.speed = Number(speed.value); });
    this.forces.addEventListener("change", () => this.stage.request());
    this.#state();
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (isTyping(event)) return;
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.key === " " && target.matches("button, input[type=checkbox]")) return;
    const many = event.shiftKey ? 10 : 1;
    /** @type {Record<string, () => void>} */
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.step(-many),
      ArrowRight: () => this.step(many),
      Home: () => { this.pause(); this.seek(this.start); },
      End: () => { this.pause(); this.seek(this.end); },
      "+": () => this.stage.zoom(1.25),
      "-": () => this.stage.zoom(0.8),
      0: () => this.stage.fit(),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    action();
  }

  #legend() {
    const key = this.motions.map(({ id, label }) => `${id} ${label}`).join("\n");
    if (this.legend.dataset.key === key) return;
    this.legend.dataset.key = key;
    this.legend.replaceChildren(...this.motions.map((motion) => {
      const box = make("input", { type: "checkbox" });
      box.checked = !this.hidden.has(motion.id);
      box.addEventListener("change", () => {
        if (box.checked) this.hidden.delete(motion.id);
        else this.hidden.add(motion.id);
        this.stage.request();
      });
      return make("li", {}, make("label", {}, box, swatch(this.styles.get(motion.id)), motion.label));
    }));
  }

  // --- drawing ------------------------------------------------------------------------------

  #scaleForces() {
    const sizes = this.motions.flatMap((motion) => motion.forces).sort((a, b) => a - b);
    const [, y0, , y1] = this.stage.box;
    const usual = TYPICAL_ARROW * (y1 - y0);
    const typical = sizes[sizes.length >> 1] ?? 0;
    this.longest = LONGEST_ARROW * usual;
    this.perNewton = typical > 0 ? usual / typical : 0;
    this.forces.disabled = sizes.length === 0;
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {Stage} stage
   */
  #draw(context, stage) {
    if (this.motions.length === 0) return;
    const shown = this.motions.filter((motion) => !this.hidden.has(motion.id));
    const touched = new Set(shown.flatMap((motion) => motion.contactsAt(this.time))
      .flatMap(({ body, other }) => [body, other]));
    this.things.forEach((thing, k) => {
      if (thing.role === "fixel") this.#solid(stage, thing, thing.pose, touched.has(k));
    });
    for (const motion of shown) this.#trail(context, stage, motion);
    for (const motion of shown) this.#moving(context, stage, motion);
    // Those of one motion: more would lie on each other.
    const pushed = shown.find((motion) => motion.contacts);
    if (this.forces.checked && pushed) this.#contacts(context, stage, pushed);
    context.setLineDash([]);
    stage.scaleBar();
    if (this.forces.checked && this.perNewton > 0) this.#forceKey(context, stage);
    context.fillStyle = colour(this.canvas, "ink", "#222222");
    stage.text(`t = ${this.time.toFixed(2)} s`, stage.width - 14, 24, "right", "600");
  }

  /**
   * @param {Stage} stage
   * @param {Thing} thing
   * @param {ArrayLike<number>} pose
   * @param {boolean} touched
   */
  #solid(stage, thing, pose, touched) {
    const { context } = stage;
    const kind = thing.role === "pusher" ? ["pusher", "#e69f00"] : ["fixel", "#7f7f7f"];
    stage.outline(thing.shape, pose);
    context.setLineDash([]);
    context.fillStyle = touched && thing.role === "fixel"
      ? colour(this.canvas, "touched", "#009e73")
      : colour(this.canvas, kind[0], kind[1]);
    context.globalAlpha = thing.role === "pusher" ? 0.55 : 0.85;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour(this.canvas, "ink", "#222222");
    context.lineWidth = 1;
    context.stroke();
  }

  /**
   * Everything a motion moves.
   * @param {CanvasRenderingContext2D} context
   * @param {Stage} stage
   * @param {Motion} motion
   */
  #moving(context, stage, motion) {
    const style = this.styles.get(motion.id);
    const shown = this.motions.filter((one) => !this.hidden.has(one.id));
    const first = shown[0];
    for (const thing of this.things) {
      if (thing.role === "fixel") continue;
      const pose = motion.poseAt(thing.name, this.time) ?? (motion === first ? thing.pose : null);
      if (!pose) continue;
      if (thing.role === "pusher") {
        // One of them is enough; they differ by what nobody sees.
        const leader = shown.find((one) => one.pose.has(thing.name)) ?? first;
        if (motion === leader) this.#solid(stage, thing, pose, false);
        continue;
      }
      stage.outline(thing.shape, pose);
      context.setLineDash(style?.dash ?? []);
      context.strokeStyle = context.fillStyle = style?.colour ?? "#0072b2";
      context.globalAlpha = motion === first ? 0.13 : 0.06;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 2.5;
      context.stroke();
      const [x, y] = stage.toScreen(placed(pose, thing.name === this.object ? this.reference : [0, 0]));
      context.beginPath();
      context.arc(x, y, 3.5, 0, 2 * Math.PI);
      context.fill();
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
    if (!rows || !now) return;
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
    const red = colour(this.canvas, "force", "#d55e00");
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
      context.fillStyle = colour(this.canvas, "card", "#ffffff");
      context.fill();
      context.lineWidth = 2;
      context.stroke();
    }
  }

  /**
   * An arrow of a round force, beside the scale bar.
   * @param {CanvasRenderingContext2D} context
   * @param {Stage} stage
   */
  #forceKey(context, stage) {
    const newtons = roundNumber(Math.max(1e-9, 70 / (this.perNewton * stage.scale)));
    const length = newtons * this.perNewton * stage.scale;
    const [x, y] = [stage.width - 14 - length, stage.height - 16];
    context.strokeStyle = context.fillStyle = colour(this.canvas, "force", "#d55e00");
    context.lineWidth = 2.5;
    stage.arrow(x, y, length, 0);
    context.fillStyle = colour(this.canvas, "force-text", "#a84300");
    stage.text(forceText(newtons), x + length / 2, y - 8, "center");
  }
}

/**
 * A short line as a motion is drawn.
 * @param {{colour: string, dash: number[]} | undefined} style
 */
export const swatch = (style) => svg(
  "svg", { class: "line", viewBox: "0 0 28 8", "aria-hidden": "true" },
  svg("path", {
    d: "M1 4h26", stroke: style?.colour ?? "currentColor", "stroke-width": 3,
    "stroke-dasharray": (style?.dash ?? []).join(" "),
  }),
);
