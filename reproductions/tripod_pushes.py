"""CMU's pushes on machined supports: end poses, forces on the way, and support points from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.objective import Comparer
from fixel.calibration.study import box_of
from fixel.calibration.target import Target
from fixel.datasets.cmu import CmuTripod
from fixel.model import Experiment, SupportPoints
from fixel.model.space import ParameterSpace, Unknown
from fixel.model.support import triangle_shares
from fixel.simulation import StewartTrinkle
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import FloatArray

GRAVITY: Final = 9.81  # [m/s^2]
SURFACES: Final = ("hardboard", "plywood")

# Errors of a push that no parameter explains: tracking and registration, tip gaps of 1.3 mm
# (5-95 %) [m], their angle over the block [rad]; stick-slip of the finger and the scatter of the
# mean force on the machined points [N].
POSE_NOISE: Final = np.array([1e-3, 1e-3, math.radians(1.0)])
FORCE_NOISE: Final = 1.0

# Step of the simulation [s]: 0.25 mm of the finger. End poses lie 0.04 mm (median) and 0.21 mm
# (90 %) from those of the adaptive stepper, well inside the noise.
STEP: Final = 0.1
SAMPLES: Final = 24  # number of samples of the path, for the direction of sliding

# An interval counts as sliding from this share of the fastest one's motion on; in slower ones the
# finger arrived midway.
SLIDING: Final = 0.7


CORNERS: Final = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")


class TripodPush(NamedTuple):
    """Target of one push and its measured forces."""

    target: Target  # all its poses are the measured end pose
    force: FloatArray  # (SAMPLES, 2) mean force on the block up to each sample [N]


def read_pushes(folder: Path, every: int = 1) -> list[TripodPush]:
    """Load the pushes of a folder that have a scene and no fault; only every `every`-th one."""
    pushes = [
        push_of(experiment)
        for experiment in CmuTripod().read(folder).experiments()
        if experiment.scene is not None and not any(flag.fault for flag in experiment.flags)
    ]
    return pushes[::every]


def push_of(experiment: Experiment) -> TripodPush:
    """Prepare a push: measured end pose, and mean forces along the path."""
    assert experiment.scene is not None
    assert experiment.pusher is not None
    end = float(experiment.pusher.time[-1])
    times = np.linspace(0.0, end, SAMPLES + 1)
    pose = np.tile(experiment.trajectory.pose[-1], (SAMPLES, 1))
    channel = next(c for c in experiment.channels if c.name == "force")
    target = Target(
        experiment.key,
        {**experiment.conditions, "experiment": experiment.key},
        RolloutCase(experiment.scene, times[1:]),
        pose,
    )
    return TripodPush(target, _means(channel.time, channel.values, times))


def _means(time: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """Means (n, c) of readings (m, c) between edges (n + 1,); interpolated where there are none."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    place = np.searchsorted(edges, time) - 1
    means = np.column_stack([np.interp(middle, time, column) for column in values.T])
    for k in range(len(middle)):
        if (own := place == k).any():
            means[k] = values[own].mean(axis=0)
    return means


def support_of(push: TripodPush) -> str:
    """Name of the support under a push."""
    return str(push.target.conditions["support"])


def machined(push: TripodPush) -> FloatArray:
    """Machined support points (3, 2) of a push [m]."""
    support = push.target.case.scene.bodies[0].support
    assert isinstance(support, SupportPoints)
    return support.points


def outline_of(push: TripodPush) -> FloatArray:
    """Outline (n, 2) of the block [m]."""
    return push.target.case.scene.bodies[0].shape.outline


# --- simulation ---------------------------------------------------------------------------------


def comparer_of(pushes: Sequence[TripodPush], space: ParameterSpace) -> Comparer:
    """Create a comparer that simulates pushes with points of a parameter space."""
    return Comparer([p.target for p in pushes], space, stepper=StewartTrinkle(step=STEP))


def unit_forces(way: FloatArray, points: FloatArray, shares: FloatArray) -> FloatArray:
    """Compute the force that slides a block along paths, for friction and weight of 1.

    Parameters
    ----------
    way : (n, k, 3) float64
        Poses along the paths [m, m, rad].
    points : (n, p, 2) float64
        Support points from the centre of mass, in the frame of the body [m].
    shares : (n, p) float64
        Shares of the weight on the points.

    Returns
    -------
    (n, k - 1, 2) float64
        Forces in the world; zero where the block does not move.

    Source
    ------
    Coulomb friction at every point: Zhou et al. (2016), section III, for points.
    """
    middle = 0.5 * (way[:, 1:, 2] + way[:, :-1, 2])
    step = np.diff(way, axis=1)
    c, s = np.cos(middle)[:, :, None], np.sin(middle)[:, :, None]
    x, y = points[:, None, :, 0], points[:, None, :, 1]
    turn = step[:, :, None, 2]
    vx = step[:, :, None, 0] - turn * (s * x + c * y)
    vy = step[:, :, None, 1] + turn * (c * x - s * y)
    speed = np.hypot(vx, vy)
    weight = np.divide(shares[:, None, :], speed, out=np.zeros_like(speed), where=speed > 1e-7)
    return np.stack(((weight * vx).sum(axis=2), (weight * vy).sum(axis=2)), axis=2)


class Forces(NamedTuple):
    """Mean forces over the sliding part of each of n pushes."""

    measured: FloatArray  # (n, 2) [N]
    unit: FloatArray  # (n, 2) predicted for a friction of 1 [N]


