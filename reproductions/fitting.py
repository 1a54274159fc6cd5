"""Fits of parameters to the ends of pushes, with their priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.optimiser import SearchBox
from fixel.datasets.mit_push_records import TIP
from fixel.model import wrapped
from fixel.typing import FloatArray, IntArray
from reproductions.pushes import PART_NAMES, PushGroup
from reproductions.registration import Registration, registration_from_gaps

# Length by which angles count [m/rad]; one degree counts as 0.6 mm.
ARM: Final = 35e-3
# Typical error of a good prediction [m]; sets the weight of the priors against the pushes.
NOISE: Final = 2.5e-3
# Error at which the loss changes from square to linear [m].
WIDTH: Final = 2.0e-3
# Error of a push that cannot be simulated, in x, y and angle [m]; independent of parameters.
LOST: Final = 10e-3


class Belief(NamedTuple):
    """Prior of one parameter: mean, standard deviation and bounds."""

    name: str
    mean: float
    sd: float
    low: float
    high: float


class FittedPushes(NamedTuple):
    """Fitted values of parameters."""

    names: tuple[str, ...]
    point: FloatArray  # (n_name,)
    evaluations: int  # pushes simulated

    def predict(self, group: PushGroup, which: IntArray) -> FloatArray:
        """Predict the end poses (n, 3) of members; NaN if the simulation did not finish."""
        return group.ends(which, self.values)

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by name."""
        return dict(zip(self.names, self.point.tolist(), strict=True))


# --- priors ---------------------------------------------------------------------------------------


def tip_beliefs(sd: float = 0.1) -> list[Belief]:
    """Prior of the friction at the tip, steel on steel."""
    return [Belief("mu_pusher", 0.2, sd, 0.02, 0.8)]


def load_beliefs(group: PushGroup, sd: float) -> list[Belief]:
    """Priors of the loads on the net of support points, as multiples of an even share."""
    return [Belief(f"load_{k + 1}", 1.0, sd, 0.0, 8.0) for k in range(len(group.points))]


def profile_beliefs() -> list[Belief]:
    """Priors of balanced loads about equal ones, from six numbers instead of one for each point."""
    wide = {"rim": 2.0, "corner": 1.5, "xy": 1.5, "diagonal": 1.0}
    found = [Belief(f"pressure_{name}", 0.0, sd, -6.0, 6.0) for name, sd in wide.items()]
    return found + [Belief(f"pressure_tilt_{axis}", 0.0, 0.3, -1.5, 1.5) for axis in "xy"]


def table_beliefs(bend: float = 0.0, quarter: float = 0.6, slope: float = 0.3) -> list[Belief]:
    """Priors of the table's shape, from standard deviations; zero omits a parameter.

    `bend` is for loads that are not free themselves; `quarter` applies to `table_bend_xy` and
    `table_bend_diagonal`.
    """
    found = [Belief("table_bend", 0.1, bend, -1.5, 1.5)] if bend else []
    for sd, limit, names in (
        (quarter, 2.0, ("table_bend_xy", "table_bend_diagonal")),
        (slope, 1.0, ("table_slope_x", "table_slope_y")),
    ):
        found += [Belief(name, 0.0, sd, -limit, limit) for name in names if sd]
    return found


def part_beliefs(sd: float) -> list[Belief]:
    """Priors of log factors on the loads at corners, inside and rim, relative to other points."""
    return [Belief(name, 0.0, sd, -2.5, 2.5) for name in PART_NAMES.values()]


def registration_beliefs(shift: FloatArray, sd: float) -> list[Belief]:
    """Priors of the registration, about a shift estimated from gaps [m]."""
    return [
        Belief(f"registration_{axis}", value, sd, value - 3e-3, value + 3e-3)
        for axis, value in zip("xy", shift.tolist(), strict=True)
    ]


def outline_beliefs() -> list[Belief]:
    """Priors of the outline's pose in the frame of the tracker's markers, and of the tip size."""
    return [
        Belief("outline_x", 0.0, 0.5e-3, -3e-3, 3e-3),
        Belief("outline_y", 0.0, 0.5e-3, -3e-3, 3e-3),
        Belief("outline_theta", 0.0, 0.015, -0.1, 0.1),
        Belief("contact_offset", 0.0, 0.3e-3, -1e-3, 1e-3),
    ]


def about(beliefs: Sequence[Belief], mean: Mapping[str, float]) -> list[Belief]:
    """Replace the means of priors by given ones, where there are any."""
    return [b._replace(mean=mean.get(b.name, b.mean)) for b in beliefs]


def gap_registration(
    group: PushGroup,
    train: IntArray,
    prior: ArrayLike = (0.0, 0.0),
    prior_sd: float = 1e-3,
) -> Registration:
    """Estimate the registration from the gaps at the ends of pushes alone, without physics."""
    return registration_from_gaps(
        group.shape,
        TIP.radius,
        group.end[train],
        group.tip_end[train],
        prior=prior,
        prior_sd=prior_sd,
    )


# --- fit ------------------------------------------------------------------------------------------


class FitMember(NamedTuple):
    """Group of pushes in a fit, its training members, and known values of the group."""

    group: PushGroup
    train: IntArray
    known: Mapping[str, float]


def fit_pushes(
    members: Sequence[FitMember],
    beliefs: Sequence[Belief],
    *,
    iterations: int,
) -> FittedPushes:
    """Fit parameters that several groups share: the most probable values given their pushes.

    Parameters
    ----------
    members : sequence of FitMember
        Groups to fit, mostly one.
    beliefs : sequence of Belief
    iterations : int
        Maximum number of steps of the Levenberg-Marquardt method.
    """
    mean, sd, low, high = (np.array([b[k] for b in beliefs]) for k in (1, 2, 3, 4))
    box = SearchBox(low, high, np.clip(mean, low, high), sd)
    method = LeastSquares(
        loss="soft_l1",
        width=WIDTH / NOISE,
        differences="one-sided",
        difference=0.15,
        largest_difference=0.6,
        trials=3,
        tolerance=1e-3,
        most_iterations=iterations,
    )
    names = tuple(b.name for b in beliefs)
    count = 0

    def residuals(points: FloatArray) -> FloatArray:
        nonlocal count
        count += len(points) * sum(len(m.train) for m in members)
        return np.concatenate([_residuals(m, names, points) for m in members], axis=1)

    end = fit(method.start(box, prior=NormalPrior(mean=mean, sd=sd)), residuals)
    return FittedPushes(names, end.point, count)


def _residuals(member: FitMember, names: tuple[str, ...], points: FloatArray) -> FloatArray:
    """Residuals (k, 3 n_train) at points (k, n_name) [standard deviations]."""
    group, train = member.group, member.train
    k, n = len(points), len(train)
    values = {name: np.repeat(points[:, j], n) for j, name in enumerate(names)}
    values |= {name: np.full(k * n, x) for name, x in member.known.items()}
    found = group.simulate(np.tile(train, k), values)
    away = found.end.reshape(k, n, 3) - group.end[train]
    away[..., 2] = ARM * wrapped(away[..., 2])
    away[~found.good.reshape(k, n)] = LOST
    return np.asarray(away.reshape(k, 3 * n) / NOISE)
