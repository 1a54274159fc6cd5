"""What uncertain parameters mean for a path and its end: bands, bounds, and what they are made of.

A draw of the future is one posterior sample simulated from one start, plus one walk of the model's
own error with that sample's standard deviation, plus the camera's noise. Its parts are kept
separate, so that it can be told whether better parameters, a better placed start, a better model or
a better camera would narrow the prediction.
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


class Band(NamedTuple):
    """Ends of a band around a path, frame by frame."""

    level: float
    low: FloatArray  # (n_frame, 3) x, y, theta [m, m, rad]
    high: FloatArray  # (n_frame, 3)


class Ellipse(NamedTuple):
    """A region of positions."""

    level: float
    centre: FloatArray  # (2,) [m]
    radii: FloatArray  # (2,) half axes, the larger first [m]
    angle: float  # of the larger axis [rad]


class EndBounds(NamedTuple):
    """Where a push ends, with a probability."""

    level: float
    position: Ellipse
    angle: tuple[float, float]  # the shortest interval [rad]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PushPrediction:
    """Draws of how an experiment goes.

    Attributes
    ----------
    time : (n_frame,) float64
        [s]
    best : (n_frame, 3) float64
        Simulated with the likeliest sample.
    draws : (k, n_frame, 3) float64
        Poses as a camera would see them; angles near those of `best`.
    truths : (k, n_frame, 3) float64
        The same without the camera's noise.
    shares : mapping of str to (3,) float64
        Standard deviation at the end of each of `PARTS` alone, and of `"all"` [m, m, rad].
    failed : int
        Draws that could not be simulated, and are left out.
    """

    time: FloatArray
    best: FloatArray
    draws: FloatArray
    truths: FloatArray
    shares: Mapping[str, FloatArray]
    failed: int

    def bands(self, levels: tuple[float, ...] = LEVELS) -> tuple[Band, ...]:
        """Pointwise bands: each frame's own quantiles."""
        return tuple(
            Band(level, *np.quantile(self.draws, (0.5 - level / 2, 0.5 + level / 2), axis=0))
            for level in levels
        )

    def bounds(self, level: float = 0.9) -> EndBounds:
        """Of the last pose as a camera would see it."""
        return bounds_of(self.draws[:, -1], level)

    def levels_of(self, pose: FloatArray) -> tuple[float, float]:
        """The levels of the smallest bounds that hold a last pose (3,): position, angle."""
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
    """Draws of how an experiment goes when it is done once more, from the same measured start.

    Parameters
    ----------
    comparer : Comparer
    member : int
        Number of the experiment among its targets.
    posterior : Posterior
        Of the comparer's space.
    prior : ParameterPrior
        That the posterior was found with.
    noise : Noise
        The camera's.
    start_sd : (3,) array, optional
        Standard deviations of the measured first pose [m, m, rad]; the camera's where left out.
        Where a start error was among the unknowns, that one is not drawn again.
    draws : int
        At most as many as there are samples.
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
    """Paths (k, n_frame, 3) under points (k, n_free) from starts that are off, and which came to
    their end."""
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
    """Angles on the side of the middle path."""
    turned = paths.copy()
    turned[..., 2] = centre[:, 2] + wrapped(paths[..., 2] - centre[:, 2])
    return turned


def _spread(paths: FloatArray) -> FloatArray:
    return np.asarray(paths[:, -1].std(axis=0)) if len(paths) else np.zeros(3)


# --- regions ------------------------------------------------------------------------------------


def bounds_of(poses: FloatArray, level: float) -> EndBounds:
    """The smallest ellipse of the draws' shape, and the shortest interval of angles, that hold a
    share of poses (k, 3)."""
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
    """The shortest interval that holds a share of values (k,)."""
    ordered = np.sort(values)
    inside = min(len(ordered) - 1, max(1, math.ceil(level * len(ordered)) - 1))
    width = ordered[inside:] - ordered[: len(ordered) - inside]
    k = int(np.argmin(width))
    return float(ordered[k]), float(ordered[k + inside])


def levels_of(poses: FloatArray, pose: FloatArray) -> tuple[float, float]:
    """Share of poses (k, 3) that lie closer to the middle than a pose (3,), in the measure of their
    own spread: the level of the smallest region that holds it. For positions, and for angles."""
    centre, spread = _shape(poses[:, :2])
    others = _distances(poses[:, :2], centre, spread)
    own = float(_distances(pose[None, :2], centre, spread)[0])
    middle = float(np.median(poses[:, 2]))
    away = abs(float(wrapped(np.array([pose[2] - middle]))[0]))
    turned = np.abs(poses[:, 2] - middle)
    return float(np.mean(others < own)), float(np.mean(turned < away))


def _shape(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middle and covariance; never flat, so that distances are numbers."""
    spread = np.cov(positions.T)
    least = 1e-12 * max(float(np.trace(spread)), 1e-18)
    return positions.mean(axis=0), spread + least * np.eye(2)


def _distances(positions: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    away = positions - centre
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", away, np.linalg.inv(spread), away)))
