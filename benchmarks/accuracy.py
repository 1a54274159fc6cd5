"""Random parameter sets, converged answers, and how far two final poses are apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fixel.model import Scene
from fixel.simulation import Adaptive, BatchResult, simulate_batch
from fixel.simulation.motion import AbstractMotionModel
from fixel.typing import FloatArray

POSITION_BAR = 0.1  # [mm]
ANGLE_BAR = 0.1  # [deg]
FINE = 1e-7  # tolerance of a converged answer, in characteristic lengths


GRASP_RANGES = {
    "mu_support": (0.15, 0.35),
    "mu_pusher": (0.15, 0.30),
    "mu_fixel": (0.10, 0.25),
    "tripod_radius": (0.025, 0.060),
}
PUSH_RANGES = {"mu_support": (0.15, 0.80), "mu_pusher": (0.30, 0.70)}


def random_sets(
    n: int, ranges: dict[str, tuple[float, float]] = GRASP_RANGES, seed: int = 7
) -> dict[str, FloatArray]:
    """`n` parameter sets, uniform in their ranges; the first sets are the same for any `n`."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(ranges.values())).T
    columns = rng.uniform(low, high, (n, len(ranges))).T
    return {name: column.copy() for name, column in zip(ranges, columns, strict=True)}


def characteristic_length(scene: Scene) -> float:
    """Radius of gyration, the median over bodies [m]."""
    return float(np.median([np.sqrt(b.moment_of_inertia / b.mass) for b in scene.bodies]))


def converged_batch(
    scene: Scene,
    parameters: dict[str, FloatArray],
    motion: AbstractMotionModel | None = None,
    fineness: float = FINE,
) -> BatchResult:
    """The answer to compare with: adaptive steps at a tolerance far below what is asked."""
    stepper = Adaptive(tolerance=fineness * characteristic_length(scene))
    result = simulate_batch(scene, parameters, motion=motion, stepper=stepper)
    return result


def apart(poses: ArrayLike, others: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Distance [mm] and angle [deg] between poses (..., 3) in [m, m, rad]."""
    with np.errstate(all="ignore"):
        difference = np.asarray(poses) - np.asarray(others)
        distance = 1e3 * np.hypot(difference[..., 0], difference[..., 1])
        return distance, np.abs(np.degrees(difference[..., 2]))


def share_within(result: BatchResult, reference: BatchResult, magnified: float = 1.0) -> float:
    """Share of rollouts that end within 0.1 mm and 0.1 degree of the reference.

    Rollouts count as within only where both finished; lengths are `magnified` before they are
    compared, for scenes smaller than the testbed.
    """
    distance, angle = apart(result.final[:, 0], reference.final[:, 0])
    near = (distance * magnified <= POSITION_BAR) & (angle <= ANGLE_BAR)
    return float(np.mean(near & result.converged & reference.converged))
