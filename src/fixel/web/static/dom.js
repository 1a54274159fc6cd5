// @ts-check
// Small functions for pages that are put together here. Texts go in as text, never as markup.

/** The element of an id; it is there, or the page is wrong. @param {string} id @returns {HTMLElement} */
export function at(id) {
  const node = document.getElementById(id);
  if (!node) throw new Error(`no element ${id}`);
  return node;
}

/** The input of an id. @param {string} id @returns {HTMLInputElement} */
export const input = (id) => /** @type {HTMLInputElement} */ (at(id));

/**
 * An element with attributes and children. `on…` are listeners, `class` and `data-…` attributes.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node | string | number | null | undefined)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function make(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/**
 * The same for SVG.
 * @param {string} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node | string | number | null | undefined)} children
 * @returns {SVGElement}
 */
export function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

/**
 * @template {Element} E
 * @param {E} node
 * @param {Record<string, any>} attributes
 * @param {(Node | string | number | null | undefined)[]} children
 */
function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) {
    if (child !== null && child !== undefined) node.append(child instanceof Node ? child : String(child));
  }
  return node;
}

/**
 * Runs only once the calls have paused.
 * @template {any[]} A
 * @param {(...given: A) => void} action
 * @param {number} pause [ms]
 * @returns {(...given: A) => void}
 */
export function settled(action, pause) {
  let timer = 0;
  return (...given) => {
    clearTimeout(timer);
    timer = window.setTimeout(() => action(...given), pause);
  };
}

// A number field drops a decimal comma, so that 1,5 would be 15.
document.addEventListener("beforeinput", (event) => {
  if (!event.data?.includes(",") || !(event.target instanceof HTMLInputElement) || event.target.type !== "number") return;
  event.preventDefault();
  document.execCommand("insertText", false, event.data.replace(",", "."));
});

/** Whether keys are meant for a field that is written into. @param {Event} event */
export const typing = (event) =>
  event.target instanceof Element && event.target.matches("input:not([type=checkbox], [type=radio], [type=range]), textarea, select, [contenteditable]");
