"""Growth of the domain of one parameter set from the nominal experiment outwards.

There is no search: a parameter set is a stored one, or a mean of those of single experiments. All
rollouts are requested as one batch.

Source: RPI thesis, section 5.3 for the places of the experiments, appendix C.6 for their order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from fixel.calibration.objective import Evaluation
from fixel.calibration.study import MIN_ERROR, weighted_mean
from fixel.errors import InvalidInput
from fixel.model.fields import settle, whole
from fixel.typing import FloatArray, IntArray

OWN: Final = "own"  # parameters of a single experiment
STORED: Final = "stored"
AVERAGED: Final = "averaged"  # mean, weighted with inverse errors
NONE: Final = "none"


Evaluate = Callable[[IntArray, FloatArray], Evaluation]
Index = Literal["corrected", "printed"]
AXES: Final = ("x", "y", "theta")
INDEXES: Final = ("corrected", "printed")
PRINTED_STEPS: Final = 5


class AxisPlace(NamedTuple):
    """Number of steps from the nominal pose along one axis."""

    axis: str
    step: int

    @property
    def name(self) -> str:
        """Name in the thesis's plan: `y-5`."""
        return self.axis if self == NOMINAL else f"{self.axis}{self.step}"


NOMINAL: Final = AxisPlace("nominal", 0)

# The 21 rows of a group in the order of the printed code, numbered from 1.
ROWS: Final = (
    NOMINAL,
    *(AxisPlace("x", k) for k in range(1, 6)),
    *(AxisPlace("y", k) for k in range(5, 0, -1)),
    *(AxisPlace("y", -k) for k in range(1, 6)),
    *(AxisPlace("theta", k) for k in range(1, 6)),
)


def joining(step: int, index: Index = "corrected") -> tuple[AxisPlace, ...]:
    """Return the places that join the domain at a step, from 1: x+i, y+i, y-i, theta+i.

    The printed code takes theta from row 15 + i, one too early: at step 1 this is y-5, which joins
    again at step 5, and theta+5, row 21, never joins. `"printed"` does the same.
    """
    if index == "corrected":
        return (
            AxisPlace("x", step),
            AxisPlace("y", step),
            AxisPlace("y", -step),
            AxisPlace("theta", step),
        )
    if index not in INDEXES:
        raise InvalidInput("index", found=repr(index), expected="corrected or printed")
    if not 1 <= step <= PRINTED_STEPS:
        raise InvalidInput("step", found=step, expected="from 1 to 5, as printed")
    return tuple(ROWS[row - 1] for row in (1 + step, 12 - step, 11 + step, 15 + step))


def domain(step: int, index: Index = "corrected") -> tuple[AxisPlace, ...]:
    """Return the places in the domain after a step, in order: the nominal one, then 4 per step."""
    joined = (place for k in range(1, step + 1) for place in joining(k, index))
    return (NOMINAL, *joined)


