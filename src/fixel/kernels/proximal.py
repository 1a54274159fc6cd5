"""Proximal Newton: slower than `newton`, and far more robust.

Outer loop: the method of multipliers. Every constraint acts like a spring of its own stiffness,
preloaded with the present impulse; once the velocities balance the springs, the spring impulses are
the next impulses. Every block is also pulled towards its previous velocity, which prevents
divergence. Inner loop: Newton on that balance, with a line search that stops where the momentum
residual along the direction changes sign. For given friction limits the balance is the gradient of
a convex function, and this always converges. Where Coulomb's coupling prevents convergence, the
friction limits are taken from the last impulses instead (Tresca), and updated in the outer
loop.

Source: Rockafellar (1976) for the multipliers, Haslinger (1983) for the friction limits, and
Alart & Curnier (1991) for the springs.
"""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.gauss_seidel import friction_answer, nearest_in_polygon
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.linear import DENSE_LIMIT
from fixel.kernels.newton import EPSILON, FLOOR, linearise, solve_linear, step_all
from fixel.kernels.one_body import is_one_body, newton_one_body
from fixel.kernels.residual import residual

# Compliance of all constraints in `stiffening_newton`: the residual at first, but between SOFT and
# SOFTEST; then it falls to STIFF. Below a residual of SETTLED it is at most CREEP times that: where
# contacts could share a load but for a tiny difference, impulses creep until one of them opens.
SOFTEST = 0.1
SOFT = 1e-4
STIFFEN = 0.4
STIFF = 1e-8
SETTLED = 1e-5
CREEP = 10.0
ROUND = 25  # iterations after which it is SOFTEST again
STICKS = 0.999  # of the friction limit
MANY = 90  # unknowns beyond which quick attempts give up early, and shorter steps are tried first
QUICK_ITERATIONS_LARGE = 5  # of Newton where contacts are many; it gives up after the first
HOPELESS = 0.3  # that leaves so large a natural map: from there one of twenty still arrives
INNER = 12  # Newton steps in search of a balance
SEARCH = 10  # evaluations of one line search
SLACK = 0.5  # part of the first slope at which a line search ends
STIFFEST = 1e9  # of the springs, relative to their blocks
# Columns of `work.contact_change` and `work.element_change`, free between sweeps.
_SLIP = 5
_GROWTH = 7
_ELEMENT_SLIP = 11
_ELEMENT_GROWTH = 14
PATIENCE = 3  # rounds with given friction limits before Coulomb's own are tried again


@large_kernel
def linearise_any(
    problem: Problem,
    work: Workspace,
    epsilon: float,
    pull: float,
    proximal: bool,
    tresca: bool,
    gentle: bool,
) -> float:
    """Call `linearise` for a problem of any size, not inlined."""
    dense = problem.size[N_DOF] <= DENSE_LIMIT
    return linearise(problem, work, epsilon, pull, dense, proximal, tresca, gentle)


@large_kernel
def solve_any(problem: Problem, work: Workspace) -> bool:
    """Call `solve_linear` for a problem of any size, not inlined."""
    return solve_linear(problem, work, problem.size[N_DOF] <= DENSE_LIMIT)


@kernel
def newton_any(
    problem: Problem, work: Workspace, tolerance: float, max_iterations: int, stiffness: float
) -> float:
    """Iterate as `newton` for any size and constraints at least as stiff as `stiffness`."""
    epsilon = min(EPSILON, 1.0 / stiffness)
    if is_one_body(problem):
        return newton_one_body(problem, work, tolerance, max_iterations, epsilon, FLOOR)
    worst = math.inf
    for iteration in range(max_iterations + 1):
        worst = linearise_any(problem, work, epsilon, FLOOR, False, False, False)
        if iteration == max_iterations or (iteration > 0 and worst <= tolerance):
            break
        hasty = max_iterations == QUICK_ITERATIONS_LARGE and problem.size[N_DOF] > MANY
        if (hasty and iteration == 1 and worst > HOPELESS) or not solve_any(problem, work):
            return math.inf
        step_all(problem, work)
    return worst


