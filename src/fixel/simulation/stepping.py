"""Steps of a simulation: steppers choose their lengths, solvers solve their problems."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels import arrays as at, codes, entries
from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.solve import MAX_ATTEMPTS, MAX_ATTEMPTS_EARLY, TOLERANCE
from fixel.kernels.step_control import AT_ONCE
from fixel.model.fields import finite, optional_positive, positive, whole
from fixel.typing import FloatArray


class StepTrial(NamedTuple):
    """Result of one attempt at a step."""

    status: int  # of `step_control.judge_step`
    residual: float
    bounces: bool = False  # whether a contact gives back speed
    closing: float = math.inf  # when contacts change inside the step, which was then not solved
    parted: bool = False  # whether a contact that pressed in the last step has come off


class StepResult(NamedTuple):
    """Step that a stepper accepted, or the status of its failure."""

    status: int
    step: float
    next_step: float
    residual: float
    event: bool = False  # whether something is known to happen where the step ends
    smooth: bool = False  # whether velocities changed as expected


class StepHistory(NamedTuple):
    """Velocities and lengths of the last three steps, scaled."""

    velocity: FloatArray  # (n_dof + 2,) of the last step, at its middle where that differs
    before: FloatArray  # (n_dof + 2,) of the step before
    last: float  # length of the last step, zero for none
    earlier: float  # of the one before it
    reached: FloatArray  # (n_dof + 2,) at the end of the last step
    older: FloatArray  # (n_dof + 2,) of the step before `before`
    earliest: float  # length of that step, zero for none


class TryStep(Protocol):
    """Function that attempts a step and writes the solution into the problem."""

    def __call__(
        self,
        step: float,
        lead: float,
        guess: FloatArray,
        min_gap: float = math.inf,
        give_up_early: int = 0,
        /,
    ) -> StepTrial:
        """Try a step with rows taken `lead` of it after its start, at the guessed velocity.

        Where contacts change inside the step at that velocity (a gap wider than `min_gap` closes,
        or a vertex that presses reaches an end of its edge), nothing is solved, and
        `StepTrial.closing` is the time of that. `give_up_early` is that of a solver.
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
        self, attempt: TryStep, problem: Problem, past: StepHistory, step: float, limits: StepLimits
    ) -> StepResult:
        """Find the next step, at most `limits.left` long, with its solution in `problem`.

        All quantities scaled; `step` is the length proposed by the step before. The status
        `codes.UNDO` takes the last step back, to be repeated in steps half as long.
        """


class StepLimits(NamedTuple):
    """Bounds on the next step, scaled."""

    left: float  # time to the end, or to where a pusher's command changes
    tolerance: float  # of position
    smallest: float
    largest: float
    inertial: bool  # whether velocities are smooth where no contact acts
    eventful: bool = True  # whether something is known to happen where the step starts


