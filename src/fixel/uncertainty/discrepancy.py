"""Model error as a separate term: the error that remains with the best values of all
parameters.

A simulation starts at the measured first pose, so its error is zero there; errors of each part of
the way add up. The error is therefore modelled as a random walk over the distance travelled by the
object: between two frames its variance grows by tau^2 times the share of the way between them,
independently in x, y and L theta. At the end of the way its standard deviation is tau.

Alternatives are worse. A constant error would not vanish at the start. An error proportional to
the way has only one shape, so parameters would have to explain all other errors. A walk has all
shapes. The likelihood of a drift of size d depends on d / tau only, not on the number of frames:
hundreds of frames of a wrong model do not make parameters appear certain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from fixel.calibration.objective import ANGLE_SCALE
from fixel.errors import InvalidInput
from fixel.model.fields import Value, check_fields, positive
from fixel.typing import FloatArray

LABEL: Final = "model_error"
MEANING: Final = "standard deviation of model error at the end of the motion"

# Range of its standard deviation: from below the camera's resolution to a useless model.
MIN_DISCREPANCY: Final = 5e-5  # [m]
MAX_DISCREPANCY: Final = 2e-2  # [m]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ModelError:
    """Prior of the standard deviation tau of model error.

    Its logarithm is uniform between two ends: as likely 0.1 to 0.2 mm as 1 to 2 mm.
    """

    # Bounds of tau, the standard deviation at the end of the way [m].
    low: Annotated[float, Value(positive, "m")] = MIN_DISCREPANCY
    high: Annotated[float, Value(positive, "m")] = MAX_DISCREPANCY
    # Length that a radian counts as; the angle's standard deviation is tau over it [m/rad].
    angle_scale: Annotated[float, Value(positive, "m/rad")] = ANGLE_SCALE

    def __post_init__(self) -> None:
        check_fields(self, "model_error")
        if not self.low < self.high:
            found = f"{self.low:g} to {self.high:g} m"
            raise InvalidInput("model_error", found=found, expected="increasing bounds")

    def transform(self, unit: FloatArray) -> FloatArray:
        """Return the standard deviations at probabilities (k,) in [0, 1] [m]."""
        return np.asarray(self.low * (self.high / self.low) ** np.asarray(unit, np.float64))

    @property
    def sides(self) -> FloatArray:
        """Divisors (3,) of tau for x, y, theta [-, -, m/rad]."""
        return np.array([1.0, 1.0, self.angle_scale])


def shares_of_way(first: FloatArray, poses: FloatArray, angle_scale: float) -> FloatArray:
    """Return the share (n,) of the way travelled at poses (n, 3) from the first (3,).

    The way includes rotation, at `angle_scale` metres per radian. It is the largest distance from
    the start so far, since camera noise would add to the length of a path at rest. Shares increase
    strictly: each frame adds a thousandth of an even share.
    """
    moved = (poses - first) * np.array([1.0, 1.0, angle_scale])
    distance = np.maximum.accumulate(np.sqrt(np.sum(moved**2, axis=1)))
    even = distance[-1] * np.arange(1, len(poses) + 1) / len(poses)
    mixed = distance + 1e-3 * even
    if not mixed[-1] > 0.0:
        return np.arange(1, len(poses) + 1) / len(poses)
    return np.asarray(mixed / mixed[-1])


def walk_over(share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the principal axes (n, n) of a walk whose variance at each frame is its share (n,) of
    the way, one column each, and the variances (n,) along them for tau = 1."""
    variance, axes = np.linalg.eigh(np.minimum(share[:, None], share[None, :]))
    return np.ascontiguousarray(axes), np.maximum(variance, 0.0)


def draw_walks(
    share: FloatArray, tau: FloatArray, sides: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draw model errors (k, n_frame, 3) in x, y, theta for standard deviations tau (k,) [m]."""
    steps = np.sqrt(np.diff(share, prepend=0.0))
    walks = np.cumsum(steps[:, None] * rng.standard_normal((len(tau), len(share), 3)), axis=1)
    return np.asarray(walks * tau[:, None, None] / sides)


def log_density(
    rotated: FloatArray, variance: FloatArray, tau: FloatArray, white: FloatArray
) -> FloatArray:
    """Return the Gaussian log density (k,) of residuals that are a walk plus white noise.

    Residuals (k, n, 3) are along the axes [m, m, rad]. The walk has a variance (n,) for tau = 1,
    and standard deviations tau (k, 3); `white` (3,) are variances of the white noise.
    """
    total = white + variance[:, None] * (tau**2)[:, None, :]
    return np.asarray(
        -0.5 * np.sum(rotated**2 / total + np.log(2.0 * math.pi * total), axis=(1, 2))
    )
