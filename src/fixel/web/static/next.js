// @ts-check
// Next pushes: starts a proposal and shows its progress until it is stored.

import { complain, copy, get, send } from "./api.js";
import { ROOT, at, input } from "./dom.js";

/** @typedef {{name: string, state: string, ended: boolean, reason: string, stage: string}} Job */

const EVERY = 1000; // [ms]
let running = "";

/** @param {string} id */
const value = (id) => /** @type {HTMLSelectElement | null} */ (document.getElementById(id))?.value ?? "";

/** @param {boolean} busy */
function show(busy) {
  /** @type {HTMLButtonElement} */ (at("start")).disabled = busy;
  at("stop").hidden = !busy;
}

/** @param {Job} job */
async function follow(job) {
  running = job.name;
  show(true);
  let now = job;
  while (!now.ended) {
    at("making").textContent = now.stage || "Starting ...";
    await new Promise((done) => setTimeout(done, EVERY));
    now = await get(`/next/jobs/${encodeURIComponent(job.name)}`);
  }
  show(false);
  running = "";
  if (now.state === "done") {
    location.assign(`${ROOT}/next`);
    return;
  }
  at("making").textContent = now.reason || `The proposal ended: ${now.state}.`;
}

document.getElementById("propose")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    show(true);
    await follow(await send("/next", { part: value("part"), surface: value("surface"), number: Number(input("number").value) || 5 }));
  } catch (problem) {
    show(false);
    complain(problem);
  }
});

document.getElementById("stop")?.addEventListener("click", async () => {
  try {
    await send(`/next/jobs/${encodeURIComponent(running)}/stop`);
  } catch (problem) {
    complain(problem);
  }
});

document.getElementById("which")?.addEventListener("change", () => {
  location.assign(`${ROOT}/next?proposal=${encodeURIComponent(value("which"))}`);
});

for (const button of document.querySelectorAll("button.copy")) {
  button.addEventListener("click", () => copy(button.getAttribute("data-text") ?? "", "the command"));
}
