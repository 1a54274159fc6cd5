// @ts-check
// The domain: a slider for the threshold, and arrow keys that go from cell to cell.

import { input } from "./dom.js";

const STEPS = 1000;
const slider = input("slider");

slider.addEventListener("input", () => {
  const [low, high] = [Number(slider.dataset.low), Number(slider.dataset.high)];
  input("threshold").value = String(+(low * (high / low) ** (Number(slider.value) / STEPS)).toPrecision(3));
});

document.addEventListener("keydown", (event) => {
  const way = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] })[event.key];
  const here = /** @type {HTMLElement} */ (event.target);
  const cell = here.closest("td");
  if (!way || !cell || event.altKey) return;
  event.preventDefault();
  const row = /** @type {HTMLTableRowElement} */ (cell.parentElement);
  const to = way[1] ? /** @type {HTMLTableSectionElement} */ (row.parentElement).rows[row.sectionRowIndex + way[1]] : row;
  const next = to?.cells[cell.cellIndex + way[0]]?.querySelector("button");
  if (!next) return;
  here.tabIndex = -1;
  next.tabIndex = 0;
  next.focus();
});
