"""Growth of a domain from the nominal experiment outwards: how far one set of parameters reaches.

Nothing is searched here. A set of parameters is a stored one, or a mean of those of single
experiments; what takes time is asked for once, as one batch of rollouts.

Source: RPI thesis, appendix C.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.objective import Evaluation
from fixel.calibration.study import MIN_ERROR, weighted_mean
from fixel.domain.places import PRINTED_STEPS, ExperimentGroup, Index, domain
from fixel.errors import InvalidInput
from fixel.model.fields import settle
from fixel.typing import FloatArray, IntArray

OWN: Final = "own"  # of the one experiment
STORED: Final = "stored"
AVERAGED: Final = "averaged"  # weighted with inverse errors
NONE: Final = "none"


class Joint(NamedTuple):
    """A stored set of parameters for several experiments."""

    calibration: int
    point: FloatArray  # (n_parameter,)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Singles:
    """What calibrations of single experiments found, experiment by experiment.

    Parameters
    ----------
    points : (n, n_parameter) float64
    errors : (n,) float64
        E of each under its own set; inf where none could be simulated.
    joint : mapping from sorted tuple of int to Joint
        Stored sets by exactly the experiments they are for.
    """

    points: FloatArray
    errors: FloatArray
    joint: Mapping[tuple[int, ...], Joint] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.errors.shape != self.points.shape[:1]:
            raise InvalidInput(
                "singles",
                found=f"points of shape {self.points.shape}, errors of {self.errors.shape}",
                expected="a row of parameters and an error an experiment",
            )
        settle(self, joint=MappingProxyType(dict(self.joint)))


class OneSet(NamedTuple):
    """One set of parameters for some experiments."""

    members: tuple[int, ...]  # one twice counts twice
    point: FloatArray | None  # (n_parameter,); none where there is none, for the reason
    source: str
    calibration: int | None = None  # where stored
    reason: str = ""


def one_set(members: Sequence[int], singles: Singles) -> OneSet:
    """The stored set for exactly these experiments, else the mean of their own sets.

    The mean is weighted with inverse errors, as in the thesis, section 5.2.2; experiments without
    an error do not count.
    """
    own = tuple(members)
    if len(own) == 1:
        if not math.isfinite(singles.errors[own[0]]):
            return OneSet(own, None, NONE, reason="its own calibration has no error")
        return OneSet(own, singles.points[own[0]], OWN)
    stored = singles.joint.get(tuple(sorted(own)))
    if stored is not None:
        return OneSet(own, stored.point, STORED, stored.calibration)
    rows = np.array(own)
    if not np.isfinite(singles.errors[rows]).any():
        return OneSet(own, None, NONE, reason="no member's own calibration has an error")
    return OneSet(own, weighted_mean(singles.points[rows], singles.errors[rows]), AVERAGED)


def weights(members: Sequence[int], singles: Singles) -> FloatArray:
    """(n_member,) shares of the members in their mean."""
    errors = singles.errors[np.array(members)]
    weight = np.where(np.isfinite(errors), 1.0 / np.maximum(errors, MIN_ERROR), 0.0)
    return np.asarray(weight / weight.sum())


# --- one batch of rollouts ----------------------------------------------------------------------

Evaluate = Callable[[IntArray, FloatArray], Evaluation]


class RolloutQueue:
    """Collects rollouts of several askers, each pair of experiment and set once, and runs them all
    in one call."""

    def __init__(self) -> None:
        self._place: dict[tuple[int, bytes], int] = {}
        self._points: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._points)

    def add(self, sample: int, point: FloatArray) -> int:
        """Place of a rollout among the answers."""
        key = (sample, point.tobytes())
        if key not in self._place:
            self._place[key] = len(self._points)
            self._points.append(point)
        return self._place[key]

    @property
    def which(self) -> IntArray:
        """(n,) experiment of each rollout."""
        return np.array([sample for sample, _ in self._place], np.int64)

    def run(self, evaluate: Evaluate) -> Evaluation:
        """The answers."""
        return evaluate(self.which, np.array(self._points))


# --- growth -------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """The domain of one group after one step.

    Attributes
    ----------
    group : ExperimentGroup
    step : int
    used : OneSet
        The set of parameters, and the members.
    errors : (n_member,) float64
        E of every member under it; inf where the simulation failed; empty where there is no set.
    reason : str
        Why there is no largest error; empty where there is one.
    """

    group: ExperimentGroup
    step: int
    used: OneSet
    errors: FloatArray
    reason: str = ""

    @property
    def largest(self) -> float | None:
        """Of the errors; none where a member is missing or could not be simulated."""
        return None if self.reason else float(self.errors.max())


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How the domains of all groups grew.

    Attributes
    ----------
    groups : tuple of ExperimentGroup
    index : str
    steps : tuple of tuple of Step
        By group, from step 0.
    """

    groups: tuple[ExperimentGroup, ...]
    index: Index
    steps: tuple[tuple[Step, ...], ...]

    @property
    def matrix(self) -> list[list[float | None]]:
        """Largest errors, a row a group, a column a step."""
        return [[step.largest for step in row] for row in self.steps]


