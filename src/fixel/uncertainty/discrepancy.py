"""Model error as a term of its own: how far a right simulation with the best values still goes
astray.

A simulation starts at the measured first pose, so there its error is zero; what it gets wrong of
each stretch of the way adds up. The error is therefore taken for a random walk in the distance that
the object has travelled: between two frames its variance grows by tau^2 times the share of the way
that lies between them, independently in x, y and L theta. At the end of the way its standard
deviation is tau.

Against the alternatives: an error that is the same in all frames would be largest where there is
none, at the start; one that grows in proportion to the way has one shape only, and whatever else
the model gets wrong would still have to be explained by parameters. A walk has all shapes. How much
it costs a drift of the size d to be explained by it depends on d / tau alone, not on how often the
camera looked: hundreds of frames of a wrong model no longer make parameters look certain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.objective import ANGLE_SCALE
from fixel.errors import InvalidInput
from fixel.model.fields import positive, settle
from fixel.typing import FloatArray

LABEL: Final = "model_error"
MEANING: Final = "standard deviation of the model's own error at the end of the way"

# Range of its standard deviation: from what a camera cannot see to what nobody would call a model.
MIN_DISCREPANCY: Final = 5e-5  # [m]
MAX_DISCREPANCY: Final = 2e-2  # [m]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ModelError:
    """What is believed of the standard deviation tau of model error before looking.

    Its logarithm is uniform between two ends: as likely 0.1 to 0.2 mm as 1 to 2 mm.

    Parameters
    ----------
    low, high : float
        Ends [m], at the end of the way.
    angle_scale : float
        A radian counts as this [m/rad]: the angle's standard deviation is tau over it.
    """

    low: float = MIN_DISCREPANCY
    high: float = MAX_DISCREPANCY
    angle_scale: float = ANGLE_SCALE

    def __post_init__(self) -> None:
        for name, unit in (("low", "m"), ("high", "m"), ("angle_scale", "m/rad")):
            settle(self, **{name: positive(getattr(self, name), f"model_error.{name}", unit)})
        if not self.low < self.high:
            found = f"{self.low:g} to {self.high:g} m"
            raise InvalidInput("model_error", found=found, expected="the lower one first")

    def transform(self, unit: FloatArray) -> FloatArray:
        """Quantiles (k,) in [0, 1] to standard deviations [m]."""
        return np.asarray(self.low * (self.high / self.low) ** np.asarray(unit, np.float64))

    @property
    def sides(self) -> FloatArray:
        """(3,) of x, y, theta: by which tau is divided [-, -, m/rad]."""
        return np.array([1.0, 1.0, self.angle_scale])


class WalkAxes(NamedTuple):
    """Principal axes of a random walk over the frames of one experiment."""

    axes: FloatArray  # (n_frame, n_frame) a column each
    variance: FloatArray  # (n_frame,) along them, of a walk with tau = 1
    share: FloatArray  # (n_frame,) of the way that lies behind each frame


def shares_of_way(first: FloatArray, poses: FloatArray, angle_scale: float) -> FloatArray:
    """Share (n,) of the way that an object has travelled at poses (n, 3), from the first (3,).

    The way is that of the origin, and of turning by `angle_scale` metres a radian. A camera's noise
    would make way where nothing moves, so what counts is the largest distance from the start that
    was reached so far. Shares grow strictly: each frame adds a thousandth of an even share.
    """
    moved = (poses - first) * np.array([1.0, 1.0, angle_scale])
    distance = np.maximum.accumulate(np.sqrt(np.sum(moved**2, axis=1)))
    even = distance[-1] * np.arange(1, len(poses) + 1) / len(poses)
    mixed = distance + 1e-3 * even
    if not mixed[-1] > 0.0:
        return np.arange(1, len(poses) + 1) / len(poses)
    return np.asarray(mixed / mixed[-1])


def walk_over(share: FloatArray) -> WalkAxes:
    """Principal axes of a walk whose variance at frames is their share (n,) of the way."""
    variance, axes = np.linalg.eigh(np.minimum(share[:, None], share[None, :]))
    return WalkAxes(np.ascontiguousarray(axes), np.maximum(variance, 0.0), share)


def draw_walks(
    share: FloatArray, tau: FloatArray, sides: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Model errors (k, n_frame, 3) of x, y, theta [m, m, rad] for standard deviations tau (k,)."""
    steps = np.sqrt(np.diff(share, prepend=0.0))
    walks = np.cumsum(steps[:, None] * rng.standard_normal((len(tau), len(share), 3)), axis=1)
    return np.asarray(walks * tau[:, None, None] / sides)


def log_density(
    rotated: FloatArray, variance: FloatArray, tau: FloatArray, white: FloatArray
) -> FloatArray:
    """Gaussian log density (k,) of residuals along the axes of a walk, white noise beside it.

    Parameters
    ----------
    rotated : (k, n, 3) array
        Residuals along the axes [m, m, rad].
    variance : (n,) array
        Of the walk with tau = 1.
    tau : (k, 3) array
        Of the walk in x, y, theta [m, m, rad].
    white : (3,) array
        Variances of the white noise.
    """
    total = white + variance[:, None] * (tau**2)[:, None, :]
    return np.asarray(
        -0.5 * np.sum(rotated**2 / total + np.log(2.0 * math.pi * total), axis=(1, 2))
    )