class _BuiltInStepper(AbstractStepper):
    """Stepper that the compiled loop knows."""

    @property
    def first_step(self) -> float | None:
        step: float | None = getattr(self, "step", None)
        return step

    def advance(
        self, attempt: TryStep, problem: Problem, past: StepHistory, step: float, limits: StepLimits
    ) -> StepResult:
        """Find the next step with the decisions of the compiled loop."""
        control = np.zeros(at.N_CONTROL)
        control[at.ADAPTIVE] = self.adaptive
        control[at.STAGGERED] = limits.inertial
        control[at.STEP], control[at.LEFT] = step, limits.left
        control[at.TOLERANCE] = limits.tolerance
        control[at.SMALLEST], control[at.LARGEST] = limits.smallest, limits.largest
        control[at.LAST], control[at.EARLIER] = past.last, past.earlier
        control[at.EARLIEST] = past.earliest
        control[at.EVENTFUL] = limits.eventful
        guess = past.velocity.copy()
        entries.choose_trial(control)
        decision, residual = codes.RETRY, math.inf
        while decision == codes.RETRY:
            entries.predict_velocity(control, past.velocity, past.before, past.older, guess)
            trial, min_gap = float(control[at.TRIAL]), float(control[at.MIN_GAP])
            give_up_early = int(control[at.GIVE_UP_EARLY])
            status, residual, bounces, closing, parted = attempt(
                trial, self.lead, guess, min_gap, give_up_early
            )
            control[at.BOUNCES], control[at.CLOSING] = bounces, closing
            control[at.PARTED] = parted
            decision = int(
                entries.judge_step(control, problem, guess, past.reached, status, float(residual))
            )
        return StepResult(
            status=decision,
            step=float(control[at.TRIAL]),
            next_step=float(control[at.STEP]),
            residual=residual,
            event=control[at.EVENTFUL] == 1.0,
            smooth=control[at.SMOOTH] == 1.0,
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StewartTrinkle(_BuiltInStepper):
    """Fixed steps of first order, with the geometry at the start of each step.

    This is the scheme of the thesis and of most engines. Choose it to reproduce their results.

    Parameters
    ----------
    step : float
        Length of a step [s].

    Source: Stewart & Trinkle (1996).

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), stepper=StewartTrinkle(step=0.01)).steps
    200
    """

    name: ClassVar[str] = "stewart-trinkle"
    order: ClassVar[int] = 1
    step: float = 0.01

    def __post_init__(self) -> None:
        positive(self.step, "StewartTrinkle.step", "s")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Midpoint(_BuiltInStepper):
    """Fixed step, rows taken half a step ahead. Second order while nothing happens, first across
    events.

    Source: Moreau (1988), section 9.
    """

    name: ClassVar[str] = "midpoint"
    lead: ClassVar[float] = 0.5
    order: ClassVar[int] = 2
    step: float = 0.01

    def __post_init__(self) -> None:
        positive(self.step, "Midpoint.step", "s")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Adaptive(_BuiltInStepper):
    """Midpoint steps that are as long as a tolerance allows.

    The estimated error of a step is half its length times the change of velocity over it, which is
    the error of a first-order step. Steps end where a pusher's path bends and where a gap closes. A
    bounce has a step of its own. A step is repeated with a shorter one if contacts change in its
    second half. With inertia, a step follows the implicit midpoint rule. See
    docs/theory/stepping.md.

    Parameters
    ----------
    tolerance : float
        Position error allowed per step [m]; angles count by the characteristic length. None: 3e-5
        of the scene's characteristic length; with n > 17 free bodies, 1e-7 n^2 but at most 1e-3.
    largest_step : float
        Length of the longest step, as a share of the time in which the fastest body moves by one
        characteristic length.
    max_steps : int
        Maximum number of steps, after which the rollout ends with the status ``max_steps``. A grasp
        takes about a hundred; a measured path one or two for each of its samples. None: 100,000,
        but 5,000 for quasi-static motion with `support_directions`.

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> coarse = simulate(pushed_square(), stepper=Adaptive(tolerance=1e-5))
    >>> fine = simulate(pushed_square(), stepper=Adaptive(tolerance=1e-8))
    >>> fine.steps > coarse.steps
    True
    """

    name: ClassVar[str] = "adaptive"
    adaptive: ClassVar[bool] = True
    lead: ClassVar[float] = 0.5
    order: ClassVar[int] = 2
    tolerance: float | None = None
    largest_step: float = 0.2
    max_steps: int | None = None

    def __post_init__(self) -> None:
        optional_positive(self.tolerance, "Adaptive.tolerance", "m")
        if positive(self.largest_step, "Adaptive.largest_step", "s") > 10.0:
            raise InvalidInput(
                "Adaptive.largest_step", found=self.largest_step, expected="a number from 0 to 10"
            )
        limit = 1 if self.max_steps is None else self.max_steps
        if not 1.0 <= finite(limit, "Adaptive.max_steps") == int(limit):
            raise InvalidInput(
                "Adaptive.max_steps", found=limit, expected="a whole number of at least 1"
            )


def stepper_of(step: float | None, tolerance: float | None) -> AbstractStepper | None:
    """Return the stepper with a fixed step [s] or a tolerance [m]; None without either."""
    if step is not None and tolerance is not None:
        hint = "a fixed step has no tolerance; leave one out"
        raise InvalidInput("step and tolerance", found="both", expected="one of them", hint=hint)
    if tolerance is not None:
        return Adaptive(tolerance=tolerance)
    return None if step is None else StewartTrinkle(step=step)


STEPPERS: tuple[type[AbstractStepper], ...] = (StewartTrinkle, Midpoint, Adaptive)


class AbstractSolver(abc.ABC):
    """Abstract solver of a mixed complementarity problem, in place."""

    name: ClassVar[str]
    kind: ClassVar[int] = codes.EXTERNAL

    @abc.abstractmethod
    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, give_up_early: int = 0
    ) -> tuple[float, int]:
        """Solve for `problem.velocity`, `problem.impulse` and `problem.element_impulse`.

        Parameters
        ----------
        problem : Problem
            In: the guess (expected velocities, impulses of the previous step). Out: the solution.
        work : Workspace
            Scratch.
        guess : (n_dof + 2,) float64
            Expected velocities, from which to restart.
        give_up_early : int
            1 to give up early, since a shorter step can be tried instead; 2 to do so where the
            first method fails; 0 to try everything.

        Returns
        -------
        (float, int)
            Natural-map residual, and 1 where a fallback was needed.
        """


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Newton(AbstractSolver):
    """Semismooth Newton from the last step's impulses, with damped Newton and Gauss-Seidel as
    fallbacks.

    The default: two or three small linear systems per step, for exact friction discs and polygons.

    Source: Alart & Curnier (1991).

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), solver=Newton()).max_residual < 1e-9
    True
    """

    name: ClassVar[str] = "newton"
    kind: ClassVar[int] = codes.NEWTON

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, give_up_early: int = 0
    ) -> tuple[float, int]:
        return _solved(problem, work, guess, self.kind, 0, give_up_early)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GaussSeidel(AbstractSolver):
    """Projected Gauss-Seidel until the residual is small enough, with the Newton chain as
    fallback.

    A simple solver for cross-checks. It is slow where bodies jam or masses differ
    much.

    Source: Jourdan, Alart & Jean (1998).

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), solver="gauss-seidel").max_residual < 1e-9
    True
    """

    name: ClassVar[str] = "gauss-seidel"
    kind: ClassVar[int] = codes.GAUSS_SEIDEL
    max_sweeps: int = 10_000

    def __post_init__(self) -> None:
        whole(self.max_sweeps, "GaussSeidel.max_sweeps")

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, give_up_early: int = 0
    ) -> tuple[float, int]:
        return _solved(problem, work, guess, self.kind, self.max_sweeps, give_up_early)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Lemke(AbstractSolver):
    """Lexicographic Lemke on the linear form: a reference, for `support_directions` of 4 or more.

    It needs no guess, so that a solution does not depend on the previous step. It is a hundred
    times slower than `Newton`, which solves the steps in which it ends on a ray. It runs in the
    plain loop, for at most `MAX_STEPS` steps (some seconds); then the status is ``max_steps``.

    Parameters
    ----------
    max_pivots : int
        Largest number of pivots per step; then `Newton` is used, as at once for steps with over
        a tenth as many rows (four per contact, one more than its directions per support point).

    Source: Cottle, Pang & Stone (1992), section 4.4; the linear form is the thesis's eqs. 2.13-14.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> scene = replace(pushed_square(duration=0.01), support_directions=4)
    >>> simulate(scene, solver=Lemke()).method["solver"]
    'lemke'
    """

    name: ClassVar[str] = "lemke"
    MAX_STEPS: ClassVar[int] = 5_000
    max_pivots: int = 2_000

    def __post_init__(self) -> None:
        whole(self.max_pivots, "Lemke.max_pivots")

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, give_up_early: int = 0
    ) -> tuple[float, int]:
        residual = float(entries.solve_by_pivoting(problem, work, self.max_pivots))
        if residual <= TOLERANCE:
            return residual, 0
        return _solved(problem, work, guess, codes.NEWTON, 0, give_up_early)[0], 1


def _solved(
    problem: Problem, work: Workspace, guess: FloatArray, kind: int, sweeps: int, give_up_early: int
) -> tuple[float, int]:
    max_attempts = MAX_ATTEMPTS_EARLY if give_up_early else MAX_ATTEMPTS
    if give_up_early == AT_ONCE:
        max_attempts = 0
    residual, fell_back = entries.solve_problem(problem, work, guess, kind, sweeps, max_attempts)
    return float(residual), int(fell_back)


SOLVERS: tuple[type[AbstractSolver], ...] = (Newton, GaussSeidel, Lemke)
