"""The solver chain of one step: the chosen solver first, and what to do when it fails."""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, Problem, Workspace
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
from fixel.kernels.linear import DENSE_LIMIT, solve_dense
from fixel.kernels.newton import newton, start_afresh
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
        if problem.size[N_DOF] == 3 and start_afresh(problem):
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


# --- is there a motion at all? --------------------------------------------------------------------

# Two certificates that prescribed motions squeeze the bodies.
GAIN = (
    1e-10  # a contact impulse joins the certificate where it reduces what is left at least so fast
)
LEFT = 1e-10  # squared distance from a certificate at which one counts as found
FASTEST = 1e5  # characteristic speed: a proof rules out every motion slower than this
ROUGHLY = 1e-9  # what the judge lets contacts overlap a step, in the same units
PIVOTS = 4  # changes of the certificate's set of impulses, at most, for each degree of freedom


@kernel
def is_squeezed(problem: Problem, work: Workspace, with_friction: bool) -> bool:
    """Return whether impulses exist that move nothing while prescribed motions work on them.

    Without friction (`with_friction` false) this proves that the step has no solution: with
    ``p >= 0``, ``rows^T p = 0`` and ``bias . p < 0``, no motion v has ``u_n = rows v + bias >= 0``
    (Farkas' lemma). It is certain in spite of rounding: what is left of ``rows^T p`` could not make
    up for the bias at any speed below FASTEST, nor could overlaps that the judge accepts.

    With friction, for impulses in the friction cones, it proves nothing. Where there are none, a
    motion with ``u_n >= mu |u_t|`` at every contact exists, and with it a solution. Where there
    are, a body may be held by friction, or may still slip out.

    The impulses are sought as the least ``|rows^T p|^2 + (bias . p + 1)^2``, which then is zero, by
    the method of Lawson & Hanson (1974), chapter 23, on the cones' edges ``n + mu t`` and
    ``n - mu t``, or on the normals.
    """
    sides = 2 if with_friction else 1
    n_contact = problem.size[N_CONTACT]
    n_dof = problem.size[N_DOF]
    z = work.contact_change  # amounts of the two edges; then the two sought in this turn
    chosen = work.active  # edges whose amounts are free, as 2 contact + side
    n = 0
    for i in range(n_contact):
        for k in range(4):
            z[i, k] = 0.0
        work.old_impulse[i, 2] = 0.0
        work.old_impulse[i, 3] = 0.0
    for _ in range(PIVOTS * n_dof + 10):
        bias = _what_is_left(problem, work, with_friction)
        best = GAIN
        pick = -1
        for i in range(n_contact):
            for side in range(sides):
                if work.old_impulse[i, 2 + side] == 0.0:
                    gain = -_edge_bias(problem, i, side, with_friction) * bias
                    for k in range(6):
                        o = problem.contact_dof[i, k // 3]
                        if o >= 0:
                            gain -= (
                                _edge(problem, i, side, k, with_friction) * work.right[o + k % 3]
                            )
                    if gain > best:
                        best = gain
                        pick = 2 * i + side
        if pick < 0 or n > n_dof:
            break
        chosen[n] = pick
        work.old_impulse[pick // 2, 2 + pick % 2] = 1.0
        n += 1
        while n > 0:
            if not _fit(problem, work, n, with_friction):
                return False
            # As far towards the fit as all amounts stay positive.
            share = 1.0
            for j in range(n):
                i = chosen[j] // 2
                side = chosen[j] % 2
                if z[i, 2 + side] <= 0.0:
                    share = min(share, z[i, side] / (z[i, side] - z[i, 2 + side] + 1e-300))
            kept = 0
            for j in range(n):
                i = chosen[j] // 2
                side = chosen[j] % 2
                z[i, side] += share * (z[i, 2 + side] - z[i, side])
                if share < 1.0 and z[i, side] <= 1e-14 and z[i, 2 + side] <= 0.0:
                    z[i, side] = 0.0
                    work.old_impulse[i, 2 + side] = 0.0
                else:
                    chosen[kept] = chosen[j]
                    kept += 1
            if share == 1.0 or kept == n:
                break
            n = kept
    bias = _what_is_left(problem, work, with_friction)
    if with_friction:
        left = bias * bias
        for i in range(n_dof):
            left += work.right[i] * work.right[i]
        return left < LEFT
    slack = 0.0
    for i in range(n_dof):
        slack += FASTEST * abs(work.right[i])
    for i in range(n_contact):
        slack += ROUGHLY * z[i, 0]
    return bias - 1.0 + slack < 0.0


@kernel
def _edge(problem: Problem, i: int, side: int, k: int, with_friction: bool) -> float:
    """Coordinate k of an edge of the friction cone of contact i, or of its normal."""
    if not with_friction:
        return float(problem.normal[i, k])
    mu = problem.friction[i] if side == 0 else -problem.friction[i]
    return problem.normal[i, k] + mu * problem.tangent[i, k]


@kernel
def _edge_bias(problem: Problem, i: int, side: int, with_friction: bool) -> float:
    if not with_friction:
        return float(problem.bias[i, 0])
    mu = problem.friction[i] if side == 0 else -problem.friction[i]
    return problem.bias[i, 0] + mu * problem.bias[i, 1]


@kernel
def _what_is_left(problem: Problem, work: Workspace, with_friction: bool) -> float:
    """``rows^T p`` into `work.right`; returns ``bias . p + 1``."""
    bias = 1.0
    for o in range(problem.size[N_DOF]):
        work.right[o] = 0.0
    for i in range(problem.size[N_CONTACT]):
        for side in range(2):
            amount = work.contact_change[i, side]
            if amount != 0.0:
                bias += amount * _edge_bias(problem, i, side, with_friction)
                for k in range(6):
                    o = problem.contact_dof[i, k // 3]
                    if o >= 0:
                        work.right[o + k % 3] += amount * _edge(problem, i, side, k, with_friction)
    return bias


@kernel
def _fit(problem: Problem, work: Workspace, n: int, with_friction: bool) -> bool:
    """Amounts of the chosen edges that leave least, by the normal equations, into the last
    columns."""
    for row in range(n):
        i = work.active[row] // 2
        i_side = work.active[row] % 2
        for column in range(n):
            j = work.active[column] // 2
            j_side = work.active[column] % 2
            total = _edge_bias(problem, i, i_side, with_friction) * _edge_bias(
                problem, j, j_side, with_friction
            )
            for k in range(6):
                o = problem.contact_dof[i, k // 3]
                for m in range(6):
                    if (
                        o >= 0
                        and problem.contact_dof[j, m // 3] >= 0
                        and o + k % 3 == problem.contact_dof[j, m // 3] + m % 3
                    ):
                        total += _edge(problem, i, i_side, k, with_friction) * _edge(
                            problem, j, j_side, m, with_friction
                        )
            work.matrix[row, column] = total
        # Two edges of one direction (no friction, or a contact twice) need telling apart.
        work.matrix[row, row] *= 1.0 + 1e-13
        work.right[row] = -_edge_bias(problem, i, i_side, with_friction)
    if not solve_dense(work.matrix, work.right, n):
        return False
    for row in range(n):
        work.contact_change[work.active[row] // 2, 2 + work.active[row] % 2] = work.right[row]
    return True
