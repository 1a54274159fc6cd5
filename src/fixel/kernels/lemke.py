"""Lemke's method: exact pivots on linear complementarity problems.

`lemke` solves any linear complementarity problem 0 <= z _|_ M z + q >= 0 or reports that it ended
on a ray; `linear_form.py` writes step problems in that form.

Source: Cottle, Pang & Stone (1992), sections 4.4 (the method) and 4.9 (the lexicographic rule).
"""

import math
from typing import Final, NamedTuple

import numpy as np

from fixel.kernels.jit import allocating_kernel, kernel, large_kernel
from fixel.typing import FloatArray, IntArray

# Results of a solve.
SOLVED: Final = 0
RAY: Final = 1  # ended on a ray: no solution, if M is copositive-plus; otherwise nothing is proven
MAX_PIVOTS: Final = 2
INACCURATE: Final = 3  # a basis was found, but rounding errors are too large

# Natural-map residual of every SOLVED answer, relative to the row's |q| where that is above one.
ACCURACY = 1e-10
PIVOT = 1e-11  # of the largest entry of a column: smaller entries are no pivots
TIE = 1e-13  # of the terms of a ratio: ratios as close as this are tied


class Tableau(NamedTuple):
    """Problem, solution and scratch of Lemke's method, with room for n rows."""

    matrix: FloatArray  # (n, n) M; unchanged
    vector: FloatArray  # (n,) q; unchanged
    answer: FloatArray  # (n,) z; out
    trial: FloatArray  # (n,)
    table: FloatArray  # (n, n + 2) columns of the variables out of the basis, then the right side
    size: FloatArray  # (n,) bound of the numbers that went into each right side
    cover: FloatArray  # (n,) covering vector, positive; in, ones to begin with
    where: IntArray  # (2 n + 1,) of w, z, artificial: column, or -1 - row if in the basis
    row_label: IntArray  # (n,) variable in the basis
    column_label: IntArray  # (n + 1,) variable of each column
    active: IntArray  # (n,) which z are in the basis at the end
    order: IntArray  # (n,) rows exchanged by the refinement
    lever: FloatArray  # (n, 6) row of each impulse in the velocities, three columns a block
    block: IntArray  # (n, 2) first degree of freedom of these blocks, -1 for none
    bias: FloatArray  # (n,) velocity of a row at rest; limit of a slip row
    scale: FloatArray  # (n,) unit of each unknown
    spent: IntArray  # (1,) work done so far, in pivots; counted up by `lemke` and `resolve`


@allocating_kernel
def allocate_tableau(n: int) -> Tableau:
    """Allocate a tableau with room for n rows; `tableau_size` counts those of a step."""
    return Tableau(
        matrix=np.zeros((n, n)),
        vector=np.zeros(n),
        answer=np.zeros(n),
        trial=np.zeros(n),
        table=np.zeros((n, n + 2)),
        size=np.zeros(n),
        cover=np.ones(n),
        where=np.zeros(2 * n + 1, np.int64),
        row_label=np.zeros(n, np.int64),
        column_label=np.zeros(n + 1, np.int64),
        active=np.zeros(n, np.int64),
        order=np.zeros(n, np.int64),
        lever=np.zeros((n, 6)),
        block=np.zeros((n, 2), np.int64),
        bias=np.zeros(n),
        scale=np.zeros(n),
        spent=np.zeros(1, np.int64),
    )


# --- the method ----------------------------------------------------------------------------------


