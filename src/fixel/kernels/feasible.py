"""Is there a motion at all? Two certificates that prescribed motions squeeze the bodies."""

from fixel.kernels.arrays import N_CONTACT, N_DOF, Problem, Workspace
from fixel.kernels.jit import kernel
from fixel.kernels.linear import solve_dense

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
