"""Solvers: how the complementarity problem of a step is solved."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar, final

from fixel.errors import InvalidInput
from fixel.kernels import codes, single
from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.solve import HASTY, PATIENT, TOLERANCE
from fixel.typing import FloatArray


class AbstractSolver(abc.ABC):
    """Solves one mixed complementarity problem in place."""

    name: ClassVar[str]
    kind: ClassVar[int] = codes.EXTERNAL

    @abc.abstractmethod
    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, hasty: bool = False
    ) -> tuple[float, int]:
        """Improve `problem.velocity`, `problem.impulse` and `problem.element_impulse`.

        Parameters
        ----------
        problem : Problem
            Holds the guess (velocities expected, impulses of the step before), then the answer.
        work : Workspace
            Scratch.
        guess : (n_dof + 2,) float64
            The velocities expected, to start again from.
        hasty : bool
            A shorter step can be tried instead: do not insist.

        Returns
        -------
        (float, int)
            Residual by the independent judge, and 1 where a fallback was needed.
        """


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Newton(AbstractSolver):
    """Semismooth Newton from the last step's impulses; damped Newton and Gauss-Seidel where it
    fails.

    The default: two or three small linear systems a step. Exact friction discs and polygons alike.

    Source: Alart & Curnier (1991).
    """

    name: ClassVar[str] = "newton"
    kind: ClassVar[int] = codes.NEWTON

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, hasty: bool = False
    ) -> tuple[float, int]:
        return single.solve_problem(problem, work, guess, self.kind, 0, _trials(hasty))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GaussSeidel(AbstractSolver):
    """Projected Gauss-Seidel until the residual is met; the Newton chain takes over where it is
    not.

    A cross-check, and the simplest thing that can work. Slow where bodies jam or masses differ
    much.

    Source: Jourdan, Alart & Jean (1998).
    """

    name: ClassVar[str] = "gauss-seidel"
    kind: ClassVar[int] = codes.GAUSS_SEIDEL
    max_sweeps: int = 10_000

    def __post_init__(self) -> None:
        if self.max_sweeps < 1:
            raise InvalidInput(
                "GaussSeidel.max_sweeps", found=self.max_sweeps, expected="at least 1"
            )

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, hasty: bool = False
    ) -> tuple[float, int]:
        return single.solve_problem(
            problem, work, guess, self.kind, self.max_sweeps, _trials(hasty)
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Lemke(AbstractSolver):
    """Lexicographic Lemke on the linear form: the reference, for `support_directions` of 4 or more.

    Pivots to the answer without a guess, so it never depends on the step before. A hundred times
    slower than `Newton`, which takes over the steps where it ends on a ray; runs in the plain loop.

    Parameters
    ----------
    max_pivots : int
        In each step; after so many, `Newton` takes over, as it does at once where the step has more
        than a tenth as many rows (four a contact, one more than its directions a point of support).

    Source: Cottle, Pang & Stone (1992), section 4.4; the linear form is the thesis's eqs. 2.13-14.
    """

    name: ClassVar[str] = "lemke"
    max_pivots: int = 2_000

    def __post_init__(self) -> None:
        if self.max_pivots < 1:
            raise InvalidInput("Lemke.max_pivots", found=self.max_pivots, expected="at least 1")

    def solve(
        self, problem: Problem, work: Workspace, guess: FloatArray, hasty: bool = False
    ) -> tuple[float, int]:
        residual = float(single.solve_by_pivoting(problem, work, self.max_pivots))
        if residual <= TOLERANCE:
            return residual, 0
        residual, _ = single.solve_problem(problem, work, guess, codes.NEWTON, 0, _trials(hasty))
        return residual, 1


def _trials(hasty: bool) -> int:
    return HASTY if hasty else PATIENT


SOLVERS: tuple[type[AbstractSolver], ...] = (Newton, GaussSeidel, Lemke)
