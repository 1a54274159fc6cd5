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

const MM = 1e3;
const DEG = 180 / Math.PI;

/**
 * @param {string} label
 * @param {string} unit
 * @param {number} factor from SI
 * @param {string} where
 * @param {() => number | undefined} get SI
 * @param {(value: number) => void} set SI
 * @param {Partial<Field>} [more]
 * @returns {Field}
 */
const number = (label, unit, factor, where, get, set, more = {}) => ({
  label,
  unit,
  where,
  kind: "number",
  get: () => {
    const value = get();
    return value === undefined ? undefined : Number((factor * value).toPrecision(6));
  },
  set: (value) => set(value === undefined ? value : tidy(value / factor)),
  ...more,
});

/**
 * A number that stands under a key of a record.
 * @param {Record<string, any>} record
 * @param {string} key
 * @param {string} label
 * @param {string} unit
 * @param {number} factor
 * @param {string} where
 * @param {Partial<Field>} [more]
 */
const keyed = (record, key, label, unit, factor, where, more = {}) => number(
  label, unit, factor, `${where}.${key}`,
  () => record[key],
  (value) => {
    if (value === undefined) delete record[key];
    else record[key] = value;
  },
  more,
);

/**
 * Fields of a thing.
 * @param {Record<string, any>} thing
 * @param {Choice} choice
 * @returns {Field[]}
 */
export function thingFields(thing, choice) {
  const where = `${choice.kind}[${choice.index}]`;
  return [
    { label: "name", unit: "", where: `${where}.name`, kind: "text", get: () => thing.name, set: (value) => { thing.name = value ?? ""; } },
    ...poseFields(thing, where),
    ...shapeFields(thing, `${where}.shape`),
    ...(choice.kind === "bodies" ? bodyFields(thing, where) : [
      keyed(thing, "friction", "friction", "", 1, where, { hint: "friction coefficient against every free body" }),
    ]),
    ...(choice.kind === "pushers" ? driveFields(thing.drive, `${where}.drive`) : []),
  ];
}

/**
 * @param {Record<string, any>} thing
 * @param {string} where
 */
function poseFields(thing, where) {
  const path = Boolean(thing.drive?.waypoints);
  return /** @type {[string, string, number][]} */ ([["x", "mm", MM], ["y", "mm", MM], ["angle", "deg", DEG]])
    .filter((_, axis) => axis < 2 || !path)
    .map(([label, unit, factor], axis) => number(
      label, unit, factor, path ? `${where}.drive` : `${where}.pose[${axis}]`,
      () => poseOf(thing)[axis],
      (value) => place(thing, poseOf(thing).map((/** @type {number} */ old, /** @type {number} */ k) => (k === axis ? value : old))),
    ));
}

/**
 * @param {Record<string, any>} thing
 * @param {string} where
 * @returns {Field[]}
 */
