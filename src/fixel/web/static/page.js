// @ts-check
// What every page does: forms are sent as JSON, and parts that the server renders are fetched again.
//
// <form data-send="/path">   its fields are sent to the API, then the parts of the page are renewed;
//   data-said   words for the message afterwards, {name} from the answer
//   data-then   page to open instead of renewing, {name} from the answer
// <form data-live>           a filter: the parts change as one types, and with every choice or button;
//   data-said on a button   words for a message that offers the way back
// <a data-renew>             a link that changes parts of this page only
// <div id data-part>         is replaced by what the server renders; data-every: again after [ms];
//   data-part="alive"        only where it differs, so that buttons can be pressed and keep the keyboard
// <button data-copy>         copies a text
// <select data-sets="ID">    its value is written into the field of that id; also of a slider
// <select data-goes>         its value is the page to open
// <a data-key="j">           is opened by that key; a button is pressed by it
// <a data-goto>              is opened at once

import { ROOT, complain, copy, reach, send, toast } from "./api.js";
import { settled, typing } from "./dom.js";

let newest = 0;
let wanted = location.href; // address that is shown, or being fetched
let timer = 0;

/** Fetch this page, or one that it leads to, and show its parts. @param {string} [address] */
export async function renew(address = wanted) {
  wanted = address;
  newest += 1;
  const mine = newest;
  clearTimeout(timer); // a renewal by the clock would overtake one for another address
  const answer = await reach(address, { redirect: "error", headers: { "X-Fixel-Parts": "only" } })
    .finally(() => mine === newest && wait());
  const text = await answer.text();
  if (mine !== newest) return; // something else is wanted meanwhile
  exchange(text);
  if (address !== location.href) history.replaceState(null, "", address);
}

/** Show the parts of a page. @param {string} text of all of it */
export function exchange(text) {
  const fresh = new DOMParser().parseFromString(text, "text/html");
  // Without parts it is a page about an error, or the text for a browser that has an earlier server's cookie.
  if (!fresh.querySelector("[data-part]")) throw new Error((fresh.querySelector(".lead") ?? fresh.body).textContent ?? "");
  const focused = document.activeElement?.id;
  for (const part of document.querySelectorAll("[data-part]")) {
    const other = fresh.getElementById(part.id);
    if (!other || part.isEqualNode(other)) continue;
    const scrolled = [...part.querySelectorAll("[id]")].filter(({ scrollTop }) => scrollTop).map(({ id, scrollTop }) => ({ id, scrollTop }));
    if (part instanceof HTMLElement && part.dataset.part) change(part, document.adoptNode(other));
    else part.replaceWith(document.adoptNode(other));
    for (const { id, scrollTop } of scrolled) document.getElementById(id)?.scrollTo({ top: scrollTop });
  }
  // Fields that were changed meanwhile are sent next.
  for (const field of waiting.length ? [] : document.querySelectorAll("form[data-live] input")) {
    const other = fresh.getElementById(field.id);
    if (field instanceof HTMLInputElement && other instanceof HTMLInputElement && field !== document.activeElement) field.value = other.value;
  }
  if (focused && document.activeElement?.id !== focused) document.getElementById(focused)?.focus({ preventScroll: true });
  document.dispatchEvent(new Event("renewed"));
  wait();
}

/**
 * Make a node like another one. What is alike stays: a button that is replaced between press and release is not clicked.
 * @param {ChildNode} node @param {ChildNode} other
 */
function change(node, other) {
  if (node.isEqualNode(other)) return;
  const [own, others] = [[...node.childNodes], [...other.childNodes]];
  const alike = node instanceof Element && other instanceof Element && node.nodeName === other.nodeName
    && own.length === others.length && own.every(({ nodeName }, k) => nodeName === others[k]?.nodeName);
  if (!alike) {
    node.replaceWith(other);
    return;
  }
  for (const { name } of [...node.attributes]) if (!other.hasAttribute(name)) node.removeAttribute(name);
  for (const { name, value } of [...other.attributes]) node.setAttribute(name, value);
  own.forEach((child, k) => { const fresh = others[k]; if (fresh) change(child, fresh); });
}

/** Renew the page once more where a part of it says so. */
function wait() {
  clearTimeout(timer);
  const next = document.querySelector("a[data-goto]");
  if (next instanceof HTMLAnchorElement) location.replace(next.href);
  const part = document.querySelector("[data-every]");
  if (!part) return;
  const every = Number(part.getAttribute("data-every"));
  timer = window.setTimeout(() => {
    if (document.hidden) wait();
    else renew().catch(complain);
  }, every);
}

