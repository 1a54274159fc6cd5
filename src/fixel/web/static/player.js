// @ts-check
// The animated top view: everything on the plate to scale, one motion or several, and what plays it.
//
//     const player = new Player(document.getElementById("player"));
//     player.show(await getJson("/api/v1/experiments/12/motion"));
//     player.addEventListener("time", () => charts.cursor(player.time));

import { make, svg, typing } from "./dom.js";
import { Motion, lastBefore } from "./motion.js";
import { TopView, swatch } from "./view.js";

/** @typedef {import("./motion.js").MotionDocument} MotionDocument */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const REST = 0.8; // [s] at the end of a motion that is repeated

const ICONS = {
  play: "M8 5v14l11-7z",
  pause: "M7 5h4v14H7zM13 5h4v14h-4z",
  back: "M6 5h2v14H6zM19 5v14l-9-7z",
  next: "M16 5h2v14h-2zM5 5v14l9-7z",
  fit: "M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z",
};

/** @param {keyof typeof ICONS} name */
const icon = (name) => svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));

/** @param {keyof typeof ICONS} name @param {string} label */
const iconButton = (name, label) =>
  make("button", { type: "button", class: "icon", "aria-label": label, title: label }, icon(name));

const FORCES = "Forces on the part in the first simulation shown. A dashed arrow is shortened: the force is larger.";

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
    this.start = 0;
    this.end = 0;
    this.playing = false;
    this.speed = 1;
    this.last = 0; // [ms] of the frame before
    this.rested = 0; // [s] at the end
    // Who asks for less motion starts it by hand.
    this.autoplay = (options.autoplay ?? false) && !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.button = iconButton("play", "Play (space)");
    this.scrubber = make("input", { type: "range", min: 0, max: 1, step: "any", "aria-label": "Time" });
    this.readout = make("output", { class: "time" }, "0.00 s");
    this.total = make("span", { class: "total" });
    this.loop = make("input", { type: "checkbox" });
    this.forces = make("input", { type: "checkbox", checked: true });
    this.legend = make("ul", { class: "legend", "aria-label": "Motions" });
    this.canvas = make("canvas", { role: "img", tabindex: 0, "aria-label": "Top view to scale" });
    this.#build();
    this.view = new TopView(this.canvas);
    this.stage = this.view.stage;
    host.addEventListener("keydown", (event) => this.#key(event));
    if (options.keys ?? true) {
      document.addEventListener("keydown", (event) => {
        if (event.target === document.body && host.offsetParent) this.#key(event);
      });
    }
    /** @type {any} */ (host).player = this; // for scripts of a page, and tests
  }

  get motions() {
    return this.view.motions;
  }

  /** Name of the thing whose motion is compared. */
  get object() {
    return this.view.object;
  }

  // --- what is shown ------------------------------------------------------------------------

  /** @param {MotionDocument} content @param {{keepView?: boolean, keepTime?: boolean}} [keep] */
  show(content, keep = {}) {
    const { view, stage } = this;
    view.things = content.things;
    view.object = content.object;
    view.reference = content.reference_m;
    stage.box = content.box_m;
    this.canvas.setAttribute("aria-label", `Top view to scale: ${content.title}`);
    this.setMotions(content.motions.map((packed) => new Motion(packed)), keep);
    if (!keep.keepView) stage.fit();
    if (this.autoplay && !keep.keepTime) this.play();
  }

  /** Other motions of the same things. @param {Motion[]} motions @param {{keepTime?: boolean}} [keep] */
  setMotions(motions, keep = {}) {
    this.view.setMotions(motions);
    this.start = Math.min(...motions.map((motion) => motion.span[0]));
    this.end = Math.max(...motions.map((motion) => motion.span[1]));
    this.scrubber.min = String(this.start);
    this.scrubber.max = String(this.end);
    this.forces.disabled = this.view.perNewton === 0;
    this.#legend();
    this.seek(keep.keepTime ? this.time : this.start);
  }

  /** @param {number} time [s] */
  seek(time) {
    this.time = this.view.time = Math.max(this.start, Math.min(this.end, time));
    const words = `${this.time.toFixed(2)} s`;
    this.scrubber.value = String(this.time);
    this.scrubber.setAttribute("aria-valuetext", words);
    this.readout.textContent = words;
    this.total.textContent = `of ${this.end.toFixed(2)} s`;
    this.stage.request();
    this.dispatchEvent(new Event("time"));
  }

  play() {
    if (this.playing || !this.motions.length) return;
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

  /** To another frame of the first motion. @param {number} frames */
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
      this.rested += passed;
      if (!this.loop.checked) this.playing = false;
      else if (this.rested > REST) time = this.start;
    } else this.rested = 0;
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
    const back = iconButton("back", "One frame back (left arrow)");
    const next = iconButton("next", "One frame forward (right arrow)");
    const fit = iconButton("fit", "Fit the view to the scene (double click, or 0)");
    const speed = make("select", { "aria-label": "Speed" },
      ...SPEEDS.map((value) => make("option", { value, selected: value === 1 }, `${value}\u00d7`)));
    host.replaceChildren(
      make("div", { class: "view" }, this.canvas),
      make("div", { class: "controls" },
        this.button, back, next, this.scrubber,
        make("span", { class: "clock-text" }, this.readout, " ", this.total)),
      make("div", { class: "controls" },
        speed,
        make("label", {}, this.loop, "loop"),
        make("label", { title: FORCES }, this.forces, "forces"),
        fit, this.legend),
    );
    this.button.addEventListener("click", () => this.toggle());
    back.addEventListener("click", () => this.step(-1));
    next.addEventListener("click", () => this.step(1));
    fit.addEventListener("click", () => this.stage.fit());
    this.scrubber.addEventListener("input", () => this.seek(Number(this.scrubber.value)));
    speed.addEventListener("change", () => { this.speed = Number(speed.value); });
    this.forces.addEventListener("change", () => {
      this.view.withForces = this.forces.checked;
      this.stage.request();
    });
    this.#state();
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (typing(event) || event.ctrlKey || event.metaKey || event.altKey) return;
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
      box.checked = !this.view.hidden.has(motion.id);
      box.addEventListener("change", () => {
        if (box.checked) this.view.hidden.delete(motion.id);
        else this.view.hidden.add(motion.id);
        this.stage.request();
      });
      return make("li", {}, make("label", {}, box, swatch(this.view.styles.get(motion.id)), motion.label));
    }));
  }
}
