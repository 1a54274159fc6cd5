// @ts-check
// The page on which scenes are made: the editor, its fields, and what a simulation makes of them.

import { Refusal, complain, copy, get, send, toast } from "./api.js";
import { Charts, inStep, usualPanels } from "./charts.js";
import { at, input, make } from "./dom.js";
import { Editor } from "./editor.js";
import { box, refuse, rows, sceneFields, thingFields } from "./inspector.js";
import { Motion } from "./motion.js";
import { Player } from "./player.js";
import { reachOf } from "./scene.js";
import { deg, mm } from "./units.js";

/** @typedef {import("./editor.js").Choice} Choice */
/** @typedef {{story: import("./motion.js").MotionDocument, summary: Record<string, any>}} Simulated */

const SLOW = 1500; // [ms] of a simulation that is not made again at every touch
const [REFUSED, CANCELLED] = [422, 499]; // status of a scene that is wrong, and of a request that was given up
const DRAFT = "fixel-scene";

const root = at("simulate");
const canvas = /** @type {HTMLCanvasElement} */ (at("editor"));
const editor = new Editor(canvas);
const player = new Player(at("watch"));
const charts = new Charts(at("charts"));
inStep(player, charts);
/** For tests. */
/** @type {any} */ (root).editor = editor;

// --- simulating -----------------------------------------------------------------------------

/** @type {Simulated | null} of the scene as it is now */
let newest = null;
let wanted = false; // whether the scene has changed since the last simulation began
let busy = false;
let slow = 0; // simulations one after the other that took their time
let watchNext = false; // whether somebody pressed Run
/** @type {AbortController | null} */
let controller = null;

/** @param {"good" | "fault" | "off" | ""} state @param {string} tag @param {string} words */
function verdict(state, tag, words) {
  at("verdict").className = `tag ${state}`;
  at("verdict").textContent = tag;
  at("verdict-words").textContent = words;
}

/** Simulates the scene of now, again and again while it changes: one at a time, the newest next. */
async function refresh() {
  if (busy) return;
  busy = true;
  if (!root.dataset.simulated) verdict("", "\u2026", "compiling the simulator: some seconds, only once");
  while (wanted || watchNext) {
    wanted = false;
    const since = performance.now();
    controller = new AbortController();
    const showCancel = setTimeout(() => { at("cancel").hidden = false; }, 300);
    try {
      const { scene } = editor;
      const check = !input("live").checked && !watchNext;
      const answer = await send(check ? "/scenes/check" : "/simulate", { scene }, "POST", controller.signal);
      const took = performance.now() - since;
      clear(null);
      if (answer) done(answer, took);
      else {
        editor.preview = null; // of another scene
        verdict("good", "valid", "Press Run to simulate.");
      }
    } catch (problem) {
      failed(problem);
    }
    clearTimeout(showCancel);
    at("cancel").hidden = true;
  }
  busy = false;
}

/** @param {Simulated} answer @param {number} took [ms] */
function done(answer, took) {
  newest = wanted ? null : answer;
  root.dataset.roundTrip = took.toFixed(1);
  root.dataset.simulated = String(Number(root.dataset.simulated ?? 0) + 1);
  slow = took > SLOW ? slow + 1 : 0;
  if (slow > 1 && input("live").checked) {
    input("live").checked = false;
    toast("This scene takes long to simulate; press Run to simulate it.");
  }
  const { story, summary } = answer;
  const [packed] = story.motions;
  editor.preview = { motion: new Motion(packed), object: story.object, reference: story.reference_m };
  editor.stage.request();
  const [x, y, angle] = summary.final[story.object];
  const touching = summary.touching.map((/** @type {string[]} */ pair) => pair.join(" on ")).join(", ");
  verdict(
    summary.status === "converged" ? "good" : "off", summary.status,
    `${story.object} ends at ${mm(x)} mm, ${mm(y)} mm, ${deg(angle)} deg`
      + `${touching ? `; at the end ${touching}` : ""}. `
      + (summary.advice ? `${summary.advice} ` : `${summary.steps} steps in ${(1e3 * summary.wall_time_s).toFixed(1)} ms.`),
  );
  if (watchNext) {
    watchNext = false;
    watch(true);
  }
}

/** @param {unknown} problem */
function failed(problem) {
  const ran = watchNext;
  watchNext = false;
  if (problem instanceof DOMException || (problem instanceof Refusal && problem.problem.status === CANCELLED)) {
    verdict("off", "cancelled", "Nothing was simulated.");
    return;
  }
  editor.preview = null;
  newest = null;
  clear(problem instanceof Refusal ? problem.problem : null);
  const sentence = problem instanceof Error ? problem.message : String(problem);
  verdict("fault", problem instanceof Refusal && problem.problem.status === REFUSED ? "invalid" : "failed", sentence);
  if (ran) complain(problem);
}

