// @ts-check
// Flags, notes and deletions, each with a way back.

import { complain, send, toast, undoNewest } from "./api.js";
import { at, input, typing } from "./dom.js";
import { several } from "./units.js";

/** @typedef {() => unknown} After what follows a change */

/**
 * Send a change, say what was done, and offer the way back.
 * @param {string} path
 * @param {Record<string, any>} body
 * @param {After} after
 * @param {(changed: number[]) => string} words
 * @param {(changed: number[]) => [string, Record<string, any>]} back path and body that undo it
 */
async function mark(path, body, after, words, back) {
  try {
    const { changed } = await send(path, body);
    await after();
    const undo = async () => {
      await send(...back(changed));
      await after();
    };
    toast(words(changed), changed.length ? { undo } : {});
  } catch (problem) {
    complain(problem);
  }
}

/**
 * Ask in a dialog; return whether it was confirmed.
 * @param {string} id of the dialog
 * @param {string} title
 * @returns {Promise<boolean>}
 */
function asked(id, title) {
  const dialog = /** @type {HTMLDialogElement} */ (at(`${id}-dialog`));
  at(`${id}-title`).textContent = title;
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "do"), { once: true });
  });
}

/** @param {number[]} ids @param {After} after */
export async function flag(ids, after) {
  if (!ids.length || !(await asked("flag", `Flag ${several(ids.length, "experiment")}`))) return;
  const name = input("flag-name").value.trim();
  const body = { ids, name, detail: input("flag-detail").value.trim(), fault: input("flag-fault").checked };
  await mark("/experiments/flag", body, after,
    (changed) => (changed.length ? `Flagged ${several(changed.length, "experiment")} as ${name}.` : `All of them already have the flag ${name}.`),
    (changed) => ["/experiments/unflag", { ids: changed, name }]);
}

/** @param {number[]} ids @param {{name: string, detail: string, fault: boolean}} old @param {After} after */
export const unflag = (ids, old, after) => mark("/experiments/unflag", { ids, name: old.name }, after,
  () => `Removed the flag ${old.name}.`, (changed) => ["/experiments/flag", { ids: changed, ...old }]);

/** @param {number[]} ids @param {After} after */
export async function note(ids, after) {
  input("note-text").value = "";
  if (!ids.length || !(await asked("note", `Note on ${several(ids.length, "experiment")}`))) return;
  await mark("/experiments/note", { ids, text: input("note-text").value }, after,
    () => `Added a note to ${several(ids.length, "experiment")}.`, (changed) => ["/notes/delete", { ids: changed }]);
}

/** @param {number} id of the note @param {After} after */
export const deleteNote = (id, after) => mark("/notes/delete", { ids: [id] }, after,
  () => "Deleted the note.", () => ["/notes/undelete", { ids: [id] }]);

/** @param {number[]} ids @param {After} after @param {boolean} restore whether they are deleted now */
export async function remove(ids, after, restore) {
  const [path, back] = restore ? ["undelete", "delete"] : ["delete", "undelete"];
  if (!ids.length) return;
  await mark(`/experiments/${path}`, { ids }, after,
    (changed) => `${restore ? "Restored" : "Deleted"} ${several(changed.length, "experiment")}.`,
    (changed) => [`/experiments/${back}`, { ids: changed }]);
}

document.addEventListener("keydown", (event) => {
  const asked = (event.ctrlKey || event.metaKey) && event.key === "z" && !typing(event) && !document.querySelector("dialog[open]");
  if (asked && undoNewest()) event.preventDefault();
});
