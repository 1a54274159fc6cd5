"""Data profiles on problems of Moré and Wild.

Moré & Wild (2009), "Benchmarking derivative-free optimization algorithms", SIAM Journal on
Optimization 20, 172-191. A profile says how many problems are solved to a tolerance within so many
times n + 1 evaluations; the best error that any of the searches compared finds is taken for the
least there is.
"""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.reference.more_wild import FORMS, PROBLEMS, objective, solved_after

from fixel.calibration import MultiStart, NelderMead, PatternSearch, SearchBox

BUDGET = 300  # times n + 1
TOLERANCES = (1e-1, 1e-3, 1e-5)
SIMPLEX = NelderMead(size=1e-10, speculative=False)
PATTERN = PatternSearch(solution_accuracy=None)

# Sum of squares at the start and at the least, as Moré, Garbow & Hillstrom and Moré & Wild print
# them; to the digits typed.
PUBLISHED = {
    "Rosenbrock": (24.2, 0.0),
    "helical valley": (2500.0, 0.0),
    "Powell singular": (215.0, 0.0),
    "Bard": (41.6817, 8.21488e-3),
    "Kowalik-Osborne": (5.31317e-3, 3.07506e-4),
    "Watson 6": (16.43083, 2.28767e-3),
    "Jennrich-Sampson": (4171.306, 124.362),
    "Brown-Dennis": (7926693.0, 85822.2),
    "Chebyquad 7": (3.377064e-2, 0.0),
    "Chebyquad 8": (3.861770e-2, 3.51687e-3),
}


def area(problem):
    """As good as unbounded; a tenth of the unknown, or of 1, is a step worth taking."""
    start = np.array(problem.start)
    scale = 0.1 * np.maximum(np.abs(start), 1.0)
    return SearchBox(start - 1e4 * scale, start + 1e4 * scale, start, scale)


def ours(optimiser, error, box, limit):
    search = optimiser.start(box)
    values = []
    while not search.done and len(values) < limit:
        errors = np.array([error(point) for point in search.ask()])
        values.extend(errors.tolist())
        search.tell(errors)
    return np.array(values[:limit])


def scipys(error, box, limit):
    values = []

    def noted(x):
        values.append(error(x))
        return values[-1]

    options = {"maxfev": limit, "maxiter": limit, "xatol": 1e-12, "fatol": 1e-14}
    minimize(noted, box.start, method="Nelder-Mead", options=options)
    return np.array(values[:limit])


@cache
def histories(name, form):
    """Errors in the order evaluated, for each problem."""
    found = []
    for problem in PROBLEMS:
        error, box = objective(problem, form), area(problem)
        limit = BUDGET * (box.n + 1)
        if name == "scipy":
            found.append(scipys(error, box, limit))
        else:
            found.append(ours(OURS[name], error, box, limit))
    return tuple(found)


OURS = {"simplex": SIMPLEX, "pattern": PATTERN, "several": MultiStart(optimiser=SIMPLEX, starts=4)}


def profiles(form, tolerance, *names):
    """(names, problems): evaluations to solve, in units of n + 1."""
    runs = [histories(name, form) for name in names]
    rows = []
    for k, problem in enumerate(PROBLEMS):
        best = min(run[k].min() for run in runs)
        unit = len(problem.start) + 1
        rows.append([solved_after(run[k], best, tolerance) / unit for run in runs])
    return np.array(rows).T


@pytest.mark.parametrize("name", PUBLISHED)
def test_problems_are_the_published_ones(name):
    problem = next(p for p in PROBLEMS if p.name == name)
    at_start, least = PUBLISHED[name]
    error = objective(problem, "smooth")
    assert error(np.array(problem.start)) == pytest.approx(at_start, rel=1e-6)
    options = {"maxfev": 20_000, "maxiter": 20_000, "xatol": 1e-10, "fatol": 1e-14}
    found = minimize(error, problem.start, method="Nelder-Mead", options=options)
    again = minimize(error, found.x, method="Nelder-Mead", options=options)
    assert again.fun == pytest.approx(least, rel=1e-5, abs=1e-9)


@pytest.mark.system
@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("form", FORMS)
def test_simplex_is_never_below_scipys_beyond_100(form, tolerance):
    us, them = profiles(form, tolerance, "simplex", "scipy")
    for budget in range(100, BUDGET + 1):
        assert (us <= budget).sum() >= (them <= budget).sum()


@pytest.mark.system
@pytest.mark.parametrize("form", FORMS)
def test_pattern_search_finds_the_rough_place(form):
    # It does not keep up with a simplex: measured 2026-11, the two compared alone, it solves 20, 17
    # and 20 of 20 to 0.1, but 10, 6 and 11 to 1e-5, where SciPy's simplex solves 19, 17 and 19.
    us, _ = profiles(form, 1e-1, "pattern", "scipy")
    assert (us <= BUDGET).sum() >= {"smooth": 18, "nondiff": 15, "wild3": 18}[form]
    fine, theirs = profiles(form, 1e-5, "pattern", "scipy")
    assert (fine <= BUDGET).sum() < (theirs <= BUDGET).sum()


@pytest.mark.system
def test_several_starts_find_what_one_misses():
    several, simplex = profiles("smooth", 1e-3, "several", "simplex")
    assert (several <= BUDGET).sum() == len(PROBLEMS)
    assert (simplex <= BUDGET).sum() < len(PROBLEMS)
