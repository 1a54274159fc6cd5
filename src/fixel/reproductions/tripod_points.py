"""Estimation of three support points from the end poses of pushes, with or without forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.study import box_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.reproductions.tripod_pushes import (
    FORCE_NOISE,
    POSE_NOISE,
    SURFACES,
    Forces,
    TripodPush,
    best_friction,
    comparer_of,
    machined,
    outline_of,
    sliding_forces,
)
from fixel.typing import FloatArray

CORNERS: Final = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")


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


def fitted_points(
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
