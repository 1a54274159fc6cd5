// @ts-check
// Tables and their scene, chosen or dropped on the page: read first, then imported.

import { complain, Refusal, send, toast } from "./api.js";
import { at, input, make } from "./dom.js";
import { several } from "./units.js";

const MOST = 1_900_000; // characters of a table that a request holds

/** @type {File[]} */
let tables = [];
/** @type {File | null} */
let scene = null;

/** @param {() => void} done when something was imported */
export function offerImport(done) {
  const dialog = /** @type {HTMLDialogElement} */ (at("import"));
  const open = () => {
    if (!dialog.open) dialog.showModal();
    read().catch(complain);
  };
  at("show-import").addEventListener("click", open);
  at("import-close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", () => take([]));
  input("import-tables").addEventListener("change", () => {
    tables = [...(input("import-tables").files ?? [])];
    read().catch(complain);
  });
  input("import-scene").addEventListener("change", () => {
    scene = input("import-scene").files?.[0] ?? null;
    read().catch(complain);
  });
  at("import-do").addEventListener("click", async () => {
    try {
      const answers = await each(false);
      dialog.close();
      const known = answers.filter((answer) => answer.known).length;
      toast(`Imported ${several(answers.length - known, "experiment")}${known ? `; ${known} were already stored` : ""}.`);
      done();
    } catch (problem) {
      refused(problem);
    }
  });
  addEventListener("dragover", (event) => {
    if (event.dataTransfer?.types.includes("Files")) event.preventDefault();
  });
  addEventListener("drop", (event) => {
    const files = [...(event.dataTransfer?.files ?? [])];
    if (!files.length) return;
    event.preventDefault();
    take([...tables, ...(scene ? [scene] : []), ...files]);
    open();
  });
}

/** Sorts files into tables and a scene. @param {File[]} files */
function take(files) {
  const named = new Map(files.map((file) => [file.name, file]));
  const all = [...named.values()];
  tables = all.filter((file) => /\.csv$/i.test(file.name));
  scene = all.filter((file) => /\.(ya?ml|json)$/i.test(file.name)).at(-1) ?? null;
  for (const [id, chosen] of /** @type {[string, File[]][]} */ ([["import-tables", tables], ["import-scene", scene ? [scene] : []]])) {
    const list = new DataTransfer();
    for (const file of chosen) list.items.add(file);
    input(id).files = list.files;
  }
}

/** Shows how the chosen tables would be read. */
async function read() {
  at("import-read").replaceChildren();
  at("import-problem").hidden = true;
  at("import-template").hidden = true;
  const go = /** @type {HTMLButtonElement} */ (at("import-do"));
  go.disabled = true;
  if (!tables.length) return;
  try {
    const answers = await each(true);
    at("import-read").replaceChildren(...answers.slice(0, 1).map((answer, k) => make("details", { open: true },
      make("summary", {}, tables[k].name + (tables.length > 1 ? `, and ${several(tables.length - 1, "table")} more` : "")),
      make("ul", {}, ...answer.understood.map((/** @type {string} */ sentence) => make("li", {}, sentence))))));
    go.disabled = false;
    if (answers[0].template) template(answers[0].template, tables[0].name);
  } catch (problem) {
    refused(problem);
  }
}

/** @param {string} text @param {string} name of the table */
function template(text, name) {
  const link = /** @type {HTMLAnchorElement} */ (at("import-template"));
  URL.revokeObjectURL(link.href);
  link.href = URL.createObjectURL(new Blob([text], { type: "text/yaml" }));
  link.download = `${name.replace(/\.csv$/i, "")}.scene.yaml`;
  link.hidden = false;
}

/** @param {unknown} problem */
function refused(problem) {
  if (!(problem instanceof Refusal)) return complain(problem);
  at("import-problem").hidden = false;
  at("import-problem").textContent = problem.message;
}

/** Sends each table with the scene. @param {boolean} dry */
async function each(dry) {
  const shared = scene ? await scene.text() : null;
  const answers = [];
  for (const file of tables) {
    const text = await file.text();
    if (text.length > MOST) {
      throw new Refusal({ status: 413, sentence: `${file.name} is too large for this page; run: fixel import ${file.name} --scene FILE` });
    }
    answers.push(await send("/import", { name: file.name, table: text, scene: shared, dry_run: dry }));
  }
  return answers;
}
