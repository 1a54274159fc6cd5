"""Bands of paths, regions of end poses, and how often bounds contain real outcomes."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.optimiser import between
from fixel.errors import InvalidInput
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray

LEVELS: Final = (0.5, 0.9)


CURVE_LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


class Band(NamedTuple):
    """Ends of a band around a path, frame by frame."""

    level: float
    low: FloatArray  # (n_frame, 3) x, y, theta [m, m, rad]
    high: FloatArray  # (n_frame, 3)


class Ellipse(NamedTuple):
    """Elliptic region of positions."""

    level: float
    centre: FloatArray  # (2,) [m]
    radii: FloatArray  # (2,) half axes, the larger first [m]
    angle: float  # angle of the larger axis [rad]


class EndBounds(NamedTuple):
    """Bounds that contain the end of a push with a given probability."""

    level: float
    position: Ellipse
    angle: tuple[float, float]  # the shortest interval [rad]


def bounds_of(poses: FloatArray, level: float) -> EndBounds:
    """Return the smallest ellipse of the draws' shape and the shortest interval of angles that
    contain a share of poses (k, 3)."""
    between(level, "level")
    centre, spread = _shape(poses[:, :2])
    radius = float(np.quantile(_distances(poses[:, :2], centre, spread), level))
    variances, axes = np.linalg.eigh(spread)
    ellipse = Ellipse(
        level,
        centre,
        radius * np.sqrt(variances[::-1]),
        math.atan2(axes[1, 1], axes[0, 1]),
    )
    return EndBounds(level, ellipse, shortest(poses[:, 2], level))


def shortest(values: FloatArray, level: float) -> tuple[float, float]:
    """Return the shortest interval that contains a share of values (k,)."""
    ordered = np.sort(values)
    inside = min(len(ordered) - 1, max(1, math.ceil(level * len(ordered)) - 1))
    width = ordered[inside:] - ordered[: len(ordered) - inside]
    k = int(np.argmin(width))
    return float(ordered[k]), float(ordered[k + inside])


def levels_of(poses: FloatArray, pose: FloatArray) -> tuple[float, float]:
    """Return levels of the smallest regions of positions and of angles that contain a pose (3,):
    the share of poses (k, 3) closer to the centre, measured in units of their spread."""
    centre, spread = _shape(poses[:, :2])
    others = _distances(poses[:, :2], centre, spread)
    own = float(_distances(pose[None, :2], centre, spread)[0])
    middle = float(np.median(poses[:, 2]))
    away = abs(float(wrapped(np.array([pose[2] - middle]))[0]))
    turned = np.abs(poses[:, 2] - middle)
    return float(np.mean(others < own)), float(np.mean(turned < away))


def _shape(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance, which is never singular, so that distances are finite."""
    spread = np.cov(positions.T)
    least = 1e-12 * max(float(np.trace(spread)), 1e-18)
    return positions.mean(axis=0), spread + least * np.eye(2)


def _distances(positions: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    away = positions - centre
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", away, np.linalg.inv(spread), away)))


class CoverageCurve(NamedTuple):
    """Share of outcomes inside the bounds of each level."""

    levels: FloatArray  # (n,)
    held: FloatArray  # (n,)
    low: FloatArray  # (n,) 2.5 % point of the share, were the levels true
    high: FloatArray  # (n,) 97.5 %
    outcomes: int

    @property
    def largest_gap(self) -> float:
        """Largest difference between a level and the share of outcomes inside its bounds."""
        return float(np.abs(self.held - self.levels).max())


def coverage_curve(found: FloatArray, levels: tuple[float, ...] = CURVE_LEVELS) -> CoverageCurve:
    """Return the coverage curve of outcomes.

    Each outcome is given by the level (n,) of the smallest bounds that contain it. The range `low`
    to `high` assumes independent outcomes.
    """
    from scipy.stats import binom

    own = np.asarray(found, np.float64)
    if own.ndim != 1 or not len(own) or not np.isfinite(own).all():
        raise InvalidInput("coverage", found="no outcomes", expected="one level for each outcome")
    wanted = np.array(levels)
    held = np.array([float(np.mean(own <= level)) for level in levels])
    n = len(own)
    return CoverageCurve(
        wanted, held, binom.ppf(0.025, n, wanted) / n, binom.ppf(0.975, n, wanted) / n, n
    )
