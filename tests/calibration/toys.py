"""Residual functions whose statistics are known."""

import numpy as np

from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import Dispersion
from fixel.calibration.optimiser import SearchBox
from fixel.calibration.profile import ProfileLikelihood
from fixel.model.space import ParameterSpace, Unknown

TIMES = np.linspace(0.0, 4.0, 60)
TRUTH = np.array([2.0, 1.3, 0.5])
NAMES = ("mu_pusher", "mu_fixel", "mu_support", "tripod_radius")
THRESHOLD = Dispersion(value=1.0).threshold()


def box(low, high, start=None):
    low, high = np.array(low, np.float64), np.array(high, np.float64)
    start = 0.5 * (low + high) if start is None else np.array(start, np.float64)
    return SearchBox(low, high, start, 0.1 * (high - low))


def each(f):
    """A function of one point, over many."""
    return lambda points: np.array([f(point) for point in points])


def linear(seed=1, sd=0.2, truth=(0.3, 0.5, 0.6)):
    """Residuals of a linear model, its matrix over the noise, and the exact fit."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(30, len(truth)))
    data = matrix @ truth + sd * rng.normal(size=30)
    exact = np.linalg.lstsq(matrix, data, rcond=None)[0]
    return lambda points: (points @ matrix.T - data) / sd, matrix / sd, exact


def decay(points):
    """(k, 60) a exp(-b t) + c."""
    return points[:, :1] * np.exp(-points[:, 1:2] * TIMES) + points[:, 2:]


def decay_residuals(seed, sd=0.05):
    data = decay(TRUTH[None])[0] + sd * np.random.default_rng(seed).normal(size=len(TIMES))
    return lambda points: (decay(points) - data) / sd


DECAY_BOX = box([0, 0, -1], [5, 5, 1], [1, 0.3, 0])


def rough(residuals, size=1e-3, jump=0.05, offset=0.0):
    """The same with deterministic noise in the last digits, and jumps."""

    def shaken(points):
        values = residuals(points)
        phase = 1e7 * points.sum(axis=1, keepdims=True) + np.arange(values.shape[1]) + offset
        steps = np.floor(37.0 * points[:, :1]) % 2.0
        return values + size * np.sin(phase) + jump * steps * np.cos(np.arange(values.shape[1]))

    return shaken


def run_profiles(search, residuals):
    """Run a search of profiles to its end."""
    while not search.done:
        search.tell(residuals(search.ask()))
    return search.profiles


def calibrated(residuals, where, threshold=THRESHOLD, prior=None, **options):
    """Fit and profiles."""
    found = fit(LeastSquares().start(where, prior=prior), residuals)
    search = ProfileLikelihood(**options).start(where, found.point, threshold, prior)
    return found, run_profiles(search, residuals)


def space_of(where, **changes):
    """Unknowns with some known names for a box."""
    return ParameterSpace(
        unknowns=tuple(
            Unknown(
                # No friction is negative.
                name=name if low >= 0.0 else "pressure_spread",
                low=low,
                high=high,
                nominal=start,
                scale=scale,
                **changes,
            )
            for name, low, high, start, scale in zip(
                NAMES, where.low, where.high, where.start, where.scale, strict=False
            )
        )
    )
