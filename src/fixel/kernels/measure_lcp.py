"""Entries of Lemke's method for Python."""

from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.jit import entry
from fixel.kernels.lemke import allocate_tableau, lemke
from fixel.kernels.linear_form import NOT_LINEAR, solve_linear_form, tableau_size
from fixel.kernels.residual import residual
from fixel.typing import FloatArray


@entry
def solve_lcp(matrix: FloatArray, vector: FloatArray, max_pivots: int) -> tuple[FloatArray, int]:
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


@entry
def solve_problem(
    problem: Problem, work: Workspace, sides_for_discs: int, max_pivots: int
) -> tuple[float, int, int]:
    """Call `solve_linear_form` with a new tableau; returns the natural-map residual, the code and
    the number of pivots."""
    n = tableau_size(problem, sides_for_discs)
    if n < 0:
        return residual(problem, work.right), NOT_LINEAR, 0
    tableau = allocate_tableau(n)
    code = solve_linear_form(problem, work, tableau, sides_for_discs, max_pivots)
    return residual(problem, work.right), code, tableau.spent[0]
