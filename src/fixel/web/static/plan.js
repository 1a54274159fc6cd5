// @ts-check
// Plan: the goal is dragged on a stage, and becomes the content of a goal file in the form.

import { complain, get } from "./api.js";
import { at, input, settled, svg } from "./dom.js";

/** @typedef {{name: string, outline: number[][]}} Fixel */
/** @typedef {{outline: number[][], start: number[], fixels: Fixel[], round: boolean}} PlanScene */

const RAD = Math.PI / 180;
/** @type {PlanScene | null} */
let scene = null;
/** @type {Set<string>} */
const wanted = new Set();

/** @param {string} id */
const number = (id) => Number(input(id).value) || 0;

/** @param {string} id @param {number} value */
function write(id, value) {
  input(id).value = String(Math.round(100 * value) / 100);
}

/**
 * Corners of an outline at a pose, for an SVG in millimetres, y down.
 * @param {number[][]} outline
 * @param {number[]} pose
 */
function points(outline, [x, y, angle]) {
  const c = Math.cos(angle * RAD);
  const s = Math.sin(angle * RAD);
  return outline.map(([a, b]) => `${(x + c * a - s * b).toFixed(3)},${(-y - s * a - c * b).toFixed(3)}`).join(" ");
}

/** Size of the part [mm]. */
const size = () => Math.max(...(scene?.outline ?? [[1, 1]]).map(([a, b]) => Math.hypot(a, b)));

const goal = () => [number("x_mm"), number("y_mm"), number("angle_deg")];

/** Fits the stage to the part, its goal and the fixels. */
function fit() {
  if (!scene) return;
  const reach = 1.3 * size() + number("position_mm");
  const places = [scene.start, goal(), ...scene.fixels.flatMap((own) => own.outline)];
  const xs = places.flatMap(([x]) => [x - reach, x + reach]);
  const ys = places.flatMap(([, y]) => [-y - reach, -y + reach]);
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  at("stage").setAttribute("viewBox", `${left} ${top} ${Math.max(...xs) - left} ${Math.max(...ys) - top}`);
}

/** Draws the start, the fixels and the goal. */
function draw() {
  if (!scene) return;
  const seated = wanted.size > 0;
  const [x, y, angle] = goal();
  const far = size() * 1.12;
  const hand = [x + far * Math.cos(angle * RAD), -y - far * Math.sin(angle * RAD)];
  const parts = [
    svg("polygon", { class: "part", points: points(scene.outline, scene.start) }),
    ...scene.fixels.map((own) =>
      svg("polygon", {
        class: `fixel${wanted.has(own.name) ? " wanted" : ""}`, points: points(own.outline, [0, 0, 0]), "data-name": own.name,
      }, svg("title", {}, own.name))),
  ];
  if (!seated) {
    parts.push(
      svg("polygon", { class: "goal", points: points(scene.outline, [x, y, angle]) }),
      svg("circle", { class: "within", cx: x, cy: -y, r: number("position_mm") }),
      svg("circle", { class: "handle", cx: hand[0], cy: hand[1], r: 0.09 * size() }),
    );
  }
  at("stage").replaceChildren(...parts);
  at("pose-fields").hidden = seated;
  at("seated").hidden = !seated;
  at("seated").textContent = `Goal: the part touches ${[...wanted].join(", ")}.`;
}

/** @param {string} key */
async function open(key) {
  try {
    scene = /** @type {PlanScene} */ (await get("/plan/scene", { experiment: key }));
    wanted.clear();
    const [x, y, angle] = scene.start;
    write("x_mm", x + 0.4 * size());
    write("y_mm", y);
    write("angle_deg", angle);
    fit();
    draw();
  } catch (problem) {
    complain(problem);
  }
}

/** @param {PointerEvent} event */
function place(event) {
  const stage = /** @type {SVGSVGElement} */ (/** @type {unknown} */ (at("stage")));
  const matrix = stage.getScreenCTM();
  if (!matrix) return [0, 0];
  const found = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
  return [found.x, -found.y];
}

/** Follows a pointer that moves or turns the goal. */
function listen() {
  const stage = at("stage");
  /** @type {{turn: boolean, x: number, y: number} | null} */
  let held = null;
  stage.addEventListener("pointerdown", (event) => {
    const target = /** @type {Element} */ (event.target);
    const name = target.getAttribute("data-name");
    if (name) {
      if (!wanted.delete(name)) wanted.add(name);
      draw();
      return;
    }
    const turn = target.classList.contains("handle");
    if (!turn && !target.classList.contains("goal")) return;
    const [x, y] = place(event);
    held = { turn, x: number("x_mm") - x, y: number("y_mm") - y };
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!held) return;
    const [x, y] = place(event);
    if (held.turn) {
      write("angle_deg", Math.atan2(y - number("y_mm"), x - number("x_mm")) / RAD);
    } else {
      write("x_mm", x + held.x);
      write("y_mm", y + held.y);
    }
    draw();
  });
  for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
    stage.addEventListener(name, () => {
      if (held) fit();
      held = null;
    });
  }
  stage.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 10 : 1;
    /** @type {Record<string, [string, number]>} */
    const moves = {
      ArrowLeft: ["x_mm", -step], ArrowRight: ["x_mm", step], ArrowUp: ["y_mm", step], ArrowDown: ["y_mm", -step],
      q: ["angle_deg", 1], e: ["angle_deg", -1],
    };
    const move = moves[event.key];
    if (!move) return;
    event.preventDefault();
    write(move[0], number(move[0]) + move[1]);
    fit();
    draw();
  });
}

/** Content of a goal file for the fields of the page. */
function content() {
  const [x, y, angle] = goal();
  const pose = {
    pose_mm_deg: [x, y, angle], position_mm: number("position_mm"), angle_deg: number("tolerance_deg"),
    symmetry: number("symmetry"),
  };
  const free = { free: { most: number("pushes") } };
  const rig = { rig: { y_mm: [-30, 30], theta_deg: [-45, 45] } };
  const [mm, deg] = [number("start_mm"), number("start_deg")];
  const start = { x_mm: mm, y_mm: mm, theta_deg: deg, kind: input("start_kind").value };
  return {
    fixel: 1,
    goal: wanted.size ? { seated: { fixels: [...wanted] } } : { pose },
    choose: input("kind").value === "rig" ? rig : free,
    belief: mm || deg ? { start } : {},
  };
}

document.getElementById("goal-form")?.addEventListener("submit", () => {
  input("goal").value = JSON.stringify(content());
});

if (document.getElementById("goal-form")) {
  listen();
  input("experiment").addEventListener("change", () => open(input("experiment").value));
  for (const id of ["x_mm", "y_mm", "angle_deg", "position_mm"]) {
    input(id).addEventListener("input", settled(() => { fit(); draw(); }, 150));
  }
  open(input("experiment").value);
}
