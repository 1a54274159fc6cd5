// @ts-check
// A motion document, as `/api/v1` answers it, made ready for drawing: see web/api/motion.py.

/** @typedef {{dtype: string, shape: number[], base64: string}} PackedArray */
/** @typedef {ReturnType<typeof numbers>} Numbers */
/** @typedef {{polygon_m: number[][] | null, disk_m: number | null}} Shape */
/** @typedef {[number, number, number]} Pose x [m], y [m], angle [rad] */
/** @typedef {{name: string, role: "object" | "body" | "pusher" | "fixel", shape: Shape, pose: number[]}} Thing */
/**
 * @typedef {object} PackedContacts
 * @property {PackedArray} sample which sample of the motion
 * @property {PackedArray} pair indices into the things: the pushed, and what pushes it
 * @property {PackedArray} point_m
 * @property {PackedArray} force_n on the first of the pair, world axes
 */
/** @typedef {{time_s: PackedArray, names: string[], values: PackedArray}} PackedTouch */
/** @typedef {{time_s: PackedArray, position_m: PackedArray, angle_rad: PackedArray}} PackedErrors */
/**
 * @typedef {object} PackedMotion
 * @property {string} id
 * @property {string} label
 * @property {"measured" | "simulated"} kind
 * @property {PackedArray} time_s
 * @property {Record<string, PackedArray>} pose
 * @property {PackedContacts | null} contacts
 * @property {PackedTouch | null} touch
 * @property {PackedErrors | null} errors
 * @property {string} status
 * @property {string} advice
 */
/**
 * @typedef {object} MotionDocument
 * @property {string} title
 * @property {string} object name of the thing whose motion is compared
 * @property {number[]} reference_m point of the object that leaves the trail, in its frame
 * @property {Thing[]} things
 * @property {number[]} box_m x and y of the lower left, x and y of the upper right
 * @property {PackedMotion[]} motions
 */
/** @typedef {{point: number[], force: number[], body: number, other: number}} Contact */

const KINDS = { "<f8": Float64Array, "<f4": Float32Array, "<i4": Int32Array };

/**
 * The numbers of an array, row after row.
 * @param {PackedArray} packed
 * @returns {Float64Array | Float32Array | Int32Array}
 */
export function numbers(packed) {
  const text = atob(packed.base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k += 1) bytes[k] = text.charCodeAt(k);
  const Kind = KINDS[/** @type {keyof typeof KINDS} */ (packed.dtype)];
  return new Kind(bytes.buffer);
}

/**
 * Index of the last instant that is not after `time`; -1 before the first.
 * @param {ArrayLike<number>} instants
 * @param {number} time
 */
export function lastBefore(instants, time) {
  let low = 0;
  let high = instants.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (instants[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/**
 * Value between samples, linear; the ends go on.
 * @param {ArrayLike<number>} instants
 * @param {ArrayLike<number>} values
 * @param {number} time
 */
export function valueAt(instants, values, time) {
  const k = lastBefore(instants, time);
  if (k < 0) return values[0];
  if (k >= instants.length - 1) return values[instants.length - 1];
  const share = (time - instants[k]) / (instants[k + 1] - instants[k]);
  return values[k] + share * (values[k + 1] - values[k]);
}

/**
 * A point of a frame, seen in the world.
 * @param {ArrayLike<number>} pose
 * @param {ArrayLike<number>} point
 * @returns {[number, number]}
 */
export function placed(pose, point) {
  const c = Math.cos(pose[2]);
  const s = Math.sin(pose[2]);
  return [pose[0] + c * point[0] - s * point[1], pose[1] + s * point[0] + c * point[1]];
}

/** One way everything moved. */
export class Motion {
  /** @param {PackedMotion} packed */
  constructor(packed) {
    this.id = packed.id;
    this.label = packed.label;
    this.kind = packed.kind;
    this.status = packed.status;
    this.advice = packed.advice;
    this.time = numbers(packed.time_s);
    /** @type {Map<string, Numbers>} three numbers a sample */
    this.pose = new Map(Object.entries(packed.pose).map(([name, rows]) => [name, numbers(rows)]));
    this.touch = packed.touch && {
      names: packed.touch.names,
      time: numbers(packed.touch.time_s),
      values: numbers(packed.touch.values),
    };
    this.errors = packed.errors && {
      time: numbers(packed.errors.time_s),
      position: numbers(packed.errors.position_m),
      angle: numbers(packed.errors.angle_rad),
    };
    const contacts = packed.contacts;
    this.contacts = contacts && {
      sample: numbers(contacts.sample),
      pair: numbers(contacts.pair),
      point: numbers(contacts.point_m),
      force: numbers(contacts.force_n),
    };
  }

  /** Whether start and end are all that was measured, so that nothing is drawn between them. */
  get ends() {
    return this.kind === "measured" && this.time.length <= 2;
  }

  /** First and last instant [s]. */
  get span() {
    return [this.time[0], this.time[this.time.length - 1]];
  }

  /** @param {string} name @param {number} time @returns {Pose | null} null for what this motion does not move */
  poseAt(name, time) {
    const rows = this.pose.get(name);
    if (!rows) return null;
    const last = this.time.length - 1;
    const k = Math.max(0, Math.min(lastBefore(this.time, time), last));
    const next = Math.min(k + 1, last);
    const span = this.time[next] - this.time[k];
    const share = span > 0 ? Math.max(0, Math.min(1, (time - this.time[k]) / span)) : 0;
    /** @param {number} axis */
    const between = (axis) => {
      const here = rows[3 * k + axis];
      return here + share * (rows[3 * next + axis] - here);
    };
    return [between(0), between(1), between(2)];
  }

  /** Contacts at a time: those of the sample before it. @param {number} time @returns {Contact[]} */
  contactsAt(time) {
    const all = this.contacts;
    if (!all) return [];
    const sample = Math.max(0, lastBefore(this.time, time));
    const end = lastBefore(all.sample, sample) + 1;
    const start = lastBefore(all.sample, sample - 1) + 1;
    const found = [];
    for (let k = start; k < end; k += 1) {
      found.push({
        point: [all.point[2 * k], all.point[2 * k + 1]],
        force: [all.force[2 * k], all.force[2 * k + 1]],
        body: all.pair[2 * k],
        other: all.pair[2 * k + 1],
      });
    }
    return found;
  }

  /** The largest contact force of every sample that has one [N]. */
  get forces() {
    /** @type {Map<number, number>} */
    const largest = new Map();
    const { sample, force } = this.contacts ?? { sample: [], force: [] };
    for (let k = 0; k < sample.length; k += 1) {
      const size = Math.hypot(force[2 * k], force[2 * k + 1]);
      largest.set(sample[k], Math.max(size, largest.get(sample[k]) ?? 0));
    }
    return [...largest.values()].filter((size) => size > 0);
  }
}

/**
 * One column of a body's poses.
 * @param {Motion} motion
 * @param {string} name
 * @param {0 | 1 | 2} axis
 * @param {number} factor to the unit it is shown in
 */
export function column(motion, name, axis, factor) {
  const rows = motion.pose.get(name) ?? new Float64Array(0);
  const values = new Float64Array(rows.length / 3);
  for (let k = 0; k < values.length; k += 1) values[k] = factor * rows[3 * k + axis];
  return values;
}