@large_kernel
def stiffening_newton(
    problem: Problem, work: Workspace, tolerance: float, max_iterations: int, ahead: float
) -> float:
    """Iterate as `newton` with soft constraints that stiffen; returns the residual.

    They do not stiffen while the residual exceeds `ahead` times the compliance.

    Stiff constraints make Newton overshoot where many contacts open, close or slide at once. Soft
    ones let a few change in each iteration. Where several contacts hold a body and only one can,
    impulses go round in a circle until one contact opens: each contact is made so soft that it
    just opens. Impulses beyond their laws are taken back after each iteration, and a contact that
    would slide the other way sticks first.
    """
    worst = residual(problem, work.right)
    epsilon = min(SOFTEST, max(SOFT, worst))
    for iteration in range(max_iterations):
        if worst <= tolerance or not math.isfinite(worst):
            break
        linearise_any(problem, work, epsilon, FLOOR, False, False, True)
        if not solve_any(problem, work):
            return math.inf
        step_all(problem, work)
        _obey_laws(problem, work)
        worst = residual(problem, work.right)
        if iteration % ROUND == ROUND - 1:
            epsilon = SOFTEST
        elif worst <= ahead * epsilon:
            epsilon = max(STIFF, STIFFEN * epsilon)
            if worst <= SETTLED:
                epsilon = max(STIFF, min(epsilon, CREEP * worst))
    return worst


@kernel
def _obey_laws(problem: Problem, work: Workspace) -> None:
    """Move every impulse back into its friction law; contacts that would turn round stick."""
    p = problem.element_impulse
    for e in range(problem.size[N_ELEMENT]):
        rho = problem.stiffness[problem.element_dof[e]]
        p[e, 0], p[e, 1], p[e, 2] = friction_answer(problem, e, rho)
    v = problem.velocity
    for i in range(problem.size[N_CONTACT]):
        rho = math.inf
        slip = problem.bias[i, 1]
        closing = -problem.bias[i, 0]
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                rho = min(rho, problem.stiffness[o])
                for k in range(3):
                    slip += problem.tangent[i, 3 * side + k] * v[o + k]
                    closing -= problem.normal[i, 3 * side + k] * v[o + k]
        p_n = max(0.0, problem.impulse[i, 0])
        reach = problem.friction[i] * p_n
        p_t = min(reach, max(-reach, problem.impulse[i, 1]))
        z = p_t - rho * slip
        reach = problem.friction[i] * max(0.0, p_n + rho * closing)
        if z * work.contact_change[i, 2] < 0.0 and abs(z) > reach:
            p_t = rho * slip + (STICKS * reach if z > 0.0 else -STICKS * reach)
        problem.impulse[i, 0] = p_n
        problem.impulse[i, 1] = p_t


@kernel
def proximal_newton(
    problem: Problem,
    work: Workspace,
    stiffness: float,
    enough: float,
    rounds: int,
    tolerance: float,
    patience: int,
    share: float,
    close: float,
) -> float:
    """Iterate velocity and impulses.

    Parameters
    ----------
    stiffness : float
        Initial stiffness of the springs, relative to each block's own.
    enough : float
        Stiffness up to which the springs are stiffened; beyond only where a round gains little.
    rounds : int
        Largest number of outer iterations.
    tolerance : float
        Largest change of an impulse in the last round, with stiff enough springs.
    patience : int
        Rounds with given friction limits before Coulomb's own are tried; negative for at once.
    share : float
        Share of the change to Coulomb's friction limits in a round; with 1 they may cycle.
    close : float
        Natural-map residual after which no further round is needed.

    Returns
    -------
    float
        Stiffness of the springs in the last round.
    """
    before = math.inf
    change = math.inf
    sigma = stiffness
    cap = enough
    wait = patience
    _follow(problem, work, 1.0)
    for _ in range(rounds):
        for i in range(problem.size[N_DOF]):
            work.centre[i] = problem.velocity[i]
        balanced = False
        tresca = False
        for attempt in range(2):
            tresca = attempt == 1 or wait > 0
            if attempt == 1:
                # Coulomb's coupling prevented convergence.
                wait = PATIENCE
                for i in range(problem.size[N_DOF]):
                    problem.velocity[i] = work.centre[i]
            change, balanced = _balance(problem, work, sigma, tresca)
            if balanced or tresca:
                break
        wait -= 1
        if not math.isfinite(change):
            return sigma
        if not balanced:
            # Too stiff to balance: continue from here with softer springs.
            sigma = max(1.0, 0.1 * sigma)
            cap = sigma
            before = math.inf
            continue
        _take_answers(problem, work)
        _follow(problem, work, share if tresca else 1.0)
        arrived = close > 0.0 and residual(problem, work.right) <= close
        for i in range(problem.size[N_DOF]):
            drift = abs(problem.velocity[i] - work.centre[i])
            change = max(change, problem.stiffness[i] * drift / sigma)
        if arrived or (sigma >= cap and change <= tolerance):
            break
        if sigma < cap or change > 0.5 * before:
            sigma = min(STIFFEST, 10.0 * sigma)
        before = change
    return sigma


