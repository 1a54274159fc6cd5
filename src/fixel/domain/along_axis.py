"""Errors of a parameter set, from a few experiments along an axis, on all experiments there.

Source: RPI thesis, chapter 6, figures 6.1 to 6.13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.objective import Evaluation
from fixel.domain import growth
from fixel.domain.growth import interval
from fixel.errors import InvalidInput
from fixel.typing import FloatArray, IntArray

# Samples that the thesis fits on (section 6.1).
SIZES: Final[Mapping[str, tuple[int, ...]]] = {"x": (2, 4), "y": (3, 5), "theta": (2, 4)}
MOST_SAMPLES: Final = 5


class AxisEdges(NamedTuple):
    """Ends of the domain about the nominal experiment along an axis, in steps."""

    low: float | None  # None if the nominal experiment is not in the domain
    high: float | None
    low_open: bool = False  # the domain contains the last experiment
    high_open: bool = False


def edges(steps: IntArray, errors: FloatArray, threshold: float) -> AxisEdges:
    """Return where an error curve first exceeds a threshold on both sides of the nominal.

    Errors (n,) at ascending steps (n,), with 0, are interpolated linearly; where one is not finite,
    the domain ends at the experiment before. Experiments farther out that are below the threshold
    again are not part of the domain.
    """
    start = int(np.flatnonzero(steps == 0)[0])
    if not errors[start] <= threshold:
        return AxisEdges(None, None)
    low, low_open = _walked(steps[start::-1], errors[start::-1], threshold)
    high, high_open = _walked(steps[start:], errors[start:], threshold)
    return AxisEdges(low, high, low_open, high_open)


def _walked(steps: IntArray, errors: FloatArray, threshold: float) -> tuple[float, bool]:
    for k in range(1, len(steps)):
        if errors[k] <= threshold:
            continue
        inner, outer = float(steps[k - 1]), float(steps[k])
        if not np.isfinite(errors[k]):
            return inner, False
        share = (threshold - errors[k - 1]) / (errors[k] - errors[k - 1])
        return inner + float(share) * (outer - inner), False
    return float(steps[-1]), True


class AxisStudy(NamedTuple):
    """Errors of all layouts of one shape along an axis, each with the set of its interval."""

    shape: str
    axis: str
    size: int  # number of samples in the interval
    interval: tuple[int, int]  # first and last step of the samples
    steps: IntArray  # (n_step,) steps of the experiments on the axis, ascending
    layouts: tuple[str, ...]
    sets: tuple[growth.GroupParameters, ...]  # parameter sets, one per layout
    # (n_layout, n_step) Error E with the set; nan without an experiment or set, inf for a failure.
    error: FloatArray
    own: FloatArray  # (n_layout, n_step) error E of each experiment with its own best set

    @property
    def average(self) -> FloatArray:
        """Mean error (n_step,) over the layouts that have one; inf if any failed."""
        return _mean(self.error)

    @property
    def own_average(self) -> FloatArray:
        """Mean error (n_step,) with the own best sets of experiments, over the same layouts."""
        return _mean(np.where(np.isnan(self.error), np.nan, self.own))

    @property
    def excess(self) -> FloatArray:
        """Error (n_layout, n_step) minus the own best: the relative error of section 6.4.3."""
        return _against(self.error, self.own, np.subtract)

    @property
    def average_excess(self) -> FloatArray:
        """Mean excess (n_step,) over the layouts."""
        return _mean(self.excess)

    @property
    def ratio(self) -> FloatArray:
        """Ratio (n_step,) of average error to average own best."""
        return _against(self.average, self.own_average, np.divide)

    def counted(self) -> IntArray:
        """Return the number of layouts (n_step,) in the average."""
        return np.asarray((~np.isnan(self.error)).sum(axis=0))

    def edges(self, threshold: float) -> AxisEdges:
        """Return the ends of the domain by the average error."""
        return edges(self.steps, self.average, threshold)

    def relative_edges(self, threshold: float) -> AxisEdges:
        """Return the ends of the domain by the average excess."""
        return edges(self.steps, self.average_excess, threshold)


def _against(error: FloatArray, own: FloatArray, how: np.ufunc) -> FloatArray:
    """Combine two errors; nan if either is missing, inf if only the first failed."""
    known = np.isfinite(own) & ~np.isnan(error)
    found = np.full(error.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        how(error, own, out=found, where=known)
    return found


def _mean(table: FloatArray) -> FloatArray:
    """Return the mean of each column without nan; nan if there is nothing else."""
    there = ~np.isnan(table)
    count = there.sum(axis=0)
    total = np.where(there, table, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def plan_studies(
    groups: Sequence[growth.ExperimentGroup],
    singles: growth.SingleCalibrations,
    wanted: growth.RolloutQueue,
    sizes: Mapping[str, Sequence[int]] = SIZES,
) -> Callable[[Evaluation], list[AxisStudy]]:
    """Add the rollouts of studies to a queue; return the function of their results.

    Numbers of samples of the intervals are by default those of the thesis.
    """
    layouts: dict[str, list[growth.ExperimentGroup]] = {}
    for group in groups:
        layouts.setdefault(group.shape, []).append(group)
    numbers = _checked(sizes)
    plan = [
        _planned(own, axis, size, singles, wanted)
        for own in layouts.values()
        for axis in growth.AXES
        if any(place.axis == axis for group in own for place in group.at)
        for size in numbers[axis]
    ]

    def read(answer: Evaluation) -> list[AxisStudy]:
        return [
            study._replace(error=np.where(places >= 0, answer.error[places], np.nan))
            for study, places in plan
        ]

    return read


def _planned(
    groups: Sequence[growth.ExperimentGroup],
    axis: str,
    size: int,
    singles: growth.SingleCalibrations,
    wanted: growth.RolloutQueue,
) -> tuple[AxisStudy, IntArray]:
    """Return a study without errors, and the indices (n_layout, n_step) of its rollouts; -1: none.

    The groups are the layouts of one shape.
    """
    low, high = interval(axis, size)
    on_axis = {p.step for group in groups for p in group.at if p.axis == axis}
    steps = np.array(sorted(on_axis | {0}))
    inside = [growth.along(axis, k) for k in range(low, high + 1)]
    sets, places = [], np.full((len(groups), len(steps)), -1)
    own = np.full(places.shape, np.nan)
    for row, group in enumerate(groups):
        for column, step in enumerate(steps.tolist()):
            if (place := growth.along(axis, step)) in group.at:
                own[row, column] = singles.errors[group.at[place]]
        missing = group.missing(inside)
        members = group.found(inside)
        if missing:
            reason = "not performed: " + ", ".join(place.name for place in missing)
            sets.append(growth.GroupParameters(members, None, growth.NONE, reason=reason))
            continue
        sets.append(growth.group_parameters(members, singles))
        point = sets[-1].point
        for column, step in enumerate(steps.tolist()):
            place = growth.along(axis, step)
            if point is not None and place in group.at:
                places[row, column] = wanted.add(group.at[place], point)
    layouts, none = tuple(group.layout for group in groups), np.full(places.shape, np.nan)
    study = AxisStudy(
        groups[0].shape, axis, size, (low, high), steps, layouts, tuple(sets), none, own
    )
    return study, places


def _checked(sizes: Mapping[str, Sequence[int]]) -> dict[str, tuple[int, ...]]:
    found = {axis: tuple(dict.fromkeys(sizes.get(axis, SIZES[axis]))) for axis in growth.AXES}
    for axis, own in found.items():
        for size in own:
            if not 2 <= size <= MOST_SAMPLES:
                raise InvalidInput(
                    f"sizes of {axis}", found=size, expected=f"from 2 to {MOST_SAMPLES} samples"
                )
    return found
