// @ts-check
// Pages with a live picture: the server renders the status anew with each report; a page says when it falls silent.

import { complain, reach, word } from "./api.js";
import { at } from "./dom.js";
import { exchange } from "./page.js";

const SILENT_AFTER = 3000; // [ms]
const path = document.body.dataset.path;
let newest = performance.now();
let ended = false;
let lost = false;

// The stream of pictures never ends, and a page that waits for it would never be loaded.
function look() {
  at("picture").hidden = false;
  /** @type {HTMLImageElement} */ (at("picture")).src = `${path}/stream?from=${Math.round(performance.now())}`;
}

/** @param {string} sentence */
function silence(sentence) {
  const node = at("silence");
  node.hidden = !sentence;
  if (sentence && node.textContent !== sentence) node.textContent = sentence;
  document.body.classList.toggle("silent", Boolean(sentence));
}

if (document.readyState === "complete") look();
else addEventListener("load", () => setTimeout(look));
// A page that nobody sees lets go of the pictures: a browser has six connections to share.
document.addEventListener("visibilitychange", () => {
  if (ended) return;
  if (document.hidden) at("picture").removeAttribute("src");
  else look();
});
const source = new EventSource(`${path}/events`);
source.addEventListener("page", ({ data }) => {
  newest = performance.now();
  if (lost) look();
  lost = false;
  silence("");
  at("link-state").textContent = "live";
  exchange(JSON.parse(data));
});
source.addEventListener("end", () => {
  ended = true;
  source.close();
  at("link-state").textContent = "ended";
  silence("The fixel command has ended. Start it again and open its new link.");
});
source.onerror = () => {
  lost = true;
  if (!ended) at("link-state").textContent = "no connection";
};
setInterval(() => {
  const quiet = performance.now() - newest;
  if (ended || quiet < SILENT_AFTER) return;
  const seconds = Math.round(quiet / 1000);
  silence(lost
    ? `Cannot reach fixel since ${seconds} s. Is it still running?`
    : `No new picture since ${seconds} s. Is the camera still connected?`);
}, 500);

/** Tell the server something. @param {string} what @param {object} said */
async function tell(what, said = {}) {
  const answer = await reach(`${path}/${what}`, {
    method: "POST", headers: { "X-Fixel-Word": word(), "Content-Type": "application/json" }, body: JSON.stringify(said),
  });
  if (!answer.ok) throw new Error(await answer.text());
}

// A stop counts from the press on, whatever happens until the release.
document.addEventListener("pointerdown", ({ target }) => {
  if (target instanceof Element && target.closest("button[data-do=stop]")) tell("act", { do: "stop" }).catch(complain);
});
document.addEventListener("click", async ({ target }) => {
  const button = target instanceof Element ? target.closest("button[data-post]") : null;
  if (!(button instanceof HTMLButtonElement)) return;
  button.disabled = true;
  try {
    await tell(button.dataset.post ?? "", { do: button.dataset.do ?? "", row: button.dataset.row ?? "" });
  } catch (problem) {
    complain(problem);
  }
  if (button.dataset.do) setTimeout(() => { button.disabled = false; }, 500);
});
// While something moves, the server stops it if this page falls silent.
setInterval(() => {
  if (document.querySelector("[data-alive]")) tell("alive").catch(() => {});
}, 500);