@kernel
def _balance(problem: Problem, work: Workspace, sigma: float, tresca: bool) -> tuple[float, bool]:
    """Newton with a line search until velocities and springs balance.

    Returns the largest difference between the impulses of a spring and of its constraint, and
    whether the balance was found.
    """
    n_dof = problem.size[N_DOF]
    change = linearise_any(problem, work, 1.0 / sigma, 1.0 / sigma, True, tresca, False)
    for step in range(INNER + 1):
        left = 0.0
        for i in range(n_dof):
            left = max(left, abs(work.right[i]))
        if left <= 1e-3 * change or left < 1e-12 or not math.isfinite(left):
            return change, True
        if step == INNER:
            break
        for i in range(n_dof):
            work.search[i, 0] = problem.velocity[i]
            work.search[i, 1] = work.right[i]
        if not solve_any(problem, work):
            return math.inf, False
        slope = 0.0
        for i in range(n_dof):
            slope -= work.search[i, 1] * work.right[i]
            work.search[i, 1] = work.right[i]
        change = _search_line(problem, work, sigma, tresca, slope)
    return change, False


@kernel
def _search_line(
    problem: Problem, work: Workspace, sigma: float, tresca: bool, slope: float
) -> float:
    """Move along the search direction until the residual along it, `slope` at first, has fallen.

    The residual is piecewise smooth and never falls: secants in the bracket of its change of sign,
    with half the weight for an end that stays (Illinois). Returns the change of impulse of the last
    linearisation.
    """
    low = 0.0
    high = 1.0
    at_low = slope
    at_high = 0.0
    alpha = 1.0
    side = 0
    start, growth = begin_line(problem, work, sigma)
    for _ in range(SEARCH):
        along = start + growth * alpha - spring_force(problem, work, sigma, tresca, alpha)
        if abs(along) <= SLACK * abs(slope) or (along < 0.0 and alpha == 1.0):
            break
        if along > 0.0:
            at_low *= 0.5 if side > 0 else 1.0
            high = alpha
            at_high = along
            side = 1
        else:
            at_high *= 0.5 if side < 0 else 1.0
            low = alpha
            at_low = along
            side = -1
        alpha = low + (high - low) * at_low / (at_low - at_high)
        if not low < alpha < high:
            alpha = 0.5 * (low + high)
    for i in range(problem.size[N_DOF]):
        problem.velocity[i] = work.search[i, 0] + alpha * work.search[i, 1]
    return linearise_any(problem, work, 1.0 / sigma, 1.0 / sigma, True, tresca, False)


