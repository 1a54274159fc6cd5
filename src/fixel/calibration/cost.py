"""What a fit by least squares minimises: residuals, a loss on them, and what was known before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, final, get_args

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import frozen, positive, settle
from fixel.model.space import ParameterSpace
from fixel.typing import FloatArray

Residuals = Callable[[FloatArray], FloatArray]
"""Points (k, n) -> residuals (k, m) in standard deviations of the noise; a failed row is inf."""

Loss = Literal["squares", "soft_l1", "huber"]

LOSSES: Final[tuple[Loss, ...]] = get_args(Loss)

# Least curvature of a residual's loss, as a share of its slope over the residual (the weight of
# iterated reweighting, which always converges but slowly). Triggs' second term takes it down to
# nothing for far residuals: below 0.4, Rosenbrock's valley was not left in 60 steps.
MIN_CURVATURE: Final = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalPrior:
    """What was known of the parameters before: independent normal distributions.

    Parameters
    ----------
    mean : (n,) array
        In the units of the parameters.
    sd : (n,) array
        Standard deviations, in the same; inf where nothing was known.
    """

    mean: FloatArray
    sd: FloatArray

    def __post_init__(self) -> None:
        settle(self, mean=frozen(self.mean), sd=frozen(self.sd))
        if self.mean.ndim != 1 or self.mean.shape != self.sd.shape:
            found = f"shapes {self.mean.shape} and {self.sd.shape}"
            raise InvalidInput("prior", found=found, expected="a mean and an sd a parameter")
        if not np.isfinite(self.mean).all():
            raise InvalidInput("prior.mean", found=self.mean.tolist(), expected="finite numbers")
        if not (self.sd > 0.0).all():
            raise InvalidInput("prior.sd", found=self.sd.tolist(), expected="positive, or inf")

    @classmethod
    def of(cls, space: ParameterSpace) -> NormalPrior:
        """Of the free unknowns of a space, about their nominal values."""
        return cls(
            mean=space.nominal,
            sd=np.array([np.inf if u.prior is None else u.prior for u in space.free]),
        )

    def weighted(self, dispersion: float) -> NormalPrior:
        """The prior beside residuals whose true variance is the dispersion, in place of 1.

        The deviance divided by the dispersion then holds the prior at its full weight.
        """
        return NormalPrior(mean=self.mean, sd=self.sd / np.sqrt(positive(dispersion, "dispersion")))

    def deviance(self, points: ArrayLike) -> FloatArray:
        """Points (..., n) -> (...,) their squared distance in standard deviations."""
        z = (np.asarray(points, np.float64) - self.mean) / self.sd
        return np.asarray(np.sum(z * z, axis=-1))


class Quadratic(NamedTuple):
    """deviance(s) ~ deviance(0) + 2 gradient s + s hessian s, s in the scales of the box."""

    hessian: FloatArray  # (n, n)
    gradient: FloatArray  # (n,)

    def gain(self, step: FloatArray) -> float:
        """By how much a step (n,) lowers the deviance, as far as the model goes."""
        return float(-(2.0 * self.gradient + self.hessian @ step) @ step)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cost:
    """The deviance: the sum of losses of the residuals, and of squares of the prior.

    Parameters
    ----------
    loss : str
        `squares`; `soft_l1` and `huber` grow like the distance where a residual is much larger than
        the width, so that a few wrong measurements do not decide.
    width : float
        Where a residual stops to count in full [standard deviations].
    prior : NormalPrior, optional

    Source
    ------
    Triggs, McLauchlan, Hartley & Fitzgibbon (2000), section 4.3, for the second-order weight of a
    residual; as in `scipy.optimize.least_squares`, whose cost is half of this deviance.
    """

    loss: Loss = "squares"
    width: float = 1.0
    prior: NormalPrior | None = None

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise InvalidInput(
                "loss", found=repr(self.loss), expected="one of " + ", ".join(LOSSES)
            )
        settle(self, width=positive(self.width, "width", "standard deviations"))

    def deviance(self, points: FloatArray, residuals: FloatArray) -> FloatArray:
        """Points (k, n), residuals (k, m) -> (k,); inf where a residual is not finite."""
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
        """Gauss-Newton model at a point (n,).

        Parameters
        ----------
        point : (n,) array
        residual : (m,) array
        columns : (m, n) array
            Change of the residuals a scale of each parameter.
        scale : (n,) array
            Of the box.
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
    """Loss of squared residuals z (m,), and its first two derivatives."""
    if loss == "soft_l1":
        t = 1.0 + z
        return 2.0 * (np.sqrt(t) - 1.0), t**-0.5, -0.5 * t**-1.5
    far = z > 1.0
    t = np.where(far, z, 1.0)
    return (
        np.where(far, 2.0 * np.sqrt(t) - 1.0, z),
        t**-0.5,
        np.where(far, -0.5 * t**-1.5, 0.0),
    )


def _reweighted(f: FloatArray, columns: FloatArray, loss: Loss) -> tuple[FloatArray, FloatArray]:
    """Residuals (m,) and columns (m, n) whose plain squares have the robust loss's curvature."""
    z = f * f
    _, first, second = _rho(z, loss)
    weight = np.sqrt(np.maximum(first + 2.0 * second * z, MIN_CURVATURE * first))
    return f * first / weight, columns * weight[:, None]