/** Show what is wrong where it is, and nothing where nothing is. @param {any} problem */
function clear(problem) {
  const named = [...(problem?.where ?? "").matchAll(/'([^']+)'/g)].map(([, name]) => name);
  const place = /^(bodies|pushers|fixels)\[(\d+)\]/.exec(problem?.where ?? "");
  if (place) named.push(editor.scene[place[1]]?.[Number(place[2])]?.name);
  editor.wrong = new Set(named);
  editor.stage.request();
  refuse(at("fields"), problem);
  refuse(at("scene-fields"), problem);
}

function changed() {
  keepDraft();
  wanted = true;
  newest = null;
  buttons();
  void refresh();
}

// --- edit and watch -------------------------------------------------------------------------

/** @param {boolean} on */
function watch(on) {
  at("edit").hidden = on;
  at("watch").hidden = !on;
  at("charts-card").hidden = !on;
  at("keys-of-it").hidden = on;
  at("tab-edit").setAttribute("aria-selected", String(!on));
  at("tab-watch").setAttribute("aria-selected", String(on));
  at("tab-edit").tabIndex = on ? -1 : 0;
  at("tab-watch").tabIndex = on ? 0 : -1;
  if (!on || !newest) {
    player.pause();
    if (on) run();
    return;
  }
  player.stage.resize();
  player.show(newest.story);
  charts.show(usualPanels(at("charts"), player.motions, player.object), [player.start, player.end]);
  player.play();
}

function run() {
  watchNext = true;
  verdict("", "\u2026", "simulating");
  void refresh();
}

at("tab-edit").addEventListener("click", () => watch(false));
at("tab-watch").addEventListener("click", () => watch(true));
for (const [here, there] of [["tab-edit", "tab-watch"], ["tab-watch", "tab-edit"]]) {
  at(here).addEventListener("keydown", (event) => {
    if (!["ArrowLeft", "ArrowRight"].includes(event.key)) return;
    event.stopPropagation();
    at(there).click();
    at(there).focus();
  });
}
at("run").addEventListener("click", run);
at("cancel").addEventListener("click", () => controller?.abort());
input("live").addEventListener("change", changed);

// --- things and fields ----------------------------------------------------------------------

function buttons() {
  const { past, future } = editor.history;
  /** @type {HTMLButtonElement} */ (at("undo")).disabled = past.length < 2;
  /** @type {HTMLButtonElement} */ (at("redo")).disabled = future.length === 0;
  const last = editor.choice?.kind === "bodies" && editor.scene.bodies.length === 1;
  /** @type {HTMLButtonElement} */ (at("remove")).disabled = !editor.chosen || last;
}

function list() {
  const focused = at("things").contains(document.activeElement);
  at("things").replaceChildren(...editor.things.map(({ kind, index, thing }) => {
    const on = thing === editor.chosen;
    const radio = make("input", { type: "radio", name: "thing", checked: on });
    radio.addEventListener("change", () => editor.choose({ kind, index }));
    return make("label", { class: "thing", "data-kind": kind }, radio, make("span", {}, thing.name));
  }));
  const checked = at("things").querySelector("input:checked");
  if (focused && checked instanceof HTMLElement) checked.focus();
}

function fields() {
  const id = document.activeElement?.id;
  const thing = editor.chosen;
  at("fields").replaceChildren(...(thing && editor.choice
    ? rows(thingFields(thing, editor.choice), edited)
    : [make("p", { class: "hint" }, "Select a body here or in the top view.")]));
  at("scene-fields").replaceChildren(...rows(sceneFields(editor.scene), edited));
  buttons();
  if (id && document.activeElement?.id !== id) document.getElementById(id)?.focus({ preventScroll: true });
}

/** @param {import("./inspector.js").Field} field @param {boolean} rebuild */
function edited(field, rebuild) {
  editor.changed(`${field.where} ${field.label}`);
  if (field.label === "name") list();
  if (rebuild) fields();
}

/** Writes the values of now into the fields that are there. */
function refill() {
  for (const entry of document.querySelectorAll(".fields input")) entry.dispatchEvent(new Event("refresh"));
}

editor.addEventListener("choose", () => {
  list();
  fields();
});
editor.addEventListener("change", () => {
  refill();
  changed();
});
editor.addEventListener("hold", () => {
  refill();
  wanted = true;
  void refresh();
});

/** @param {string} stem */
function freeName(stem) {
  const taken = new Set(editor.things.map(({ thing }) => thing.name));
  let k = 1;
  while (taken.has(`${stem}-${k}`)) k += 1;
  return `${stem}-${k}`;
}

/** A place at the edge of what is there, where nothing lies. @param {number} reach */
function freePlace(reach) {
  const [, y0, , y1] = editor.box();
  const right = Math.max(...editor.things.map(({ thing }) => (thing.pose ?? [0])[0] + reachOf(thing.shape)));
  return [right + 2 * reach, (y0 + y1) / 2, 0];
}