function shapeFields(thing, where) {
  const shape = thing.shape;
  /** @type {Field} */
  const kind = {
    label: "shape", unit: "", where,
    options: shape.disk !== undefined || isBox(shape.polygon)
      ? [["disk", "disk"], ["box", "box"]] : [["disk", "disk"], ["box", "box"], ["polygon", `polygon of ${shape.polygon.length}`]],
    get: () => (shape.disk !== undefined ? "disk" : isBox(shape.polygon) ? "box" : "polygon"),
    set: (value) => {
      const [width, height] = sizeOf(shape);
      if (value === "disk") thing.shape = { disk: tidy(Math.min(width, height) / 2) };
      if (value === "box") thing.shape = { polygon: box(width, height) };
    },
  };
  if (shape.disk !== undefined) {
    return [kind, keyed(shape, "disk", "radius", "mm", MM, where)];
  }
  return [kind, ...["width", "height"].map((label, axis) => number(
    label, "mm", MM, `${where}.polygon`,
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

/**
 * @param {Record<string, any>} body
 * @param {string} where
 * @returns {Field[]}
 */
function bodyFields(body, where) {
  const kind = Object.keys(body.support ?? { none: {} })[0];
  /** @type {[string, string][]} */
  const options = [["tripod", "tripod"], ["uniform", "uniform pressure"], ["ellipsoid", "ellipsoid"], ["none", "no friction"]];
  if (kind === "points") options.unshift(["points", "given points"]);
  return [
    keyed(body, "mass", "mass", "g", 1e3, where),
    {
      label: "support", unit: "", where: `${where}.support`, options,
      get: () => kind,
      set: (value) => { body.support = support(value, body); },
    },
    ...supportFields(body.support ?? {}, `${where}.support`),
  ];
}

/**
 * A support of a kind that suits a body.
 * @param {string} kind
 * @param {Record<string, any>} body
 */
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

/**
 * @param {Record<string, any>} given
 * @param {string} where
 * @returns {Field[]}
 */
function supportFields(given, where) {
  const { tripod, uniform, ellipsoid, points } = given;
  if (tripod) {
    return [
      keyed(tripod, "friction", "friction with the plane", "", 1, `${where}.tripod`),
      keyed(tripod, "radius", "tripod radius", "mm", MM, `${where}.tripod`),
      keyed(tripod, "angle", "tripod angle", "deg", DEG, `${where}.tripod`),
    ];
  }
  if (uniform) return [keyed(uniform, "friction", "friction with the plane", "", 1, `${where}.uniform`)];
  if (points && typeof points.friction === "number") {
    return [keyed(points, "friction", "friction with the plane", "", 1, `${where}.points`)];
  }
  if (ellipsoid) {
    return [
      keyed(ellipsoid, "force", "largest force", "N", 1, `${where}.ellipsoid`),
      keyed(ellipsoid, "torque", "largest torque", "N mm", 1e3, `${where}.ellipsoid`),
    ];
  }
  return [];
}

/**
 * @param {Record<string, any>} drive
 * @param {string} where
 * @returns {Field[]}
 */
function driveFields(drive, where) {
  const limit = keyed(drive, "force_limit", "force limit", "N", 1, where, { empty: true, hint: "empty: a rigid drive" });
  if (drive.waypoints) return [limit];
  return [
    number(
      "drive direction", "deg", DEG, `${where}.direction`,
      () => Math.atan2(drive.direction[1], drive.direction[0]),
      (value) => { drive.direction = [tidy(Math.cos(value)), tidy(Math.sin(value))]; },
    ),
    keyed(drive, "speed", "speed", "mm/s", MM, where),
    keyed(drive, "travel", "travel", "mm", MM, where, { empty: true, hint: "empty: no limit" }),
    limit,
  ];
}

/**
 * Fields of the scene itself.
 * @param {Scene} scene
 * @returns {Field[]}
 */
export function sceneFields(scene) {
  return [
    number("duration", "s", 1, "duration", () => scene.duration, (value) => { scene.duration = value; }),
    {
      label: "motion", unit: "", where: "motion",
      options: [["dynamic", "dynamic"], ["quasistatic", "quasistatic"], ["first-order", "first-order"]],
      get: () => scene.motion ?? "dynamic",
      set: (value) => { scene.motion = value; },
    },
  ];
}

/**
 * Fields as elements.
 * @param {Field[]} fields
 * @param {(field: Field, rebuild: boolean) => void} changed
 */
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
  entry.addEventListener("refresh", refresh);
  entry.addEventListener("input", () => {
    if (numeric && entry.value === "" && !field.empty) return;
    field.set(entry.value === "" ? undefined : numeric ? Number(entry.value) : entry.value);
    changed(field, false);
  });
  return entry;
}

/**
 * Show a refusal at the field it is about; whether there is one.
 * @param {ParentNode} host
 * @param {{where?: string | null, found?: string | null, expected?: string | null, sentence: string} | null} problem
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
  if (!best || !problem) return false;
  const refusal = /** @type {HTMLElement} */ (best.querySelector(".refusal"));
  refusal.textContent = problem.expected
    ? `found ${problem.found ?? "nothing"}, expected ${problem.expected}` : problem.sentence;
  refusal.hidden = false;
  const entry = best.querySelector("input, select");
  entry?.setAttribute("aria-invalid", "true");
  entry?.setAttribute("aria-describedby", refusal.id);
  return true;
}
