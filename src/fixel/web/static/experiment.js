// @ts-check
// One experiment: its motion and a simulation of it, in step with charts and video.

import { complain, get, send, undoNewest } from "./api.js";
import { Charts, inStep, usualPanels } from "./charts.js";
import { at, make, typing } from "./dom.js";
import * as marks from "./marks.js";
import { Motion } from "./motion.js";
import { calibratedOf } from "./offered.js";
import { renew } from "./page.js";
import { Player } from "./player.js";
import { deg, fixed, mm } from "./units.js";
import { Film } from "./video.js";
import { stylesOf, swatch } from "./view.js";

const root = at("experiment");
const number = Number(root.dataset.experiment);
const address = `/experiments/${number}`;

// --- motion and simulation --------------------------------------------------------------------

/** @typedef {{id: number, method: Record<string, string>, parameters: Record<string, number>}} Stored */
/** Whether the publisher of the data made a stored simulation. @param {Stored} one */
const byPublisher = (one) => Boolean(one.method.simulated_by);

async function show() {
  const player = new Player(at("player"));
  const charts = new Charts(at("charts"));
  inStep(player, charts);
  const { simulations } = await get(`${address}/simulations`);
  const story = await get(`${address}/motion`, { simulation: simulations.find(byPublisher)?.id });
  player.show(story);
  const draw = () => charts.show(usualPanels(at("charts"), player.motions, player.object), /** @type {[number, number]} */ ([player.start, player.end]));
  draw();
  if (root.dataset.video) film(player).catch(complain);
  await simulate(player, simulations.find((/** @type {Stored} */ one) => !byPublisher(one)));
  draw();
  root.dataset.ready = "yes";
}

/**
 * Nominal against calibrated values; without a calibration, the newest stored simulation, made again for its forces.
 * @param {Player} player
 * @param {Stored | undefined} stored
 */
async function simulate(player, stored) {
  /** @type {{sets: any[]}} */
  const { sets } = await get(`${address}/comparison`).catch(() => ({ sets: [] }));
  const calibrated = calibratedOf(sets);
  const motion = ["dynamic", "quasistatic", "first-order"].find((name) => name === stored?.method.motion) ?? "dynamic";
  const shown = calibrated ? [{ ...sets[0], head: "nominal" }, { ...calibrated, head: "calibrated" }]
    : [{ id: "simulated", label: stored ? `simulation ${stored.id}` : "simulated now", head: "simulated", parameters: stored?.parameters ?? {}, motion }];
  try {
    const answers = await Promise.all(shown.map(({ parameters, motion }) => send(`${address}/comparison`, { parameters, motion })));
    const motions = answers.map((answer, k) => new Motion({ ...answer.motion, id: shown[k].id, label: shown[k].label }));
    player.setMotions([...player.motions, ...motions], { keepTime: true });
    const values = Object.entries(shown[0].parameters).map(([name, value]) => `${name} ${Number(value).toPrecision(3)}`);
    at("which").textContent = calibrated ? `nominal against ${calibrated.label}` : `${shown[0].label}, ${values.join(", ") || "nominal values"}`;
    table(answers, shown.map(({ id, head }) => [swatch(stylesOf(at("player"), player.motions).get(id)), " ", head]));
  } catch (problem) {
    at("which").textContent = "not simulated";
    at("figures").replaceChildren(make("p", {}, problem instanceof Error ? problem.message : String(problem)));
  }
}

/** @param {any[]} answers @param {(Node | string)[][]} heads */
function table(answers, heads) {
  /** @type {[string, (answer: any) => string][]} */
  const lines = [
    ["error, root of E [mm]", (answer) => fixed(Math.sqrt(answer.error_mm2), 2)],
    ["distance, rms [mm]", (answer) => mm(answer.position_rms_m, 2)],
    ["distance, end [mm]", (answer) => mm(answer.final_position_m, 2)],
    ["angle, end [deg]", (answer) => deg(answer.final_angle_rad, 2)],
    ["contacts", (answer) => `${answer.contact_mode || "\u2013"}${answer.measured_contact_mode && answer.contact_mode !== answer.measured_contact_mode ? ` \u2260 ${answer.measured_contact_mode}` : ""}`],
  ];
  at("figures").replaceChildren(
    make("table", { class: "plain against" },
      make("thead", {}, make("tr", {}, make("td"), ...heads.map((head) => make("th", { scope: "col" }, ...head)))),
      make("tbody", {}, ...lines.map(([name, value]) => make("tr", {}, make("th", { scope: "row" }, name),
        ...answers.map((answer) => make("td", {}, answer.error_mm2 === null ? answer.motion.status : value(answer))))))),
    ...answers.filter(({ motion }) => motion.advice).map(({ motion }) => make("p", {}, motion.advice)));
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
    if (at("video-remark").textContent?.startsWith("Getting")) at("video-remark").textContent = "";
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

// --- marks and keys -----------------------------------------------------------------------------

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

document.addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]") || typing(event)) return;
  if ((event.ctrlKey || event.metaKey) && event.key === "z") {
    if (undoNewest()) event.preventDefault();
    return;
  }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  /** @type {Record<string, () => void>} */
  const keys = {
    f: acts.flag,
    n: acts.note,
    Delete: acts.delete,
    Escape: () => location.assign(root.dataset.list ?? ""),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});

if (root.dataset.scene) show().catch(complain);
else {
  at("judged").hidden = true;
  at("charts").textContent = "";
}
