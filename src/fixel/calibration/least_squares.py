"""Least squares in a box, from residuals that are evaluated a batch at a time."""

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

# Distance of the points that measure roughness [scales]: the jumps of a simulation with adaptive
# steps lie closer, and what bends over it is not roughness.
NEAR: Final = 1e-4
N_NEAR: Final = 9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LeastSquares:
    """Levenberg and Marquardt's method with bounds, robust loss, priors and several starts.

    The method of choice where residuals are at hand and mostly smooth: it needs tens of evaluations
    an unknown where a direct search needs hundreds. Not for residuals that jump by more than the
    noise or are flat in steps: take a pattern search or CMA-ES first, and this one from there.

    `scipy.optimize.least_squares` does the same for one start and one evaluation at a time, inside
    a call. This one exists because it asks: all derivatives in one batch, several damped steps in
    the next, all starts side by side, and the same points again when a journal is replayed. On
    smooth problems the tests hold it to SciPy's answers.

    Parameters
    ----------
    loss : str
        `squares`, `soft_l1` or `huber`.
    width : float
        Of the robust losses [standard deviations].
    starts : int
        The box's own, and random feasible points.
    differences : str
        `one-sided` or `central`; `auto` starts one-sided, and goes on with central differences and
        larger steps when it would end otherwise.
    difference, largest_difference : float
        First and largest step of the differences, as fractions of the scale.
    roughness : float
        Change of a residual that means nothing [standard deviations]; `roughness_of` measures it.
    trials : int
        Steps of different damping that are tried in one batch.
    tolerance : float
        Ends when the deviance falls by less than this fraction of it.
    enough : float
        Or by less than this.
    most_iterations : int
        Steps taken, at most.
    secant : bool
        Whether derivatives are corrected after a good step instead of taken again: one evaluation
        an iteration instead of one an unknown, and an end that is less exact.

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
        """The deviance this minimises."""
        return Cost(loss=self.loss, width=self.width, prior=prior)

    def start(
        self,
        box: SearchBox,
        seed: int = 0,
        feasible: Feasible | None = None,
        prior: NormalPrior | None = None,
    ) -> LeastSquaresSearch:
        """Begin.

        Parameters
        ----------
        box : SearchBox
        seed : int
            Of the random starts.
        feasible : callable, optional
            For random starts.
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
    """Running descents, side by side. `ask` and `tell` take turns.

    Attributes
    ----------
    descents : tuple of Descent
        One a start.
    """

    def __init__(self, box: SearchBox, descents: tuple[Descent, ...]) -> None:
        self.box = box
        self.descents = descents

    @property
    def best(self) -> Best:
        """The first of the points with the smallest deviance told."""
        first = min(self.descents, key=lambda descent: descent.deviance)
        return Best(first.point, first.deviance)

    @property
    def fits(self) -> tuple[LeastSquaresFit, ...]:
        """One a start, best first."""
        return tuple(sorted((d.fit for d in self.descents), key=lambda fit: fit.deviance))

    @property
    def evaluations(self) -> int:
        """Points told so far."""
        return sum(descent.evaluations for descent in self.descents)

    @property
    def done(self) -> bool:
        """Whether all have ended; `reason` then says why."""
        return not self._running

    @property
    def reason(self) -> str:
        """Why the one that holds the best point ended; empty while any still runs."""
        return self.fits[0].reason if self.done else ""

    def ask(self) -> FloatArray:
        """(k, n) points to evaluate next; none once done. Asking again gives the same."""
        return ask_all(self._running) if self._running else np.zeros((0, self.box.n))

    def tell(self, residuals: FloatArray) -> None:
        """Residuals (k, m) of the points asked for; a row that is not finite has failed."""
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
    """Change of a residual that means nothing, for `LeastSquares.roughness`.

    Parameters
    ----------
    residuals : callable
    box : SearchBox
    point : (n,) array
        One that can be evaluated.

    Returns
    -------
    float
        Largest second difference along a short line, over the root of 6 by which it exceeds the
        scatter of one residual [standard deviations]; 0 where fewer than three points succeed.
    """
    centre = np.clip(point, box.low, box.high)
    inward = np.where(centre > 0.5 * (box.low + box.high), -1.0, 1.0)
    steps = NEAR * np.arange(N_NEAR)[:, None]
    told = np.asarray(residuals(centre + steps * inward * box.scale), np.float64)
    told = told[np.isfinite(told).all(axis=1)]
    return float(np.abs(np.diff(told, n=2, axis=0)).max(initial=0.0) / 6.0**0.5)


def fit(search: LeastSquaresSearch, residuals: Residuals) -> LeastSquaresFit:
    """Run a search to its end; the best fit."""
    while not search.done:
        search.tell(residuals(search.ask()))
    return search.fits[0]
