// @ts-check
// Tables and their scene, chosen or dropped on the page: read first, then imported.

import { complain, Refusal, send, toast } from "./api.js";
import { at, input, make } from "./dom.js";
import { several } from "./units.js";

const MOST = 1_900_000; // characters of a table that a request holds

/** @param {() => unknown} done when something was imported */
export function offerImport(done) {
  const dialog = /** @type {HTMLDialogElement} */ (at("import"));
  const open = () => {
    if (!dialog.open) dialog.showModal();
    read().catch(complain);
  };
  at("show-import").addEventListener("click", open);
  at("import-close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", () => take([]));
  dialog.addEventListener("change", () => read().catch(complain));
  at("import-do").addEventListener("click", async () => {
    try {
      const { answers, skipped } = await each(false);
      dialog.close();
      const [stored, known, replaced] = ["stored", "known", "replaced"].map((name) => answers.reduce((sum, answer) => sum + answer[name], 0));
      const more = [replaced && `replaced ${several(replaced, "earlier experiment")} of the same name`, known && `${known} were already stored`, skipped.length && `skipped ${skipped.join("; ")}`];
      toast(`Imported ${[several(stored, "experiment"), ...more.filter(Boolean)].join("; ")}.`);
      await done();
    } catch (problem) {
      refused(problem);
    }
  });
  addEventListener("dragover", (event) => event.dataTransfer?.types.includes("Files") && event.preventDefault());
  addEventListener("drop", (event) => {
    const files = [...(event.dataTransfer?.files ?? [])];
    if (!files.length) return;
    event.preventDefault();
    take([...chosen("import-tables"), ...chosen("import-scene"), ...files]);
    open();
  });
}

/** @param {string} id */
const chosen = (id) => [...(input(id).files ?? [])];

/** Sorts files into tables and a scene. @param {File[]} files */
function take(files) {
  const named = [...new Map(files.map((file) => [file.name, file])).values()];
  const sorted = { "import-tables": named.filter(({ name }) => /\.csv$/i.test(name)), "import-scene": named.filter(({ name }) => /\.(ya?ml|json)$/i.test(name)).slice(-1) };
  for (const [id, some] of Object.entries(sorted)) {
    const list = new DataTransfer();
    for (const file of some) list.items.add(file);
    input(id).files = list.files;
  }
}

let readings = 0;

/** Shows how the chosen tables would be read, unless they were read again meanwhile. */
async function read() {
  const own = ++readings;
  const tables = chosen("import-tables");
  const go = /** @type {HTMLButtonElement} */ (at("import-do"));
  const link = /** @type {HTMLAnchorElement} */ (at("import-template"));
  at("import-read").replaceChildren();
  at("import-problem").hidden = link.hidden = go.disabled = true;
  if (!tables.length) return;
  try {
    const { answers: [first], skipped } = await each(true);
    if (own !== readings) return;
    at("import-read").replaceChildren(
      make("details", { open: true },
        make("summary", {}, first.name + (tables.length > 1 ? `, and ${several(tables.length - 1, "table")} more` : "")),
        make("ul", {}, ...first.understood.map((/** @type {string} */ sentence) => make("li", {}, sentence)))),
      ...(skipped.length ? [make("p", {}, `Skipped ${skipped.length}:`),
        make("ul", { id: "import-skipped" }, ...skipped.map((sentence) => make("li", {}, sentence)))] : []));
    go.disabled = false;
    link.hidden = !first.template;
    link.href = `data:text/yaml;charset=utf-8,${encodeURIComponent(first.template)}`;
    link.download = `${first.name.replace(/\.csv$/i, "")}.scene.yaml`;
  } catch (problem) {
    if (own === readings) refused(problem);
  }
}

/** @param {unknown} problem */
function refused(problem) {
  if (!(problem instanceof Refusal)) return complain(problem);
  at("import-problem").hidden = false;
  at("import-problem").textContent = problem.message;
}

/** Sends each table with the scene; of several, those that cannot be read are skipped. @param {boolean} dry */
async function each(dry) {
  const tables = chosen("import-tables");
  const scene = (await chosen("import-scene")[0]?.text()) ?? null;
  /** @type {any[]} */
  const answers = [];
  /** @type {string[]} */
  const skipped = [];
  for (const file of tables) {
    const { name } = file;
    try {
      const table = await file.text();
      if (table.length > MOST) throw new Refusal({ status: 413, sentence: `${name} is too large for this page; run: fixel import ${name} --scene FILE` });
      answers.push({ name, ...await send("/import", { name, table, scene, split_by: input("import-split").value.trim() || null, dry_run: dry }) });
      skipped.push(...answers[answers.length - 1].skipped);
    } catch (problem) {
      if (!(problem instanceof Refusal) || tables.length === 1) throw problem;
      skipped.push(problem.message.includes(name) ? problem.message : `${name}: ${problem.message}`);
    }
  }
  if (!answers.length) throw new Refusal({ status: 422, sentence: skipped.join("; ") });
  return { answers, skipped };
}
