// @ts-check
// A scene that can be taken hold of: drag a thing to move it, its handle to turn it, the end of a
// drive to send the pusher elsewhere. Keeps what was before, for undo.

import { placed } from "./motion.js";
import { History, KINDS, drawable, endOf, feetOf, inside, place, poseOf, reachOf, tidy } from "./scene.js";
import { Stage, colour, roundNumber } from "./stage.js";

/** @typedef {import("./motion.js").Motion} Motion */
/** @typedef {import("./scene.js").Kind} Kind */
/** @typedef {import("./scene.js").Choice} Choice */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {{deed: "move" | "turn" | "drive", grip: [number, number], began: string}} Hold */

const REACH = 12; // [px] about a handle
const HANDLE = 26; // [px] from the outline to the handle that turns
const SHORTEST = 40; // [px] of the arrow of a drive without a travel
/** Fires "change" when the scene is another, "choose" when the chosen thing is, "hold" while something is dragged. */
export class Editor extends EventTarget {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    /** @type {Scene} */
    this.scene = { bodies: [] };
    /** @type {Choice | null} */
    this.choice = null;
    /** @type {Set<string>} names of what cannot be as it is */
    this.wrong = new Set();
    /** @type {{motion: Motion, object: string, reference: number[]} | null} */
    this.preview = null;
    this.history = new History("{}");
    /** @type {Hold | null} */
    this.hold = null;
    this.stage = new Stage(canvas, (context) => this.#draw(context));
    this.stage.press = (event, world) => this.#press(event, world);
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("lostpointercapture", () => this.#release());
    canvas.addEventListener("dblclick", () => this.stage.fit(this.box()));
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  // --- the scene ------------------------------------------------------------------------------

  /** Another scene, with nothing to take back. @param {Scene} scene */
  open(scene) {
    this.history = new History(JSON.stringify(scene));
    this.#restore(JSON.stringify(scene));
    this.choice = { kind: "bodies", index: 0 };
    this.stage.fit(this.box());
    this.dispatchEvent(new Event("choose"));
  }

  /**
   * Something was changed in `scene`.
   * @param {string} [key] of what, so that one stroke after the other is one change
   */
  changed(key = "") {
    this.history.push(JSON.stringify(this.scene), key);
    this.stage.request();
    this.dispatchEvent(new Event("change"));
  }

  undo() {
    this.#restore(this.history.undo());
  }

  redo() {
    this.#restore(this.history.redo());
  }

  /** @param {string | null} state */
  #restore(state) {
    if (state === null) return;
    this.scene = JSON.parse(state);
    if (this.choice && !this.chosen) this.choice = null;
    this.stage.request();
    this.dispatchEvent(new Event("change"));
    this.dispatchEvent(new Event("choose"));
  }

  /** All things with their place in the scene, as they are drawn: the last on top. @returns {(Choice & {thing: Record<string, any>})[]} */
  get things() {
    return KINDS.flatMap((kind) => (this.scene[kind] ?? []).map(
      (/** @type {Record<string, any>} */ thing, /** @type {number} */ index) => ({ kind, index, thing }),
    ));
  }

  /** @returns {Record<string, any> | null} */
  get chosen() {
    return this.choice ? this.scene[this.choice.kind]?.[this.choice.index] ?? null : null;
  }

  /** @param {Choice | null} choice */
  choose(choice) {
    this.choice = choice;
    this.stage.request();
    this.dispatchEvent(new Event("choose"));
  }

  /** Of everything and where the drives lead, with some room to drag to. */
  box() {
    const points = this.things.flatMap(({ thing }) => {
      const pose = poseOf(thing);
      const reach = reachOf(thing.shape);
      const end = endOf(thing, 0);
      const places = end ? [pose, end] : [pose];
      return places.flatMap(([x, y]) => [[x - reach, y - reach], [x + reach, y + reach]]);
    });
    const xs = points.map(([x]) => x);
    const ys = points.map(([, y]) => y);
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const room = 0.1 * Math.max(x1 - x0, y1 - y0);
    return [x0 - room, y0 - room, x1 + room, y1 + room];
  }

  // --- pointer and keys -----------------------------------------------------------------------

  /** @param {PointerEvent} event @param {[number, number]} world */
  #press(event, world) {
    this.stage.canvas.focus();
    const [x, y] = this.stage.toScreen(world);
    /** @param {[number, number] | null} handle */
    const near = (handle) => handle !== null && Math.hypot(handle[0] - x, handle[1] - y) < REACH;
    const chosen = this.chosen;
    if (chosen && near(this.#handle(chosen))) return this.#take(event, "turn", world);
    if (chosen && near(this.#driveEnd(chosen))) return this.#take(event, "drive", world);
    const hit = this.things.reverse().find(({ thing }) => inside(thing, world));
    this.choose(hit ? { kind: hit.kind, index: hit.index } : null);
    if (!hit) return false;
    const [px, py] = poseOf(hit.thing);
    return this.#take(event, "move", [world[0] - px, world[1] - py]);
  }

  /** @param {PointerEvent} event @param {Hold["deed"]} deed @param {[number, number]} grip */
  #take(event, deed, grip) {
    this.stage.canvas.setPointerCapture(event.pointerId);
    this.hold = { deed, grip, began: JSON.stringify(this.scene) };
    return true;
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const thing = this.chosen;
    if (!this.hold || !thing) return;
    const world = this.stage.worldOf(event);
    const [x, y, angle] = poseOf(thing);
    if (this.hold.deed === "move") {
      const [gx, gy] = this.hold.grip;
      place(thing, [this.#round(world[0] - gx), this.#round(world[1] - gy), angle]);
    } else if (this.hold.deed === "turn") {
      const raw = Math.atan2(world[1] - y, world[0] - x) - Math.PI / 2;
      const step = Math.PI / (event.shiftKey ? 36 : 1800);
      place(thing, [x, y, Math.round(Math.atan2(Math.sin(raw), Math.cos(raw)) / step) * step]);
    } else {
      const [dx, dy] = [world[0] - x, world[1] - y];
      const length = Math.hypot(dx, dy);
      if (length > 0) thing.drive.direction = [tidy(dx / length), tidy(dy / length)];
      if (thing.drive.travel !== undefined) thing.drive.travel = tidy(this.#round(length));
    }
    this.stage.request();
    this.dispatchEvent(new Event("hold"));
  }

  /** A length to the decimal that half a pixel can tell [m]. @param {number} metres */
  #round(metres) {
    const step = 10 ** Math.floor(Math.log10(0.5 / this.stage.scale));
    return Math.round(metres / step) * step;
  }

  #release() {
    if (!this.hold) return;
    const moved = this.hold.began !== JSON.stringify(this.scene);
    this.hold = null;
    if (moved) this.changed();
  }

  /** Move the chosen thing a little. @param {number} dx [m] @param {number} dy [m] @param {number} turn [rad] */
  nudge(dx, dy, turn) {
    const thing = this.chosen;
    if (!thing) return;
    const [x, y, angle] = poseOf(thing);
    place(thing, [x + dx, y + dy, angle + turn]);
    this.changed("nudge");
  }

  /** How far an arrow key moves: a millimetre, or less where all of the view is some millimetres [m]. */
  get stride() {
    return Math.min(1e-3, roundNumber(this.stage.width / this.stage.scale / 100));
  }

  /** The next thing, or the one before. @param {number} way */
  chooseNext(way) {
    const things = this.things;
    const now = things.findIndex(({ kind, index }) => kind === this.choice?.kind && index === this.choice?.index);
    const { kind, index } = things[(now + way + things.length) % things.length];
    this.choose({ kind, index });
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const mm = (event.shiftKey ? 10 : 1) * this.stride;
    const degree = ((event.shiftKey ? 10 : 1) * Math.PI) / 180;
    /** @type {Record<string, () => void>} */
    const actions = {
      ArrowLeft: () => this.nudge(-mm, 0, 0),
      ArrowRight: () => this.nudge(mm, 0, 0),
      ArrowUp: () => this.nudge(0, mm, 0),
      ArrowDown: () => this.nudge(0, -mm, 0),
      q: () => this.nudge(0, 0, degree),
      e: () => this.nudge(0, 0, -degree),
      Q: () => this.nudge(0, 0, degree),
      E: () => this.nudge(0, 0, -degree),
      n: () => this.chooseNext(1),
      p: () => this.chooseNext(-1),
      "+": () => this.stage.zoom(1.25),
      "-": () => this.stage.zoom(0.8),
      0: () => this.stage.fit(this.box()),
      Escape: () => this.choose(null),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    action();
  }

  // --- drawing --------------------------------------------------------------------------------

  /** @param {CanvasRenderingContext2D} context */
  #draw(context) {
    this.#grid(context);
    for (const { kind, thing } of this.things) this.#thing(context, kind, thing);
    this.#preview(context);
    for (const { thing } of this.things) if (thing.drive) this.#drive(context, thing);
    const chosen = this.chosen;
    if (chosen) this.#handles(context, chosen);
    this.stage.scaleBar();
  }

  /** Lines a power of ten apart that can be told apart. @param {CanvasRenderingContext2D} context */
  #grid(context) {
    const { stage } = this;
    const step = 10 ** Math.ceil(Math.log10(14 / stage.scale));
    const [x0, y1] = stage.toWorld(0, 0);
    const [x1, y0] = stage.toWorld(stage.width, stage.height);
    context.strokeStyle = colour(stage.canvas, "faint", "#eef1f4");
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(x0 / step) * step; x < x1; x += step) {
      const [px] = stage.toScreen([x, 0]);
      context.moveTo(Math.round(px) + 0.5, 0);
      context.lineTo(Math.round(px) + 0.5, stage.height);
    }
    for (let y = Math.ceil(y0 / step) * step; y < y1; y += step) {
      const [, py] = stage.toScreen([0, y]);
      context.moveTo(0, Math.round(py) + 0.5);
      context.lineTo(stage.width, Math.round(py) + 0.5);
    }
    context.stroke();
  }

  /** @param {CanvasRenderingContext2D} context @param {Kind} kind @param {Record<string, any>} thing */
  #thing(context, kind, thing) {
    const { stage } = this;
    const name = { bodies: "body", pushers: "pusher", fixels: "fixel" }[kind];
    const wrong = this.wrong.has(thing.name);
    const chosen = thing === this.chosen;
    const tone = wrong ? colour(stage.canvas, "bad", "#a81c07") : colour(stage.canvas, name, "#7f7f7f");
    const pose = poseOf(thing);
    stage.outline(drawable(thing.shape), pose);
    context.fillStyle = context.strokeStyle = tone;
    context.globalAlpha = kind === "bodies" ? 0.16 : 0.6;
    context.fill();
    context.globalAlpha = 1;
    context.setLineDash(wrong ? [5, 3] : []);
    context.lineWidth = chosen ? 3 : 1.6;
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = colour(stage.canvas, "soft", "#59636d");
    for (const point of feetOf(thing)) stage.dot(placed(pose, point), 3);
  }

  /** Where everything would end. @param {CanvasRenderingContext2D} context */
  #preview(context) {
    if (!this.preview) return;
    const { stage } = this;
    const { motion, object, reference } = this.preview;
    context.strokeStyle = colour(stage.canvas, "sim-1", "#a03d78");
    context.setLineDash([6, 4]);
    context.lineWidth = 1.8;
    for (const thing of this.scene.bodies) {
      const pose = motion.poseAt(thing.name, Infinity);
      if (!pose) continue;
      stage.outline(drawable(thing.shape), pose);
      context.stroke();
    }
    const rows = motion.pose.get(object);
    context.beginPath();
    for (let k = 0; rows && k < motion.time.length; k += 1) {
      const [x, y] = stage.toScreen(placed(rows.subarray(3 * k, 3 * k + 3), reference));
      context.lineTo(x, y);
    }
    context.setLineDash([]);
    context.stroke();
  }

