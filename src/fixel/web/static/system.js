// @ts-check
// Self-test, check and backup on demand.

import { complain, get, send, toast } from "./api.js";
import { ROOT, at, make } from "./dom.js";
import { bytes, several } from "./units.js";

/** @typedef {{name: string, path: string, size_bytes: number, made_utc: string}} Backup */
/** @typedef {{name: string, passed: boolean, detail: string, residual: number | null}} Check */
/** @typedef {{where: string, sentence: string, hint: string}} Trouble */

/**
 * Runs something that takes long, with its button off meanwhile.
 * @param {string} id of the button
 * @param {() => Promise<void>} work
 */
function onDemand(id, work) {
  const button = /** @type {HTMLButtonElement | null} */ (document.getElementById(id));
  button?.addEventListener("click", async () => {
    button.disabled = true;
    try {
      await work();
    } catch (problem) {
      complain(problem);
    }
    button.disabled = false;
    // A button that is off has lost the keyboard; it gets it back unless it went elsewhere.
    if (document.activeElement === document.body) button.focus();
  });
}

/** @param {string} id @param {string} words @param {"good" | "fault" | ""} kind */
function verdict(id, words, kind) {
  at(id).textContent = words;
  at(id).className = `tag ${kind}`;
}

onDemand("test", async () => {
  verdict("test-verdict", "running", "");
  let found;
  try {
    found = await send("/system/self-test");
  } catch (problem) {
    verdict("test-verdict", "not run", "");
    throw problem;
  }
  const failed = found.checks.filter((/** @type {Check} */ check) => !check.passed).length;
  verdict("test-verdict", failed ? `${failed} of ${found.checks.length} failed` : "all passed", failed ? "fault" : "good");
  at("test-words").textContent = `Took ${found.seconds.toFixed(1)} s. The largest allowed residual is ${found.allowed_residual}.`;
  at("test-region").hidden = false;
  at("test-rows").replaceChildren(...found.checks.map((/** @type {Check} */ check) => make("tr", {},
    make("td", {}, make("span", { class: check.passed ? "tag good" : "tag fault" }, check.passed ? "pass" : "fail"), ` ${check.name}`),
    make("td", {}, check.detail),
    make("td", { class: "number" }, check.residual === null ? "\u2013" : check.residual.toExponential(0)))));
});

onDemand("check", async () => {
  verdict("check-verdict", "reading everything", "");
  let found;
  try {
    found = await send("/system/check");
  } catch (problem) {
    verdict("check-verdict", "", "");
    throw problem;
  }
  verdict("check-verdict", found.ok ? "no errors" : several(found.n_trouble, "error"), found.ok ? "good" : "fault");
  const { counts } = found;
  at("check-words").textContent = `${several(counts.experiment ?? 0, "experiment")}, ${several(counts.simulation ?? 0, "simulation")}, `
    + `${several(counts.calibration ?? 0, "calibration")}; ${several(found.media_files, "media file")}.`;
  at("check-troubles").replaceChildren(...found.troubles.map((/** @type {Trouble} */ one) =>
    make("li", {}, `${one.where}: ${one.sentence}. ${one.hint}`)));
});

onDemand("backup", async () => {
  const { backup, sha256, media } = await send("/system/backups");
  toast(`Backed up to ${backup.path} (${bytes(backup.size_bytes)}, SHA-256 ${sha256.slice(0, 12)}\u2026). Copy ${media}, too.`);
  await backups();
});

async function backups() {
  /** @type {Backup[]} */
  const found = (await get("/system")).backups;
  at("no-backups").hidden = found.length > 0;
  at("backups").replaceChildren(...found.map((one) => make("li", {},
    make("a", { href: `${ROOT}/api/v1/system/backups/${encodeURIComponent(one.name)}`, download: one.name }, one.name),
    make("span", {}, bytes(one.size_bytes)),
    make("small", {}, one.path))));
  document.body.dataset.ready = "yes";
}

backups().catch(complain);
