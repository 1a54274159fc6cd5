"""Steppers: choice of the lengths of time steps."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels import codes, single
from fixel.kernels.arrays import Problem
from fixel.kernels.rollout import (
    CAUTION,
    CUT,
    EVENT,
    EXPONENT,
    GROWTH,
    INSIST,
    JUMP,
    PREDICTED,
    RENEWED,
    SECOND_ORDER,
    SHRINK,
)
from fixel.kernels.solve import TOLERANCE
from fixel.typing import FloatArray


class Attempt(NamedTuple):
    """Result of one attempt at a step."""

    status: int  # codes.CONVERGED, CONTACT_OVERFLOW, MAX_ITERATIONS or THROWN
    residual: float
    bounces: bool = False  # whether a contact gives back speed
    closing: float = math.inf  # when a gap closes inside the step, which was then not solved
    jams: bool = False  # whether an unsolved step may have no solution


class Advance(NamedTuple):
    """Step that a stepper accepted, or the status of its failure."""

    status: int
    step: float
    next_step: float
    residual: float
    event: bool = False  # whether something is known to happen where the step ends
    smooth: bool = False  # whether velocities changed as expected


class Past(NamedTuple):
    """Velocities and lengths of the last two steps, scaled."""

    velocity: FloatArray  # (n_dof + 2,) of the last step, at its middle where that differs
    before: FloatArray  # (n_dof + 2,) of the step before
    last: float  # length of the last step, zero for none
    earlier: float  # of the one before it
    reached: FloatArray  # (n_dof + 2,) at the end of the last step


class Try(Protocol):
    """Function that attempts a step and writes the solution into the problem."""

    def __call__(
        self,
        step: float,
        lead: float,
        guess: FloatArray,
        least: float = math.inf,
        hasty: bool = False,
        /,
    ) -> Attempt:
        """Attempt a step with rows taken `lead` of it after its start, at the guessed velocity.

        Where a gap wider than `least` closes inside the step at that velocity, nothing is solved,
        and `Attempt.closing` tells when. `hasty`: a shorter step can be tried instead.
        """


class AbstractStepper(abc.ABC):
    """Abstract stepper, which chooses the next step and the place of its rows."""

    name: ClassVar[str]
    adaptive: ClassVar[bool] = False
    lead: ClassVar[float] = 0.0
    order: ClassVar[int]

    @property
    @abc.abstractmethod
    def first_step(self) -> float | None:
        """Length of the first step [s]; None for the stepper's own choice."""

    @abc.abstractmethod
    def advance(
        self, attempt: Try, problem: Problem, past: Past, step: float, limits: StepLimits
    ) -> Advance:
        """Find the next step, at most `limits.left` long, with its solution in `problem`.

        All quantities scaled; `step` is the length proposed by the step before. The status
        `codes.UNDO` takes the last step back, to be repeated at `Advance.next_step`.
        """


class StepLimits(NamedTuple):
    """Bounds on the next step, scaled."""

    left: float  # time to the end, or to where a pusher's command changes
    tolerance: float  # of position
    smallest: float
    largest: float
    inertial: bool  # whether velocities are smooth where no contact acts
    eventful: bool = True  # whether something is known to happen where the step starts


