// @ts-check
// Flags, notes and deletions, each with a way back.

import { complain, get, send, toast } from "./api.js";
import { at, input, make } from "./dom.js";
import { several } from "./units.js";

/**
 * Asks in a dialog; gives whether it was done.
 * @param {string} id of the dialog
 * @returns {Promise<boolean>}
 */
function asked(id) {
  const dialog = /** @type {HTMLDialogElement} */ (at(id));
  dialog.returnValue = "";
  dialog.showModal();
  for (const button of dialog.querySelectorAll("[data-close]")) {
    /** @type {HTMLButtonElement} */ (button).onclick = () => dialog.close("");
  }
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "do"), { once: true });
  });
}

/**
 * @param {number[]} ids
 * @param {() => void} after what has changed
 */
export async function flag(ids, after) {
  if (!ids.length) return;
  at("flag-title").textContent = `Flag ${several(ids.length, "experiment")}`;
  get("/project").then(({ flags }) => {
    at("flag-names").replaceChildren(...Object.keys(flags).map((name) => make("option", { value: name })));
  }, complain);
  if (!(await asked("flag-dialog"))) return;
  const name = input("flag-name").value.trim();
  const body = { ids, name, detail: input("flag-detail").value.trim(), fault: input("flag-fault").checked };
  try {
    const { changed } = await send("/experiments/flag", body);
    after();
    if (!changed.length) toast(`All of them already have the flag ${name}.`);
    else {
      toast(`Flagged ${several(changed.length, "experiment")} as ${name}.`, {
        undo: () => send("/experiments/unflag", { ids: changed, name }).then(after),
      });
    }
  } catch (problem) {
    complain(problem);
  }
}

/**
 * @param {number[]} ids
 * @param {{name: string, detail: string, fault: boolean}} old
 * @param {() => void} after
 */
export async function unflag(ids, old, after) {
  try {
    const { changed } = await send("/experiments/unflag", { ids, name: old.name });
    after();
    toast(`Removed the flag ${old.name}.`, {
      undo: () => send("/experiments/flag", { ids: changed, ...old }).then(after),
    });
  } catch (problem) {
    complain(problem);
  }
}

/**
 * @param {number[]} ids
 * @param {() => void} after
 */
export async function note(ids, after) {
  if (!ids.length) return;
  at("note-title").textContent = `Note on ${several(ids.length, "experiment")}`;
  input("note-text").value = "";
  if (!(await asked("note-dialog"))) return;
  try {
    const { changed } = await send("/experiments/note", { ids, text: input("note-text").value });
    after();
    toast(`Added a note to ${several(ids.length, "experiment")}.`, {
      undo: () => send("/notes/delete", { ids: changed }).then(after),
    });
  } catch (problem) {
    complain(problem);
  }
}

/**
 * @param {number} id of the note
 * @param {() => void} after
 */
export async function deleteNote(id, after) {
  try {
    await send("/notes/delete", { ids: [id] });
    after();
    toast("Deleted the note.", { undo: () => send("/notes/undelete", { ids: [id] }).then(after) });
  } catch (problem) {
    complain(problem);
  }
}

/**
 * @param {number[]} ids
 * @param {() => void} after
 */
export async function remove(ids, after) {
  if (!ids.length) return;
  try {
    const { changed } = await send("/experiments/delete", { ids });
    after();
    toast(`Deleted ${several(changed.length, "experiment")}.`, {
      undo: () => send("/experiments/undelete", { ids: changed }).then(after),
    });
  } catch (problem) {
    complain(problem);
  }
}

/**
 * @param {number[]} ids
 * @param {() => void} after
 */
export async function restore(ids, after) {
  if (!ids.length) return;
  try {
    const { changed } = await send("/experiments/undelete", { ids });
    after();
    toast(`Restored ${several(changed.length, "experiment")}.`, {
      undo: () => send("/experiments/delete", { ids: changed }).then(after),
    });
  } catch (problem) {
    complain(problem);
  }
}
