// @ts-check
// Carries out a plan on the simulated testbed.

import { complain, send } from "./api.js";
import { at } from "./dom.js";

at("try").addEventListener("click", async (event) => {
  const button = /** @type {HTMLButtonElement} */ (event.currentTarget);
  button.disabled = true;
  try {
    const name = at("of-plan").getAttribute("data-name") ?? "";
    const answer = await send(`/plan/${encodeURIComponent(name)}/trials`);
    at("trials").textContent = answer.lines.join("\n");
  } catch (problem) {
    complain(problem);
  }
  button.disabled = false;
});