def n_steps_of(groups: Sequence[ExperimentGroup], index: Index) -> int:
    """Steps that the experiments allow.

    Raises
    ------
    InvalidInput
        Nothing to grow by.
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
            expected="one step about the nominal experiment at least",
            hint="perform the thesis's plan: fixel sample --thesis",
        )  # fmt: skip
    return max(group.reach for group in groups)


class Grower:
    """Says which rollouts the growth of the groups takes, then reads the answers.

    Parameters
    ----------
    groups : sequence of ExperimentGroup
    singles : Singles
    index : str
        `"corrected"`, or `"printed"` for the thesis's code as it is printed.
    """

    def __init__(
        self, groups: Sequence[ExperimentGroup], singles: Singles, index: Index = "corrected"
    ) -> None:
        self.groups, self.singles, self.index = tuple(groups), singles, index
        self.n_steps = n_steps_of(self.groups, index)
        self._plan: list[list[tuple[OneSet, list[int], str]]] = []

    def ask(self, wanted: RolloutQueue) -> None:
        """Collect the rollouts."""
        self._plan = [
            [self._planned(group, step, wanted) for step in range(self.n_steps + 1)]
            for group in self.groups
        ]

    def _planned(
        self, group: ExperimentGroup, step: int, wanted: RolloutQueue
    ) -> tuple[OneSet, list[int], str]:
        places = domain(step, self.index)
        missing = group.missing(places)
        if missing:
            reason = "not performed: " + ", ".join(place.name for place in missing)
            return OneSet(group.found(places), None, NONE, reason=reason), [], reason
        used = one_set(group.found(places), self.singles)
        if used.point is None:
            return used, [], used.reason
        return used, [wanted.add(member, used.point) for member in used.members], ""

    def read(self, answer: Evaluation) -> Growth:
        """The growth, of the answers to what was collected."""
        rows = [
            tuple(
                self._step(group, step, planned, answer)
                for step, planned in enumerate(row)
            )
            for group, row in zip(self.groups, self._plan, strict=True)
        ]  # fmt: skip
        return Growth(groups=self.groups, index=self.index, steps=tuple(rows))

    def _step(
        self,
        group: ExperimentGroup,
        step: int,
        planned: tuple[OneSet, list[int], str],
        answer: Evaluation,
    ) -> Step:
        used, places, reason = planned
        errors = answer.error[np.array(places, np.int64)]
        if not np.isfinite(errors).all():
            k = int(np.flatnonzero(~np.isfinite(errors))[0])
            at = domain(step, self.index)[k].name
            reason = f"no simulation of {at}: {answer.reasons[places[k]]}"
        return Step(group=group, step=step, used=used, errors=errors, reason=reason)


def grow(
    groups: Sequence[ExperimentGroup],
    singles: Singles,
    evaluate: Evaluate,
    index: Index = "corrected",
) -> Growth:
    """Grow the domains of groups, all rollouts in one call.

    Parameters
    ----------
    groups, singles, index
        As for `Grower`.
    evaluate : callable
        (n,) experiments and (n, n_parameter) points -> their errors; `Comparer.errors`.
    """
    grower, wanted = Grower(groups, singles, index), RolloutQueue()
    grower.ask(wanted)
    return grower.read(wanted.run(evaluate))
