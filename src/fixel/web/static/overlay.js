// @ts-check
import { at, follow, list, verdict, write } from "./live.js";

/** @type {Record<string, string>} */
const MARKS = { placed: "\u2713", off: "\u2717", "not-seen": "?", trouble: "!" };

/** @param {number | null} value @param {number} digits */
const signed = (value, digits) => {
  if (value === null) return "\u2013";
  const text = Math.abs(value).toFixed(digits);
  if (Number(text) === 0) return text;
  return (value < 0 ? "\u2212" : "+") + text;
};

/** @param {string} text @param {"td" | "th"} [kind] @returns {HTMLTableCellElement} */
function cell(text, kind = "td") {
  const node = document.createElement(kind);
  node.textContent = text;
  return node;
}

/** @param {any} part @param {number} decimals */
function row(part, decimals) {
  const node = document.createElement("tr");
  node.dataset.state = part.seen ? (part.within ? "placed" : "off") : "not-seen";
  const name = cell(part.name, "th");
  name.scope = "row";
  if (!part.seen) {
    const reason = cell(part.reason, "td");
    reason.colSpan = 3;
    reason.className = "reason";
    node.append(name, reason, cell("? not seen"));
    return node;
  }
  node.append(
    name,
    cell(signed(part.dx_mm, decimals)), cell(signed(part.dy_mm, decimals)),
    cell(signed(part.angle_deg, 2)),
    cell(part.within ? "\u2713 in place" : "\u2717 off"),
  );
  return node;
}

/** @param {any} part @param {{mm: number, deg: number}} within @param {number} decimals */
function guide(part, within, decimals) {
  at("guide").hidden = !part || !part.seen;
  if (!part || !part.seen) return;
  const moved = part.distance_mm <= within.mm;
  write("push", part.distance_mm.toFixed(decimals - 1));
  write("push-what", moved ? "position is right" : "push");
  // Angles of a picture grow downwards, as those of SVG do.
  at("push-arrow").setAttribute("transform", `rotate(${part.push_screen_deg.toFixed(0)})`);
  at("push-arrow").toggleAttribute("hidden", moved);
  at("push-done").toggleAttribute("hidden", !moved);
  const turned = Math.abs(part.angle_deg) <= within.deg;
  const clockwise = part.angle_deg > 0;
  write("turn", Math.abs(part.angle_deg).toFixed(1));
  write("turn-what", turned ? "angle is right" : clockwise ? "turn clockwise" : "turn counterclockwise");
  at("turn-arrow").setAttribute("transform", clockwise ? "" : "scale(-1 1)");
  at("turn-arrow").toggleAttribute("hidden", turned);
  at("turn-done").toggleAttribute("hidden", !turned);
}

follow((status) => {
  verdict(status.state, MARKS[status.state] ?? "", status.headline);
  const within = { mm: status.tolerance_mm, deg: status.tolerance_deg };
  write("tolerance", `${within.mm} mm, ${within.deg} deg`);
  const part = status.parts.find((/** @type {any} */ one) => one.name === status.to_place);
  guide(status.state === "trouble" ? null : part, within, status.decimals);
  at("parts").replaceChildren(...status.parts.map((/** @type {any} */ one) => row(one, status.decimals)));
  list("problems", status.problems);
  list("remarks", status.remarks);
});
