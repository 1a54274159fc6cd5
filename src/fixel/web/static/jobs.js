// @ts-check
// The queue, and one job of it: asked for every few seconds while somebody looks.

import { complain, copy, get, send, toast } from "./api.js";
import { at, make } from "./dom.js";
import { count, several } from "./units.js";

/**
 * @typedef {object} Job
 * @property {string} name
 * @property {string} state
 * @property {string} reason
 * @property {string} note
 * @property {string} maker
 * @property {number} done
 * @property {number} total
 * @property {number} failed
 * @property {number} kept
 * @property {number} rate_per_s
 * @property {number | null} left_s
 * @property {number | null} share
 * @property {number} workers
 * @property {number} deaths
 * @property {number} again
 * @property {string} host
 * @property {number} pid
 * @property {string} made_utc
 * @property {string} started_utc
 * @property {string} updated_utc
 * @property {string} command
 * @property {boolean} can_cancel
 * @property {boolean} can_resume
 */
/** @typedef {{name: string, host: string, pid: number, state: string, reason: string}} Worker */

const EVERY = 2000; // [ms]
const LINES = 200;

/** @type {Job[]} */
let jobs = [];
let chosen = fromAddress();
let busy = false;

function fromAddress() {
  try {
    return decodeURIComponent(location.hash.slice(1));
  } catch {
    return "";
  }
}