  /** @param {CanvasRenderingContext2D} context @param {Record<string, any>} thing */
  #drive(context, thing) {
    const { stage } = this;
    context.strokeStyle = context.fillStyle = colour(stage.canvas, "pusher-text", "#8a5a00");
    context.lineWidth = 2;
    const path = thing.drive.waypoints;
    if (path) {
      context.beginPath();
      for (const [, x, y] of path) context.lineTo(...stage.toScreen([x, y]));
      context.stroke();
      return;
    }
    const [x, y] = stage.toScreen(poseOf(thing));
    const [ex, ey] = this.#driveEnd(thing) ?? [x, y];
    context.setLineDash(thing.drive.travel === undefined ? [4, 4] : []);
    stage.arrow(x, y, ex - x, ey - y);
    context.setLineDash([]);
    if (thing === this.chosen) this.#knob(context, ex, ey);
  }

  /** @param {CanvasRenderingContext2D} context @param {Record<string, any>} thing */
  #handles(context, thing) {
    const handle = this.#handle(thing);
    if (!handle) return;
    const [x, y] = this.stage.toScreen(poseOf(thing));
    context.strokeStyle = colour(this.stage.canvas, "blue", "#0063a0");
    context.lineWidth = 1.5;
    context.setLineDash([3, 3]);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(...handle);
    context.stroke();
    context.setLineDash([]);
    this.#knob(context, ...handle);
  }

  /** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y */
  #knob(context, x, y) {
    context.beginPath();
    context.arc(x, y, 7, 0, 2 * Math.PI);
    context.fillStyle = colour(this.stage.canvas, "card", "#ffffff");
    context.strokeStyle = colour(this.stage.canvas, "blue", "#0063a0");
    context.lineWidth = 2.5;
    context.fill();
    context.stroke();
  }

  /** Where the handle is that turns a thing [px]; a path turns by itself. @param {Record<string, any>} thing @returns {[number, number] | null} */
  #handle(thing) {
    if (thing.drive?.waypoints) return null;
    const [px, py, angle] = poseOf(thing);
    const [x, y] = this.stage.toScreen([px, py]);
    const length = reachOf(thing.shape) * this.stage.scale + HANDLE;
    return [x - length * Math.sin(angle), y - length * Math.cos(angle)];
  }

  /** Where the arrow of a drive ends [px]. @param {Record<string, any>} thing @returns {[number, number] | null} */
  #driveEnd(thing) {
    const end = endOf(thing, SHORTEST / this.stage.scale);
    return end && this.stage.toScreen(end);
  }
}
