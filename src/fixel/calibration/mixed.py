"""Mixed-effects fit: parameters that all experiments share, and shifts that each has of its own.

The residuals of experiment e near a point are taken to be linear,

    y_e = J_e d + G_e b_e + walk_e + white_e,

with the common change d of the parameters, own shifts b_e ~ N(0, diag) of friction, pressure centre
and start, a random walk for what the model gets wrong on the way, and white noise of the camera.
All variances are estimated by restricted maximum likelihood (REML), d by generalised least squares.

Source: Patterson & Thompson (1971), REML; Lindstrom & Bates (1990), linearisation about the
conditional means.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.typing import FloatArray, IntArray

ITERATIONS: Final = 60  # of the search for variances


class Linear(NamedTuple):
    """Linearised experiments; arrays are padded with zeros beyond an experiment's last residual."""

    y: FloatArray  # (n, 3, m) what simulations lack of the measurement, without own shifts [mm]
    common: FloatArray  # (n, 3, m, p) change a unit of each parameter
    own: FloatArray  # (n, 3, m, q) change a unit of each own shift
    # (n, m) Of the way of the walk that lies behind each instant; 0 beyond the last.
    share: FloatArray
    white: FloatArray  # (3,) standard deviations of the camera [mm]
    # (n,) How often an experiment counts: 1 over how many were done under its conditions.
    weight: FloatArray
    precision: FloatArray  # (p, p) of what is known of d before
    mean: FloatArray  # (p,) the same, of its mean


class MixedFit(NamedTuple):
    """Result of one fit."""

    step: FloatArray  # (p,) d
    shifts: FloatArray  # (n, q) conditional means of b_e
    # (q + 3,) Logarithms of the estimated standard deviations: of own shifts, walk in position and
    # angle, white noise.
    log_sd: FloatArray
    information: FloatArray  # (n, p, p) J' V^-1 J of each experiment, times its weight
    gradient: FloatArray  # (n, p) J' V^-1 (y - J d) of each, times its weight
    covariance: FloatArray  # (p, p) inverse of the summed information and the prior's precision


def fit_mixed(data: Linear, start: FloatArray, span: float) -> MixedFit:
    """Fit variances, common step and own shifts, from first logarithms (q + 3,) of deviations.

    The logarithms are searched from `-span` to `span`.
    """
    from scipy.optimize import minimize

    rotated = _rotated(data)
    found = minimize(
        lambda at: _criterion(rotated, at)[:2],
        np.clip(start, -span, span),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-span, span)] * len(start),
        options={"maxiter": ITERATIONS},
    )
    return _criterion(rotated, found.x)[2]


def mixed_at(data: Linear, log_sd: FloatArray) -> MixedFit:
    """Return the fit with given logarithms of standard deviations (q + 3,)."""
    return _criterion(_rotated(data), log_sd)[2]


class _RotatedData(NamedTuple):
    """The data along the axes of the walks, where all noise is independent."""

    y: FloatArray  # (n, k)
    common: FloatArray  # (n, k, p)
    own: FloatArray  # (n, k, q)
    variance: FloatArray  # (n, k) of a walk of unit size
    seen: FloatArray  # (n, k) 1 where there is a residual
    angle: FloatArray  # (k,) 1 for angles
    white: FloatArray  # (k,)
    weight: FloatArray
    precision: FloatArray
    mean: FloatArray


def _rotated(data: Linear) -> _RotatedData:
    n, _, m = data.y.shape
    walk = np.minimum(data.share[:, :, None], data.share[:, None, :])
    variance, axes = np.linalg.eigh(walk)
    # Axes of padding have no variance, and neither have their residuals any size.
    real = (axes**2 * (data.share > 0.0)[:, :, None]).sum(axis=1) > 0.5

    def turned(table: FloatArray) -> FloatArray:
        out = axes.mT[:, None] @ table.reshape(n, 3, m, -1)
        return out.reshape(n, 3 * m, *table.shape[3:])

    return _RotatedData(
        y=turned(data.y),
        common=turned(data.common),
        own=turned(data.own),
        variance=np.tile(np.maximum(variance, 0.0), 3),
        seen=np.tile(real, 3).astype(np.float64),
        angle=np.repeat([0.0, 0.0, 1.0], m),
        white=np.repeat(data.white, m),
        weight=data.weight,
        precision=data.precision,
        mean=data.mean,
    )


