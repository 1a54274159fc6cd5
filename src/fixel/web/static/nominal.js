// @ts-check
// Simulations with nominal values of experiments that have none: what the errors before are of.

import { complain, get, send, toast } from "./api.js";
import { at } from "./dom.js";
import { count, several } from "./units.js";

const AT_ONCE = 20; // experiments a request; about a second

export class Nominal {
  /** @param {() => void} after some were simulated */
  constructor(after) {
    this.after = after;
    /** @type {number[]} */
    this.ids = [];
    /** @type {Set<number>} those that cannot be simulated */
    this.refused = new Set();
    this.running = false;
    at("simulate").addEventListener("click", () => {
      if (this.running) this.running = false;
      else this.#run().catch(complain);
    });
  }

  /** @param {string} filter */
  async offer(filter) {
    this.filter = filter;
    if (!this.running) at("simulate").hidden = true; // what it said was of another filter
    const { ids } = await get("/experiments/unsimulated", { filter });
    if (this.running || filter !== this.filter) return;
    this.ids = ids.filter((/** @type {number} */ id) => !this.refused.has(id));
    at("simulate").hidden = this.ids.length === 0;
    at("simulate").textContent = `Simulate ${several(this.ids.length, "experiment")} with nominal values`;
  }

  async #run() {
    const ids = this.ids;
    /** @type {string[]} */
    const reasons = [];
    let done = 0;
    this.running = true;
    at("simulate").textContent = "Stop";
    try {
      for (let k = 0; k < ids.length && this.running; k += AT_ONCE) {
        at("simulating").textContent = `simulated ${count(k)} of ${count(ids.length)}`;
        const { stored, refused } = await send("/experiments/simulate", { ids: ids.slice(k, k + AT_ONCE) });
        done += stored.length;
        for (const [id, reason] of Object.entries(refused)) {
          this.refused.add(Number(id));
          reasons.push(/** @type {string} */ (reason));
        }
      }
      toast(`Simulated ${several(done, "experiment")} with nominal values.`
        + (reasons.length ? ` ${several(reasons.length, "experiment")} could not be simulated: ${reasons[0]}` : ""));
    } finally {
      this.running = false;
      at("simulating").textContent = "";
      at("simulate").hidden = true; // until it is known how many are left
      this.after();
    }
  }
}
