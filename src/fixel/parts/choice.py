"""Choice of the pushes that reduce the uncertainty of the ends of others most."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.typing import FloatArray, IntArray

# Size of the error of a push that depends on nothing [m]; and the share of the uncertainty of its
# end that is misfit of the model rather than ignorance of the parameters: where parts flip, and at
# corners, pushes tell less than their sensitivity says.
NOISE: Final = 2.5e-3
MISFIT_SHARE: Final = 0.35


class ChosenPushes(NamedTuple):
    """Pushes in the order in which they should be made."""

    which: IntArray  # (k,)
    variance: FloatArray  # (k + 1,) mean variance of the intended ends before and after each [m^2]


def errors_of(table: FloatArray, noise: float) -> FloatArray:
    """Return the sizes (k,) of the errors of pushes with derivatives (k, 3, n_param) [m]."""
    return np.asarray(np.sqrt(noise**2 + MISFIT_SHARE**2 * np.einsum("kci,kci->k", table, table)))


def choose_pushes(candidates: FloatArray, intended: FloatArray, n: int) -> ChosenPushes:
    """Choose pushes that reduce the mean variance of predicted ends most, one after another.

    Parameters
    ----------
    candidates : (m, 3, n_param) float64
        Derivatives of the ends of pushes that can be made, along standard normal coordinates of
        the parameters [m]; angles times a length.
    intended : (i, 3, n_param) float64
        The same for the pushes whose ends matter.
    n : int
        Number of pushes, at most m.

    Source: Fedorov (1972), V-optimal designs; greedy choice as in Krause, Singh & Guestrin (2008).
    """
    covariance = np.eye(candidates.shape[2])
    wanted = np.einsum("kci,kcj->ij", intended, intended) / max(len(intended), 1)
    noise = errors_of(candidates, NOISE)[:, None, None] ** 2 * np.eye(candidates.shape[1])
    chosen: list[int] = []
    variance = [float(np.trace(wanted @ covariance))]
    for _ in range(min(n, len(candidates))):
        along = candidates @ covariance
        seen = np.einsum("kci,kdi->kcd", along, candidates) + noise
        gain = np.einsum("kcd,kdi,ij,kcj->k", np.linalg.inv(seen), along, wanted, along)
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        covariance = covariance - along[best].T @ np.linalg.solve(seen[best], along[best])
        variance.append(float(np.trace(wanted @ covariance)))
    return ChosenPushes(np.array(chosen, np.int64), np.array(variance))