def _fixed(attempt: Try, past: Past, step: float, lead: float, limits: StepLimits) -> Advance:
    trial = limits.left if limits.left < step * (1.0 + 1e-9) else step
    status, residual, *_ = attempt(trial, lead, past.velocity)
    return Advance(status, trial, step, residual)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StewartTrinkle(AbstractStepper):
    """Fixed step, rows taken at the step's start. First order.

    The scheme of the thesis and of most peers; choose it to reproduce them.

    Source: Stewart & Trinkle (1996).
    """

    name: ClassVar[str] = "stewart-trinkle"
    order: ClassVar[int] = 1
    step: float = 0.01

    def __post_init__(self) -> None:
        _refuse_step("StewartTrinkle.step", self.step)

    @property
    def first_step(self) -> float | None:
        return self.step

    def advance(
        self, attempt: Try, problem: Problem, past: Past, step: float, limits: StepLimits
    ) -> Advance:
        return _fixed(attempt, past, step, self.lead, limits)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Midpoint(AbstractStepper):
    """Fixed step, rows taken half a step ahead. Second order while nothing happens, first across
    events.

    Source: Moreau (1988), section 9.
    """

    name: ClassVar[str] = "midpoint"
    lead: ClassVar[float] = 0.5
    order: ClassVar[int] = 2
    step: float = 0.01

    def __post_init__(self) -> None:
        _refuse_step("Midpoint.step", self.step)

    @property
    def first_step(self) -> float | None:
        return self.step

    def advance(
        self, attempt: Try, problem: Problem, past: Past, step: float, limits: StepLimits
    ) -> Advance:
        return _fixed(attempt, past, step, self.lead, limits)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Adaptive(AbstractStepper):
    """Midpoint steps as long as a tolerance allows: long while bodies glide, short where contacts
    change.

    The error of a step is taken as half its length times the change of velocity over it, what a
    first-order step would be wrong by. Steps end where a pusher's path bends and where a gap
    closes; a bounce is taken in a step of its own; a step in whose second half something happened
    is taken back. With inertia it is the implicit midpoint rule. docs/theory/stepping.md.

    Parameters
    ----------
    tolerance : float
        Of position in one step [m]; angles count by the characteristic length. None: 1e-5
        of the scene's characteristic length.
    largest_step : float
        In the time in which the fastest body moves by one characteristic length.
    max_steps : int
        After so many the rollout ends with the status ``max_steps``, so that no rollout holds up a
        batch. A grasp takes about a hundred; a measured path one or two for each of its samples.
    """

    name: ClassVar[str] = "adaptive"
    adaptive: ClassVar[bool] = True
    lead: ClassVar[float] = 0.5
    order: ClassVar[int] = 2
    tolerance: float | None = None
    largest_step: float = 0.2
    max_steps: int = 100_000

    def __post_init__(self) -> None:
        if self.tolerance is not None and not 0.0 < self.tolerance < math.inf:
            raise InvalidInput(
                "Adaptive.tolerance", found=self.tolerance, expected="a positive length [m]"
            )
        if not 0.0 < self.largest_step <= 10.0:
            raise InvalidInput(
                "Adaptive.largest_step", found=self.largest_step, expected="a number from 0 to 10"
            )
        if isinstance(self.max_steps, bool) or not 1 <= int(self.max_steps) == self.max_steps:
            raise InvalidInput(
                "Adaptive.max_steps", found=self.max_steps, expected="a whole number of at least 1"
            )

    @property
    def first_step(self) -> float | None:
        return None

    def advance(
        self, attempt: Try, problem: Problem, past: Past, step: float, limits: StepLimits
    ) -> Advance:
        """Advance with the same decisions as the compiled loop in kernels/rollout.py."""
        trial = min(step, limits.left)
        if trial < limits.left < 1.5 * trial:
            trial = 0.5 * limits.left
        rate, guess = 0.0, past.velocity
        guessed = PREDICTED
        predicting = True
        growth = GROWTH
        unsolved = 0
        resumed = 0.0  # the step to go on with after a bounce or a closing gap
        while True:
            if predicting:
                rate, guess = _predict(past, trial)
                predicting = False
            least = limits.tolerance if guessed == PREDICTED else math.inf
            hasty = trial > limits.smallest and unsolved % INSIST != INSIST - 1
            status, residual, bounces, closing, jams = attempt(
                trial, self.lead, guess, least, hasty
            )
            if status == codes.CONTACT_OVERFLOW:
                return Advance(status, trial, trial, residual)
            if closing < math.inf:
                resumed = max(resumed, trial)
                trial, guessed = max(closing * (1.0 - 1e-6), limits.smallest), CUT
                continue
            if not residual <= TOLERANCE:
                unsolved += not jams
                if trial > limits.smallest:
                    trial, guessed, predicting = 0.25 * trial, PREDICTED, True
                    continue
                return Advance(codes.MAX_ITERATIONS, trial, trial, residual)
            if status == codes.THROWN:
                if trial > limits.smallest:
                    trial, guessed, predicting = 0.25 * trial, PREDICTED, True
                    continue
                return Advance(status, trial, trial, residual)
            if bounces and trial > limits.smallest:
                resumed = max(resumed, trial)
                trial, guessed = max(limits.smallest, 0.25 * trial), PREDICTED
                predicting = True
                continue
            change = float(single.largest_change(problem, guess))
            jumped = change > JUMP * float(single.largest_speed(problem))
            if (
                not limits.eventful
                and guessed != RENEWED
                and min(past.last, trial) > limits.smallest
                and 0.25 * past.last * change > EVENT * limits.tolerance
            ):
                if trial > past.last:
                    trial = past.last
                    predicting, guessed = True, PREDICTED
                    continue
                return Advance(codes.UNDO, trial, 0.5 * past.last, residual)
            error = 0.5 * trial * change
            if rate > 0.0 and not jumped:
                error *= SECOND_ORDER
            if limits.inertial:
                error = max(error, trial * float(single.untouched_change(problem, past.reached)))
                if jumped or guessed == RENEWED:
                    forced = trial * float(single.forced_change(problem, past.reached))
                    if forced > limits.tolerance and trial > limits.smallest:
                        growth = 1.0
                        shrink = CAUTION * limits.tolerance / forced
                        trial = max(limits.smallest, trial * shrink)
                        guessed, predicting = PREDICTED, True
                        continue
                    error = max(error, forced)
            if error <= limits.tolerance or trial <= limits.smallest:
                ratio = limits.tolerance / max(error, 1e-30)
                growth = min(growth, CAUTION * ratio**EXPONENT)
                following = trial * max(0.5, growth)
                if trial < step and trial >= limits.left:
                    following = max(following, step)  # cut short by the end of the straight
                if resumed > 0.0 and (trial <= limits.smallest or guessed == CUT):
                    following = resumed
                event = guessed == CUT or (trial < step and trial >= limits.left)
                return Advance(
                    codes.CONVERGED,
                    trial,
                    min(following, limits.largest),
                    residual,
                    event,
                    rate > 0.0 and not jumped,
                )
            if jumped:
                rate, guess = 0.0, np.array(problem.velocity)
                if guessed != RENEWED:
                    guessed = RENEWED
                    continue
            growth = 1.0
            shrink = max(SHRINK, CAUTION * (limits.tolerance / error) ** EXPONENT)
            trial = max(limits.smallest, trial * shrink)
            predicting = guessed != RENEWED
            guessed = PREDICTED


def _predict(past: Past, step: float) -> tuple[float, FloatArray]:
    guess = past.velocity.copy()
    rate = single.predict(
        past.velocity, past.before, guess.size - 2, step, past.last, past.earlier, guess
    )
    return float(rate), guess


def _refuse_step(where: str, step: float) -> None:
    if not 0.0 < step < math.inf:
        raise InvalidInput(where, found=step, expected="a positive time [s]")


STEPPERS: tuple[type[AbstractStepper], ...] = (StewartTrinkle, Midpoint, Adaptive)