def sliding_forces(
    pushes: Sequence[TripodPush], which: np.ndarray, difference: FloatArray, points: FloatArray
) -> Forces:
    """Compute forces of rollouts (n,) from the differences (n, k, 3) of their poses from the
    measured ends, and from their support points (n, 3, 2)."""
    start = np.array([p.target.case.scene.bodies[0].pose for p in pushes])[which]
    end = np.array([p.target.pose[-1] for p in pushes])[which]
    way = np.concatenate((start[:, None], difference + end[:, None]), axis=1)
    body = pushes[0].target.case.scene.bodies[0]
    unit = body.mass * GRAVITY * unit_forces(way, points, np.maximum(triangle_shares(points), 0.0))
    step = np.hypot(np.diff(way[:, :, 0], axis=1), np.diff(way[:, :, 1], axis=1))
    slides = step > SLIDING * step.max(axis=1, keepdims=True)
    weight = slides / np.maximum(slides.sum(axis=1, keepdims=True), 1)
    force = np.array([p.force for p in pushes])[which]
    return Forces(np.einsum("nk,nki->ni", weight, force), np.einsum("nk,nki->ni", weight, unit))


def best_friction(forces: Forces) -> float:
    """Coefficient of friction that fits predicted to measured forces by least squares."""
    return float(np.sum(forces.measured * forces.unit) / max(np.sum(forces.unit**2), 1e-30))


# --- support points -----------------------------------------------------------------------------


class SupportFit(NamedTuple):
    """Support points and friction fitted to pushes."""

    points: FloatArray  # (3, 2) [m], in the order nearest to the machined ones
    values: Mapping[str, float]
    friction: Mapping[str, float]  # surface -> coefficient, if forces were used
    deviance: float


def support_space(outline: FloatArray) -> ParameterSpace:
    """Parameter space: friction of the finger, and three points in the outline's bounding box."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle = outline.mean(axis=0)
    guess = middle + 0.4 * (outline[:3] - middle)
    corners = [
        Unknown(
            name=name,
            low=float(low[axis]),
            high=float(high[axis]),
            nominal=float(guess[k // 2, axis]),
            scale=0.01,
        )
        for k, name in enumerate(CORNERS)
        for axis in (k % 2,)
    ]
    return ParameterSpace(
        unknowns=(Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.4), *corners)
    )


def fit_points(
    pushes: Sequence[TripodPush], options: LeastSquares, *, forces: bool, known: bool = False
) -> SupportFit:
    """Fit support points and friction of the finger to end poses, and to forces if requested.

    The friction of each surface only affects forces; it is solved for at every trial. With
    `known`, the points are the machined ones, and only the finger's friction is fitted.
    """
    space = support_space(outline_of(pushes[0]))
    if known:
        truth = machined(pushes[0]).ravel().tolist()
        space = space.with_frozen(dict(zip(CORNERS, truth, strict=True)))
    comparer = comparer_of(pushes, space)
    n = len(pushes)

    def residuals(trials: FloatArray) -> FloatArray:
        which = np.tile(np.arange(n), len(trials))
        rows = np.repeat(trials, n, axis=0)
        difference, good, _ = comparer.differences(which, rows)
        found = difference[:, -1] / POSE_NOISE
        found[~good] = np.inf
        if forces:
            corners = np.array([corners_of(space, point) for point in trials])
            force = _force_residuals(pushes, which, difference, corners[:, None], len(trials))
            found = np.concatenate((found, force), axis=1)
        return np.asarray(found.reshape(len(trials), -1))

    search = options.start(box_of(space), 1, comparer.feasible)
    best = fit(search, residuals)
    points = _nearest_order(corners_of(space, best.point), machined(pushes[0]))
    friction = {}
    if forces:
        difference, _, _ = comparer.differences(np.arange(n), np.tile(best.point, (n, 1)))
        friction = _frictions(pushes, difference, np.tile(points, (n, 1, 1)))
    return SupportFit(points, space.values(best.point), friction, best.deviance)


def corners_of(space: ParameterSpace, point: FloatArray) -> FloatArray:
    """Support points (3, 2) in a point of the parameter space [m]."""
    values = space.values(point)
    return np.array([values[name] for name in CORNERS]).reshape(3, 2)


def _force_residuals(
    pushes: Sequence[TripodPush],
    which: np.ndarray,
    difference: FloatArray,
    corners: FloatArray,
    k: int,
) -> FloatArray:
    """Residuals (k n, 2) of forces in k trials with points (k, 1, 3, 2), each with its best
    friction of each surface."""
    points = np.broadcast_to(corners, (k, len(pushes), 3, 2)).reshape(-1, 3, 2)
    found = sliding_forces(pushes, which, difference, points)
    trial = np.repeat(np.arange(k), len(pushes))
    surface = np.array([str(p.target.conditions["surface"]) for p in pushes])[which]
    residual = np.zeros_like(found.measured)
    for name in np.unique(surface):
        own = surface == name
        above = np.bincount(trial[own], np.sum(found.measured * found.unit, axis=1)[own], k)
        below = np.bincount(trial[own], np.sum(found.unit**2, axis=1)[own], k)
        mu = above / np.maximum(below, 1e-30)
        residual[own] = (found.measured - mu[trial][:, None] * found.unit)[own]
    return residual / FORCE_NOISE


def _frictions(
    pushes: Sequence[TripodPush], difference: FloatArray, points: FloatArray
) -> dict[str, float]:
    found = sliding_forces(pushes, np.arange(len(pushes)), difference, points)
    surface = np.array([str(p.target.conditions["surface"]) for p in pushes])
    return {
        name: best_friction(Forces(found.measured[surface == name], found.unit[surface == name]))
        for name in SURFACES
        if (surface == name).any()
    }


def _nearest_order(points: FloatArray, truth: FloatArray) -> FloatArray:
    orders = [points[list(order)] for order in permutations(range(3))]
    return min(orders, key=lambda p: float(np.sum((p - truth) ** 2)))
