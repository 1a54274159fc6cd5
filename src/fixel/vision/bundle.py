"""Least-squares fit of a lens and camera places to points with known pixels, with covariance.

A rotation is updated by a small rotation about the camera's axes after it, so that no place of the
camera is singular.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.typing import FloatArray
from fixel.vision.camera import turned
from fixel.vision.lens import FOCAL, Lens

STEPS: Final = 60
CALM: Final = 1e-8  # [px] decrease of the root mean square at which the fit has converged
# Steps of the finite differences: pixels, then coefficients, radians, metres.
NUDGE: Final = {"px": 1e-3, "coefficient": 1e-6, "rad": 1e-6, "m": 1e-7}


class BundleFit(NamedTuple):
    """Result of a fit."""

    lens: Lens
    rotations: FloatArray  # (n_view, 3, 3)
    # (n_view, 3) Translation of each view's points in the camera's axes [m].
    translations: FloatArray
    residuals: FloatArray  # (n, 2) found minus fitted pixels [px]
    # (n_name, n_name) Covariance of the lens's parameters, with the places unknown.
    covariance: FloatArray
    # (n_view, 6, 6) Covariance of each place given the lens: rx, ry, rz [rad], tx, ty, tz [m].
    place_covariance: FloatArray
    noise: float  # standard deviation of a pixel along each axis [px]


class PointObservations(NamedTuple):
    """Points and their pixels, all views in one array."""

    points: FloatArray  # (n, 3) points in the frame of their view [m]
    pixels: FloatArray  # (n, 2)
    view: NDArray[np.intp]  # (n,) index of the view of each point

    def only(self, which: NDArray[np.bool_]) -> PointObservations:
        """Return the observations that a mask selects."""
        return PointObservations(self.points[which], self.pixels[which], self.view[which])


def fit(
    lens: Lens,
    names: Sequence[str],
    rotations: FloatArray,
    translations: FloatArray,
    sight: PointObservations,
    *,
    steps: int = STEPS,
) -> BundleFit:
    """Fit lens and places by least squares, with Levenberg and Marquardt's method.

    It starts at the given lens and place of every view. `names` are the parameters of the lens to
    fit; without any, only places are fitted.
    """
    damping, state = 1e-4, (lens, rotations, translations)
    error = _residuals(*state, sight)
    for _ in range(steps):
        slopes = slopes_of(state, names, sight)
        matrix = slopes.T @ slopes
        gradient = slopes.T @ error.ravel()
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        unit = matrix / np.outer(scale, scale)
        before = float(np.sqrt(np.mean(error**2)))
        for _ in range(12):
            step = np.linalg.solve(unit + damping * np.eye(len(unit)), gradient / scale) / scale
            try:
                new_state = _moved(state, names, step)
                new_error = _residuals(*new_state, sight)
            except ValueError:
                new_error = np.full_like(error, np.inf)
            after = float(np.sqrt(np.mean(new_error**2)))
            if after <= before:
                state, error, damping = new_state, new_error, max(damping * 0.2, 1e-12)
                break
            damping *= 10.0
        if not after < before - CALM:
            break
    return _fitted(state, names, sight, error)


def _fitted(
    state: tuple[Lens, FloatArray, FloatArray],
    names: Sequence[str],
    sight: PointObservations,
    error: FloatArray,
) -> BundleFit:
    slopes = slopes_of(state, names, sight)
    n, n_view = len(names), len(state[1])
    free = error.size - slopes.shape[1]
    noise = float(np.sqrt((error**2).sum() / max(free, 1)))
    matrix = slopes.T @ slopes
    shared = matrix[:n, :n].copy()
    place_covariance = np.empty((n_view, 6, 6))
    place_slope = np.empty((n_view, 6, n))
    # Each view's place is eliminated from the equations, which leaves those of the lens.
    for k in range(n_view):
        own = slice(n + 6 * k, n + 6 * k + 6)
        inverse = np.linalg.pinv(matrix[own, own], hermitian=True)
        place_covariance[k] = noise**2 * inverse
        place_slope[k] = -inverse @ matrix[own, :n]
        shared += matrix[:n, own] @ place_slope[k]
    covariance = np.zeros((0, 0))
    if n:
        scale = np.sqrt(np.abs(np.diag(shared)))
        unit = shared / np.outer(scale, scale)
        inverse = np.linalg.pinv(unit, hermitian=True) / np.outer(scale, scale)
        # Derivatives of corners with respect to the lens, with the places adjusted.
        each = slopes.reshape(len(sight.view), 2, -1)
        own_columns = n + 6 * sight.view[:, None] + np.arange(6)
        by_place = np.take_along_axis(each, own_columns[:, None, :], axis=2)
        alone = each[:, :, :n] + by_place @ place_slope[sight.view]
        pulls, own_matrix = np.zeros((n_view, n)), np.zeros((n_view, n, n))
        np.add.at(pulls, sight.view, np.einsum("icn,ic->in", alone, error))
        np.add.at(own_matrix, sight.view, np.einsum("icn,icm->inm", alone, alone))
        covariance = noise**2 * _together(pulls, own_matrix, shared, noise) * inverse
    return BundleFit(*state, error, covariance, place_covariance, noise)


def _together(pulls: FloatArray, own: FloatArray, whole: FloatArray, noise: float) -> float:
    """Ratio of the variance of the lens to that for independent corners, at least 1.

    Errors of corners in one view are correlated: paper bends, light falls from one side, and the
    model error of the lens depends on the place of the board. Each view is left out in turn, with
    the places adjusted (the jackknife over clusters). The mean square of the changes is compared
    with the variance for independent corners.

    Each view has a gradient (n,) in `pulls` and a normal matrix (n, n) in `own`, with its place
    eliminated; `whole` is the sum of the matrices.

    Source
    ------
    J. G. MacKinnon and H. White, "Some heteroskedasticity-consistent covariance matrix estimators
    with improved finite sample properties", Journal of Econometrics 29(3), 1985: HC3, by clusters.
    """
    n_view, n = pulls.shape
    if n_view < 3 or not noise > 0.0:
        return 1.0
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit = whole / np.outer(scale, scale)
    total = 0.0
    for k in range(n_view):
        rest = unit - own[k] / np.outer(scale, scale)
        change = np.linalg.pinv(rest, rcond=1e-9, hermitian=True) @ (pulls[k] / scale)
        total += float(change @ unit @ change)
    return float(max(1.0, (n_view - 1) / n_view * total / (n * noise**2)))


def _residuals(
    lens: Lens, rotations: FloatArray, translations: FloatArray, sight: PointObservations
) -> FloatArray:
    seen = np.einsum("nij,nj->ni", rotations[sight.view], sight.points) + translations[sight.view]
    if (seen[:, 2] <= 0.0).any():
        raise ValueError("a point behind the camera")
    return sight.pixels - lens.pixel(seen[:, :2] / seen[:, 2:])


def _moved(
    state: tuple[Lens, FloatArray, FloatArray], names: Sequence[str], step: FloatArray
) -> tuple[Lens, FloatArray, FloatArray]:
    lens, rotations, translations = state
    n = len(names)
    places = step[n:].reshape(-1, 6)
    if n:
        known = lens.parameters
        lens = lens.with_parameters(
            names, [known[k] + by for k, by in zip(names, step[:n].tolist(), strict=True)]
        )
    return lens, turned(rotations, places[:, :3]), translations + places[:, 3:]


def slopes_of(
    state: tuple[Lens, FloatArray, FloatArray], names: Sequence[str], sight: PointObservations
) -> FloatArray:
    """Derivatives (2 n, n_name + 6 n_view) of pixels by parameters, from central differences."""
    n, n_view, count = len(names), len(state[1]), len(sight.view)
    slopes = np.zeros((count, 2, n + 6 * n_view))

    def slope(move: FloatArray, nudge: float) -> FloatArray:
        ahead = _residuals(*_moved(state, names, move * nudge), sight)
        back = _residuals(*_moved(state, names, -move * nudge), sight)
        return (back - ahead) / (2.0 * nudge)

    for k, name in enumerate(names):
        move = np.zeros(n + 6 * n_view)
        move[k] = 1.0
        nudge = NUDGE["px"] if name in FOCAL[:4] else NUDGE["coefficient"]
        slopes[:, :, k] = slope(move, nudge)
    each = np.arange(count)
    for k in range(6):
        move = np.zeros(n + 6 * n_view)
        move[n + k :: 6] = 1.0  # a pixel depends on the place of its own view only
        slopes[each, :, n + 6 * sight.view + k] = slope(move, NUDGE["rad" if k < 3 else "m"])
    return slopes.reshape(2 * count, -1)
