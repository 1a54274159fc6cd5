"""The path of the pusher, smoothed as far as its own scatter demands.

A camera that sees the pusher with noise makes it shake. Pushing is one-way: a simulation that
follows the shaking carries the object along with every excursion, so the noise becomes a bias. The
velocity of the path is therefore modelled as a random walk, measured with white noise. Both
strengths are estimated from the path itself, by restricted maximum likelihood over a grid of their
ratio; an exact measurement is followed exactly.

Source: Whittaker (1923), On a new method of graduation; Patterson & Thompson (1971), Recovery of
inter-block information when block sizes are unequal.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from fixel.typing import FloatArray

# Variance of the change of velocity in one mean interval over that of the noise [-], least first.
RATIOS: Final = 10.0 ** np.arange(-8.0, 5.0, 2.0)
EXACT: Final = 1e-8  # [m], [rad]: deviations of noise below it are rounding
AS_GOOD: Final = 2.0  # [-] logarithms of likelihoods
MIN_SAMPLES: Final = 5  # samples, below which noise and motion cannot be separated


def smoothed(time: FloatArray, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return measured poses (n, k) with their noise smoothed out, and how uncertain they still are.

    Each coordinate is smoothed for itself, at increasing times (n,) [s]. The second value (k,) is
    the variance by which the error of the path changes in a second, in the coordinates' own units;
    zero where there are too few samples.
    """
    n = len(time)
    if n < MIN_SAMPLES:
        return measured.copy(), np.zeros(measured.shape[1])
    interval = np.diff(time) / np.mean(np.diff(time))
    rows = np.stack(
        [1.0 / interval[:-1], -1.0 / interval[:-1] - 1.0 / interval[1:], 1.0 / interval[1:]]
    ) / np.sqrt(0.5 * (interval[:-1] + interval[1:]))
    band = _penalty(rows, n)
    paths, squares, likelihoods = [], [], []
    for ratio in RATIOS:
        matrix = band / ratio
        matrix[-1] += 1.0
        factor = cholesky_banded(matrix)
        path = cho_solve_banded((factor, False), measured)
        square = np.maximum(np.sum(measured * (measured - path), axis=0) / (n - 2), EXACT**2)
        likelihood = -0.5 * (n - 2) * (np.log(square) + math.log(ratio))
        paths.append(path)
        squares.append(square)
        likelihoods.append(likelihood - float(np.sum(np.log(factor[-1]))))
    # The smoothest of those that are as good as the best: straight where nothing speaks against it.
    found = np.array(likelihoods)
    best = np.argmax(found >= found.max(axis=0) - AS_GOOD, axis=0)
    each = np.arange(measured.shape[1])
    # As many samples as the smoothing averages over at the end, and the random walk whose own
    # filter would be as uncertain there.
    window = np.minimum(n, 2.0 * math.sqrt(2.0) / RATIOS[best] ** 0.25)
    rate = np.array(squares)[best, each] * (4.0 / window) ** 2 / np.mean(np.diff(time))
    return np.array(paths)[best, :, each].T, rate


def _penalty(rows: FloatArray, n: int) -> FloatArray:
    """Return the upper bands (3, n) of D'D, D with three numbers in each of its n - 2 rows."""
    band = np.zeros((3, n))
    a, b, c = rows
    band[2, :-2] += a * a
    band[2, 1:-1] += b * b
    band[2, 2:] += c * c
    band[1, 1:-1] += a * b
    band[1, 2:] += b * c
    band[0, 2:] += a * c
    return band