@large_kernel
def lemke(tableau: Tableau, n: int, max_pivots: int) -> int:
    """Solve 0 <= z _|_ M z + q >= 0; returns SOLVED, RAY, MAX_PIVOTS or INACCURATE.

    Parameters
    ----------
    tableau : Tableau
        In: the first n rows (and columns) of `matrix` and `vector`, and `cover`. Out: the first n
        of `answer`; SOLVED is returned only where its natural-map residual is within `ACCURACY`.
    n : int
        Size of the problem.
    max_pivots : int
        Largest number of pivots; each costs about n^2 multiplications, and n to 2 n are usual.

    Notes
    -----
    The table maintains y + T x = rhs for the variables y in the basis and x out of it, so that the
    columns of w, which the lexicographic rule compares, are either in the table or unit columns.

    Source: Cottle, Pang & Stone (1992), algorithms 4.4.1 and 4.9.3.
    """
    for i in range(n):
        tableau.answer[i] = 0.0
        tableau.active[i] = 0
    worst = _first_row(tableau, n)
    if worst < 0:
        return SOLVED if _is_solved(tableau, tableau.answer, n) else INACCURATE
    _fill_table(tableau, n)
    artificial = 2 * n
    _exchange(tableau, n, worst, n)
    entering = n + worst
    for _ in range(max_pivots):
        column = tableau.where[entering]
        row = _leaving_row(tableau, n, column)
        if row < 0:
            return RAY
        leaving = tableau.row_label[row]
        _exchange(tableau, n, row, column)
        tableau.spent[0] += 1
        if leaving == artificial:
            return SOLVED if _finish(tableau, n) else INACCURATE
        entering = leaving + n if leaving < n else leaving - n
    return MAX_PIVOTS


@kernel
def _first_row(tableau: Tableau, n: int) -> int:
    """Row in which the artificial variable enters first; -1 where no q is negative.

    Among equals it is the last, which is lexicographically the least.
    """
    row = -1
    least = 0.0
    for i in range(n):
        ratio = tableau.vector[i] / tableau.cover[i]
        if ratio < 0.0 and ratio <= least:
            least = ratio
            row = i
    return row


@kernel
def _fill_table(tableau: Tableau, n: int) -> None:
    """Write the initial table: every w in the basis, every z and the artificial variable out."""
    for i in range(n):
        for j in range(n):
            tableau.table[i, j] = -tableau.matrix[i, j]
        tableau.table[i, n] = -tableau.cover[i]
        tableau.size[i] = abs(tableau.vector[i])
        tableau.table[i, n + 1] = tableau.vector[i]
        tableau.row_label[i] = i
        tableau.column_label[i] = n + i
        tableau.where[i] = -1 - i
        tableau.where[n + i] = i
    tableau.column_label[n] = 2 * n
    tableau.where[2 * n] = n


@kernel
def _exchange(tableau: Tableau, n: int, row: int, column: int) -> None:
    """Pivot: the variable of `column` enters the basis, that of `row` leaves it."""
    table = tableau.table
    pivot = table[row, column]
    table[row, column] = 1.0
    for j in range(n + 2):
        table[row, j] /= pivot
    tableau.size[row] /= abs(pivot)
    for i in range(n):
        factor = table[i, column]
        if i == row or factor == 0.0:
            continue
        table[i, column] = 0.0
        for j in range(n + 2):
            table[i, j] -= factor * table[row, j]
        tableau.size[i] = max(tableau.size[i], abs(factor) * tableau.size[row])
    entering = tableau.column_label[column]
    leaving = tableau.row_label[row]
    tableau.row_label[row] = entering
    tableau.column_label[column] = leaving
    tableau.where[entering] = -1 - row
    tableau.where[leaving] = column


@kernel
def _leaving_row(tableau: Tableau, n: int, column: int) -> int:
    """Row of the lexicographically least ratio; -1 for none, which is a ray.

    The artificial variable leaves as soon as possible: a tie with it is a solution.
    """
    table = tableau.table
    largest = 0.0
    peak = 0.0
    for i in range(n):
        largest = max(largest, abs(table[i, column]))
        peak = max(peak, abs(table[i, n + 1]))
    best = -1
    for i in range(n):
        if not table[i, column] > PIVOT * largest:
            continue
        if best < 0:
            best = i
            continue
        # Ratios are compared crosswise; negative numbers are rounding errors.
        a = table[i, column]
        b = table[best, column]
        ahead = max(0.0, table[i, n + 1]) * b - max(0.0, table[best, n + 1]) * a
        # The bound of a row's rounding is tight at first, but grows far too large: hence `peak`.
        rounding = min(peak, tableau.size[i]) * b + min(peak, tableau.size[best]) * a
        if abs(ahead) > TIE * rounding:
            if ahead < 0.0:
                best = i
        elif tableau.row_label[best] != 2 * n and (
            tableau.row_label[i] == 2 * n or _is_before(tableau, n, column, i, best)
        ):
            best = i
    return best