def interval(axis: str, size: int) -> tuple[int, int]:
    """Return the first and last step of a domain of `size` samples along an axis.

    The samples include the nominal one: "when the domain size is expanded to 4 samples" (6.2.1).
    Along x and theta, sampled in one direction, they begin there: 4 is 0 to 3. Along y they are
    centred: 3 is -1 to 1; even numbers, unused in the thesis, have one more on the positive side.
    """
    if axis not in AXES:
        raise InvalidInput("axis", found=repr(axis), expected="x, y or theta")
    whole(size, f"size of {axis}", 2)
    low = -((size - 1) // 2) if axis == "y" else 0
    return low, low + size - 1


def along(axis: str, step: int) -> AxisPlace:
    """Return a place on an axis; step 0 is the nominal place."""
    return AxisPlace(axis, step) if step else NOMINAL


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentGroup:
    """Experiments of one shape and layout."""

    shape: str
    layout: str
    # Index of the experiment at each place that has one.
    at: Mapping[AxisPlace, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        settle(self, at=MappingProxyType(dict(self.at)))
        if NOMINAL not in self.at:
            found = "no nominal experiment"
            expected = "the experiment from which all others are offset"
            hint = "perform it, or select other shapes: --shape"
            raise InvalidInput(f"group {self.name}", found=found, expected=expected, hint=hint)

    @property
    def name(self) -> str:
        """Shape and layout as one name."""
        return f"{self.shape} {self.layout}"

    @property
    def reach(self) -> int:
        """Largest step at which an experiment joins."""
        return max(abs(place.step) for place in self.at)

    def found(self, places: Sequence[AxisPlace]) -> tuple[int, ...]:
        """Return the experiments at places, without those that are missing."""
        return tuple(self.at[place] for place in places if place in self.at)

    def missing(self, places: Sequence[AxisPlace]) -> list[AxisPlace]:
        """Return the places without an experiment, each once."""
        return [place for place in dict.fromkeys(places) if place not in self.at]


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleCalibrations:
    """Results of the calibrations of single experiments."""

    points: FloatArray  # (n, n_parameter)
    errors: FloatArray  # (n,) error E of each with its own set; inf if it could not be simulated
    # Stored sets of several experiments, by these: id of the calibration, and point (n_parameter,).
    joint: Mapping[tuple[int, ...], tuple[int, FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.errors.shape != self.points.shape[:1]:
            found = f"points of shape {self.points.shape}, errors of {self.errors.shape}"
            expected = "a row of parameters and an error for each experiment"
            raise InvalidInput("singles", found=found, expected=expected)
        settle(self, joint=MappingProxyType(dict(self.joint)))


class GroupParameters(NamedTuple):
    """Parameter set for some experiments."""

    members: tuple[int, ...]  # repeated members count repeatedly
    point: FloatArray | None  # (n_parameter,); None for `reason`
    source: str
    calibration: int | None = None  # id, if stored
    reason: str = ""


def group_parameters(members: Sequence[int], singles: SingleCalibrations) -> GroupParameters:
    """Return the stored set for exactly these experiments, else the mean of their own sets.

    The mean is weighted with inverse errors, as in section 5.2.2 of the thesis; experiments without
    an error are ignored.
    """
    own = tuple(members)
    if len(own) == 1:
        if not math.isfinite(singles.errors[own[0]]):
            return GroupParameters(own, None, NONE, reason="its own calibration has no error")
        return GroupParameters(own, singles.points[own[0]], OWN)
    stored = singles.joint.get(tuple(sorted(own)))
    if stored is not None:
        calibration, point = stored
        return GroupParameters(own, point, STORED, calibration)
    rows = np.array(own)
    if not np.isfinite(singles.errors[rows]).any():
        return GroupParameters(own, None, NONE, reason="no member's own calibration has an error")
    return GroupParameters(own, weighted_mean(singles.points[rows], singles.errors[rows]), AVERAGED)


def weights(members: Sequence[int], singles: SingleCalibrations) -> FloatArray:
    """Return the weights (n_member,) of the members in their mean."""
    errors = singles.errors[np.array(members)]
    weight = np.where(np.isfinite(errors), 1.0 / np.maximum(errors, MIN_ERROR), 0.0)
    return np.asarray(weight / weight.sum())


# --- one batch of rollouts ----------------------------------------------------------------------


class RolloutQueue:
    """Queue of rollouts, each pair of experiment and parameter set once, which are evaluated in
    one call."""

    def __init__(self) -> None:
        self._place: dict[tuple[int, bytes], int] = {}
        self._points: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._points)

    def add(self, sample: int, point: FloatArray) -> int:
        """Add a rollout and return its index among the results."""
        key = (sample, point.tobytes())
        if key not in self._place:
            self._place[key] = len(self._points)
            self._points.append(point)
        return self._place[key]

    @property
    def which(self) -> IntArray:
        """Experiment (n,) of each rollout."""
        return np.array([sample for sample, _ in self._place], np.int64)

    def run(self, evaluate: Evaluate) -> Evaluation:
        """Evaluate all rollouts."""
        return evaluate(self.which, np.array(self._points))


# --- growth -------------------------------------------------------------------------------------


class Step(NamedTuple):
    """Domain of one group after one step."""

    group: ExperimentGroup
    step: int
    used: GroupParameters  # parameter set, with its members
    # (n_member,) Error E of every member with it; inf for a failed simulation; empty without a set.
    errors: FloatArray
    reason: str = ""  # reason why there is no largest error, else empty

    @property
    def largest(self) -> float | None:
        """Largest error; None if a member is missing or could not be simulated."""
        return None if self.reason else float(self.errors.max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Growth of the domains of all groups."""

    groups: tuple[ExperimentGroup, ...]
    index: Index
    steps: tuple[tuple[Step, ...], ...]  # steps of each group, from step 0

    @property
    def matrix(self) -> list[list[float | None]]:
        """Largest errors, one row per group and one column per step."""
        return [[step.largest for step in row] for row in self.steps]


def n_steps_of(groups: Sequence[ExperimentGroup], index: Index) -> int:
    """Return the number of steps that the experiments allow.

    Raise `InvalidInput` without a group that has all experiments of the first step.
    """
    if not groups:
        raise InvalidInput(
            "groups", found="none", expected="one shape and layout with a nominal experiment"
        )
    if index == "printed":
        return PRINTED_STEPS
    if not any(not group.missing(domain(1)) for group in groups):
        lacking = groups[0].missing(domain(1))
        raise InvalidInput(
            "steps",
            found=f"no group with all of x1, y1, y-1 and theta1 ({groups[0].name} lacks "
            + ", ".join(place.name for place in lacking) + ")",
            expected="at least one step about the nominal experiment",
            hint="perform the plan of the thesis: fixel testbed run",
        )  # fmt: skip
    return max(group.reach for group in groups)


def plan_growth(
    groups: Sequence[ExperimentGroup],
    singles: SingleCalibrations,
    wanted: RolloutQueue,
    index: Index = "corrected",
) -> Callable[[Evaluation], Growth]:
    """Add the rollouts of a growth to a queue; return the function of their results.

    The index is `"corrected"`, or `"printed"` for the thesis's code as it is printed.
    """
    n_steps = n_steps_of(groups, index)
    plan = [
        [_planned(group, step, index, singles, wanted) for step in range(n_steps + 1)]
        for group in groups
    ]

    def read(answer: Evaluation) -> Growth:
        rows = (
            tuple(_step(group, domain(k, index), k, *own, answer) for k, own in enumerate(row))
            for group, row in zip(groups, plan, strict=True)
        )
        return Growth(groups=tuple(groups), index=index, steps=tuple(rows))

    return read


def _planned(
    group: ExperimentGroup,
    step: int,
    index: Index,
    singles: SingleCalibrations,
    wanted: RolloutQueue,
) -> tuple[GroupParameters, list[int], str]:
    """Return the parameters of a step, its rollouts in the queue, and why there are none."""
    places = domain(step, index)
    missing = group.missing(places)
    if missing:
        reason = "not performed: " + ", ".join(place.name for place in missing)
        return GroupParameters(group.found(places), None, NONE, reason=reason), [], reason
    used = group_parameters(group.found(places), singles)
    if used.point is None:
        return used, [], used.reason
    return used, [wanted.add(member, used.point) for member in used.members], ""


def _step(
    group: ExperimentGroup,
    places: Sequence[AxisPlace],
    step: int,
    used: GroupParameters,
    rollouts: list[int],
    reason: str,
    answer: Evaluation,
) -> Step:
    errors = answer.error[np.array(rollouts, np.int64)]
    if not np.isfinite(errors).all():
        k = int(np.flatnonzero(~np.isfinite(errors))[0])
        reason = f"no simulation of {places[k].name}: {answer.reasons[rollouts[k]]}"
    return Step(group=group, step=step, used=used, errors=errors, reason=reason)
