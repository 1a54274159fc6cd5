"""The mixed-effects fit against dense matrices and known variances."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from fixel.calibration.mixed import Linear, _criterion, _rotated, fit_mixed


def _data(n=8, m=6, p=2, q=2, seed=0, shifts=None, tau=(0.3, 0.2), short=2):
    """Experiments whose residuals are drawn as the model says; the last ones are shorter."""
    draw = np.random.default_rng(seed)
    common, own = draw.normal(size=(n, 3, m, p)), draw.normal(size=(n, 3, m, q))
    share = np.tile(np.arange(1, m + 1) / m, (n, 1))
    sd = np.full(q, 0.5) if shifts is None else shifts
    step = np.array([0.4, -0.7])[:p]
    white = np.array([0.05, 0.05, 0.07])
    y = np.einsum("ncmp,p->ncm", common, step)
    y += np.einsum("ncmq,nq->ncm", own, sd * draw.normal(size=(n, q)))
    walk = np.cumsum(draw.normal(size=(n, 3, m)) / np.sqrt(m), axis=2)
    y += walk * np.array([tau[0], tau[0], tau[1]])[:, None]
    y += white[:, None] * draw.normal(size=y.shape)
    for table in (y, common, own):
        table[-1, :, m - short :] = 0.0
    share[-1, m - short :] = 0.0
    return Linear(y, common, own, share, white, np.ones(n), 0.1 * np.eye(p), np.zeros(p))


def _dense(data, log_sd):
    """-2 log restricted likelihood by whole matrices, and the generalised least squares step."""
    q = data.own.shape[3]
    sd, tau, white = np.exp(log_sd[:q]), np.exp(log_sd[q : q + 2]), np.exp(log_sd[-1])
    total, a, b = 0.0, data.precision.copy(), data.precision @ data.mean
    parts = []
    for y, x, z, share in zip(data.y, data.common, data.own, data.share, strict=True):
        real = share > 0.0
        walk = np.minimum(share[real][:, None], share[real])
        blocks = [
            t**2 * walk + (white * w) ** 2 * np.eye(real.sum())
            for t, w in zip((tau[0], tau[0], tau[1]), data.white, strict=True)
        ]
        size = real.sum()
        v = np.zeros((3 * size, 3 * size))
        for c, block in enumerate(blocks):
            v[c * size : (c + 1) * size, c * size : (c + 1) * size] = block
        rows = [table[:, real].reshape(3 * size, -1) for table in (x, z)]
        v += (rows[1] * sd**2) @ rows[1].T
        flat = y[:, real].ravel()
        inverse = np.linalg.inv(v)
        total += np.linalg.slogdet(v)[1]
        a += rows[0].T @ inverse @ rows[0]
        b += rows[0].T @ inverse @ flat
        parts.append((flat, rows[0], inverse))
    step = np.linalg.solve(a, b)
    total += np.linalg.slogdet(a)[1] + (step - data.mean) @ data.precision @ (step - data.mean)
    total += sum((f - x @ step) @ i @ (f - x @ step) for f, x, i in parts)
    return total, step, np.linalg.inv(a)


AT = np.array([-0.4, -1.0, -1.1, -1.5, 0.2])


def test_the_restricted_likelihood_is_that_of_whole_matrices():
    data = _data()
    value, _, fit = _criterion(_rotated(data), AT)
    other, _, _ = _criterion(_rotated(data), AT + 0.3)
    dense, step, covariance = _dense(data, AT)
    assert value - other == pytest.approx(dense - _dense(data, AT + 0.3)[0], rel=1e-9)
    np.testing.assert_allclose(fit.step, step, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-9)


def test_its_gradient_is_the_slope():
    rotated = _rotated(_data())
    slope = approx_fprime(AT, lambda at: _criterion(rotated, at)[0], 1e-6)
    np.testing.assert_allclose(_criterion(rotated, AT)[1], slope, rtol=1e-4, atol=1e-3)


def test_variances_and_step_that_were_drawn_are_found():
    data = _data(n=150, m=12, shifts=np.array([0.5, 0.05]), seed=3)
    fit = fit_mixed(data, np.zeros(5), 3.4)
    np.testing.assert_allclose(
        np.exp(fit.log_sd), [0.5, 0.05, 0.3, 0.2, 1.0], rtol=0.2
    )  # relative error of a standard deviation from 150 draws: 6 %
    deviation = (fit.step - [0.4, -0.7]) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(deviation).max() < 3.0


def test_experiments_stored_twice_say_no_more_than_once():
    once = _data(n=5)
    twice = Linear(
        *(np.concatenate([table, table]) for table in once[:4]),
        once.white,
        np.full(10, 0.5),
        once.precision,
        once.mean,
    )
    a, b = (fit_mixed(data, np.zeros(5), 3.4) for data in (once, twice))
    np.testing.assert_allclose(b.step, a.step, rtol=1e-4)
    np.testing.assert_allclose(b.covariance, a.covariance, rtol=1e-3)
