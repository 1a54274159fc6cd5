"""Error terms of simulations: errors of the start pose, and the error that the model leaves.

The model error is a separate term: what remains with the best values of all parameters. A
simulation starts at the measured first pose, so its error is zero there; errors of each part of
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
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Final, Literal, cast, final

import numpy as np

from fixel.calibration.objective import ANGLE_SCALE
from fixel.errors import InvalidInput, check_name
from fixel.model.fields import Value, check_fields, non_negative, positive, whole
from fixel.model.goals import length
from fixel.model.shape import Shape, length_scale
from fixel.typing import FloatArray

Kind = Literal["uniform", "normal"]
KINDS: Final = ("uniform", "normal")
NO_KIND: Final = cast(Kind, "")  # refused, with both meanings in the error
MEANINGS: Final = "'uniform' (sizes are half-widths) or 'normal' (sizes are standard deviations)"

MAX_STARTS: Final = 1_000_000
MAX_SIZE: Final = 1e6  # [m or rad] of a start error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartError:
    """Distribution of the error of a start pose.

    Parameters
    ----------
    x, y : float
        Size along the world axes [m]; 0 if not given. At least one of the three sizes is positive.
    theta : float
        Size of the angle's error [rad]; 0 if not given.
    kind : str
        ``"uniform"``: sizes are half-widths of a box, as in the ASME paper; ``"normal"``: sizes are
        standard deviations. There is no default: the same sizes mean different errors.

    Examples
    --------
    >>> from fixel.units import deg, mm
    >>> print(StartError(x=1 * mm, y=1 * mm, theta=2 * deg, kind="uniform"))
    start: +-1 mm, +-2 deg uniform
    """

    x: Annotated[float, Value(non_negative, "m")] = 0.0
    y: Annotated[float, Value(non_negative, "m")] = 0.0
    theta: Annotated[float, Value(non_negative, "rad")] = 0.0
    kind: Kind = NO_KIND

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            hint = "the same sizes mean different errors, so there is no default"
            found = str(self.kind) or "none"
            raise InvalidInput("start_error.kind", found=found, expected=MEANINGS, hint=hint)
        check_fields(self, "start_error")
        if self.x == self.y == self.theta == 0.0:
            expected = "at least one of x, y and theta above zero"
            raise InvalidInput("start_error", found="zero in all directions", expected=expected)
        for name, unit in (("x", "m"), ("y", "m"), ("theta", "rad")):
            if (size := getattr(self, name)) > MAX_SIZE:
                expected = f"at most {MAX_SIZE:.0f} [{unit}]"
                raise InvalidInput(f"start_error.{name}", found=size, expected=expected)

    @property
    def size(self) -> FloatArray:
        """Half-widths or standard deviations (3,) [m, m, rad]."""
        return np.array([self.x, self.y, self.theta])

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations (3,) [m, m, rad]."""
        return self.size / math.sqrt(3.0) if self.kind == "uniform" else self.size

    @property
    def reach(self) -> FloatArray:
        """Limits (3,) that errors hardly ever exceed [m, m, rad]."""
        return self.size if self.kind == "uniform" else 4.0 * self.size

    def samples(self, n: int, seed: int = 0) -> FloatArray:
        """Return errors (n, 3) from a scrambled Sobol sequence [m, m, rad].

        Source: Owen (1998), scrambling Sobol and Niederreiter-Xing points; `scipy.stats.qmc`.
        """
        from scipy.special import ndtri

        even = even_points(n, 3, seed)
        if self.kind == "uniform":
            return np.asarray(self.size * (2.0 * even - 1.0))
        # A point on the border of the cube has an infinite normal quantile.
        return np.asarray(self.size * ndtri(np.clip(even, 1e-9, 1.0 - 1e-9)))

    def __str__(self) -> str:
        x, y, theta = length(self.x), length(self.y), f"{math.degrees(self.theta):.3g} deg"
        places = [x] * (self.x > 0.0)
        if self.x != self.y:
            places = [f"{x} (x)"] * (self.x > 0.0) + [f"{y} (y)"] * (self.y > 0.0)
        sizes = [*places, *[theta] * (self.theta > 0.0)]
        if self.kind == "normal":
            return f"start: {', '.join(sizes)} standard deviation"
        return f"start: {', '.join(f'+-{size}' for size in sizes)} uniform"


# Experimental errors of the ASME paper: +-1 pixel in x and y; 0.5 deg is read from its figure of
# the same simulations.
ASME: Final = StartError(x=5e-6, y=5e-6, theta=math.radians(0.5), kind="uniform")
# Static noise of the stickers' poses in RPI's trials.
RPI_CAMERA: Final = StartError(x=5e-5, y=5e-5, theta=2e-3, kind="normal")

PRESETS: Final[Mapping[str, StartError]] = MappingProxyType(
    {"asme": ASME, "rpi-camera": RPI_CAMERA}
)


def preset(name: str) -> StartError:
    """Return a start error by name, or raise `InvalidInput`."""
    check_name("preset", name, PRESETS)
    return PRESETS[name]


def even_points(n: int, dimensions: int, seed: int) -> FloatArray:
    """Return points (n, dimensions) of a scrambled Sobol sequence in the unit cube."""
    from scipy.stats import qmc

    whole(n, "samples", 1, MAX_STARTS)
    power = math.ceil(math.log2(n)) if n > 1 else 0
    cube = qmc.Sobol(dimensions, scramble=True, seed=np.random.default_rng(whole(seed, "seed", 0)))
    return np.asarray(cube.random_base2(power)[:n], np.float64)


LABEL: Final = "model_error"
MEANING: Final = "standard deviation of model error at the end of the motion"

# Range of its standard deviation: from below the camera's resolution to a useless model.
MIN_DISCREPANCY: Final = 5e-5  # [m]
MAX_DISCREPANCY: Final = 2e-2  # [m]


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

    @classmethod
    def usual(cls, shape: Shape) -> ModelError:
        """Return the usual prior for a part, with shorter lengths for small ones."""
        scale = length_scale(shape)
        return cls(
            low=scale * MIN_DISCREPANCY,
            high=scale * MAX_DISCREPANCY,
            angle_scale=scale * ANGLE_SCALE,
        )

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
    rotated: FloatArray,
    variance: FloatArray,
    tau: FloatArray,
    white: FloatArray,
    start: FloatArray | None = None,
) -> FloatArray:
    """Return the Gaussian log density (k,) of residuals that are a walk plus white noise.

    Residuals (k, n, 3) are along the axes [m, m, rad]. The walk has a variance (n,) for tau = 1,
    and standard deviations tau (k, 3); `white` (3,) are variances of the white noise. Three more
    errors, of standard deviation 1, change all residuals together, by `start` (n, 3, 3).
    """
    total = white + variance[:, None] * (tau**2)[:, None, :]
    alone = -0.5 * np.sum(rotated**2 / total + np.log(2.0 * math.pi * total), axis=(1, 2))
    if start is None:
        return np.asarray(alone)
    # Woodbury's identity, with (3, 3 n) matrices for each point.
    common = start.reshape(-1, 3)
    weighted = np.swapaxes(common / total.reshape(len(total), -1, 1), 1, 2)
    pull = np.matmul(weighted, rotated.reshape(len(rotated), -1, 1))
    information = np.eye(3) + np.matmul(weighted, common)
    gained = np.sum(pull * np.linalg.solve(information, pull), axis=(1, 2))
    return np.asarray(alone + 0.5 * (gained - np.linalg.slogdet(information)[1]))
