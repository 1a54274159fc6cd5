// @ts-check
// What all pages with a live picture share: the status stream, and saying so when it falls silent.

import { at } from "./dom.js";

const SILENT_AFTER = 3000; // [ms]

export const path = document.body.dataset.path;
export { at };

/** @param {string} id @param {string} text */
export function write(id, text) {
  const node = at(id);
  if (node.textContent !== text) node.textContent = text;
}

/** @param {string} id @param {string[]} sentences */
export function list(id, sentences) {
  const node = at(id);
  const key = sentences.join("\n");
  if (node.dataset.key === key) return;
  node.dataset.key = key;
  node.replaceChildren(...sentences.map((sentence) => {
    const item = document.createElement("li");
    item.textContent = sentence;
    return item;
  }));
  node.hidden = sentences.length === 0;
}

/** @param {string} state @param {string} mark @param {string} words */
export function verdict(state, mark, words) {
  at("verdict").dataset.state = state;
  document.body.dataset.state = state;
  write("mark", mark);
  write("verdict-words", words);
}

/** @param {string} address @returns {Promise<any>} */
export async function tell(address) {
  const word = /** @type {HTMLMetaElement} */ (document.querySelector('meta[name="fixel-word"]')).content;
  const answer = await fetch(address, { method: "POST", headers: { "X-Fixel-Word": word } });
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

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

// Calls `show(status)` with every report.
/** @param {(status: any) => void} show */
export function follow(show) {
  let newest = performance.now();
  let ended = false;
  let lost = false;
  if (document.readyState === "complete") look();
  else addEventListener("load", () => setTimeout(look));
  // A page that nobody sees lets go of the pictures: a browser has six connections to share.
  document.addEventListener("visibilitychange", () => {
    if (ended) return;
    if (document.hidden) at("picture").removeAttribute("src");
    else look();
  });
  const source = new EventSource(`${path}/events`);
  source.onmessage = (event) => {
    newest = performance.now();
    if (lost) look();
    lost = false;
    silence("");
    write("link-state", "live");
    const status = JSON.parse(event.data);
    if (Object.keys(status).length) show(status);
  };
  source.addEventListener("end", () => {
    ended = true;
    source.close();
    write("link-state", "ended");
    silence("The fixel command has ended. Start it again and open its new link.");
  });
  source.onerror = () => {
    lost = true;
    if (!ended) write("link-state", "no connection");
  };
  setInterval(() => {
    const quiet = performance.now() - newest;
    if (ended || quiet < SILENT_AFTER) return;
    const seconds = Math.round(quiet / 1000);
    silence(lost
      ? `Cannot reach fixel since ${seconds} s. Is it still running?`
      : `No new picture since ${seconds} s. Is the camera still connected?`);
  }, 500);
}
