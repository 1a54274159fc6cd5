// @ts-check
// Fields for what is chosen in the scene editor, in the units people use; each knows the key of the
// scene file that it changes, so that a refusal can be shown beside it.

import { make } from "./dom.js";
import { poseOf, place, tidy } from "./scene.js";

/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./scene.js").Choice} Choice */
/**
 * One field.
 * @typedef {object} Field
 * @property {string} label
 * @property {string} unit
 * @property {string} where key of the scene file
 * @property {() => number | string | undefined} get as shown
 * @property {(value: any) => void} set from what is shown; undefined where it was emptied
 * @property {"number" | "text"} [kind]
 * @property {[string, string][]} [options] value and words, for a choice
 * @property {boolean} [empty] whether it may be left empty
 * @property {string} [hint]
 */

/** Factors from SI. @type {Record<string, number>} */
const UNITS = { mm: 1e3, deg: 180 / Math.PI, g: 1e3, "mm/s": 1e3, "N mm": 1e3, N: 1, s: 1, "": 1 };

// Numbers of a thing: key below the thing, label, unit, and what an empty field means.
/** @typedef {[string, string, string, string?]} Known */
/** @type {Known[]} */
const SUPPORT = [
  ["support.tripod.friction", "friction with the plane", ""],
  ["support.tripod.radius", "tripod radius", "mm"],
  ["support.tripod.angle", "tripod angle", "deg"],
  ["support.uniform.friction", "friction with the plane", ""],
  ["support.points.friction", "friction with the plane", ""],
  ["support.ellipsoid.force", "largest force", "N"],
  ["support.ellipsoid.torque", "largest torque", "N mm"],
];
/** @type {Known[]} */
const DRIVE = [["drive.speed", "speed", "mm/s"], ["drive.travel", "travel", "mm", "no limit"]];
/** @type {Known} */
const FORCE_LIMIT = ["drive.force_limit", "force limit", "N", "a rigid drive"];

/**
 * @param {string} label
 * @param {string} unit
 * @param {string} where
 * @param {() => number | undefined} get SI
 * @param {(value: number) => void} set SI
 * @param {Partial<Field>} [more]
 * @returns {Field}
 */
const number = (label, unit, where, get, set, more = {}) => ({
  label, unit, where, kind: "number",
  get: () => {
    const value = get();
    return value === undefined ? undefined : Number((UNITS[unit] * value).toPrecision(6));
  },
  set: (value) => set(value === undefined ? value : tidy(value / UNITS[unit])),
  ...more,
});

/**
 * Fields of those known numbers that a thing has.
 * @param {Record<string, any>} thing
 * @param {string} where
 * @param {...Known} known
 */
const numbers = (thing, where, ...known) => known.flatMap(([path, label, unit, empty]) => {
  const keys = path.split(".");
  const last = /** @type {string} */ (keys.pop());
  const record = keys.reduce((/** @type {any} */ one, key) => one?.[key], thing);
  if (!record || Array.isArray(record[last])) return []; // every point may have its own friction
  return [number(label, unit, `${where}.${path}`, () => record[last], (value) => {
    if (value === undefined) delete record[last];
    else record[last] = value;
  }, empty === undefined ? {} : { empty: true, hint: `empty: ${empty}` })];
});

/** Fields of a thing. @param {Record<string, any>} thing @param {Choice} choice @returns {Field[]} */
export function thingFields(thing, choice) {
  const where = `${choice.kind}[${choice.index}]`;
  const { drive } = thing;
  const path = Boolean(drive?.waypoints);
  const pose = /** @type {[string, string][]} */ ([["x", "mm"], ["y", "mm"], ["angle", "deg"]]).slice(0, path ? 2 : 3)
    .map(([label, unit], axis) => number(
      label, unit, path ? `${where}.drive` : `${where}.pose[${axis}]`,
      () => poseOf(thing)[axis],
      (value) => place(thing, poseOf(thing).map((/** @type {number} */ old, /** @type {number} */ k) => (k === axis ? value : old))),
    ));
  return [
    { label: "name", unit: "", where: `${where}.name`, kind: "text", get: () => thing.name, set: (value) => { thing.name = value ?? ""; } },
    ...pose,
    ...shapeFields(thing, `${where}.shape`),
    ...(choice.kind === "bodies" ? bodyFields(thing, where) : numbers(thing, where, ["friction", "friction", ""])),
    ...(drive && !path ? [number(
      "drive direction", "deg", `${where}.drive.direction`,
      () => Math.atan2(drive.direction[1], drive.direction[0]),
      (value) => { drive.direction = [tidy(Math.cos(value)), tidy(Math.sin(value))]; },
    ), ...numbers(thing, where, ...DRIVE)] : []),
    ...(drive ? numbers(thing, where, FORCE_LIMIT) : []),
  ];
}