/** @param {number | null} seconds */
function left(seconds) {
  if (seconds === null) return "\u2013";
  if (seconds < 90) return `${Math.ceil(seconds)} s`;
  if (seconds < 5400) return `${Math.ceil(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

/** @param {string} iso */
const instant = (iso) => (iso ? `${iso.slice(0, 10)} ${iso.slice(11, 16)} UTC` : "\u2013");

/** @param {string} state */
const tag = (state) => make("span", { class: "tag", "data-state": state }, state);

/** @param {Job} job */
function row(job) {
  const running = job.state === "running";
  return make(
    "tr", { class: job.name === chosen ? "chosen" : null, "data-job": job.name },
    make("th", { scope: "row" }, make("button", {
      type: "button", class: "open", "aria-pressed": job.name === chosen ? "true" : "false", onclick: () => choose(job.name),
    }, job.name)),
    make("td", { class: "state" }, tag(job.state)),
    make("td", { class: "progress" },
      job.share === null ? null : make("progress", { max: 1, value: job.share, "aria-label": `Progress of ${job.name}` }),
      job.share === null ? `${count(job.done)} done` : `${count(job.done)} of ${count(job.total)}`),
    make("td", { "data-label": "failed", class: job.failed ? "number bad" : "number" }, count(job.failed)),
    make("td", { "data-label": "workers", class: "number" }, count(job.workers)),
    make("td", { "data-label": "lost", class: job.deaths ? "number off" : "number" }, count(job.deaths)),
    make("td", { "data-label": "repeated", class: job.again ? "number off" : "number" }, count(job.again)),
    make("td", { "data-label": "rate [1/s]", class: "number" }, running ? job.rate_per_s.toPrecision(3) : "\u2013"),
    make("td", { "data-label": "left", class: "number" }, running ? left(job.left_s) : "\u2013"),
  );
}

function table() {
  // Rows are made anew: whoever is at one with the keyboard stays there.
  const held = document.activeElement?.closest("#rows tr")?.getAttribute("data-job");
  at("rows").replaceChildren(...jobs.map(row));
  if (held !== null && held !== undefined) {
    const mine = [...at("rows").children].find((one) => one.getAttribute("data-job") === held);
    /** @type {HTMLElement | null} */ (mine?.querySelector(".open") ?? null)?.focus();
  }
  at("table").hidden = jobs.length === 0;
  at("nothing").hidden = jobs.length > 0;
  const running = jobs.filter((job) => job.can_cancel && !job.can_resume).length;
  at("counted").textContent = jobs.length ? `${several(jobs.length, "job")}, ${running} running` : "";
}

/**
 * @param {Job} job
 * @param {Worker[]} workers
 * @param {{lines: string[], whole: boolean}} log
 */
function detail(job, workers, log) {
  at("one").hidden = false;
  at("name").textContent = job.name;
  at("state").textContent = job.state;
  at("state").dataset.state = job.state;
  at("reason").textContent = [job.reason, job.note].filter(Boolean).join("; ");
  /** @type {HTMLButtonElement} */ (at("cancel")).disabled = !job.can_cancel;
  /** @type {HTMLButtonElement} */ (at("resume")).disabled = !job.can_resume;
  at("command").textContent = job.command;
  const facts = [
    ["stored chunks", count(job.kept)], ["failed chunks", count(job.failed)],
    ["workers lost", count(job.deaths)], ["repeated chunks", count(job.again)],
    ["created", instant(job.made_utc)], ["last update", instant(job.updated_utc)],
    ["coordinator", job.host ? `${job.host}, process ${job.pid}` : "\u2013"], ["work", job.maker || "\u2013"],
  ];
  at("facts").replaceChildren(...facts.map(([name, value]) =>
    make("div", {}, make("dt", {}, name), make("dd", {}, value))));
  at("no-workers").hidden = workers.length > 0;
  at("workers-region").hidden = workers.length === 0;
  at("worker-rows").replaceChildren(...workers.map((one) => make("tr", {},
    make("td", {}, one.name),
    make("td", {}, tag(one.state), one.reason ? ` ${one.reason}` : null),
    make("td", {}, one.host || "\u2013"),
    make("td", { class: "number" }, one.pid || "\u2013"))));
  const box = at("log");
  const atEnd = box.scrollHeight - box.scrollTop - box.clientHeight < 8;
  box.textContent = log.lines.join("\n") || "The log is empty.";
  at("log-words").textContent = log.whole ? "" : `the last ${log.lines.length} lines`;
  if (atEnd) box.scrollTop = box.scrollHeight;
}

async function refresh() {
  if (busy) return;
  busy = true;
  try {
    jobs = (await get("/jobs")).jobs;
    if (!jobs.some((job) => job.name === chosen)) chosen = jobs[0]?.name ?? "";
    table();
    const wanted = chosen;
    if (!wanted) {
      at("one").hidden = true;
      return;
    }
    const place = `/jobs/${encodeURIComponent(wanted)}`;
    const [{ job, workers }, log] = await Promise.all([get(place), get(`${place}/log`, { lines: LINES })]);
    if (wanted === chosen) detail(job, workers, log);
    document.body.dataset.ready = "yes";
  } finally {
    busy = false;
  }
}

/** @param {string} name */
function choose(name) {
  chosen = name;
  history.replaceState(null, "", `#${encodeURIComponent(name)}`);
  table();
  refresh().catch(complain);
}

/** @param {"cancel" | "resume"} deed @param {string} told */
async function act(deed, told) {
  const buttons = ["cancel", "resume"].map((id) => /** @type {HTMLButtonElement} */ (at(id)));
  for (const button of buttons) button.disabled = true;
  const name = chosen;
  try {
    await send(`/jobs/${encodeURIComponent(name)}/${deed}`);
    toast(`${name}: ${told}`);
  } catch (problem) {
    complain(problem);
  }
  await refresh();
}

at("cancel").addEventListener("click", () =>
  act("cancel", "cancelled; finished chunks are stored.").catch(complain));
at("resume").addEventListener("click", () =>
  act("resume", "continues in a separate process, even if this server stops.").catch(complain));
at("copy").addEventListener("click", () => copy(at("command").textContent ?? "", "the command"));
window.addEventListener("hashchange", () => choose(fromAddress()));

let complained = false;
async function watch() {
  if (document.visibilityState === "visible") {
    try {
      await refresh();
      complained = false;
    } catch (problem) {
      if (!complained) complain(problem);
      complained = true; // once: the next attempts would say the same
    }
  }
  setTimeout(watch, EVERY);
}

void watch();
