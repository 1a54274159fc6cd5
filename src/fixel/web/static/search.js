// @ts-check
// Searches that a page starts as jobs: their progress, the button that stops them, commands to copy.

import { complain, copy, get, send } from "./api.js";
import { at } from "./dom.js";

/** @typedef {{name: string, state: string, ended: boolean, reason: string, stage: string}} Job */

let running = "";

/** @param {boolean} busy */
function show(busy) {
  /** @type {HTMLButtonElement} */ (at("start")).disabled = busy;
  at("stop").hidden = !busy;
}

/**
 * Start a search, show its progress until it ends, and open its result.
 * @param {string} resource address of the searches, as `/plan`
 * @param {Record<string, any>} request
 * @param {{what: string, every: number, result: () => string}} options
 *   name for people, time between two requests [ms], page of the result
 */
export async function search(resource, request, { what, every, result }) {
  try {
    show(true);
    /** @type {Job} */
    let now = await send(resource, request);
    running = now.name;
    while (!now.ended) {
      at("making").textContent = now.stage || "Starting ...";
      await new Promise((done) => setTimeout(done, every));
      now = await get(`${resource}/jobs/${encodeURIComponent(running)}`);
    }
    show(false);
    running = "";
    if (now.state === "done") location.assign(result());
    else at("making").textContent = now.reason || `The ${what} ended: ${now.state}.`;
  } catch (problem) {
    show(false);
    complain(problem);
  }
}

/**
 * Let the buttons of the page stop the search and copy commands.
 * @param {string} resource
 */
export function listenToButtons(resource) {
  document.getElementById("stop")?.addEventListener("click", async () => {
    try {
      await send(`${resource}/jobs/${encodeURIComponent(running)}/stop`);
    } catch (problem) {
      complain(problem);
    }
  });
  for (const button of document.querySelectorAll("button.copy")) {
    button.addEventListener("click", () => copy(button.getAttribute("data-text") ?? "", "the command"));
  }
}