@kernel
def begin_line(problem: Problem, work: Workspace, sigma: float) -> tuple[float, float]:
    """Write the slips at the start of the line and their growth along it.

    Returns what the residual along the line is there without springs, and how it grows.
    """
    n_free = problem.size[N_FREE_DOF]
    v = work.search
    start = 0.0
    growth = 0.0
    for i in range(problem.size[N_DOF]):
        pull = problem.stiffness[i] / sigma
        force = pull * (v[i, 0] - work.centre[i]) - problem.momentum[i]
        more = pull * v[i, 1]
        block = i - i % 3 if i < n_free else i
        for k in range(3 if i < n_free else 1):
            force += problem.inertia[i, k] * v[block + k, 0]
            more += problem.inertia[i, k] * v[block + k, 1]
        start += force * v[i, 1]
        growth += more * v[i, 1]
    for i in range(problem.size[N_CONTACT]):
        change = work.contact_change[i]
        for k in range(2):
            change[_SLIP + k] = problem.bias[i, k]
            change[_GROWTH + k] = 0.0
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    normal = problem.normal[i, 3 * side + k]
                    tangent = problem.tangent[i, 3 * side + k]
                    change[_SLIP] += normal * v[o + k, 0]
                    change[_SLIP + 1] += tangent * v[o + k, 0]
                    change[_GROWTH] += normal * v[o + k, 1]
                    change[_GROWTH + 1] += tangent * v[o + k, 1]
    for e in range(problem.size[N_ELEMENT]):
        o = problem.element_dof[e]
        for j in range(3):
            slip = problem.element_bias[e, j]
            more = 0.0
            for k in range(3):
                slip += problem.element_row[e, j, k] * v[o + k, 0]
                more += problem.element_row[e, j, k] * v[o + k, 1]
            work.element_change[e, _ELEMENT_SLIP + j] = slip
            work.element_change[e, _ELEMENT_GROWTH + j] = more
    return start, growth


@kernel
def spring_force(
    problem: Problem, work: Workspace, sigma: float, tresca: bool, alpha: float
) -> float:
    """Force of all springs along the line, at a place `alpha` of it."""
    total = 0.0
    for i in range(problem.size[N_CONTACT]):
        change = work.contact_change[i]
        rho = problem.stiffness[problem.contact_dof[i, 0]]
        if problem.contact_dof[i, 1] >= 0:
            rho = min(rho, problem.stiffness[problem.contact_dof[i, 1]])
        stiff = sigma * rho
        p_n = problem.impulse[i, 0] - stiff * (change[_SLIP] + alpha * change[_GROWTH])
        p_t = problem.impulse[i, 1] - stiff * (change[_SLIP + 1] + alpha * change[_GROWTH + 1])
        p_n = max(0.0, p_n)
        reach = change[4] if tresca else problem.friction[i] * p_n
        p_t = min(reach, max(-reach, p_t))
        total += p_n * change[_GROWTH] + p_t * change[_GROWTH + 1]
    for e in range(problem.size[N_ELEMENT]):
        change = work.element_change[e]
        stiff = sigma * problem.stiffness[problem.element_dof[e]]
        x = problem.element_impulse[e, 0] - stiff * (
            change[_ELEMENT_SLIP] + alpha * change[_ELEMENT_GROWTH]
        )
        y = problem.element_impulse[e, 1] - stiff * (
            change[_ELEMENT_SLIP + 1] + alpha * change[_ELEMENT_GROWTH + 1]
        )
        z = problem.element_impulse[e, 2] - stiff * (
            change[_ELEMENT_SLIP + 2] + alpha * change[_ELEMENT_GROWTH + 2]
        )
        limit = problem.element_limit[e]
        share = 1.0
        if problem.element_sides[e] > 0:
            x, y = nearest_in_polygon(x, y, limit, problem.element_sides[e])
        else:
            square = x * x + y * y + z * z
            if square > limit * limit:
                share = limit / math.sqrt(square)
        total += share * (
            x * change[_ELEMENT_GROWTH]
            + y * change[_ELEMENT_GROWTH + 1]
            + z * change[_ELEMENT_GROWTH + 2]
        )
    return total


@kernel
def _follow(problem: Problem, work: Workspace, share: float) -> None:
    """Change the given friction limits towards Coulomb's by a share."""
    for i in range(problem.size[N_CONTACT]):
        own = problem.friction[i] * problem.impulse[i, 0]
        work.contact_change[i, 4] += share * (own - work.contact_change[i, 4])


@kernel
def _take_answers(problem: Problem, work: Workspace) -> None:
    """Set the impulses to those of the springs."""
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            problem.impulse[i, k] += work.contact_change[i, k]
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            problem.element_impulse[e, k] += work.element_change[e, k]