/** @param {Record<string, any>} thing @param {string} where @returns {Field[]} */
function shapeFields(thing, where) {
  const shape = thing.shape;
  const now = shape.disk !== undefined ? "disk" : isBox(shape.polygon) ? "box" : "polygon";
  /** @type {Field} */
  const kind = {
    label: "shape", unit: "", where,
    options: [["disk", "disk"], ["box", "box"], .../** @type {[string, string][]} */ (now === "polygon" ? [["polygon", `polygon of ${shape.polygon.length}`]] : [])],
    get: () => now,
    set: (value) => {
      const [width, height] = sizeOf(shape);
      if (value === "disk") thing.shape = { disk: tidy(Math.min(width, height) / 2) };
      if (value === "box") thing.shape = { polygon: box(width, height) };
    },
  };
  if (now === "disk") return [kind, ...numbers(thing, where.replace(/\.shape$/, ""), ["shape.disk", "radius", "mm"])];
  return [kind, ...["width", "height"].map((label, axis) => number(
    label, "mm", `${where}.polygon`,
    () => sizeOf(shape)[axis],
    (value) => {
      const ratio = value / sizeOf(shape)[axis];
      if (!(ratio > 0)) return;
      shape.polygon = shape.polygon.map((/** @type {number[]} */ corner) => corner.map((x, k) => (k === axis ? tidy(ratio * x) : x)));
    },
    { hint: "centre of the outline in the frame of the body" },
  ))];
}

/** @param {number[][] | undefined} polygon */
function isBox(polygon) {
  if (polygon?.length !== 4) return false;
  const [xs, ys] = [0, 1].map((axis) => new Set(polygon.map((corner) => corner[axis].toFixed(9))));
  return xs.size === 2 && ys.size === 2;
}

/** @param {number} width @param {number} height */
export function box(width, height) {
  const [x, y] = [tidy(width / 2), tidy(height / 2)];
  return [[-x, -y], [x, -y], [x, y], [-x, y]];
}

/** @param {Record<string, any>} shape @returns {[number, number]} */
function sizeOf(shape) {
  if (shape.disk !== undefined) return [2 * shape.disk, 2 * shape.disk];
  const [width, height] = [0, 1].map((axis) => {
    const values = shape.polygon.map((/** @type {number[]} */ corner) => corner[axis]);
    return Math.max(...values) - Math.min(...values);
  });
  return [width, height];
}

/** @param {Record<string, any>} body @param {string} where @returns {Field[]} */
function bodyFields(body, where) {
  const kind = Object.keys(body.support ?? { none: {} })[0];
  /** @type {[string, string][]} */
  const options = [["tripod", "tripod"], ["uniform", "uniform pressure"], ["ellipsoid", "ellipsoid"], ["none", "no friction"]];
  if (kind === "points") options.unshift(["points", "given points"]);
  return [
    ...numbers(body, where, ["mass", "mass", "g"]),
    {
      label: "support", unit: "", where: `${where}.support`, options,
      get: () => kind,
      set: (value) => { body.support = support(value, body); },
    },
    ...numbers(body, where, ...SUPPORT),
  ];
}

/** A support of a kind that suits a body. @param {string} kind @param {Record<string, any>} body */
function support(kind, body) {
  const old = body.support ?? {};
  const mu = old.tripod?.friction ?? old.uniform?.friction ?? 0.25;
  const [width, height] = sizeOf(body.shape);
  const reach = tidy(Math.min(width, height) / 3);
  const force = tidy(mu * body.mass * 9.81);
  return {
    tripod: { tripod: { radius: reach, friction: mu, angle: 0 } },
    uniform: { uniform: { friction: mu } },
    ellipsoid: { ellipsoid: { force, torque: tidy(force * reach) } },
    none: { none: {} },
  }[kind] ?? old;
}

