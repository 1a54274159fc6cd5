// @ts-check
// One experiment: its motion and a simulation of it, in step with charts and video.

import { complain, copy, get, send, undoNewest } from "./api.js";
import { Charts, inStep, usualPanels } from "./charts.js";
import { ROOT, at, make, typing } from "./dom.js";
import * as marks from "./marks.js";
import { Motion } from "./motion.js";
import { calibratedOf } from "./offered.js";
import { Player } from "./player.js";
import { tags } from "./rows.js";
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
  await simulate(player);
  draw();
  root.dataset.ready = "yes";
}

/** Nominal against calibrated values; without a calibration, one simulation. @param {Player} player */
async function simulate(player) {
  const { sets } = await get(`${address}/comparison`).catch(() => ({ sets: [] }));
  const calibrated = calibratedOf(sets);
  if (calibrated) await both(player, [sets[0], calibrated]);
  else await newest(player);
}

/**
 * @param {Player} player
 * @param {{id: string, label: string, parameters: Record<string, number>, motion: string}[]} sets
 */
async function both(player, sets) {
  try {
    const answers = await Promise.all(sets.map(({ parameters, motion }) => send(`${address}/comparison`, { parameters, motion })));
    const motions = answers.map((answer, k) => new Motion({ ...answer.motion, id: sets[k].id, label: sets[k].label }));
    player.setMotions([...player.motions, ...motions], { keepTime: true });
    const styles = stylesOf(at("player"), player.motions);
    at("which").textContent = `nominal against ${sets[1].label}`;
    /** @type {[string, (answer: any) => string][]} */
    const lines = [
      ["error, root of E [mm]", (answer) => fixed(answer.error_mm2 === null ? null : Math.sqrt(answer.error_mm2), 2)],
      ["distance, rms [mm]", (answer) => mm(answer.position_rms_m, 2)],
      ["distance, end [mm]", (answer) => mm(answer.final_position_m, 2)],
      ["angle, end [deg]", (answer) => deg(answer.final_angle_rad, 2)],
      ["contacts", (answer) => `${answer.contact_mode || "\u2013"}${answer.measured_contact_mode && answer.contact_mode !== answer.measured_contact_mode ? ` \u2260 ${answer.measured_contact_mode}` : ""}`],
    ];
    at("figures").replaceWith(make("table", { id: "figures", class: "plain against" },
      make("thead", {}, make("tr", {}, make("td"), ...motions.map((motion, k) =>
        make("th", { scope: "col" }, swatch(styles.get(motion.id)), " ", k ? "calibrated" : "nominal")))),
      make("tbody", {}, ...lines.map(([name, value]) => make("tr", {}, make("th", { scope: "row" }, name),
        ...answers.map((answer) => make("td", {}, answer.error_mm2 === null ? answer.motion.status : value(answer))))))));
  } catch (problem) {
    refused(problem);
  }
}

/** The newest stored simulation, made again for its forces; without one, with nominal values. @param {Player} player */
async function newest(player) {
  const { simulations } = await get(`${address}/simulations`);
  const stored = simulations.find((/** @type {Stored} */ one) => !byPublisher(one));
  const parameters = stored?.parameters ?? {};
  const motion = ["dynamic", "quasistatic", "first-order"].find((name) => name === stored?.method?.motion) ?? "dynamic";
  const label = stored ? `simulation ${stored.id}` : "simulated now";
  try {
    const answer = await send(`${address}/comparison`, { parameters, motion });
    const values = Object.entries(parameters).map(([name, value]) => `${name} ${Number(value).toPrecision(3)}`);
    at("which").textContent = `${label}, ${values.join(", ") || "nominal values"}`;
    const complete = answer.error_mm2 !== null;
    const same = answer.contact_mode === answer.measured_contact_mode;
    at("figures").replaceChildren(...(complete ? [
      figure("error, root of E", fixed(Math.sqrt(answer.error_mm2), 2), "mm"),
      figure("distance, rms", mm(answer.position_rms_m, 2), "mm"),
      figure("distance, end", mm(answer.final_position_m, 2), "mm"),
      figure("angle, end", deg(answer.final_angle_rad, 2), "deg"),
      answer.measured_contact_mode
        ? figure("contacts", `${answer.contact_mode} ${same ? "\u2713" : `\u2260 ${answer.measured_contact_mode}`}`, "", same ? "good" : "bad")
        : figure("contacts", answer.contact_mode || "\u2013", ""),
    ] : [
      figure("stopped early", answer.motion.status, "", "bad"),
      figure("advice", answer.motion.advice, "", "words"),
    ]));
    player.setMotions([...player.motions, new Motion({ ...answer.motion, id: "simulated", label })], { keepTime: true });
  } catch (problem) {
    refused(problem);
  }
}

