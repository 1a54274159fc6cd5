"""The solver chain of one step: the chosen solver first, and what to do when it fails."""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import FloatArray, Problem, Workspace
from fixel.kernels.gauss_seidel import gauss_seidel
from fixel.kernels.jit import kernel, large_kernel, spliced_kernel
from fixel.kernels.newton import newton
from fixel.kernels.residual import residual

TOLERANCE = 1e-9  # natural-map residual, scaled units, that every step must reach; see residual.py
NEWTON_TOLERANCE = 1e-11  # Newton's own map; two digits tighter so that the judge agrees at once
QUICK_ITERATIONS = 10  # Newton from the step before: 2 or 3 are the rule
DAMPED_ITERATIONS = 60
RUNGS = 7  # how often the stiffness is raised, by RUNG each time, before giving up
RUNG = 6.0
SWEEPS = 100  # of Gauss-Seidel between damped Newtons


@spliced_kernel
def solve(
    problem: Problem, work: Workspace, guess: FloatArray, solver: int, sweeps: int
) -> tuple[float, int]:
    """Solve the problem in place; returns (residual, 1 if a fallback was needed)."""
    if solver == codes.GAUSS_SEIDEL:
        sweep(problem, work, 1e-13, sweeps)
    else:
        newton(problem, work, NEWTON_TOLERANCE, QUICK_ITERATIONS, False)
    worst = residual(problem, work.right)
    if worst <= TOLERANCE:
        return worst, 0
    return recover(problem, work, guess), 1


@large_kernel
def recover(problem: Problem, work: Workspace, guess: FloatArray) -> float:
    """Solve a problem on which the first try failed; returns the residual.

    First damped Newton from nothing: the impulses of the step before mislead when a contact closes
    or a drive stalls. Then damped Newton on a
    ladder of stiffnesses, which scale impulses against velocities inside the solvers only: how large
    impulses will get is not known beforehand when a drive a hundred times stronger than friction
    runs into a dead end.
    """
    _forget(problem, work, guess)
    worst = attempt(problem, work, DAMPED_ITERATIONS, True)
    if worst <= TOLERANCE:
        return worst
    for rung in range(RUNGS):
        if rung > 0:
            for i in range(problem.size[0]):
                problem.stiffness[i] *= RUNG
        _forget(problem, work, guess)
        for swept in (False, True):
            if swept:
                sweep(problem, work, 1e-13, SWEEPS)
            worst = attempt(problem, work, DAMPED_ITERATIONS, True)
            if worst <= TOLERANCE:
                return worst
    return worst


@large_kernel
def attempt(problem: Problem, work: Workspace, iterations: int, damped: bool) -> float:
    """`newton`, out of line; returns the residual."""
    newton(problem, work, NEWTON_TOLERANCE, iterations, damped)
    return residual(problem, work.right)


@large_kernel
def sweep(problem: Problem, work: Workspace, tolerance: float, sweeps: int) -> float:
    """`gauss_seidel`, out of line."""
    return gauss_seidel(problem, work, tolerance, sweeps)


@kernel
def _forget(problem: Problem, work: Workspace, guess: FloatArray) -> None:
    """Go back to the guessed velocities and no impulses, and leave no infinities in the scratch."""
    for i in range(work.right.size):
        # The spare entries behind the last degree of freedom are added to, but never set.
        work.right[i] = 0.0
    for i in range(problem.size[0]):
        problem.velocity[i] = guess[i]
    for i in range(problem.size[1]):
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
    for e in range(problem.size[2]):
        for k in range(3):
            problem.element_impulse[e, k] = 0.0


@large_kernel
def locked(problem: Problem, work: Workspace, guess: FloatArray) -> bool:
    """Whether the problem has no solution because prescribed motions squeeze the bodies.

    Gauss-Seidel on such a problem piles up impulses along a direction d that moves nothing (the rows times
    d vanish) while the prescribed motions work against it (bias . d < 0): a certificate in the manner of
    Farkas. Checked on the pile itself, normalised.
    """
    _forget(problem, work, guess)
    sweep(problem, work, 0.0, 2000)
    size = 0.0
    against = 0.0
    for i in range(problem.size[0]):
        work.right[i] = 0.0
    for i in range(problem.size[1]):
        pn = problem.impulse[i, 0]
        pt = problem.impulse[i, 1]
        size = max(size, pn)
        against += pn * problem.bias[i, 0] + pt * problem.bias[i, 1]
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    work.right[o + k] += (
                        problem.normal[i, 3 * side + k] * pn + problem.tangent[i, 3 * side + k] * pt
                    )
    left = 0.0
    for i in range(problem.size[0]):
        left = max(left, abs(work.right[i]))
    return size > 0.0 and not math.isnan(size) and against < 0.0 and left < 0.1 * size