def _criterion(data: _RotatedData, log_sd: FloatArray) -> tuple[float, FloatArray, MixedFit]:
    """-2 log restricted likelihood, its gradient in the logarithms, and the fit there."""
    q = data.own.shape[2]
    sd, walk, white = np.exp(log_sd[:q]), np.exp(2.0 * log_sd[q : q + 2]), np.exp(2.0 * log_sd[-1])
    angle = data.angle
    walked = data.seen * data.variance * np.where(angle > 0.0, walk[1], walk[0])
    seen = data.seen * white * data.white**2
    diagonal = walked + seen + (1.0 - data.seen)
    shifted = data.own * sd
    over = shifted / diagonal[:, :, None]  # D^-1 G L
    core = np.linalg.inv(np.eye(q) + shifted.mT @ over)

    def solved(table: FloatArray) -> FloatArray:
        """V^-1 of columns (n, k, c)."""
        return np.asarray(table / diagonal[:, :, None] - over @ (core @ (over.mT @ table)))

    w = data.weight
    vj = solved(data.common)
    information = w[:, None, None] * (data.common.mT @ vj)
    covariance = np.linalg.inv(information.sum(axis=0) + data.precision)
    right = w @ np.einsum("nkp,nk->np", vj, data.y) + data.precision @ data.mean
    step = covariance @ right
    rest = data.y - data.common @ step
    u = solved(rest[:, :, None])[:, :, 0]
    off = step - data.mean
    quadratic = float(w @ np.einsum("nk,nk->n", rest, u) + off @ data.precision @ off)
    logs = np.log(diagonal).sum(axis=1) - np.linalg.slogdet(core)[1]
    value = quadratic + float(w @ logs) - float(np.linalg.slogdet(covariance)[1])

    # Derivatives: of V by each log standard deviation, 2 sd^2 g g' or a diagonal.
    vg = solved(shifted)
    gu = np.einsum("nkq,nk->nq", shifted, u)
    gj = shifted.mT @ vj
    loss = ((gj @ covariance) * gj).sum(axis=2)
    own = 2.0 * w @ (np.einsum("nkq,nkq->nq", shifted, vg) - gu**2 - loss)
    inverse = 1.0 / diagonal - ((over @ core) * over).sum(axis=2)
    each = 2.0 * w[:, None] * (inverse - u**2 - ((vj @ covariance) * vj).sum(axis=2))
    ends = [(each * part).sum() for part in (walked * (1.0 - angle), walked * angle, seen)]
    gradient = np.concatenate([own, ends])
    fit = MixedFit(
        step=step,
        shifts=gu * sd,
        log_sd=np.asarray(log_sd, np.float64).copy(),
        information=information,
        gradient=np.einsum("n,nkp,nk->np", w, data.common, u),
        covariance=covariance,
    )
    return value, gradient, fit


def numbered(labels: Sequence[Hashable]) -> IntArray:
    """Return the cluster number (n,) of each label, in order of appearance."""
    number = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    return np.array([number[label] for label in labels], np.int64)


def jackknife(
    information: FloatArray, gradient: FloatArray, covariance: FloatArray, cluster: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Compute the jackknife that leaves out each cluster in turn, with one Newton step each.

    Return the CR3 covariance (p, p), which is zero for one cluster, and the effective number (p,)
    of clusters for each parameter, at least 1.
    Each experiment has information (n, p, p), the gradient (n, p) of its log likelihood at the
    estimate, and the number of its cluster (n,), from 0. The covariance (p, p) is the inverse of
    all information, including the prior.
    """
    count = int(cluster.max()) + 1
    p = len(covariance)
    own, score = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(own, cluster, information)
    np.add.at(score, cluster, gradient)
    every = np.linalg.inv(covariance)
    moved = -np.linalg.solve(every - own, score[:, :, None])[:, :, 0]
    spread = (count - 1) / count * moved.T @ moved
    carried = np.einsum("ij,njk,ki->ni", covariance, own, covariance)
    total, squares = carried.sum(axis=0), (carried**2).sum(axis=0)
    effective = np.divide(total**2, squares, out=np.ones(p), where=squares > 0.0)
    return np.asarray(spread), np.maximum(1.0, effective)
