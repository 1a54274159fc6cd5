"""Least squares in a box, with residuals that are evaluated in batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final, get_args

import numpy as np

from fixel.calibration.cost import LOSSES, Cost, Loss, NormalPrior, Residuals
from fixel.calibration.descent import Descent, LeastSquaresFit, ask_all, tell_all
from fixel.calibration.optimiser import Best, Feasible, SearchBox
from fixel.calibration.options import whole
from fixel.calibration.starts import feasible_points
from fixel.errors import InvalidInput
from fixel.model.fields import non_negative, positive, settle
from fixel.typing import FloatArray

DifferenceKind = Literal["one-sided", "central", "auto"]

DIFFERENCE_KINDS: Final[tuple[DifferenceKind, ...]] = get_args(DifferenceKind)

# Distance of the points that measure roughness [scales]: jumps of a simulation with adaptive
# steps are closer together, and curvature over this distance is negligible.
NEAR: Final = 1e-4
N_NEAR: Final = 9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LeastSquares:
    """Levenberg-Marquardt method with bounds, robust loss, priors and several starts.

    Recommended for residuals that are mostly smooth: it needs tens of evaluations per unknown, a
    direct search hundreds. If residuals jump by more than the noise or are piecewise constant, use
    a pattern search or CMA-ES first, and start this method from its result.

    `scipy.optimize.least_squares` solves the same problem for one start and with one evaluation at
    a time. This implementation requests all derivatives in one batch, several damped steps in the
    next, and all starts together. It requests the same points again when a journal is replayed. The
    tests compare it with SciPy on smooth problems.

    Parameters
    ----------
    loss : str
        `squares`, `soft_l1` or `huber`.
    width : float
        Width of the robust losses [standard deviations].
    starts : int
        Number of starts: that of the box, and random feasible points.
    differences : str
        `one-sided` or `central`; `auto` begins one-sided, and continues with central differences
        and larger steps when it would otherwise end.
    difference, largest_difference : float
        First and largest step of the differences, as fractions of the scale.
    roughness : float
        Insignificant change of a residual, see `roughness_of` [standard deviations].
    trials : int
        Number of steps of different damping in one batch.
    tolerance : float
        Relative decrease of the deviance below which the search ends.
    enough : float
        Decrease of the deviance below which the search ends.
    most_iterations : int
        Maximum number of accepted steps.
    secant : bool
        Whether derivatives are corrected after a good step instead of computed again: one
        evaluation per iteration instead of one per unknown, and a less exact end.

    Source
    ------
    Marquardt (1963); the damping is in the scales of the box, as Levenberg's (1944). Broyden (1965)
    for the correction of derivatives.
    """

    loss: Loss = "squares"
    width: float = 1.0
    starts: int = 1
    differences: DifferenceKind = "auto"
    difference: float = 1e-2
    largest_difference: float = 0.3
    roughness: float = 1e-2
    trials: int = 5
    tolerance: float = 1e-8
    enough: float = 1e-8
    most_iterations: int = 60
    secant: bool = False

    def __post_init__(self) -> None:
        for name, kinds in (("loss", LOSSES), ("differences", DIFFERENCE_KINDS)):
            if getattr(self, name) not in kinds:
                found, expected = repr(getattr(self, name)), "one of " + ", ".join(kinds)
                raise InvalidInput(f"LeastSquares.{name}", found=found, expected=expected)
        for name in ("starts", "trials", "most_iterations"):
            settle(self, **{name: whole(getattr(self, name), f"LeastSquares.{name}")})
        for name in ("width", "difference", "largest_difference"):
            settle(self, **{name: positive(getattr(self, name), f"LeastSquares.{name}")})
        for name in ("roughness", "tolerance", "enough"):
            settle(self, **{name: non_negative(getattr(self, name), f"LeastSquares.{name}")})

    def cost(self, prior: NormalPrior | None = None) -> Cost:
        """Return the cost that the method minimises."""
        return Cost(loss=self.loss, width=self.width, prior=prior)

    def start(
        self,
        box: SearchBox,
        seed: int = 0,
        feasible: Feasible | None = None,
        prior: NormalPrior | None = None,
    ) -> LeastSquaresSearch:
        """Start a search.

        Parameters
        ----------
        box : SearchBox
        seed : int
            Seed of the random starts.
        feasible : callable, optional
            Test of points for the random starts.
        prior : NormalPrior, optional
        """
        if prior is not None and len(prior.mean) != box.n:
            found = f"{len(prior.mean)} parameters"
            raise InvalidInput("prior", found=found, expected=f"{box.n}, as the box has")
        starts = box.start[None]
        if self.starts > 1:
            drawn = feasible_points(box, self.starts - 1, seed, feasible)
            starts = np.concatenate((starts, drawn))
        cost = self.cost(prior)
        return LeastSquaresSearch(
            box, tuple(Descent(self, box, cost, start[None]) for start in starts)
        )


@final
class LeastSquaresSearch:
    """Running descents from all starts, advanced by the residuals of the points they request.

    Attributes
    ----------
    descents : tuple of Descent
        Descents, one per start.
    """

    def __init__(self, box: SearchBox, descents: tuple[Descent, ...]) -> None:
        self.box = box
        self.descents = descents

    @property
    def best(self) -> Best:
        """First of the points with the smallest deviance."""
        first = min(self.descents, key=lambda descent: descent.deviance)
        return Best(first.point, first.deviance)

    @property
    def fits(self) -> tuple[LeastSquaresFit, ...]:
        """Fits, one per start, the best first."""
        return tuple(sorted((d.fit for d in self.descents), key=lambda fit: fit.deviance))

    @property
    def evaluations(self) -> int:
        """Number of evaluated points."""
        return sum(descent.evaluations for descent in self.descents)

    @property
    def done(self) -> bool:
        """Whether all descents have ended, for `reason`."""
        return not self._running

    @property
    def reason(self) -> str:
        """Reason why the best descent ended; empty while any descent runs."""
        return self.fits[0].reason if self.done else ""

    def ask(self) -> FloatArray:
        """Return the points (k, n) to evaluate next; the same until their residuals are given."""
        return ask_all(self._running) if self._running else np.zeros((0, self.box.n))

    def tell(self, residuals: FloatArray) -> None:
        """Take the residuals (k, m) of the requested points; rows that are not finite failed."""
        asked = len(self.ask())
        if np.ndim(residuals) != 2 or len(residuals) != asked:
            raise InvalidInput(
                "residuals",
                found=f"shape {np.shape(residuals)}",
                expected=f"({asked}, m), one row a point",
            )
        if asked:
            tell_all(self._running, residuals)

    @property
    def _running(self) -> list[Descent]:
        return [descent for descent in self.descents if not descent.done]


def roughness_of(residuals: Residuals, box: SearchBox, point: FloatArray) -> float:
    """Estimate the insignificant change of a residual, for `LeastSquares.roughness`.

    Parameters
    ----------
    residuals : callable
    box : SearchBox
    point : (n,) array
        Feasible point.

    Returns
    -------
    float
        Largest second difference along a short line over the root of 6, the ratio of its scatter to
        that of one residual [standard deviations]; 0 if fewer than three points succeed.
    """
    centre = np.clip(point, box.low, box.high)
    inward = np.where(centre > 0.5 * (box.low + box.high), -1.0, 1.0)
    steps = NEAR * np.arange(N_NEAR)[:, None]
    told = np.asarray(residuals(centre + steps * inward * box.scale), np.float64)
    told = told[np.isfinite(told).all(axis=1)]
    return float(np.abs(np.diff(told, n=2, axis=0)).max(initial=0.0) / 6.0**0.5)


def fit(search: LeastSquaresSearch, residuals: Residuals) -> LeastSquaresFit:
    """Run a search to its end and return the best fit."""
    while not search.done:
        search.tell(residuals(search.ask()))
    return search.fits[0]
