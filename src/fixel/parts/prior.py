"""Prior of the support parameters of a part: what other parts have in common, and their spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.typing import FloatArray


class Marginal(NamedTuple):
    """Prior of one parameter before any part has been pushed."""

    mean: float
    sd: float
    low: float
    high: float
    symmetric: bool = False  # whether its sign means nothing on another part


# Equal loads with the centre of pressure under the centre of mass, on a flat table.
UNPUSHED: Final[Mapping[str, Marginal]] = {
    "mu_pusher": Marginal(0.2, 0.1, 0.02, 0.8),
    "registration_x": Marginal(0.0, 1e-3, -4e-3, 4e-3),
    "registration_y": Marginal(0.0, 1e-3, -4e-3, 4e-3),
    "contact_offset": Marginal(0.0, 0.3e-3, -1e-3, 1e-3),
    "table_bend_xy": Marginal(0.0, 0.6, -2.0, 2.0),
    "table_bend_diagonal": Marginal(0.0, 0.6, -2.0, 2.0),
    "pressure_rim": Marginal(0.0, 1.5, -6.0, 6.0),
    "pressure_corner": Marginal(0.0, 1.0, -3.0, 3.0),
    "pressure_xy": Marginal(0.0, 1.0, -3.0, 3.0),
    "pressure_diagonal": Marginal(0.0, 1.0, -3.0, 3.0, symmetric=True),
    "pressure_tilt_x": Marginal(0.0, 0.3, -1.0, 1.0, symmetric=True),
    "pressure_tilt_y": Marginal(0.0, 0.3, -1.0, 1.0, symmetric=True),
}
NAMES: Final = tuple(UNPUSHED)


@final
@dataclass(frozen=True, slots=True, eq=False)
class SupportPrior:
    """Normal distribution of the support parameters of a part."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)

    @classmethod
    def unpushed(cls) -> SupportPrior:
        """Return the prior before any part has been pushed."""
        rows = UNPUSHED.values()
        return cls(np.array([p.mean for p in rows]), np.diag([p.sd**2 for p in rows]))

    @property
    def factor(self) -> FloatArray:
        """Lower triangle L (n, n) with L L' the covariance."""
        rounding = 1e-12 * np.diag(np.diag(self.covariance))
        return np.asarray(np.linalg.cholesky(self.covariance + rounding), np.float64)

    @property
    def best(self) -> FloatArray:
        """Most probable parameters (n,), within bounds."""
        return np.clip(self.mean, *bounds())

    def at(self, z: FloatArray) -> FloatArray:
        """Return the parameters (k, n) at standard normal coordinates (k, n), within bounds."""
        low, high = bounds()
        return np.clip(self.mean + z @ self.factor.T, low, high)


def bounds() -> tuple[FloatArray, FloatArray]:
    """Return the bounds (n,) of the parameters."""
    rows = UNPUSHED.values()
    return np.array([p.low for p in rows]), np.array([p.high for p in rows])


class PartValues(NamedTuple):
    """Support parameters fitted to the pushes of one part on one surface."""

    part: str
    surface: str
    values: FloatArray  # (n,)


# Number of imaginary parts, spread as before any push, that the covariance is learned with.
IMAGINARY: Final = 1.0
# Factor on the learned covariance: a handful of parts shows less spread than there is, and their
# model misfits. Of 1, 2 and 4, leaving plates out preferred 2 for random pushes and 4 for chosen.
WIDER: Final = 2.0
# Correlations learned from a handful of parts are halved.
CORRELATED: Final = 0.5
# Parameters of a table and its tracker, rather than of a part.
ON_SURFACE: Final = ("mu_pusher", "registration", "contact_offset", "table")


def learned_prior(fits: Sequence[PartValues], surface: str, share: float) -> SupportPrior:
    """Return the prior of a new part on a surface, from other parts.

    Parameters
    ----------
    fits : sequence of PartValues
        Other parts, each on one or several surfaces.
    surface : str
        Surface of the new part. What belongs to a surface is learned from the parts on it, if
        there are any.
    share : float
        Weight of the others' mean load and table, between 0 (equal loads on a flat table) and 1.

    Source: Gelman et al. (2013), Bayesian Data Analysis, chapter 5, for the model of parts that
    differ about a mean.
    """
    prior = SupportPrior.unpushed()
    if not fits:
        return prior
    table = np.array([own.values for own in fits])
    on = np.array([own.surface for own in fits])
    centres = {name: _centre(table[on == name]) for name in dict.fromkeys(on.tolist())}
    overall = _centre(table)
    of_surface = np.array([name.startswith(ON_SURFACE) for name in NAMES])
    here = np.where(of_surface, centres.get(surface, overall), overall)
    away = table - np.where(of_surface, [centres[name] for name in on.tolist()], overall)
    n_part = len({own.part for own in fits})
    weight = n_part / max(n_part - 1, 1) / len(fits)
    scatter = weight * away.T @ away
    scatter = CORRELATED * scatter + (1.0 - CORRELATED) * np.diag(np.diag(scatter))
    total = n_part + IMAGINARY
    covariance = WIDER * (n_part * scatter + IMAGINARY * prior.covariance) / total
    kept = np.array([1.0 if _always(name) else share for name in NAMES])
    kept[[UNPUSHED[name].symmetric for name in NAMES]] = 0.0
    return SupportPrior(prior.mean + kept * (here - prior.mean), covariance)


def _centre(table: FloatArray) -> FloatArray:
    """Return means (n,) of parameters; medians of shifts, of which single sessions are far off."""
    shifts = np.array([name.startswith("registration") for name in NAMES])
    return np.where(shifts, np.median(table, axis=0), table.mean(axis=0))


def _always(name: str) -> bool:
    return name.startswith(("mu_pusher", "registration", "contact_offset"))
