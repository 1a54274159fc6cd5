// @ts-check
import { at, follow, list, path, tell, verdict, write } from "./live.js";

/** @type {Record<string, [string, string, string]>} */
const STATES = {
  waiting: ["waiting", "\u2026", "Waiting for the camera"],
  recording: ["recording", "\u25CF", "Recording"],
  finished: ["placed", "\u2713", "Finished"],
};
const SCARCE = 2.0; // [GB]

/** @param {number} seconds */
const clock = (seconds) => {
  const whole = Math.floor(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
};

let asked = false;
const button = /** @type {HTMLButtonElement} */ (at("stop"));

/** @param {{name: string, on: boolean | null}[]} tactile */
function lamps(tactile) {
  tactile.forEach(({ name, on }) => {
    const lamp = /** @type {HTMLElement | null} */ (document.querySelector(`#lamps li[data-name="${CSS.escape(name)}"]`));
    if (!lamp) return;
    lamp.dataset.on = on === null ? "unknown" : on ? "yes" : "no";
    const words = lamp.querySelector(".words");
    if (words) words.textContent = on === null ? "no reading" : on ? "touched" : "free";
  });
}

at("stop").addEventListener("click", async () => {
  asked = true;
  button.disabled = true;
  write("stop", "Stopping\u2026");
  try {
    await tell(`${path}/stop`);
  } catch (problem) {
    asked = false;
    button.disabled = false;
    write("stop", "Stop the recording");
    list("problems", [`Stopping failed: ${problem instanceof Error ? problem.message : problem}`]);
  }
});

follow((status) => {
  const finished = status.state === "finished";
  verdict(...(STATES[status.state] ?? STATES.waiting));
  write("elapsed", clock(status.elapsed_s));
  write("limit", status.limit_s === null ? "min:s" : `of ${clock(status.limit_s)} min:s`);
  write("frames", status.frames.toLocaleString("en"));
  write("lost", status.lost.toLocaleString("en"));
  at("lost-box").classList.toggle("bad", status.lost > 0);
  at("disk-box").hidden = status.disk_free_gb === null;
  if (status.disk_free_gb !== null) {
    write("disk", `${status.disk_free_gb.toFixed(1)} GB`);
    at("disk-box").classList.toggle("bad", status.disk_free_gb < SCARCE);
  }
  lamps(status.tactile);
  if (finished || status.stopping || asked) {
    button.disabled = true;
    write("stop", finished ? "The recording has ended" : "Stopping\u2026");
  }
  list("problems", status.problems);
});
