// @ts-check
// A video in step with a player, with the outline of the part as it was measured drawn over it.

import { lastBefore, numbers } from "./motion.js";

/** @typedef {{size_px: [number, number], time_s: import("./motion.js").PackedArray, outline_px: import("./motion.js").PackedArray}} Seen */

const LATE = 0.08; // [s] that a playing video may be off before it is put right
const SAME = 0.004; // [s] that nobody sees

export class Film {
  /** @param {HTMLVideoElement} video @param {HTMLCanvasElement} over @param {import("./player.js").Player} player */
  constructor(video, over, player) {
    this.video = video;
    this.over = over;
    this.player = player;
    this.shown = true;
    /** @type {{size: [number, number], time: ArrayLike<number>, outline: ArrayLike<number>, corners: number} | null} */
    this.seen = null;
    player.addEventListener("time", () => this.follow());
    player.addEventListener("state", () => this.follow());
    video.addEventListener("seeked", () => this.draw());
    video.addEventListener("loadeddata", () => this.follow());
    new ResizeObserver(() => this.draw()).observe(video);
  }

  /** @param {Seen} seen */
  outline(seen) {
    this.seen = {
      size: seen.size_px, time: numbers(seen.time_s), outline: numbers(seen.outline_px), corners: seen.outline_px.shape[1],
    };
    this.draw();
  }

  /** Goes where the player is. */
  follow() {
    const { video, player } = this;
    const off = video.currentTime - player.time;
    if (player.playing) {
      video.playbackRate = Math.max(0.0625, Math.min(16, player.speed));
      if (Math.abs(off) > LATE * Math.max(1, player.speed)) video.currentTime = player.time;
      if (video.paused && !video.ended) video.play().catch(() => {}); // a browser may not let it; frames still follow
    } else {
      if (!video.paused) video.pause();
      if (Math.abs(off) > SAME && !video.seeking) video.currentTime = player.time;
    }
    this.draw();
  }

  draw() {
    const { over, video, seen } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [over.clientWidth, over.clientHeight];
    over.width = Math.round(width * ratio);
    over.height = Math.round(height * ratio);
    const context = over.getContext("2d");
    if (!context || !seen || !this.shown || !video.videoWidth) return;
    const k = Math.max(0, lastBefore(seen.time, video.currentTime + 0.5 / 60));
    // The picture lies in the middle of its box, as large as fits.
    const scale = Math.min(width / seen.size[0], height / seen.size[1]);
    const left = (width - scale * seen.size[0]) / 2;
    const top = (height - scale * seen.size[1]) / 2;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.beginPath();
    for (let corner = 0; corner < seen.corners; corner += 1) {
      const place = 2 * (k * seen.corners + corner);
      // A pixel's number is that of its middle.
      context.lineTo(left + scale * (seen.outline[place] + 0.5), top + scale * (seen.outline[place + 1] + 0.5));
    }
    context.closePath();
    context.lineWidth = 4;
    context.strokeStyle = "rgb(0 0 0 / 45%)";
    context.stroke();
    context.lineWidth = 2;
    context.strokeStyle = "#56b4e9";
    context.stroke();
  }
}
