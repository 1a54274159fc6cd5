"""Errors of the start pose of a body: their size, and samples of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Final, Literal, cast, final

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model.fields import Value, check_fields, non_negative, whole
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
        x, y, theta = _length(self.x), _length(self.y), f"{math.degrees(self.theta):.3g} deg"
        places = [x] * (self.x > 0.0)
        if self.x != self.y:
            places = [f"{x} (x)"] * (self.x > 0.0) + [f"{y} (y)"] * (self.y > 0.0)
        sizes = [*places, *[theta] * (self.theta > 0.0)]
        if self.kind == "normal":
            return f"start: {', '.join(sizes)} standard deviation"
        return f"start: {', '.join(f'+-{size}' for size in sizes)} uniform"


def _length(metres: float) -> str:
    return f"{1e6 * metres:.3g} um" if 0.0 < metres < 1e-4 else f"{1e3 * metres:.3g} mm"


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
