// @ts-check
// The list of calibrations: those that run, and what came of those that ended.

import { complain, get } from "./api.js";
import { ROOT, at, make } from "./dom.js";
import { digits, lasting, rms, verdictOf } from "./quantity.js";
import { several } from "./units.js";

/** @typedef {import("./calibrating.js").Running} Running */
/** @typedef {{id: number, name: string, how: string, mode: string, optimiser: string, engine: string, unit: string, created_utc: string, sets: number, experiments: number, before: number | null, after: number | null, verdicts: Record<string, number>}} Listed */

const PAGE = 100;
const AGAIN = 2000; // [ms] until running ones are looked at again
let asked = PAGE;
let timer = 0;

async function refresh() {
  /** @type {{calibrations: Listed[], total: number, running: Running[], unreadable: string[]}} */
  const all = await get("/calibrations", { limit: asked });
  at("unreadable").replaceChildren(...all.unreadable.map((sentence) => make("p", { class: "notice" }, sentence)));
  at("running").replaceChildren(...all.running.map(card));
  at("running-section").hidden = all.running.length === 0;
  at("rows").replaceChildren(...all.calibrations.map(row));
  at("list-section").hidden = all.calibrations.length === 0;
  at("nothing").hidden = all.calibrations.length + all.running.length > 0;
  at("more").hidden = all.calibrations.length >= all.total;
  at("calibrations").dataset.ready = "yes";
  clearTimeout(timer);
  if (all.running.some((one) => !one.ended)) timer = window.setTimeout(again, AGAIN);
}

function again() {
  if (document.hidden) timer = window.setTimeout(again, AGAIN);
  else refresh().catch(() => { timer = window.setTimeout(again, 5 * AGAIN); });
}

/** @param {Running} one */
function card(one) {
  const best = rms(one.best, one.unit);
  const left = one.left_s === null ? "" : `${one.at_most ? "at most " : ""}${lasting(one.left_s)} left`;
  const told = [
    several(one.experiments, "experiment"), one.mode, one.optimiser,
    one.evaluations ? several(one.evaluations, "evaluation") : "",
    one.share === null ? "" : `${Math.floor(100 * one.share)} %`,
    best === null ? "" : `best ${digits(best)} mm`, left,
  ];
  return make(
    "li", { class: "card run-card" },
    make("a", { href: `${ROOT}/calibrations/running/${encodeURIComponent(one.name)}` }, one.label),
    make("span", { class: `tag ${one.ended ? "simulated" : "good"}` }, one.state),
    make("span", { class: "told" }, told.filter(Boolean).join(", ")),
  );
}

/** @param {Listed} one */
function row(one) {
  const [before, after] = [rms(one.before, one.unit), rms(one.after, one.unit)];
  return make(
    "tr", {},
    make("th", { scope: "row" },
      make("a", { href: `${ROOT}/calibrations/${one.id}` }, one.name),
      ...(one.engine ? [" ", make("span", { class: "tag" }, one.engine)] : []),
      make("small", {}, one.sets > 1 ? `${one.mode}, ${one.sets} sets` : one.how)),
    make("td", { class: "number" }, one.experiments),
    make("td", {}, one.optimiser || "\u2013"),
    make("td", { class: "number" }, digits(before)),
    make("td", { class: "number" }, make("strong", {}, digits(after))),
    make("td", {}, ...Object.entries(one.verdicts).map(([verdict, n]) => {
      const { sign, kind } = verdictOf(verdict);
      return make("span", { class: `tag ${kind}` }, `${sign} ${n} ${verdict}`);
    })),
    make("td", { class: "when" }, one.created_utc ? `${one.created_utc.slice(0, 10)} ${one.created_utc.slice(11, 16)}` : "\u2013"),
  );
}

at("more").addEventListener("click", () => {
  asked = Math.min(500, asked + PAGE);
  refresh().catch(complain);
});
refresh().catch(complain);