/** Fields of a form as the JSON that the API expects. @param {HTMLFormElement} form */
export function fieldsOf(form) {
  /** @type {Record<string, any>} */
  const body = JSON.parse(form.dataset.body ?? "{}");
  for (const field of form.elements) {
    if (!(field instanceof HTMLInputElement || field instanceof HTMLSelectElement || field instanceof HTMLTextAreaElement)) continue;
    if (!field.name || field.disabled) continue;
    if (field.type === "checkbox") body[field.name] = /** @type {HTMLInputElement} */ (field).checked;
    else if (field.type === "radio" && !(/** @type {HTMLInputElement} */ (field).checked)) continue;
    else if (field.value !== "") body[field.name] = field.type === "number" ? Number(field.value) : field.value;
  }
  return body;
}

/** @param {string} words @param {any} answer */
const filled = (words, answer) => words.replace(/\{(\w+)\}/g, (_, name) => String(answer?.[name] ?? ""));

/** @param {HTMLFormElement} form */
async function sent(form) {
  const button = form.querySelector("button:not([type=button])");
  const busy = form.querySelector(".busy");
  if (button instanceof HTMLButtonElement) button.disabled = true;
  if (busy instanceof HTMLElement) busy.hidden = false;
  try {
    const answer = await send(form.dataset.send ?? "", fieldsOf(form));
    if (form.dataset.said) toast(filled(form.dataset.said, answer));
    if (form.dataset.then) location.assign(ROOT + filled(form.dataset.then, answer));
    else await renew();
  } catch (problem) {
    complain(problem);
  }
  if (button instanceof HTMLButtonElement) button.disabled = false;
  if (busy instanceof HTMLElement) busy.hidden = true;
  // A button that is off has lost the keyboard; it gets it back unless it went elsewhere.
  if (button && document.activeElement === document.body) document.getElementById(button.id)?.focus();
}

let busy = false;
/** Buttons that were pressed; null stands for a slider. @type {(HTMLButtonElement | null)[]} */
const waiting = [];

/** Show what a filter selects. @param {HTMLFormElement} form */
function searched(form) {
  if (busy) inTurn(form);
  else renew(selects(form)).catch(complain);
}

/**
 * The same for sliders and buttons: one request at a time, with the values of then.
 * @param {HTMLFormElement} form
 * @param {HTMLButtonElement | null} [button]
 */
async function inTurn(form, button = null) {
  if (button || !waiting.length) waiting.push(button);
  if (busy) return;
  busy = true;
  while (waiting.length) {
    const pressed = waiting.shift();
    const before = location.href;
    await renew(selects(form, pressed)).catch(complain);
    if (pressed?.dataset.said) toast(pressed.dataset.said, { undo: () => renew(before) });
  }
  busy = false;
}

/** Address of what a form selects. @param {HTMLFormElement} form @param {HTMLButtonElement | null} [button] */
function selects(form, button) {
  const fields = [...new FormData(form)].filter(([, value]) => value !== "");
  const query = new URLSearchParams(/** @type {[string, string][]} */ (fields));
  if (button?.name) query.append(button.name, button.value);
  return `${location.pathname}${query.size ? `?${query}` : ""}`;
}

const typed = settled(searched, 150);

document.addEventListener("submit", (event) => {
  const form = /** @type {HTMLFormElement} */ (event.target);
  if (!form.matches("[data-send], [data-live]")) return;
  event.preventDefault();
  if (form.dataset.send) sent(form);
  else if (event.submitter) inTurn(form, /** @type {HTMLButtonElement} */ (event.submitter));
  else searched(form);
});
document.addEventListener("input", ({ target }) => {
  if (!(target instanceof HTMLInputElement) || !target.form?.matches("[data-live]")) return;
  const field = document.getElementById(target.dataset.sets ?? "");
  if (field instanceof HTMLInputElement) field.value = String(+Number(target.value).toPrecision(5));
  if (target.type === "range") inTurn(target.form);
  else {
    newest += 1; // an answer to what was there before would take back what is typed
    typed(target.form);
  }
});
document.addEventListener("change", ({ target }) => {
  if (target instanceof HTMLSelectElement && target.matches("[data-goes]")) location.assign(target.value);
  if (!(target instanceof HTMLSelectElement) || !target.form) return;
  const field = document.getElementById(target.dataset.sets ?? "");
  if (field instanceof HTMLInputElement) field.value = target.value;
  if (target.form.matches("[data-live]")) searched(target.form);
});
document.addEventListener("click", (event) => {
  const target = /** @type {Element} */ (event.target).closest("a[data-renew], button[data-copy]");
  if (!target || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  if (target.matches("a")) renew(new URL(target.getAttribute("href") ?? "", location.href).href).catch(complain);
  else copy(target.getAttribute("data-copy") ?? "", target.getAttribute("data-what") ?? "the command");
});
document.addEventListener("keydown", (event) => {
  if (typing(event) || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const pressed = document.querySelector(`[data-key="${CSS.escape(event.key)}"]`);
  if (!(pressed instanceof HTMLElement)) return;
  event.preventDefault();
  pressed.click();
});
const here = document.querySelector(".bar [aria-current]"); // on a phone, the navigation is wider than the page
if (here instanceof HTMLElement && here.parentElement) here.parentElement.scrollLeft = here.offsetLeft - 60;
wait();
