"""Lemke's method on random problems."""

import itertools
import math

import numpy as np
import pytest
from tests.kernels.entries import solve_lcp

from fixel.kernels.lemke import INACCURATE, MAX_PIVOTS, RAY, SOLVED

LCP_TOLERANCE = 1e-10  # natural map of every answer called solved, n <= 60
PIVOTS = 5000


def natural_map(matrix, vector, z):
    """Largest entry of min(z, M z + q), computed apart from the kernels."""
    return float(np.abs(np.minimum(z, matrix @ z + vector)).max(initial=0.0))


def solutions(matrix, vector):
    """Every solution with a regular complementary basis."""
    n = vector.size
    found = []
    for choice in itertools.product((False, True), repeat=n):
        active = np.array(choice, bool)
        z = np.zeros(n)
        block = matrix[np.ix_(active, active)]
        if active.any():
            if abs(np.linalg.det(block)) < 1e-12:
                continue
            z[active] = np.linalg.solve(block, -vector[active])
        if min(z.min(), (matrix @ z + vector).min()) > -1e-9:
            found.append(z)
    return found


# --- the method ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("matrix", "vector", "pivots", "expected"), [
    (np.zeros((0, 0)), np.zeros(0), 10, SOLVED),
    (-np.ones((3, 3)), np.ones(3), 0, SOLVED),  # a positive vector needs no pivot
    (np.eye(5), -np.arange(1.0, 6.0), 2, MAX_PIVOTS),
    (np.eye(2), np.array([math.nan, 1.0]), 10, INACCURATE),
])  # fmt: skip
def test_problems_that_need_no_method(matrix, vector, pivots, expected):
    z, code = solve_lcp(matrix, vector, pivots)
    assert code == expected
    assert z.size == vector.size
    assert code != SOLVED or (z == 0.0).all()


@pytest.mark.parametrize("n", [1, 2, 5, 10, 30, 60])
def test_positive_definite(n):
    """Symmetric or not, a positive definite matrix has exactly one solution."""
    random = np.random.default_rng(n)
    for _ in range(20 if n <= 10 else 5):
        factor, skew = random.normal(size=(2, n, n))
        matrix = factor @ factor.T + 0.1 * np.eye(n) + skew - skew.T
        vector = random.normal(size=n)
        z, code = solve_lcp(matrix, vector, 20 * n)
        assert code == SOLVED
        assert natural_map(matrix, vector, z) <= LCP_TOLERANCE
        if n <= 5:
            (expected,) = solutions(matrix, vector)
            assert z == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("n", [4, 6, 8, 10])
def test_degenerate_integers_against_enumeration(n):
    """Positive semidefinite with ties everywhere: solved wherever enumeration finds a solution.

    For such matrices a ray proves that there is none; small integers make nearly every pivot a tie.
    """
    random = np.random.default_rng(n)
    seen = set()
    for _ in range(30 if n < 10 else 5):
        factor = random.integers(-1, 2, size=(n, n // 2)).astype(float)
        skew = np.triu(random.integers(-1, 2, size=(n, n)), 1).astype(float)
        matrix = factor @ factor.T + skew - skew.T
        vector = random.integers(-3, 2, size=n).astype(float)
        z, code = solve_lcp(matrix, vector, 1000)
        seen.add(int(code))
        assert code == (SOLVED if solutions(matrix, vector) else RAY)
        if code == SOLVED:
            assert natural_map(matrix, vector, z) <= LCP_TOLERANCE
    assert n > 6 or seen == {SOLVED, RAY}


def friction_lcp(random, n_contact):
    """Linear form of one to four free bodies of unit inertia in frictional contact, by NumPy."""
    n_body = int(random.integers(1, 5))
    levers = np.zeros((3 * n_contact, 3 * n_body))
    coupling = np.zeros((3 * n_contact, n_contact))
    limits = np.zeros((n_contact, 3 * n_contact))
    for i in range(n_contact):
        angle = random.uniform(0.0, 2.0 * math.pi)
        n = np.array([math.cos(angle), math.sin(angle)])
        t = np.array([-n[1], n[0]])
        bodies = random.permutation(n_body)[:2]
        for sign, b in zip((1.0, -1.0), bodies, strict=False):
            r = random.normal(size=2)
            for row, d in enumerate((n, t, -t)):
                arm = r[0] * d[1] - r[1] * d[0]
                levers[3 * i + row, 3 * b : 3 * b + 3] = sign * np.array([*d, arm])
        coupling[3 * i + 1 : 3 * i + 3, i] = 1.0
        limits[i, 3 * i] = random.choice([0.0, 0.3, 1.0])
        limits[i, 3 * i + 1 : 3 * i + 3] = -1.0
    if n_contact > 1 and random.random() < 0.3:
        levers[-3:] = levers[:3]  # the same contact twice
    corner = np.zeros((n_contact, n_contact))
    matrix = np.block([[levers @ levers.T, coupling], [limits, corner]])
    velocity = random.normal(size=3 * n_body) if random.random() < 0.8 else np.zeros(3 * n_body)
    vector = np.concatenate([levers @ velocity, np.zeros(n_contact)])
    vector[: 3 * n_contact : 3] += random.choice([0.0, 0.5]) * random.random(n_contact)
    return matrix, vector


@pytest.mark.parametrize("n_contact", [1, 2, 5, 10, 15])
def test_frictional_contact_always_has_a_solution(n_contact):
    """Anitescu & Potra (1997), theorem 3.1: no ray where nothing is prescribed. n = 4 n_contact."""
    random = np.random.default_rng(n_contact)
    for _ in range(40 if n_contact < 10 else 10):
        matrix, vector = friction_lcp(random, n_contact)
        z, code = solve_lcp(matrix, vector, PIVOTS)
        assert code == SOLVED
        assert natural_map(matrix, vector, z) <= LCP_TOLERANCE
        if n_contact <= 2 and len(others := solutions(matrix, vector)) == 1:
            assert z == pytest.approx(others[0], abs=1e-8)
