"""Predictive bands of a path and bounds of its end, and their contributions.

A draw is the simulation of one posterior sample from one start, plus one random walk of the model
error with that sample's standard deviation, plus the noise of the camera. The contributions are
reported separately, to show whether better parameters, a better placed start, a better model or
a better camera would narrow the prediction. A coverage curve compares bounds with real outcomes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.errors import InvalidInput, SolveFailed
from fixel.model.fields import fraction
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.uncertainty.discrepancy import draw_walks
from fixel.uncertainty.likelihood import expected_shares
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prior import ParameterPrior

PARTS: Final = ("parameters", "start", "model error", "noise")
START: Final = ("start_x", "start_y", "start_theta")
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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PushPrediction:
    """Predictive draws of an experiment.

    Attributes
    ----------
    time : (n_frame,) float64
        Times of the frames [s].
    best : (n_frame, 3) float64
        Path simulated with the likeliest sample.
    draws : (k, n_frame, 3) float64
        Poses with camera noise; angles near those of `best`.
    truths : (k, n_frame, 3) float64
        The same poses without camera noise.
    shares : mapping of str to (3,) float64
        Standard deviation at the end of each of `PARTS` alone, and of `"all"` [m, m, rad].
    failed : int
        Number of draws that could not be simulated and are left out.
    """

    time: FloatArray
    best: FloatArray
    draws: FloatArray
    truths: FloatArray
    shares: Mapping[str, FloatArray]
    failed: int

    def bands(self, levels: tuple[float, ...] = LEVELS) -> tuple[Band, ...]:
        """Return pointwise bands: quantiles of each frame."""
        return tuple(
            Band(level, *np.quantile(self.draws, (0.5 - level / 2, 0.5 + level / 2), axis=0))
            for level in levels
        )

    def bounds(self, level: float = 0.9) -> EndBounds:
        """Return the bounds of the last pose, with camera noise."""
        return bounds_of(self.draws[:, -1], level)

    def levels_of(self, pose: FloatArray) -> tuple[float, float]:
        """Return levels of the smallest bounds that contain a last pose (3,): position, angle."""
        return levels_of(self.draws[:, -1], np.asarray(pose, np.float64))


def predict(
    comparer: Comparer,
    member: int,
    posterior: Posterior,
    prior: ParameterPrior,
    noise: Noise,
    *,
    start_sd: FloatArray | None = None,
    draws: int = 400,
    seed: int = 0,
) -> PushPrediction:
    """Predict a repetition of an experiment from the same measured start.

    Parameters
    ----------
    comparer : Comparer
    member : int
        Index of the experiment among its targets.
    posterior : Posterior
        Posterior of the comparer's space.
    prior : ParameterPrior
        Prior of this posterior.
    noise : Noise
        Noise of the camera.
    start_sd : (3,) array, optional
        Standard deviations of the measured first pose [m, m, rad]; by default the camera noise.
        Start errors that are among the unknowns are not drawn again.
    draws : int
        Number of draws, at most the number of samples.
    seed : int
    """
    rng = np.random.default_rng([seed, member])
    rows = rng.permutation(len(posterior.samples))[: max(2, draws)]
    points, k = posterior.samples[rows], len(rows)
    n_free = len(comparer.space.labels)
    own = noise.standard_deviations if start_sd is None else np.asarray(start_sd, np.float64)
    errors = rng.standard_normal((k, 3)) * own
    fit = np.array([name in {u.name for u in comparer.space.free} for name in START])
    errors[:, fit] = 0.0
    still = np.zeros_like(errors)
    best = np.repeat(posterior.best[None], k, axis=0)
    middle, fine = _simulated(comparer, member, best[:1, :n_free], still[:1])
    if not fine[0]:
        raise SolveFailed("the likeliest sample cannot be simulated")
    centre = middle[0]
    both, good = _simulated(comparer, member, points[:, :n_free], errors)
    only, good_only = _simulated(comparer, member, points[:, :n_free], still)
    begun, good_begun = _simulated(comparer, member, best[:, :n_free], errors)
    target = comparer.targets[member]
    walk = np.zeros_like(both)
    if prior.model_error is not None:
        share = expected_shares(comparer, member, prior.model_error)
        walk = draw_walks(share, points[:, -1], prior.model_error.sides, rng)
    seen = rng.standard_normal(both.shape) * noise.standard_deviations
    paths = [_near(path, centre) for path in (only, begun, both)]
    truths = (paths[2] + walk)[good]
    if len(truths) < 2:
        raise SolveFailed("hardly any sample can be simulated from the starts drawn")
    return PushPrediction(
        time=np.asarray(target.case.times),
        best=centre,
        draws=truths + seen[good],
        truths=truths,
        shares={
            "parameters": _spread(paths[0][good_only]),
            "start": _spread(paths[1][good_begun]),
            "model error": _spread(walk),
            "noise": _spread(seen),
            "all": _spread(truths + seen[good]),
        },
        failed=int((~good).sum()),
    )


def _simulated(
    comparer: Comparer, member: int, points: FloatArray, errors: FloatArray
) -> tuple[FloatArray, np.ndarray]:
    """Return paths (k, n_frame, 3) of points (k, n_free) from perturbed starts, and which
    simulations converged."""
    target = comparer.targets[member]
    values = comparer.space.columns(points, target.conditions)
    for name, error in zip(START, errors.T, strict=True):
        if error.any() or name in values:
            values[name] = values.get(name, 0.0) + error
    which = np.full(len(points), member)
    outcome = comparer.ensemble.simulate(
        which, {name: np.ascontiguousarray(value) for name, value in values.items()}
    )
    return outcome.pose[:, : len(target.pose)], outcome.converged


def _near(paths: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the paths with angles within half a turn of the central path."""
    turned = paths.copy()
    turned[..., 2] = centre[:, 2] + wrapped(paths[..., 2] - centre[:, 2])
    return turned


def _spread(paths: FloatArray) -> FloatArray:
    return np.asarray(paths[:, -1].std(axis=0)) if len(paths) else np.zeros(3)


# --- regions ------------------------------------------------------------------------------------


def bounds_of(poses: FloatArray, level: float) -> EndBounds:
    """Return the smallest ellipse of the draws' shape and the shortest interval of angles that
    contain a share of poses (k, 3)."""
    if not 0.0 < fraction(level, "level") < 1.0:
        raise InvalidInput("level", found=level, expected="a number between 0 and 1")
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
        raise InvalidInput("coverage", found="no outcomes", expected="one level an outcome")
    wanted = np.array(levels)
    held = np.array([float(np.mean(own <= level)) for level in levels])
    n = len(own)
    return CoverageCurve(
        wanted, held, binom.ppf(0.025, n, wanted) / n, binom.ppf(0.975, n, wanted) / n, n
    )
