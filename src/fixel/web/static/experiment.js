// @ts-check
// One experiment: its motion and a simulation of it, in step with charts and video.

import { complain, get } from "./api.js";
import { Charts, inStep, usualPanels } from "./charts.js";
import { at } from "./dom.js";
import * as marks from "./marks.js";
import { Motion } from "./motion.js";
import { renew } from "./page.js";
import { Player } from "./player.js";
import { Film } from "./video.js";

const root = at("experiment");
const number = Number(root.dataset.experiment);
const address = `/experiments/${number}`;
const charts = new Charts(document.getElementById("charts") ?? document.createElement("div"));

// --- motion and simulation --------------------------------------------------------------------

/** @type {Player | null} */
let player = null;
let newest = "";

/** Shows the motions that the page holds: the measured one and simulations. */
function show() {
  const text = document.getElementById("story")?.dataset.story;
  if (!text || text === newest) return;
  newest = text;
  const story = JSON.parse(text);
  if (player) player.setMotions(story.motions.map((/** @type {any} */ packed) => new Motion(packed)), { keepTime: true });
  else {
    player = new Player(at("player"));
    inStep(player, charts);
    player.show(story);
    if (root.dataset.video) film(player).catch(complain);
  }
  charts.show(usualPanels(at("charts"), player.motions, player.object), [player.start, player.end]);
}

/** @param {Player} player */
async function film(player) {
  const video = /** @type {HTMLVideoElement} */ (at("video"));
  const shown = new Film(video, /** @type {HTMLCanvasElement} */ (at("over")), player);
  const box = /** @type {HTMLInputElement} */ (at("outlined"));
  box.addEventListener("change", () => {
    shown.shown = box.checked;
    shown.draw();
  });
  if (video.readyState < HTMLMediaElement.HAVE_CURRENT_DATA) at("video-remark").textContent = "Converting the video for the browser (only once) ...";
  video.addEventListener("loadeddata", () => {
    if (at("video-remark").textContent?.startsWith("Converting")) at("video-remark").textContent = "";
  });
  video.addEventListener("error", () => {
    at("video-remark").textContent = "This browser cannot play the video; its file is in the project's media folder.";
  });
  const seen = await get(`${address}/outlines`);
  if (seen.outlines) shown.outline(seen.outlines);
  else {
    box.disabled = true;
    box.checked = false;
    at("video-remark").textContent = "The outline cannot be drawn: the project's folder rigs has no rig file of this bench.";
  }
}

// --- marks --------------------------------------------------------------------------------------

const acts = {
  flag: () => marks.flag([number], renew),
  note: () => marks.note([number], renew),
  delete: () => marks.remove([number], renew, Boolean(at("marks").dataset.deleted)),
};
document.addEventListener("click", ({ target }) => {
  if (!(target instanceof HTMLElement)) return;
  if (target.id in acts) acts[/** @type {keyof typeof acts} */ (target.id)]();
  if (target.dataset.flag) marks.unflag([number], JSON.parse(target.dataset.flag), renew);
  if (target.dataset.note) marks.deleteNote(Number(target.dataset.note), renew);
});

document.addEventListener("renewed", show);
show();
