// @ts-check
// The keys of a scene file as an editor sees them: where things are, what they enclose, what was.

/** @typedef {"bodies" | "pushers" | "fixels"} Kind */
/** @typedef {{kind: Kind, index: number}} Choice */
/** @typedef {Record<string, any>} Scene the keys of a scene file */

export const KINDS = /** @type {Kind[]} */ (["bodies", "pushers", "fixels"]);
const TOGETHER = 700; // [ms] changes of one kind within this are taken back together
const MOST_STEPS_BACK = 200;

/** A number without the noise of its last digits. @param {number} value */
export const tidy = (value) => Number(value.toPrecision(9));

/** What was, and what was taken back. */
export class History {
  /** @param {string} state */
  constructor(state) {
    this.past = [state];
    /** @type {string[]} */
    this.future = [];
    this.key = "";
    this.at = 0;
  }

  /** @param {string} state @param {string} key changes of one key that follow at once count as one; empty: never */
  push(state, key = "") {
    if (state === this.past[this.past.length - 1]) return;
    const now = performance.now();
    if (key && key === this.key && now - this.at < TOGETHER) this.past.pop();
    this.past.push(state);
    if (this.past.length > MOST_STEPS_BACK) this.past.splice(1, 1);
    this.future = [];
    [this.key, this.at] = [key, now];
  }

  undo() {
    if (this.past.length < 2) return null;
    this.future.push(/** @type {string} */ (this.past.pop()));
    this.key = "";
    return this.past[this.past.length - 1];
  }

  redo() {
    const state = this.future.pop();
    if (state === undefined) return null;
    this.past.push(state);
    this.key = "";
    return state;
  }
}

/** @param {Record<string, any>} shape of a scene file */
export const drawable = (shape) => ({ polygon_m: shape.polygon ?? null, disk_m: shape.disk ?? null });

/** Where a thing is at the start; a path says it for what follows one. @param {Record<string, any>} thing */
export function poseOf(thing) {
  const first = thing.drive?.waypoints?.[0];
  return first ? first.slice(1) : thing.pose;
}

/** Put a thing somewhere else; a path goes along. @param {Record<string, any>} thing @param {number[]} pose */
export function place(thing, pose) {
  const path = thing.drive?.waypoints;
  if (!path) {
    thing.pose = pose.map(tidy);
    return;
  }
  const [dx, dy] = [pose[0] - path[0][1], pose[1] - path[0][2]];
  thing.drive.waypoints = path.map((/** @type {number[]} */ [t, x, y, angle]) => [t, tidy(x + dx), tidy(y + dy), angle]);
  thing.pose = thing.drive.waypoints[0].slice(1);
}

/**
 * Where a straight drive leads [m].
 * @param {Record<string, any>} thing
 * @param {number} otherwise length where it has none [m]
 */
export function endOf(thing, otherwise) {
  const { direction, travel } = thing.drive ?? {};
  if (!direction) return null;
  const [x, y] = poseOf(thing);
  const size = Math.hypot(direction[0], direction[1]) || 1;
  const length = travel ?? otherwise;
  return [x + (length * direction[0]) / size, y + (length * direction[1]) / size];
}

/** From the frame's origin to the farthest point [m]. @param {Record<string, any>} shape */
export const reachOf = (shape) =>
  shape.disk ?? Math.max(...(shape.polygon ?? [[0, 0]]).map((/** @type {number[]} */ [x, y]) => Math.hypot(x, y)));

/** @param {Record<string, any>} thing @param {[number, number]} world */
export function inside(thing, world) {
  const [px, py, angle] = poseOf(thing);
  const [dx, dy] = [world[0] - px, world[1] - py];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const [x, y] = [c * dx + s * dy, c * dy - s * dx];
  if (thing.shape.disk !== undefined) return Math.hypot(x, y) <= thing.shape.disk;
  const corners = thing.shape.polygon ?? [];
  let odd = false;
  for (let k = 0, before = corners.length - 1; k < corners.length; before = k, k += 1) {
    const [ax, ay] = corners[k];
    const [bx, by] = corners[before];
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) odd = !odd;
  }
  return odd;
}

/** The points a body stands on, in its frame [m]; none where it is not on a few. @param {Record<string, any>} thing @returns {number[][]} */
export function feetOf(thing) {
  const { tripod, points } = thing.support ?? {};
  if (points) return points.at;
  if (!tripod) return [];
  const [x, y] = thing.centre_of_mass ?? centroidOf(thing.shape);
  return [0, 1, 2].map((k) => {
    const angle = (tripod.angle ?? 0) + (2 * Math.PI * k) / 3;
    return [x + tripod.radius * Math.cos(angle), y + tripod.radius * Math.sin(angle)];
  });
}

/** @param {Record<string, any>} shape */
function centroidOf(shape) {
  let [area, x, y] = [0, 0, 0];
  const corners = shape.polygon ?? [];
  corners.forEach((/** @type {number[]} */ [ax, ay], /** @type {number} */ k) => {
    const [bx, by] = corners[(k + 1) % corners.length];
    const cross = ax * by - bx * ay;
    area += cross / 2;
    x += ((ax + bx) * cross) / 6;
    y += ((ay + by) * cross) / 6;
  });
  return area === 0 ? [0, 0] : [x / area, y / area];
}
