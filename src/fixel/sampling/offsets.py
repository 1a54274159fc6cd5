"""Offsets of the object from its nominal pose: steps along an axis, grids, lists, samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Annotated, Final, Literal, get_args

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model.fields import Value, finite, positive, settle, vector
from fixel.typing import FloatArray

AxisName = Literal["x", "y", "theta"]
Method = Literal["sobol", "halton", "uniform"]

Triple = tuple[float, float, float]
Bounds = tuple[float, float]

# Configurations of one scheme, and steps of one axis. More could not be measured in a year.
MAX_OFFSETS: Final = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Offset of the object from its nominal pose.

    Parameters
    ----------
    axis : str
        `nominal`, `x`, `y` or `theta` for an offset along one axis; otherwise `grid`, `list` or the
        name of the sampling method.
    step : float
        Signed number of steps along the axis; otherwise the number in its scheme, from 1.
    x, y : float
        Offset along the motion of the head and to its left [m].
    theta : float
        Rotation about the centroid, counter-clockwise [rad].
    """

    axis: str
    step: float
    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    @property
    def label(self) -> str:
        """Short name: `nominal`, `y-5`, `theta3`, `sobol12`."""
        return "nominal" if self.axis == "nominal" else f"{self.axis}{self.step:g}"


@dataclass(frozen=True, slots=True)
class Nominal:
    """Scheme of the nominal pose alone."""

    def __len__(self) -> int:
        return 1

    def offsets(self) -> tuple[Offset, ...]:
        """Return the zero offset."""
        return (Offset(axis="nominal", step=0.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetAxis:
    """Scheme of equal steps along one axis, without step 0, the nominal pose.

    Parameters
    ----------
    name : str
        `x`, `y` or `theta`.
    step : float
        Length of a step [m], or [rad] for theta.
    first, last : int
        Numbers of the first and last step; either may be negative.
    """

    name: AxisName
    step: Annotated[float, Value(positive)]
    first: int
    last: int

    def __post_init__(self) -> None:
        check_name("axis.name", self.name, AXES)
        settle(self, step=positive(self.step, "axis.step", "rad" if self.name == "theta" else "m"))
        if not self.first <= self.last or max(-self.first, self.last) > MAX_OFFSETS:
            found = f"steps {self.first} to {self.last}"
            expected = f"first <= last, and at most {MAX_OFFSETS} steps"
            raise InvalidInput("axis.last", found=found, expected=expected)

    def __len__(self) -> int:
        return self.last - self.first + 1 - (self.first <= 0 <= self.last)

    def offsets(self) -> tuple[Offset, ...]:
        """Return the offsets in the order of their steps."""
        counts = [k for k in range(self.first, self.last + 1) if k != 0]
        return tuple(
            Offset(axis=self.name, step=float(k), **{self.name: k * self.step}) for k in counts
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Scheme of all combinations of given values; theta varies fastest.

    Parameters
    ----------
    x, y : tuple of float
        Offsets along the axes [m].
    theta : tuple of float
        Rotations [rad].
    """

    x: tuple[float, ...] = (0.0,)
    y: tuple[float, ...] = (0.0,)
    theta: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        for name in AXES:
            values = tuple(finite(value, f"grid.{name}") for value in getattr(self, name))
            if not values:
                raise InvalidInput(f"grid.{name}", found="no values", expected="at least one")
            settle(self, **{name: values})
        _refuse_crowd(len(self), "grid")

    def __len__(self) -> int:
        return prod(len(getattr(self, name)) for name in AXES)

    def offsets(self) -> tuple[Offset, ...]:
        """Return the offsets, numbered from 1."""
        return _numbered("grid", product(self.x, self.y, self.theta))


@dataclass(frozen=True, slots=True)
class OffsetList:
    """Scheme of given offsets.

    Parameters
    ----------
    rows : tuple of (x, y, theta)
        Offsets [m, m, rad].
    """

    rows: tuple[Triple, ...]

    def __post_init__(self) -> None:
        rows = [vector(row, f"list[{k}]", _LABELS).tolist() for k, row in enumerate(self.rows)]
        if not rows:
            raise InvalidInput("list", found="no offsets", expected="at least one")
        _refuse_crowd(len(rows), "list")
        settle(self, rows=tuple((x, y, theta) for x, y, theta in rows))

    def __len__(self) -> int:
        return len(self.rows)

    def offsets(self) -> tuple[Offset, ...]:
        """Return the offsets, numbered from 1."""
        return _numbered("list", self.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetSample:
    """Scheme of points that fill a box evenly, the same for the same seed.

    Parameters
    ----------
    count : int
        Number of points.
    method : str
        `sobol` or `halton`, scrambled sequences of low discrepancy, or `uniform` random numbers.
    seed : int
        Seed of the scrambling or of the random numbers.
    x, y : (float, float)
        Bounds [m].
    theta : (float, float)
        Bounds [rad].
    """

    count: int
    method: Method = "sobol"
    seed: int = 0
    x: Bounds = (0.0, 0.0)
    y: Bounds = (0.0, 0.0)
    theta: Bounds = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_name("sample.method", self.method, get_args(Method))
        if self.count < 1 or self.seed < 0:
            found = f"a count of {self.count} and the seed {self.seed}"
            raise InvalidInput(
                "sample", found=found, expected="at least one point, and a seed of 0 or more"
            )
        _refuse_crowd(self.count, "sample")
        for name in AXES:
            low, high = vector(getattr(self, name), f"sample.{name}", "smallest, largest").tolist()
            if low > high:
                raise InvalidInput(
                    f"sample.{name}", found=(low, high), expected="in increasing order"
                )
            settle(self, **{name: (low, high)})

    def __len__(self) -> int:
        return self.count

    def offsets(self) -> tuple[Offset, ...]:
        """Return the offsets, numbered from 1."""
        low, high = np.array([getattr(self, name) for name in AXES]).T
        points = low + (high - low) * _unit_points(self.method, self.count, self.seed)
        return _numbered(self.method, points.tolist())


OffsetScheme = Nominal | OffsetAxis | Grid | OffsetList | OffsetSample

AXES: Final[tuple[AxisName, ...]] = get_args(AxisName)
_LABELS: Final = "x [m], y [m], theta [rad]"


def _numbered(axis: str, rows: Sequence[Sequence[float]] | product[Triple]) -> tuple[Offset, ...]:
    return tuple(
        Offset(axis=axis, step=float(number), x=x, y=y, theta=theta)
        for number, (x, y, theta) in enumerate(rows, 1)
    )


def _unit_points(method: Method, count: int, seed: int) -> FloatArray:
    """Return points (count, 3) in the unit cube."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "uniform":
        return rng.random((count, len(AXES)))
    if method == "halton":
        return np.asarray(qmc.Halton(d=len(AXES), seed=rng).random(count))
    # Sobol sequences are balanced for powers of two; the first points of a longer one are good too.
    exponent = (count - 1).bit_length()
    return np.asarray(qmc.Sobol(d=len(AXES), seed=rng).random_base2(exponent)[:count])


def _refuse_crowd(count: int, where: str) -> None:
    if count > MAX_OFFSETS:
        raise InvalidInput(
            where, found=f"{count} configurations", expected=f"at most {MAX_OFFSETS}"
        )
