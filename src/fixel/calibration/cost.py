"""Cost of a least-squares fit: a loss of the residuals, and a normal prior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, final, get_args

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, check_name
from fixel.model.fields import frozen, positive, settle
from fixel.model.space import ParameterSpace
from fixel.typing import FloatArray

Residuals = Callable[[FloatArray], FloatArray]
"""Points (k, n) -> residuals (k, m) in standard deviations of the noise; a failed row is inf."""

Loss = Literal["squares", "soft_l1", "huber"]

LOSSES: Final[tuple[Loss, ...]] = get_args(Loss)

# Smallest curvature of the loss of a residual, as a share of its slope over the residual (the
# weight of iterated reweighting, which always converges, but slowly). Triggs' second term reduces
# it to zero for large residuals: below 0.4, Rosenbrock's function needed more than 60 steps.
MIN_CURVATURE: Final = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalPrior:
    """Prior of the parameters: independent normal distributions."""

    mean: FloatArray  # (n,) means, in the units of the parameters
    sd: FloatArray  # (n,) standard deviations, in the same units; inf without prior knowledge

    def __post_init__(self) -> None:
        settle(self, mean=frozen(self.mean), sd=frozen(self.sd))
        if self.mean.ndim != 1 or self.mean.shape != self.sd.shape:
            found = f"shapes {self.mean.shape} and {self.sd.shape}"
            raise InvalidInput("prior", found=found, expected="a mean and an sd for each parameter")
        if not np.isfinite(self.mean).all():
            raise InvalidInput("prior.mean", found=self.mean.tolist(), expected="finite numbers")
        if not (self.sd > 0.0).all():
            raise InvalidInput("prior.sd", found=self.sd.tolist(), expected="positive, or inf")

    @classmethod
    def of(cls, space: ParameterSpace) -> NormalPrior:
        """Return the prior of the free unknowns of a space, about their nominal values."""
        return cls(
            mean=space.nominal,
            sd=np.array([np.inf if u.prior is None else u.prior for u in space.free]),
        )

    def weighted(self, dispersion: float) -> NormalPrior:
        """Return the prior for residuals whose true variance is the dispersion instead of 1.

        The deviance divided by the dispersion then contains the prior with its full weight.
        """
        return NormalPrior(mean=self.mean, sd=self.sd / np.sqrt(positive(dispersion, "dispersion")))

    def deviance(self, points: ArrayLike) -> FloatArray:
        """Return the squared distance (...,) of points (..., n) in standard deviations."""
        z = (np.asarray(points, np.float64) - self.mean) / self.sd
        return np.asarray(np.sum(z * z, axis=-1))


class Quadratic(NamedTuple):
    """Model deviance(s) ~ deviance(0) + 2 gradient s + s hessian s, s in the scales of the box."""

    hessian: FloatArray  # (n, n)
    gradient: FloatArray  # (n,)

    def gain(self, step: FloatArray) -> float:
        """Return the predicted decrease of the deviance by a step (n,)."""
        return float(-(2.0 * self.gradient + self.hessian @ step) @ step)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cost:
    """Deviance: sum of the losses of residuals, and of the squares of the prior.

    Source
    ------
    Triggs, McLauchlan, Hartley & Fitzgibbon (2000), section 4.3, for the second-order weight of a
    residual; as in `scipy.optimize.least_squares`, whose cost is half of this deviance.
    """

    # `squares`; `soft_l1` and `huber` grow linearly for residuals much larger than the width, so
    # that a few wrong measurements have little influence.
    loss: Loss = "squares"
    width: float = 1.0  # size of residuals above which the loss is reduced [standard deviations]
    prior: NormalPrior | None = None

    def __post_init__(self) -> None:
        check_name("loss", self.loss, LOSSES)
        settle(self, width=positive(self.width, "width", "standard deviations"))

    def deviance(self, points: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return deviances (k,) for points (k, n) and residuals (k, m); inf for failures."""
        with np.errstate(over="ignore", invalid="ignore"):
            total = np.array([self._data(row) for row in residuals])
            if self.prior is not None:
                total = total + self.prior.deviance(points)
        return np.where(np.isfinite(total), total, np.inf)

    def _data(self, row: FloatArray) -> float:
        if self.loss == "squares":
            return float(row @ row)
        return float(self.width**2 * np.sum(_rho((row / self.width) ** 2, self.loss)[0]))

    def quadratic(
        self, point: FloatArray, residual: FloatArray, columns: FloatArray, scale: FloatArray
    ) -> Quadratic:
        """Return the Gauss-Newton model at a point (n,) with residuals (m,).

        Columns (m, n) are their derivatives, per scale (n,) of each parameter.
        """
        if self.loss != "squares":
            residual, columns = _reweighted(residual / self.width, columns / self.width, self.loss)
            residual, columns = residual * self.width, columns * self.width
        with np.errstate(over="ignore", invalid="ignore"):
            hessian, gradient = columns.T @ columns, columns.T @ residual
        if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
            return Quadratic(np.zeros_like(hessian), np.zeros_like(gradient))
        if self.prior is not None:
            weight = (scale / self.prior.sd) ** 2
            hessian = hessian + np.diag(weight)
            gradient = gradient + weight * (point - self.prior.mean) / scale
        return Quadratic(hessian, gradient)


def _rho(z: FloatArray, loss: Loss) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the loss of squared residuals z (m,), and its first two derivatives."""
    if loss == "soft_l1":
        t = 1.0 + z
        return 2.0 * (np.sqrt(t) - 1.0), t**-0.5, -0.5 * t**-1.5
    far = z > 1.0
    t = np.where(far, z, 1.0)
    return (np.where(far, 2.0 * np.sqrt(t) - 1.0, z), t**-0.5, np.where(far, -0.5 * t**-1.5, 0.0))


def _reweighted(f: FloatArray, columns: FloatArray, loss: Loss) -> tuple[FloatArray, FloatArray]:
    """Return residuals (m,) and columns (m, n) whose squares have the curvature of the loss."""
    z = f * f
    _, first, second = _rho(z, loss)
    weight = np.sqrt(np.maximum(first + 2.0 * second * z, MIN_CURVATURE * first))
    return f * first / weight, columns * weight[:, None]
