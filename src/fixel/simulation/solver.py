"""Solvers of the complementarity problem of a step."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar, final

from fixel.kernels import codes, entries
from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.solve import MAX_ATTEMPTS, MAX_ATTEMPTS_EARLY, TOLERANCE
from fixel.kernels.step_control import AT_ONCE
from fixel.model.fields import whole
from fixel.typing import FloatArray


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