/** @param {unknown} problem */
function refused(problem) {
  at("which").textContent = "not simulated";
  at("figures").replaceChildren(figure("why", problem instanceof Error ? problem.message : String(problem), "", "words"));
}

/** @param {string} name @param {string} value @param {string} unit @param {string} [kind] */
const figure = (name, value, unit, kind) =>
  make("div", { class: kind ?? null }, make("dt", {}, name), make("dd", {}, value, unit ? make("small", {}, ` ${unit}`) : ""));

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

// --- marks --------------------------------------------------------------------------------------

async function refresh() {
  const known = await get(address);
  /** @type {{name: string, detail: string, fault: boolean}[]} */
  const flags = [...known.flags.map((/** @type {any} */ one) => ({ ...one, fault: true })), ...known.remarks.map((/** @type {any} */ one) => ({ ...one, fault: false }))];
  at("flags").replaceChildren(...tags(flags).map((tag, k) => {
    tag.append(make("button", { type: "button", "aria-label": `Remove the flag ${flags[k].name}`, onclick: () => marks.unflag([number], flags[k], changed) }, "\u2715"));
    return tag;
  }));
  at("notes").replaceChildren(...known.notes.map((/** @type {{id: number, text: string, created_utc: string}} */ note) => make("li", {},
    make("p", {}, note.text),
    make("button", { type: "button", class: "quiet", "aria-label": "Delete this note", onclick: () => marks.deleteNote(note.id, changed) }, "\u2715"),
    make("small", {}, new Date(note.created_utc).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })))));
  if (!known.notes.length) at("notes").append(make("li", {}, make("p", {}, "No notes. Press n to write one.")));
  at("deleted").hidden = !known.deleted;
  at("delete").textContent = known.deleted ? "Restore" : "Delete";
}

const changed = () => {
  refresh().catch(complain);
};

const acts = {
  flag: () => marks.flag([number], changed),
  note: () => marks.note([number], changed),
  delete: () => (at("deleted").hidden ? marks.remove([number], changed) : marks.restore([number], changed)),
};
at("flag").addEventListener("click", acts.flag);
at("note").addEventListener("click", acts.note);
at("delete").addEventListener("click", acts.delete);
for (const [id, what] of [["copy-command", "the command"], ["copy-python", "the Python code"]]) {
  at(id).addEventListener("click", () => copy(at(id).dataset.text ?? "", what));
}

// --- neighbours -----------------------------------------------------------------------------------

async function neighbours() {
  const list = sessionStorage.getItem("fixel-list") ?? "";
  const found = new URLSearchParams(list);
  const query = { filter: found.get("filter"), sort: found.get("sort"), descending: found.get("descending") };
  let { ids } = await get("/experiments/ids", query);
  if (!ids.includes(number)) ({ ids } = await get("/experiments/ids"));
  const place = ids.indexOf(number);
  link("previous", ids[place - 1]);
  link("next", place < 0 ? undefined : ids[place + 1]);
}

/** @param {string} id @param {number | undefined} to */
function link(id, to) {
  const node = at(id);
  node.toggleAttribute("data-ready", true);
  if (to === undefined) {
    node.setAttribute("aria-disabled", "true");
    node.removeAttribute("href");
  } else node.setAttribute("href", `${ROOT}/experiments/${to}`);
}

document.addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]") || typing(event)) return;
  if ((event.ctrlKey || event.metaKey) && event.key === "z") {
    if (undoNewest()) event.preventDefault();
    return;
  }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  /** @type {Record<string, () => void>} */
  const keys = {
    j: () => at("next").click(),
    k: () => at("previous").click(),
    f: acts.flag,
    n: acts.note,
    Delete: acts.delete,
    Escape: () => location.assign(`${ROOT}/experiments?${sessionStorage.getItem("fixel-list") ?? ""}`),
  };
  const act = keys[event.key];
  if (act) {
    event.preventDefault();
    act();
  }
});

refresh().catch(complain);
neighbours().catch(complain);
if (root.dataset.scene) show().catch(complain);
else {
  at("judged").hidden = true;
  at("charts").textContent = "";
}
