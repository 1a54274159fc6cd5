// @ts-check
// Sets of parameters against one experiment: the server simulates them for the form, and the player shows them.

import { Charts, inStep, usualPanels } from "./charts.js";
import { at, input } from "./dom.js";
import { Motion } from "./motion.js";
import { Player } from "./player.js";

const player = new Player(at("player"));
const charts = new Charts(at("charts"));
inStep(player, charts);

function show() {
  /** @type {import("./motion.js").MotionDocument} */
  const story = JSON.parse(at("story").dataset.story ?? "");
  if (player.motions.length) player.setMotions(story.motions.map((packed) => new Motion(packed)), { keepTime: true });
  else player.show(story);
  charts.show(usualPanels(at("charts"), player.motions, player.object), [player.start, player.end]);
  const shown = (at("shown").dataset.names ?? "").split(" ");
  for (const slider of document.querySelectorAll(".slider")) turn(slider, shown.includes(slider.getAttribute("data-name") ?? ""));
}

/** @param {Element} slider @param {boolean} on */
function turn(slider, on) {
  slider.toggleAttribute("hidden", !on);
  for (const field of slider.querySelectorAll("input")) field.disabled = !on;
}

document.addEventListener("change", ({ target }) => {
  if (!(target instanceof HTMLSelectElement) || target.id !== "add-slider" || !target.value) return;
  turn(/** @type {Element} */ (document.querySelector(`.slider[data-name="${target.value}"]`)), true);
  at("shown").dataset.names += ` ${target.value}`;
  input(`slide-${target.value}`).focus();
});
at("sliders").addEventListener("keydown", (event) => {
  const range = /** @type {HTMLInputElement} */ (event.target);
  const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
  if (!way || !event.shiftKey || range.type !== "range") return;
  event.preventDefault();
  range.stepUp(10 * way);
  range.dispatchEvent(new Event("input", { bubbles: true }));
});
document.addEventListener("renewed", show);
show();
