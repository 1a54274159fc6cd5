// @ts-check
// Next pushes: starts a proposal and shows its progress until it is stored.

import { ROOT, input } from "./dom.js";
import { listenToButtons, search } from "./search.js";

const EVERY = 1000; // [ms]

/** @param {string} id */
const value = (id) => /** @type {HTMLSelectElement | null} */ (document.getElementById(id))?.value ?? "";

document.getElementById("propose")?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const request = { part: value("part"), surface: value("surface"), number: Number(input("number").value) || 5 };
  await search("/next", request, { what: "proposal", every: EVERY, result: () => `${ROOT}/next` });
});

document.getElementById("which")?.addEventListener("change", () => {
  location.assign(`${ROOT}/next?proposal=${encodeURIComponent(value("which"))}`);
});

listenToButtons("/next");
