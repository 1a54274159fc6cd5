"""Problems of the benchmark of Moré and Wild, typed from the formulas that they cite.

Moré, Garbow & Hillstrom (1981), "Testing unconstrained optimization software", for the functions;
Moré & Wild (2009), "Benchmarking derivative-free optimization algorithms", for the forms and for
data profiles. Twenty of their 53 rows: those of up to eight unknowns that need no long table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Residuals = Callable[[np.ndarray], np.ndarray]


class Problem(NamedTuple):
    """Residuals f: R^n -> R^m, a start, and whether the form `nondiff` takes max(x, 0)."""

    name: str
    residuals: Residuals
    start: tuple[float, ...]
    clipped: bool = False


def linear_rank_one(m):
    i = np.arange(1, m + 1)
    return lambda x: i * (np.arange(1, len(x) + 1) @ x) - 1.0


def rosenbrock(x):
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def helical_valley(x):
    turn = np.arctan2(x[1], x[0]) / (2.0 * np.pi)
    # The published branch: from -1/4 to 3/4 of a turn.
    turn = turn + 1.0 if turn < -0.25 else turn
    radius = np.hypot(x[0], x[1])
    return np.array([10.0 * (x[2] - 10.0 * turn), 10.0 * (radius - 1.0), x[2]])


def powell_singular(x):
    return np.array([
        x[0] + 10.0 * x[1],
        np.sqrt(5.0) * (x[2] - x[3]),
        (x[1] - 2.0 * x[2]) ** 2,
        np.sqrt(10.0) * (x[0] - x[3]) ** 2,
    ])  # fmt: skip


def freudenstein_roth(x):
    return np.array([
        -13.0 + x[0] + ((5.0 - x[1]) * x[1] - 2.0) * x[1],
        -29.0 + x[0] + ((x[1] + 1.0) * x[1] - 14.0) * x[1],
    ])  # fmt: skip


BARD = (0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39)


def bard(x):
    u = np.arange(1.0, 16.0)
    v = 16.0 - u
    return np.array(BARD) - (x[0] + u / (x[1] * v + x[2] * np.minimum(u, v)))


KOWALIK = np.array([
    (4.0, 0.1957), (2.0, 0.1947), (1.0, 0.1735), (0.5, 0.1600), (0.25, 0.0844), (0.167, 0.0627),
    (0.125, 0.0456), (0.1, 0.0342), (0.0833, 0.0323), (0.0714, 0.0235), (0.0625, 0.0246),
])  # fmt: skip


def kowalik_osborne(x):
    u, y = KOWALIK.T
    return y - x[0] * (u**2 + u * x[1]) / (u**2 + u * x[2] + x[3])


def watson(x):
    t = np.arange(1, 30)[:, None] / 29.0
    j = np.arange(len(x))
    slope = (j[1:] * x[1:] * t ** (j[1:] - 1)).sum(axis=1)
    value = (x * t**j).sum(axis=1)
    return np.concatenate((slope - value**2 - 1.0, [x[0], x[1] - x[0] ** 2 - 1.0]))


def box_three(x):
    t = 0.1 * np.arange(1.0, 11.0)
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10.0 * t))


def jennrich_sampson(x):
    i = np.arange(1.0, 11.0)
    return 2.0 + 2.0 * i - (np.exp(i * x[0]) + np.exp(i * x[1]))


def brown_dennis(x):
    t = np.arange(1.0, 21.0) / 5.0
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


def chebyquad(x):
    n = len(x)
    values = np.polynomial.chebyshev.chebvander(2.0 * x - 1.0, n)[:, 1:].mean(axis=0)
    i = np.arange(1, n + 1)
    even = i % 2 == 0
    return values + np.where(even, 1.0 / np.where(even, i**2 - 1.0, 1.0), 0.0)


def bdqrtic(x):
    k = len(x) - 4
    quartic = sum((j + 1) * x[j : j + k] ** 2 for j in range(4)) + 5.0 * x[-1] ** 2
    return np.concatenate((3.0 - 4.0 * x[:k], quartic))


def cube(x):
    return np.concatenate(([x[0] - 1.0], 10.0 * (x[1:] - x[:-1] ** 3)))


def mancino(x):
    i = np.arange(1, len(x) + 1)
    v = np.sqrt(x[:, None] ** 2 + i[:, None] / i)
    waves = v * (np.sin(np.log(v)) ** 5 + np.cos(np.log(v)) ** 5)
    return 1400.0 * x + (i - 50.0) ** 3 + waves.sum(axis=1)


def mancino_start(n):
    return tuple((-8.710996e-4 * (mancino(np.zeros(n)))).tolist())


def heart(x):
    a, b, c, d, t, u, v, w = x
    return np.array([
        a + b + 0.69,
        c + d + 0.044,
        t * a + u * b - v * c - w * d + 1.57,
        v * a + w * b + t * c + u * d + 1.31,
        a * (t**2 - v**2) - 2.0 * c * t * v + b * (u**2 - w**2) - 2.0 * d * u * w + 2.65,
        c * (t**2 - v**2) + 2.0 * a * t * v + d * (u**2 - w**2) + 2.0 * b * u * w - 2.0,
        a * t * (t**2 - 3.0 * v**2)
        + c * v * (v**2 - 3.0 * t**2)
        + b * u * (u**2 - 3.0 * w**2)
        + d * w * (w**2 - 3.0 * u**2)
        + 12.6,
        c * t * (t**2 - 3.0 * v**2)
        - a * v * (v**2 - 3.0 * t**2)
        + d * u * (u**2 - 3.0 * w**2)
        - b * w * (w**2 - 3.0 * u**2)
        - 9.48,
    ])  # fmt: skip


def spread(n):
    return tuple((np.arange(1, n + 1) / (n + 1)).tolist())


PROBLEMS = (
    Problem("linear, rank 1", linear_rank_one(35), (1.0,) * 7),
    Problem("Rosenbrock", rosenbrock, (-1.2, 1.0)),
    Problem("Rosenbrock x 10", rosenbrock, (-12.0, 10.0)),
    Problem("helical valley", helical_valley, (-1.0, 0.0, 0.0)),
    Problem("Powell singular", powell_singular, (3.0, -1.0, 0.0, 1.0)),
    Problem("Freudenstein-Roth", freudenstein_roth, (0.5, -2.0)),
    Problem("Freudenstein-Roth x 10", freudenstein_roth, (5.0, -20.0)),
    Problem("Bard", bard, (1.0, 1.0, 1.0), clipped=True),
    Problem("Kowalik-Osborne", kowalik_osborne, (0.25, 0.39, 0.415, 0.39), clipped=True),
    Problem("Watson 6", watson, (0.5,) * 6),
    Problem("Box 3", box_three, (0.0, 10.0, 20.0)),
    Problem("Jennrich-Sampson", jennrich_sampson, (0.3, 0.4), clipped=True),
    Problem("Brown-Dennis", brown_dennis, (25.0, 5.0, -5.0, -1.0)),
    Problem("Chebyquad 6", chebyquad, spread(6)),
    Problem("Chebyquad 7", chebyquad, spread(7)),
    Problem("Chebyquad 8", chebyquad, spread(8)),
    Problem("Bdqrtic 8", bdqrtic, (1.0,) * 8),
    Problem("Cube 5", cube, (0.5,) * 5),
    Problem("Mancino 5", mancino, mancino_start(5)),
    Problem("Heart 8", heart, (-0.3, -0.39, 0.3, -0.344, -1.2, 2.69, 1.59, -1.5)),
)
FORMS = ("smooth", "nondiff", "wild3")


def objective(problem, form):
    """One of the forms: sum of squares, sum of magnitudes, squares with a wild factor of 0.1 %."""

    def value(x):
        with np.errstate(all="ignore"):
            at = np.maximum(x, 0.0) if form == "nondiff" and problem.clipped else x
            f = problem.residuals(at)
            y = float(np.abs(f).sum() if form == "nondiff" else (f**2).sum())
            if form == "wild3":
                y *= 1.0 + 1e-3 * wild(x)
        return y if np.isfinite(y) else np.inf

    return value


def wild(x):
    """The noise of Moré & Wild, eqs. 4.2-4.3: deterministic, from -1 to 1."""
    one, two, most = (np.linalg.norm(x, p) for p in (1, 2, np.inf))
    phi = 0.9 * np.sin(100.0 * one) * np.cos(100.0 * most) + 0.1 * np.cos(two)
    return float(phi * (4.0 * phi**2 - 3.0))


def solved_after(histories, best, tolerance):
    """Evaluations until the error fell by 1 - tolerance of what it can; a large number for never.

    Moré & Wild, eq. 2.2.
    """
    lowest = np.minimum.accumulate(histories)
    done = np.flatnonzero(lowest <= best + tolerance * (lowest[0] - best))
    return int(done[0]) + 1 if len(done) else 10**9
