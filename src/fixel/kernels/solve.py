"""The solver chain of one step: the chosen solver first, and what to do when it fails."""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, Problem, Workspace
from fixel.kernels.feasible import is_squeezed
from fixel.kernels.fresh_start import start_afresh
from fixel.kernels.gauss_seidel import gauss_seidel
from fixel.kernels.islands import (
    ROUNDS,
    choose_contacts,
    find_islands,
    gather,
    islands_of,
    mark_changed,
    scatter,
)
from fixel.kernels.jit import kernel, large_kernel, spliced_kernel
from fixel.kernels.josephy import is_small, josephy
from fixel.kernels.linear import DENSE_LIMIT
from fixel.kernels.newton import newton
from fixel.kernels.proximal import (
    MANY,
    QUICK_ITERATIONS_LARGE,
    STIFFEST,
    newton_any,
    proximal_newton,
    stiffening_newton,
)
from fixel.kernels.residual import residual
from fixel.typing import FloatArray

TOLERANCE = (
    1e-9  # natural-map residual, scaled units, that every step must reach; judged by residual.py
)
NEWTON_TOLERANCE = (
    1e-11  # Newton's own map; two digits tighter so that the judge need not be asked twice
)
STILL_VELOCITY = 1e-9  # velocity below which the answer of the step before is tried as it is
QUICK_ITERATIONS = 10  # Newton from the step before: 2 or 3 are the rule
ITERATIONS = 12  # Newton from where the recovery got to
ITERATIONS_LARGE = 6  # the same for many contacts
NEAR = 1e-4  # residual from which Newton usually arrives, in a problem that is not small
NEAR_ITERATIONS = 3  # after sweeps
STIFF_NEAR = 1e4  # constraints with which proximal steps begin there
ARRIVALS = 8  # times that Newton starts from the iterates of one proximal iteration
# Trials of the recovery: each starts where the last one got to, every eighth from no impulses.
MAX_ATTEMPTS = 98
MAX_ATTEMPTS_EARLY = 8
PIVOTING_ITERATIONS = 6  # of `josephy`; one to three are the rule
STIFFENING = 25  # iterations of `stiffening_newton`; ten to twenty are the rule
AHEAD = 10.0  # its residual, in compliances, above which constraints do not stiffen, if that failed
STARTS = 5  # of those iterations, each after a few sweeps
GIVE_UP = 5  # after this trial ask whether friction may jam: nothing was ever found later then
CLOSE_RESIDUAL = 1e-5  # residual of an answer that may want nothing but stiffer constraints:
STIFF = 1e10  # a light body between a heavy one and a wall bears forces 1e8 times its own
SWEEPS = 300  # of Gauss-Seidel before the second start, twice and three times as many later


@spliced_kernel
def solve(
    problem: Problem,
    work: Workspace,
    guess: FloatArray,
    solver: int,
    sweeps: int,
    max_attempts: int,
) -> tuple[float, int]:
    """Solve the problem in place; returns (residual, 1 if a fallback was needed).

    Few unknowns: a few steps of Newton from the impulses of the step before, or what
    `solve_fallback` can do in `max_attempts`: MAX_ATTEMPTS_EARLY where a shorter step may be tried
    instead, else MAX_ATTEMPTS. With `max_attempts` of zero it is not tried.
    """
    first_sweeps = sweeps if solver == codes.GAUSS_SEIDEL else 0
    if first_sweeps == 0 and problem.size[N_DOF] <= DENSE_LIMIT:
        if at_rest(problem):
            worst = residual(problem, work.right)
            if worst <= NEWTON_TOLERANCE:
                return worst, 0  # the answer of the step before holds on
            if problem.size[N_DOF] == 3:
                start_afresh(problem)  # not called for others: a call with all arrays takes time
        save(problem, work)
        worst = newton(problem, work, NEWTON_TOLERANCE, QUICK_ITERATIONS)
        if worst <= TOLERANCE or max_attempts == 0:
            return worst, 0
    return solve_fallback(problem, work, guess, first_sweeps, max(max_attempts, MAX_ATTEMPTS_EARLY))


@spliced_kernel
def solve_fallback(
    problem: Problem, work: Workspace, guess: FloatArray, sweeps: int, max_attempts: int
) -> tuple[float, int]:
    """Solve a problem that `solve` has not tried or not solved, by the slower methods."""
    if sweeps > 0:
        sweep(problem, work, sweeps)
        worst = residual(problem, work.right)
        if worst <= TOLERANCE:
            return worst, 0
        reset_to_guess(problem, guess)
        save(problem, work)
    if problem.size[N_DOF] > DENSE_LIMIT:
        return solve_large(problem, work, guess, max_attempts)
    return recover(problem, work, guess, False, max_attempts)


