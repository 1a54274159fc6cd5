"""Model misfit of a filter run: how far the model alone is from what the camera saw."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from fixel.calibration.misfit import WARNED, noise_from_differences
from fixel.calibration.target import Target
from fixel.filtering.head_path import smoothed
from fixel.filtering.running import RunningFilter
from fixel.model import Scene, Trajectory, wrapped
from fixel.simulation import StewartTrinkle, simulate_batch
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import FloatArray

TRIES: Final = 64  # simulations, of which the best counts
STEP: Final = 5e-4  # [m] of the pusher's way in one step of these simulations
KNOWN: Final = 1e-9  # [m], [rad]: deviations below it say that the noise is not known


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilterMisfit:
    """Residuals of a simulation without correction by the camera, and the noise of the camera."""

    # Root mean square in either coordinate and in angle, of the best of 64 simulations.
    residual_m: float
    residual_rad: float
    # Standard deviations of the measured poses, from second differences; zero where unknown.
    noise_m: float
    noise_rad: float

    @property
    def ratio(self) -> float | None:
        """Residual over noise, the larger of position and angle [-]; None without noise."""
        pairs = ((self.residual_m, self.noise_m), (self.residual_rad, self.noise_rad))
        known = [residual / noise for residual, noise in pairs if noise > KNOWN]
        return max(known, default=None)

    @property
    def warns(self) -> bool:
        """Whether the model is wrong by more than the noise explains."""
        return self.ratio is not None and self.ratio >= WARNED


def noise_of(scene: Scene, track: Trajectory) -> FloatArray:
    """Return standard deviations (2,) of white noise [m, rad]; zeros if unknown."""
    if len(track.time) < 2:
        return np.zeros(2)
    case = RolloutCase(scene, track.time[1:] - track.time[0])
    found = noise_from_differences([Target("", {}, case, track.pose[1:])])
    return np.zeros(2) if found is None else np.array([found.position_m, found.angle_rad])


def misfit_of(
    running: RunningFilter, track: Trajectory, pusher: Trajectory, seed: int
) -> FilterMisfit:
    """Measure the misfit of a filter's scene with the parameters that it ended with.

    Parameters
    ----------
    running : RunningFilter
        At the end of a run.
    track, pusher : Trajectory
        What was measured of the object and of the pusher, over that run.
    """
    random = np.random.default_rng([seed, 1])
    noise = noise_of(running.scene, track)
    _, values, weight = running.particles
    drawn = values[random.choice(len(values), TRIES, p=weight)]
    start = track.pose[0] + random.standard_normal((TRIES, 3)) * noise[[0, 0, 1]]
    clock = pusher.time - track.time[0]
    path, _ = smoothed(clock, pusher.pose)
    inside = clock > 0.0
    waypoints = np.column_stack((clock, path))[inside]
    first = [0.0, *Trajectory(time=clock, pose=path).at(max(0.0, float(clock[0])))]
    waypoints = np.concatenate(([first], waypoints))
    moments = track.time[1:] - track.time[0]
    duration = float(moments[-1])
    way = float(np.sum(np.hypot(*np.diff(waypoints[:, 1:3], axis=0).T)))
    steps = max(len(moments), math.ceil(way / STEP))
    result = simulate_batch(
        running.scene,
        running.prior.columns(drawn) or None,
        start=start,
        waypoints=np.broadcast_to(waypoints, (TRIES, *waypoints.shape)),
        motion=running.options.motion,
        stepper=StewartTrinkle(step=duration / steps),
        duration=duration,
        times=moments,
        threads=running.options.threads,
    )
    away = result.pose[:, :, 0] - track.pose[1:]
    position = np.sqrt(0.5 * np.mean(np.sum(away[:, :, :2] ** 2, axis=2), axis=1))
    angle = np.sqrt(np.mean(wrapped(away[:, :, 2]) ** 2, axis=1))
    scale = np.where(noise > KNOWN, noise, 1.0)
    best = int(np.argmin((position / scale[0]) ** 2 + (angle / scale[1]) ** 2))
    return FilterMisfit(
        residual_m=float(position[best]),
        residual_rad=float(angle[best]),
        noise_m=float(noise[0]),
        noise_rad=float(noise[1]),
    )
