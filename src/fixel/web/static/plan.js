// @ts-check
// Plan: the goal is dragged on the stage, and becomes the content of a goal file in the form.

import { complain } from "./api.js";
import { at, input, settled } from "./dom.js";
import { renew } from "./page.js";

const RAD = Math.PI / 180;
/** @type {{turn: boolean, x: number, y: number} | null} */
let held = null;

const stage = () => /** @type {SVGSVGElement} */ (/** @type {unknown} */ (at("stage")));
/** Names of fixels that the part should touch. */
const wanted = () => [...stage().querySelectorAll(".fixel.wanted")].map((one) => one.getAttribute("data-name"));
/** @param {string} id */
const number = (id) => Number(input(id).value) || 0;
const goal = () => [number("x_mm"), number("y_mm"), number("angle_deg")];

/** @param {string} id @param {number} value */
function write(id, value) {
  input(id).value = String(Math.round(100 * value) / 100);
}

/** Shows the goal; an SVG has y down. @param {boolean} [fit] whether the stage changes its limits */
function draw(fit = false) {
  const [x, y, angle] = goal();
  const seated = wanted().length > 0;
  const group = /** @type {SVGGElement} */ (stage().querySelector(".at-goal"));
  group.setAttribute("transform", `translate(${x} ${-y})`);
  group.querySelector(".turned")?.setAttribute("transform", `rotate(${-angle})`);
  group.querySelector(".within")?.setAttribute("r", String(number("position_mm")));
  group.toggleAttribute("hidden", seated);
  at("pose-fields").hidden = seated;
  at("seated").hidden = !seated;
  at("seated").textContent = `Goal: the part touches ${wanted().join(", ")}.`;
  if (!fit) return;
  const box = stage().getBBox();
  const room = 0.12 * Math.max(box.width, box.height);
  stage().setAttribute("viewBox", `${box.x - room} ${box.y - room} ${box.width + 2 * room} ${box.height + 2 * room}`);
}

/** Adds a fixel to those that the part should touch, or takes it away. @param {Element | undefined} fixel */
function want(fixel) {
  fixel?.classList.toggle("wanted");
  draw();
}

/** Puts the goal beside the start. */
function begin() {
  const { x, y, angle, size } = stage().dataset;
  write("x_mm", Number(x) + 0.4 * Number(size));
  write("y_mm", Number(y));
  write("angle_deg", Number(angle));
  draw(true);
}

/** @param {PointerEvent} event */
function place(event) {
  const found = new DOMPoint(event.clientX, event.clientY).matrixTransform(stage().getScreenCTM()?.inverse());
  return [found.x, -found.y];
}

/** Content of a goal file for the fields of the page. */
function content() {
  const pose = {
    pose_mm_deg: goal(), position_mm: number("position_mm"), angle_deg: number("tolerance_deg"), symmetry: number("symmetry"),
  };
  /** Error of a pose by its two fields. @param {string} key @param {string} fields @param {string} kind */
  const error = (key, fields, kind) => {
    const [mm, deg] = [number(`${fields}_mm`), number(`${fields}_deg`)];
    return mm || deg ? { [key]: { x_mm: mm, y_mm: mm, theta_deg: deg, kind } } : {};
  };
  return {
    fixel: 1,
    goal: wanted().length ? { seated: { fixels: wanted() } } : { pose },
    choose: input("kind").value === "rig" ? { rig: { y_mm: [-30, 30], theta_deg: [-45, 45] } } : { free: { most: number("pushes") } },
    belief: { ...error("start", "start", input("start_kind").value), ...error("camera", "seen", "normal") },
  };
}

const part = at("staged");
part.addEventListener("pointerdown", (event) => {
  const target = /** @type {Element} */ (event.target);
  if (target.matches(".fixel")) want(target);
  if (!target.matches(".handle, .goal")) return;
  const [x, y] = place(event);
  held = { turn: target.matches(".handle"), x: number("x_mm") - x, y: number("y_mm") - y };
  part.setPointerCapture(event.pointerId);
});
part.addEventListener("pointermove", (event) => {
  if (!held) return;
  const [x, y] = place(event);
  if (held.turn) write("angle_deg", Math.atan2(y - number("y_mm"), x - number("x_mm")) / RAD);
  else {
    write("x_mm", x + held.x);
    write("y_mm", y + held.y);
  }
  draw();
});
part.addEventListener("lostpointercapture", () => {
  held = null;
  draw(true);
});
part.addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 10 : 1;
  const move = /** @type {Record<string, [string, number]>} */ ({
    ArrowLeft: ["x_mm", -step], ArrowRight: ["x_mm", step], ArrowUp: ["y_mm", step], ArrowDown: ["y_mm", -step],
    q: ["angle_deg", 1], e: ["angle_deg", -1],
  })[event.key];
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (/^[1-9]$/.test(event.key)) want(stage().querySelectorAll(".fixel")[Number(event.key) - 1]);
  if (!move) return;
  event.preventDefault();
  write(move[0], number(move[0]) + move[1]);
  draw(true);
});
at("goal-form").addEventListener("submit", () => {
  input("goal").value = JSON.stringify(content());
});
input("experiment").addEventListener("change", () => {
  renew(`${location.pathname}?${new URLSearchParams({ experiment: input("experiment").value })}`).catch(complain);
});
for (const id of ["x_mm", "y_mm", "angle_deg", "position_mm"]) input(id).addEventListener("input", settled(() => draw(true), 150));
document.addEventListener("renewed", begin);
begin();