@large_kernel
def sweep(problem: Problem, work: Workspace, sweeps: int) -> float:
    """`gauss_seidel`, out of line."""
    return gauss_seidel(problem, work, 1e-13, sweeps)


@spliced_kernel
def solve_large(
    problem: Problem, work: Workspace, guess: FloatArray, max_attempts: int
) -> tuple[float, int]:
    """Solve island by island."""
    islands = islands_of(problem, work)
    fell_back = 0
    for i in range(problem.size[N_CONTACT]):
        islands.contact_in[i] = 0
    for round_ in range(ROUNDS):
        added = choose_contacts(problem, islands, round_ == ROUNDS - 1)
        if round_ > 0 and added == 0:
            break
        n_block = find_islands(problem, islands)
        mark_changed(problem, islands, n_block, round_ == 0)
        for b in range(n_block):
            if islands.island[b] == b and islands.first[b] == 1:
                gather(problem, work, islands, guess, b)
                _, more = recover(islands.part, work, islands.guess, True, max_attempts)
                fell_back = max(fell_back, more)
                scatter(problem, islands, b)
    return residual(problem, work.right), fell_back


@large_kernel
def recover(
    problem: Problem, work: Workspace, guess: FloatArray, fresh: bool, max_attempts: int
) -> tuple[float, int]:
    """Solve a problem of any size by every means there are.

    `fresh`: quick Newton first. Otherwise that has failed, and `work` holds what it began with.
    Profiles must be set where there are more than DENSE_LIMIT unknowns.
    """
    small = is_small(problem)
    if fresh:
        worst = polish(problem, work, QUICK_ITERATIONS if small else QUICK_ITERATIONS_LARGE, 1.0)
        if worst <= TOLERANCE:
            return worst, 0
    else:
        restore(problem, work)
        if start_afresh(problem):
            worst = polish(problem, work, QUICK_ITERATIONS, 1.0)
            if worst <= TOLERANCE:
                return worst, 1
    if not small:
        return recover_large(problem, work, guess, max_attempts), 1
    # Asked first where contacts are few, at less than the cost of a trial: a step that can be
    # shortened is given up where friction may jam, another only where a jam is proven.
    if is_squeezed(problem, work, max_attempts <= MAX_ATTEMPTS_EARLY):
        return residual(problem, work.right), 1
    stiffness = 100.0
    worst = math.inf
    for trial in range(max_attempts):
        if trial % 8 == 1:
            reset_to_guess(problem, guess)
            if trial > 9:
                perturb(problem, trial // 8)
            stiffness = 10.0
            if trial > 1:
                sweep(problem, work, SWEEPS * min(trial // 8, 3))
        n_pivoting = 1
        if trial == 0:
            n_pivoting = PIVOTING_ITERATIONS
        elif trial % 8 == 1:
            n_pivoting = 5 * PIVOTING_ITERATIONS
        else:
            age = trial - 2  # since the last start from nothing
            wait = -1 if age % 2 == 0 else 100
            # Where a body turns almost freely, impulses settle long before its velocity.
            tolerance = 1e-6 if trial < MAX_ATTEMPTS_EARLY else TOLERANCE
            stiffness = proximal_newton(
                problem, work, stiffness, 1e4, 3 + trial // 2, tolerance, wait, 1.0 / (1 + age % 8),
                0.0,
            )  # fmt: skip
        for k in range(n_pivoting):
            more = n_pivoting > 1 and josephy(problem, work, k, trial + k)
            worst = polish(problem, work, ITERATIONS, 10.0 * stiffness)
            if worst <= TOLERANCE:
                return worst, 1
            if not more:
                break
        if trial == GIVE_UP and is_squeezed(problem, work, True):
            break
        stiffness = min(stiffness, 1e4)
    return worst, 1


@large_kernel
def recover_large(problem: Problem, work: Workspace, guess: FloatArray, max_attempts: int) -> float:
    """Solve a problem that is not small; returns the residual.

    Newton with constraints that stiffen solves most, at once or after sweeps. Where it fails, the
    proximal method decides which contacts press and slide, and Newton starts from what it finds.
    """
    worst = stiffening_newton(problem, work, TOLERANCE, STIFFENING, math.inf)
    for _ in range(STARTS):
        if worst <= TOLERANCE:
            return worst
        sweep(problem, work, SWEEPS // 30)
        worst = stiffening_newton(problem, work, TOLERANCE, 2 * STIFFENING, AHEAD)
    if worst <= TOLERANCE:
        return worst
    restore(problem, work)
    for trial in range(max_attempts):
        stiffness = 100.0
        if trial % 4 == 1:
            # Sweeps may end near a point that is almost a solution: start again without them.
            reset_to_guess(problem, guess)
            if trial > 4:
                perturb(problem, trial // 4)
            stiffness = 10.0
        for _ in range(0 if trial % 4 == 1 else 2):
            sweep(problem, work, SWEEPS // 3)
            worst = arrive(problem, work, NEAR_ITERATIONS, 1.0)
            if worst <= TOLERANCE:
                return worst
            if worst <= NEAR:
                stiffness = STIFF_NEAR
                break
        wait = -1 if trial % 2 == 0 else 100
        for _ in range(ARRIVALS):
            # Impulses travel through a heap from body to body.
            stiffness = proximal_newton(
                problem, work, stiffness, 1e5, 10 + trial // 2, 1e-6, wait, 1.0 / (1 + trial % 8),
                NEAR,
            )  # fmt: skip
            worst = arrive(problem, work, ITERATIONS_LARGE, 10.0 * stiffness)
            if worst <= TOLERANCE:
                return worst
            if not worst <= NEAR:
                break
            stiffness = min(STIFFEST, 10.0 * stiffness)
        if trial == GIVE_UP and may_jam(problem, work, max_attempts <= MAX_ATTEMPTS_EARLY):
            break
    return worst


@large_kernel
def arrive(problem: Problem, work: Workspace, iterations: int, stiffness: float) -> float:
    """Try Newton where the residual is small enough for it to succeed; returns the residual."""
    worst = residual(problem, work.right)
    if worst <= NEAR:
        worst = min(worst, polish(problem, work, iterations, stiffness))
    return worst


@large_kernel
def polish(problem: Problem, work: Workspace, iterations: int, stiffness: float) -> float:
    """Newton from here, and back to here where it does not arrive; returns the residual it had."""
    worst = residual(problem, work.right)
    if worst <= TOLERANCE:
        return worst
    save(problem, work)
    tolerance = NEWTON_TOLERANCE
    for _ in range(2):
        newton_any(problem, work, tolerance, iterations, stiffness)
        worst = residual(problem, work.right)
        if worst <= TOLERANCE:
            return worst
        if not worst <= CLOSE_RESIDUAL:
            break
        stiffness = STIFF
        tolerance = 0.0  # small as a force on the light body may still be large as its velocity
    restore(problem, work)
    return worst


@kernel
def at_rest(problem: Problem) -> bool:
    """Whether nothing moves."""
    fastest = 0.0
    for i in range(problem.size[N_DOF]):
        fastest = max(fastest, abs(problem.velocity[i]))
    return fastest <= STILL_VELOCITY


@kernel
def save(problem: Problem, work: Workspace) -> None:
    for i in range(problem.size[N_DOF]):
        work.search[i, 2] = problem.velocity[i]
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            work.old_impulse[i, 2 + k] = problem.impulse[i, k]
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            work.element_change[e, 8 + k] = problem.element_impulse[e, k]


@kernel
def restore(problem: Problem, work: Workspace) -> None:
    for i in range(problem.size[N_DOF]):
        problem.velocity[i] = work.search[i, 2]
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            problem.impulse[i, k] = work.old_impulse[i, 2 + k]
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            problem.element_impulse[e, k] = work.element_change[e, 8 + k]


@kernel
def reset_to_guess(problem: Problem, guess: FloatArray) -> None:
    """Go back to the guessed velocities and no impulses."""
    for i in range(problem.size[N_DOF]):
        problem.velocity[i] = guess[i]
    for i in range(problem.size[N_CONTACT]):
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            problem.element_impulse[e, k] = 0.0


@kernel
def perturb(problem: Problem, variant: int) -> None:
    """Move the velocities to somewhere else of the same size, another place for each `variant`."""
    size = 0.1
    for i in range(problem.size[N_DOF]):
        size = max(size, abs(problem.velocity[i]))
    for i in range(problem.size[N_DOF]):
        place = (i + 1) * variant * 0.6180339887498949
        problem.velocity[i] += size * (2.0 * (place - math.floor(place)) - 1.0)


@large_kernel
def may_jam(problem: Problem, work: Workspace, give_up_early: bool) -> bool:
    """Return whether prescribed motions and friction may squeeze the bodies, so that a solution
    need not exist.

    Not asked where bodies are many and a shorter step can be tried instead: the answer takes far
    longer than that step.
    """
    return not (give_up_early and problem.size[N_DOF] > MANY) and is_squeezed(problem, work, True)