@kernel
def _is_before(tableau: Tableau, n: int, column: int, i: int, j: int) -> bool:
    """Whether row i is lexicographically less than row j, each divided by its entry in `column`.

    The rows of B^-1 are compared. Its columns are those of w: in the table, or unit columns.
    """
    table = tableau.table
    a = table[i, column]
    b = table[j, column]
    size = 0.0
    for c in range(n + 1):
        if tableau.column_label[c] < n:
            size = max(size, abs(table[i, c]) * b, abs(table[j, c]) * a)
    for k in range(n):
        place = tableau.where[k]
        if place >= 0:
            ahead = table[i, place] * b - table[j, place] * a
        else:
            ahead = (b if place == -1 - i else 0.0) - (a if place == -1 - j else 0.0)
        if abs(ahead) > TIE * size:
            return bool(ahead < 0.0)
    return False


@kernel
def _finish(tableau: Tableau, n: int) -> bool:
    """Read the solution from the table, then solve its basis again from the original data."""
    for i in range(n):
        z = tableau.row_label[i] - n
        if z >= 0:
            tableau.active[z] = 1
            tableau.answer[z] = max(0.0, tableau.table[i, n + 1])
    if resolve(tableau, n):
        return True
    # For a nearly singular basis the solution from the table may be better.
    return _is_solved(tableau, tableau.answer, n)


@kernel
def resolve(tableau: Tableau, n: int) -> bool:
    """Solve M z + q = 0 for the active z, by elimination and one refinement.

    `answer` is set, and True returned, only if that solves the problem. O(k^3) for k active z.
    """
    order = tableau.order
    table = tableau.table
    k = 0
    for i in range(n):
        tableau.trial[i] = 0.0
        if tableau.active[i] == 1:
            tableau.column_label[k] = i
            k += 1
    tableau.spent[0] += 1 + k // 3  # k^3 / 3 multiplications, where a pivot has n^2
    for i in range(k):
        order[i] = tableau.column_label[i]
        for j in range(k):
            table[i, j] = tableau.matrix[order[i], tableau.column_label[j]]
    if not _factor(table, order, k):
        return False
    for _ in range(2):
        for i in range(k):
            table[i, n + 1] = -tableau.vector[order[i]]
            for j in range(k):
                z = tableau.column_label[j]
                table[i, n + 1] -= tableau.matrix[order[i], z] * tableau.trial[z]
        _substitute(table, k, n + 1)
        for j in range(k):
            tableau.trial[tableau.column_label[j]] += table[j, n + 1]
    for i in range(n):
        tableau.trial[i] = max(0.0, tableau.trial[i])
    if not _is_solved(tableau, tableau.trial, n):
        return False
    for i in range(n):
        tableau.answer[i] = tableau.trial[i]
    return True


@kernel
def _factor(table: FloatArray, order: IntArray, k: int) -> bool:
    """Factor the leading k by k block into LU in place, rows in `order`; False if singular."""
    for p in range(k):
        best = p
        for i in range(p + 1, k):
            if abs(table[i, p]) > abs(table[best, p]):
                best = i
        if not abs(table[best, p]) > 0.0:
            return False
        if best != p:
            order[p], order[best] = order[best], order[p]
            for j in range(k):
                table[p, j], table[best, j] = table[best, j], table[p, j]
        for i in range(p + 1, k):
            factor = table[i, p] / table[p, p]
            table[i, p] = factor
            if factor != 0.0:
                for j in range(p + 1, k):
                    table[i, j] -= factor * table[p, j]
    return True


@kernel
def _substitute(table: FloatArray, k: int, column: int) -> None:
    """Solve with the LU factors for the right side in `column`, in place."""
    for i in range(k):
        for j in range(i):
            table[i, column] -= table[i, j] * table[j, column]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            table[i, column] -= table[i, j] * table[j, column]
        table[i, column] /= table[i, i]


@kernel
def _is_solved(tableau: Tableau, z: FloatArray, n: int) -> bool:
    """Whether the natural map min(z, M z + q) vanishes within `ACCURACY`."""
    for i in range(n):
        size = max(1.0, abs(tableau.vector[i]))
        w = tableau.vector[i]
        for j in range(n):
            w += tableau.matrix[i, j] * z[j]
        # Written so that NaN is no solution.
        if not (math.isfinite(w + z[i]) and abs(min(z[i], w)) <= ACCURACY * size):
            return False
    return True


# --- the step problem ----------------------------------------------------------------------------