/** Fields of the scene itself. @param {Scene} scene @returns {Field[]} */
export const sceneFields = (scene) => [
  number("duration", "s", "duration", () => scene.duration, (value) => { scene.duration = value; }),
  {
    label: "motion", unit: "", where: "motion",
    options: ["dynamic", "quasistatic", "first-order"].map((name) => [name, name]),
    get: () => scene.motion ?? "dynamic",
    set: (value) => { scene.motion = value; },
  },
];

/** Fields as elements. @param {Field[]} fields @param {(field: Field, rebuild: boolean) => void} changed */
export function rows(fields, changed) {
  return fields.map((field) => {
    const id = `field-${field.where.replace(/\W+/g, "-")}-${field.label.replace(/\W+/g, "-")}`;
    const entry = field.options ? choice(field, id, changed) : typed(field, id, changed);
    return make(
      "div", { class: "field", "data-where": field.where },
      make("label", { for: id, title: field.hint }, field.label),
      entry,
      make("span", { class: "unit-of" }, field.unit),
      make("p", { class: "refusal", id: `${id}-refusal`, hidden: true }),
    );
  });
}

/** @param {Field} field @param {string} id @param {(field: Field, rebuild: boolean) => void} changed */
function choice(field, id, changed) {
  const select = make("select", { id }, ...(field.options ?? []).map(([value, words]) => make("option", { value }, words)));
  select.value = String(field.get());
  select.addEventListener("change", () => {
    field.set(select.value);
    changed(field, true);
  });
  return select;
}

/** @param {Field} field @param {string} id @param {(field: Field, rebuild: boolean) => void} changed */
function typed(field, id, changed) {
  const numeric = field.kind === "number";
  const entry = make("input", {
    id, type: numeric ? "number" : "text", step: "any", maxlength: numeric ? null : 80,
    placeholder: field.empty ? field.hint?.replace("empty: ", "") : null, autocomplete: "off",
  });
  /** Shows the value of now, unless somebody is writing it. */
  const refresh = () => {
    if (document.activeElement === entry) return;
    const value = field.get();
    entry.value = value === undefined ? "" : String(value);
  };
  refresh();
  for (const name of ["refresh", "blur"]) entry.addEventListener(name, refresh);
  entry.addEventListener("input", () => {
    if (entry.validity.badInput || (numeric && entry.value === "" && !field.empty)) return;
    field.set(entry.value === "" ? undefined : numeric ? Number(entry.value) : entry.value);
    changed(field, false);
  });
  return entry;
}

/**
 * Show a refusal at the field it is about, if there is one.
 * @param {ParentNode} host
 * @param {{where?: string | null, found?: string | number | null, expected?: string | null, sentence: string} | null} problem
 */
export function refuse(host, problem) {
  let best = null;
  let most = 0;
  for (const node of host.querySelectorAll(".field")) {
    const where = /** @type {HTMLElement} */ (node).dataset.where ?? "";
    const refusal = node.querySelector(".refusal");
    const entry = node.querySelector("input, select");
    if (refusal instanceof HTMLElement) refusal.hidden = true;
    entry?.removeAttribute("aria-invalid");
    entry?.removeAttribute("aria-describedby");
    const about = problem?.where ?? "";
    const fits = where && (about === where || about.startsWith(`${where}.`) || about.startsWith(`${where}[`) || where.startsWith(about + "["));
    if (about && fits && where.length > most) [best, most] = [node, where.length];
  }
  if (!best || !problem) return;
  const refusal = /** @type {HTMLElement} */ (best.querySelector(".refusal"));
  refusal.textContent = problem.sentence;
  refusal.hidden = false;
  const entry = best.querySelector("input, select");
  entry?.setAttribute("aria-invalid", "true");
  entry?.setAttribute("aria-describedby", refusal.id);
}
