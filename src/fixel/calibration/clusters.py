"""Covariance of an estimate by a jackknife over clusters of experiments.

Errors of frames of one experiment, and of its repetitions, are correlated. The covariance depends
on the number of clusters, and on how evenly they share the information.

Source: MacKinnon & White (1985), HC3; Bell & McCaffrey (2002), CR3, the same for clusters.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from fixel.typing import FloatArray, IntArray


class Jackknife(NamedTuple):
    """Variation of an estimate over clusters.

    Attributes
    ----------
    covariance : (p, p) float64
        CR3 covariance; zero for one cluster, which has no variation between clusters.
    effective : (p,) float64
        Effective number of clusters for each parameter, at least 1.
    """

    covariance: FloatArray
    effective: FloatArray


def numbered(labels: Sequence[Hashable]) -> IntArray:
    """Return the cluster number (n,) of each label, in order of appearance."""
    number = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    return np.array([number[label] for label in labels], np.int64)


def jackknife(
    information: FloatArray, gradient: FloatArray, covariance: FloatArray, cluster: IntArray
) -> Jackknife:
    """Compute the jackknife that leaves out each cluster in turn, with one Newton step each.

    Parameters
    ----------
    information : (n, p, p) array
        Information of each experiment.
    gradient : (n, p) array
        Gradient of the log likelihood of each experiment at the estimate.
    covariance : (p, p) array
        Inverse of all information, including the prior.
    cluster : (n,) int
        Number of the cluster of each experiment, from 0.
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
    return Jackknife(np.asarray(spread), np.maximum(1.0, effective))
