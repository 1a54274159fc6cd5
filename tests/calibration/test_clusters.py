"""The jackknife over clusters against estimates with each cluster left out in earnest."""

import numpy as np

from fixel.calibration.mixed import jackknife, numbered


def _regression(seed=0, rows=40, clusters=8):
    draw = np.random.default_rng(seed)
    x = draw.normal(size=(rows, 3))
    cluster = np.arange(rows) % clusters
    y = x @ [1.0, -2.0, 0.5] + draw.normal(size=clusters)[cluster] + draw.normal(size=rows)
    return x, y, cluster


def _parts(x, y):
    covariance = np.linalg.inv(x.T @ x)
    rest = y - x @ (covariance @ x.T @ y)
    return x[:, :, None] * x[:, None], x * rest[:, None], covariance


def test_of_a_linear_model_leaving_out_is_exact():
    x, y, cluster = _regression()
    full = np.linalg.lstsq(x, y, rcond=None)[0]
    moved = [
        np.linalg.lstsq(x[cluster != k], y[cluster != k], rcond=None)[0] - full for k in range(8)
    ]
    spread = 7.0 / 8.0 * np.transpose(moved) @ moved
    found, _ = jackknife(*_parts(x, y), cluster)
    np.testing.assert_allclose(found, spread, rtol=1e-9)


def test_even_clusters_all_count_and_a_heavy_one_counts_alone():
    information = np.tile(np.eye(1), (6, 1, 1))
    _, even = jackknife(information, np.zeros((6, 1)), np.eye(1) / 6.0, np.arange(6))
    np.testing.assert_allclose(even, 6.0)
    information[0] = 1e4
    total = np.linalg.inv(information.sum(axis=0))
    _, heavy = jackknife(information, np.zeros((6, 1)), total, np.arange(6))
    assert heavy[0] < 1.01


def test_one_cluster_says_nothing_of_the_variation_between_clusters():
    x, y, _ = _regression()
    information, gradient, covariance = _parts(x, y)
    spread, effective = jackknife(information, gradient, 0.9 * covariance, np.zeros(len(x), int))
    np.testing.assert_allclose(spread, 0.0)
    np.testing.assert_allclose(effective, 1.0)


def test_clusters_are_numbered_in_order_of_appearance():
    assert numbered(["b", "a", "b", ("c", 1)]).tolist() == [0, 1, 0, 2]