/** @param {Choice} choice where @param {Record<string, any>} thing */
function insert({ kind, index }, thing) {
  editor.scene[kind] = (editor.scene[kind] ?? []).toSpliced(index, 0, thing);
  editor.choice = { kind, index: editor.scene[kind].indexOf(thing) };
  editor.changed();
  editor.choose(editor.choice);
}

at("add-fixel").addEventListener("click", () => {
  const like = editor.scene.fixels?.[0];
  const shape = like ? structuredClone(like.shape) : { disk: 0.005 };
  const fixel = { name: freeName("fixel"), shape, pose: freePlace(reachOf(shape)), friction: like?.friction ?? 0.2 };
  insert({ kind: "fixels", index: editor.scene.fixels?.length ?? 0 }, fixel);
});
at("add-pusher").addEventListener("click", () => {
  const shape = { polygon: box(0.02, 0.02) };
  const drive = { direction: [-1, 0], speed: 0.01, travel: 0.05 };
  const pusher = { name: freeName("pusher"), shape, pose: freePlace(reachOf(shape)), drive, friction: 0.25 };
  insert({ kind: "pushers", index: editor.scene.pushers?.length ?? 0 }, pusher);
});
at("remove").addEventListener("click", () => {
  const { choice } = editor;
  if (!choice) return;
  const [thing] = editor.scene[choice.kind].splice(choice.index, 1);
  editor.choice = null;
  editor.changed();
  editor.choose(null);
  const origin = at("origin").textContent;
  toast(`Removed ${thing.name}.`, {
    undo: async () => { // whatever has been changed since, but not in another scene
      if (at("origin").textContent !== origin) throw new Error("Another scene has been opened.");
      if (editor.things.some((one) => one.thing.name === thing.name)) return; // Ctrl-Z was faster
      insert(choice, thing);
    },
  });
});
at("undo").addEventListener("click", () => editor.undo());
at("redo").addEventListener("click", () => editor.redo());
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey)) return;
  const key = event.key.toLowerCase();
  if (key === "enter") run();
  else if (key === "z" && !event.shiftKey && !inText(event)) editor.undo();
  else if ((key === "y" || (key === "z" && event.shiftKey)) && !inText(event)) editor.redo();
  else return;
  event.preventDefault();
});

/** @param {KeyboardEvent} event */
const inText = (event) => event.target instanceof HTMLInputElement && event.target.type === "text";

// --- from and to files ----------------------------------------------------------------------

/** @param {Record<string, any>} scene @param {string} origin */
function open(scene, origin) {
  at("origin").textContent = origin;
  newest = null;
  editor.preview = null;
  input("live").checked = true;
  watch(false);
  editor.open(scene);
}

async function openExample() {
  const name = /** @type {HTMLSelectElement} */ (at("example")).value;
  open((await get(`/scenes/examples/${name}`)).scene, `the example ${name}`);
  input("file-name").value = name;
}

at("open-example").addEventListener("click", () => openExample().catch(complain));
at("choose-file").addEventListener("click", () => input("file").click());
input("file").addEventListener("change", async () => {
  const [file] = input("file").files ?? [];
  input("file").value = "";
  if (!file) return;
  try {
    const most = Number(root.dataset.most);
    if (file.size > most) throw new Error(`This file is larger than ${most / 1024} kB; scene files are smaller.`);
    const answer = await send("/scenes/read", { text: await file.text(), is_json: /\.json$/i.test(file.name) });
    open(answer.scene, file.name);
    input("file-name").value = file.name.replace(/\.\w+$/, "").replace(/[^\w-]+/g, "-").slice(0, 60) || "scene";
  } catch (problem) {
    complain(problem);
  }
});

const fileName = () => `${input("file-name").value.replace(/[^\w-]+/g, "-") || "scene"}.yaml`;

at("save").addEventListener("click", async () => {
  try {
    const { text } = await send("/scenes/write", { scene: editor.scene });
    const address = URL.createObjectURL(new Blob([text], { type: "application/yaml" }));
    make("a", { href: address, download: fileName() }).click();
    URL.revokeObjectURL(address);
    toast(`Saved ${fileName()} in the download folder of the browser.`);
  } catch (problem) {
    complain(problem);
  }
});
at("copy").addEventListener("click", () => copy(`fixel simulate ${fileName()}`, "the command, for the saved file"));

/** What is made here survives going to another page and coming back. */
function keepDraft() {
  try {
    if (editor.history.past.length > 1) sessionStorage.setItem(DRAFT, JSON.stringify(editor.scene));
  } catch {
    // Too large for what the browser gives: then it does not survive.
  }
}

async function begin() {
  const number = root.dataset.experiment;
  const draft = new URLSearchParams(location.search).size ? null : sessionStorage.getItem(DRAFT);
  if (number) open((await get(`/experiments/${number}/scene`)).scene, root.dataset.key ?? "");
  else if (draft) open(JSON.parse(draft), "your last unsaved scene");
  else await openExample();
  root.dataset.ready = "yes";
}

begin().catch(complain);
