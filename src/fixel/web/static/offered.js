// @ts-check
// Sets of parameters that an experiment is compared with.

/**
 * The newest calibration that was fitted to the experiment; without one, the newest of all.
 * @template {{kind: string, error_mm2: number | null}} S
 * @param {S[]} offered newest first
 * @returns {S | undefined}
 */
export function calibratedOf(offered) {
  const known = offered.filter(({ kind }) => kind === "calibration");
  return known.find(({ error_mm2 }) => error_mm2 !== null) ?? known[0];
}
