"""Kernels that only tests call from Python: contacts of convex pieces, Lemke's method."""

import math

import numpy as np

from fixel.kernels.arrays import N_PLACE
from fixel.kernels.gap import contact_pair
from fixel.kernels.jit import entry
from fixel.kernels.lemke import allocate_tableau, lemke
from fixel.kernels.linear_form import NOT_LINEAR, solve_linear_form, tableau_size
from fixel.kernels.residual import residual
from fixel.kernels.solve import is_squeezed


@entry
def measure_contacts(world, real, start, radius, margin):
    """Compute contacts of many pairs of convex pieces in world coordinates.

    Parameters
    ----------
    world : (n_vertex, 2) float64
    real : (n_vertex,) int64
        1 where the edge from this vertex is no seam.
    start : (n, 3) int64
        Pair i is ``world[start[i, 0]:start[i, 1]]`` and ``world[start[i, 1]:start[i, 2]]``.
    radius : (n, 2) float64
        Radius of disks, zero for polygons.
    margin : float
        Largest gap of the contacts.

    Returns
    -------
    count : (n,) int64
    place : (n, 2, 5) float64
        Contacts as in `arrays.Problem.contact_place`; NaN where there are fewer than two.
    key : (n, 2) int64
        Feature codes, -1 where there are none.
    """
    n = start.shape[0]
    count = np.empty(n, np.int64)
    place = np.full((n, 2, N_PLACE), math.nan)
    key = np.full((n, 2), -1)
    for i in range(n):
        s, m, e = start[i]
        count[i] = contact_pair(
            world, real, s, m, radius[i, 0], m, e, radius[i, 1], margin, place[i], key[i], 0
        )
    return count, place[:, :, :5], key


@entry
def solve_lcp(matrix, vector, max_pivots):
    """Solve 0 <= z _|_ M z + q >= 0.

    Parameters
    ----------
    matrix : (n, n) float64
    vector : (n,) float64
    max_pivots : int

    Returns
    -------
    (n,) float64, int
        Solution (zeros where there is none), and one of the codes of `lemke`.
    """
    n = vector.size
    tableau = allocate_tableau(n)
    for i in range(n):
        tableau.vector[i] = vector[i]
        for j in range(n):
            tableau.matrix[i, j] = matrix[i, j]
    code = lemke(tableau, n, max_pivots)
    return tableau.answer, code


def solve_problem(problem, work, sides_for_discs, max_pivots, rows=0):
    """Call `solve_linear_form` with a new tableau, of this many rows if they are stated; returns
    the natural-map residual, the code and the number of pivots."""
    return _solve_problem(problem, work, sides_for_discs, max_pivots, rows)


@entry
def _solve_problem(problem, work, sides_for_discs, max_pivots, rows):
    n = tableau_size(problem, sides_for_discs)
    if n < 0:
        return residual(problem, work.right), NOT_LINEAR, 0
    tableau = allocate_tableau(rows or n)
    code = solve_linear_form(problem, work, tableau, sides_for_discs, max_pivots)
    return residual(problem, work.right), code, tableau.spent[0]


@entry
def is_proven_unsolvable(problem, work):
    """Whether the bodies of a step are squeezed, without friction."""
    return is_squeezed(problem, work, False)
