// @ts-check
// Asking fixel: JSON in and out, refusals as sentences, undo.

import { at, make, settled } from "./dom.js";

/** Path below which all pages are, as `/SECRET`: the cookie is sent with no other path. */
export const ROOT = new URL("..", import.meta.url).pathname.replace(/\/$/, "");
const BASE = `${ROOT}/api/v1`;
const SHOWN_FOR = 8000; // [ms]

/** What fixel answered instead of what was asked for. */
export class Refusal extends Error {
  /** @param {{sentence: string, status: number, where?: string | null, hint?: string | null}} problem */
  constructor(problem) {
    super(problem.sentence);
    this.problem = problem;
  }
}

export const word = () => document.querySelector('meta[name="fixel-word"]')?.getAttribute("content") ?? "";

/** @param {string} path below /api/v1 @param {Record<string, string>} [query] @returns {Promise<any>} */
export const get = (path, query = {}) => ask(`${path}?${new URLSearchParams(query)}`, {});

/**
 * Changes something.
 * @param {string} path
 * @param {any} [body]
 * @param {string} [method]
 * @param {AbortSignal} [signal]
 * @returns {Promise<any>}
 */
export function send(path, body, method = "POST", signal) {
  const headers = { "Content-Type": "application/json", "X-Fixel-Word": word() };
  return ask(path, { method, headers, signal, body: body === undefined ? undefined : JSON.stringify(body) });
}

/** Fetches; refuses where no server answers. @param {string} address @param {RequestInit} options */
export async function reach(address, options) {
  try {
    return await fetch(address, options);
  } catch (problem) {
    if (problem instanceof DOMException && problem.name === "AbortError") throw problem;
    throw new Refusal({ status: 0, sentence: "Cannot reach the fixel server. Is it still running?" });
  }
}

/** @param {string} path @param {RequestInit} options */
async function ask(path, options) {
  const answer = await reach(BASE + path, options);
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  // The link of an earlier server is refused with a text.
  const json = answer.headers.get("content-type") === "application/json";
  throw new Refusal({ status: answer.status, ...(json ? await answer.json() : { sentence: await answer.text() }) });
}

/** Of the messages that are there, the newest last. @type {(() => void)[]} */
let undos = [];

/**
 * Says something for a while, with a way back where there is one; a trouble that lasts is said once.
 * @param {string} sentence
 * @param {{undo?: () => Promise<unknown>, bad?: boolean}} [options]
 */
export function toast(sentence, { undo, bad = false } = {}) {
  const said = [...at("toasts").querySelectorAll(".bad")].find((one) => one.firstChild?.textContent === sentence);
  if (bad && said) return void said.dispatchEvent(new Event("again"));
  const close = () => {
    box.remove();
    undos = undos.filter((one) => one !== back);
  };
  const back = () => {
    close();
    if (undo) undo().catch(complain);
  };
  const stay = settled(close, bad ? 2 * SHOWN_FOR : SHOWN_FOR);
  const box = make("div", { class: bad ? "toast bad" : "toast", role: bad ? "alert" : null, onagain: stay },
    make("span", {}, sentence),
    undo ? make("button", { type: "button", class: "undo", onclick: back }, "Undo") : null,
    make("button", { type: "button", "aria-label": "Close", onclick: close }, "\u2715"));
  at("toasts").append(box);
  if (undo) undos.push(back);
  stay();
}

/** Takes back what the newest toast offers to; for Ctrl-Z. @returns {boolean} */
export function undoNewest() {
  const back = undos.at(-1);
  back?.();
  return back !== undefined;
}

/** Shows why something did not work. @param {unknown} problem */
export function complain(problem) {
  if (problem instanceof DOMException && problem.name === "AbortError") return;
  toast(problem instanceof Error ? problem.message : String(problem), { bad: true });
}

/** @param {string} text @param {string} what it is */
export async function copy(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    toast(`Copied ${what}.`);
  } catch {
    toast("The browser does not allow this page to copy; select the text and copy it.", { bad: true });
  }
}
