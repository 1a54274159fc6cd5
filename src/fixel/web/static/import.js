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
      const { read, skipped } = await each(false);
      dialog.close();
      const known = read.filter(({ answer }) => answer.known).length;
      toast(`Imported ${several(read.length - known, "experiment")}${known ? `; ${known} were already stored` : ""}${
        skipped.length ? `; skipped ${skipped.join("; ")}` : ""}.`);
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
    const { read, skipped } = await each(true);
    const [{ name, answer }] = read;
    at("import-read").replaceChildren(
      make("details", { open: true },
        make("summary", {}, name + (read.length > 1 ? `, and ${several(read.length - 1, "table")} more` : "")),
        make("ul", {}, ...answer.understood.map((/** @type {string} */ sentence) => make("li", {}, sentence)))),
      ...(skipped.length ? [make("p", {}, `Skipped ${several(skipped.length, "table")}:`),
        make("ul", { id: "import-skipped" }, ...skipped.map((sentence) => make("li", {}, sentence)))] : []));
    go.disabled = false;
    if (answer.template) template(answer.template, name);
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

/** Sends each table with the scene; tables that cannot be read are skipped. @param {boolean} dry */
async function each(dry) {
  const shared = scene ? await scene.text() : null;
  /** @type {{name: string, answer: any}[]} */
  const read = [];
  /** @type {string[]} */
  const skipped = [];
  for (const file of tables) {
    try {
      read.push({ name: file.name, answer: await sent(file, shared, dry) });
    } catch (problem) {
      if (!(problem instanceof Refusal) || tables.length === 1) throw problem;
      skipped.push(problem.message.includes(file.name) ? problem.message : `${file.name}: ${problem.message}`);
    }
  }
  if (!read.length) throw new Refusal({ status: 422, sentence: skipped.join("; ") });
  return { read, skipped };
}

/** @param {File} file @param {string | null} shared the scene @param {boolean} dry */
async function sent(file, shared, dry) {
  const text = await file.text();
  if (text.length > MOST) {
    throw new Refusal({ status: 413, sentence: `${file.name} is too large for this page; run: fixel import ${file.name} --scene FILE` });
  }
  return send("/import", { name: file.name, table: text, scene: shared, dry_run: dry });
}
