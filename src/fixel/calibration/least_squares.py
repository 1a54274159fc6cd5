"""Least squares in a box, with residuals that are evaluated in batches.

The cost of a fit is a loss of the residuals, and a normal prior.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.optimiser import Best, Count, Feasible, SearchBox, Size, feasible_points
from fixel.errors import InvalidInput, check_name
from fixel.model.fields import Value, check_fields, frozen, non_negative, positive, settle
from fixel.model.space import ParameterSpace
from fixel.typing import BoolArray, FloatArray, IntArray

Residuals = Callable[[FloatArray], FloatArray]
"""Points (k, n) -> residuals (k, m) in standard deviations of the noise; a failed row is inf."""

Loss = Literal["squares", "soft_l1", "huber"]

LOSSES: Final[tuple[Loss, ...]] = get_args(Loss)

# Smallest curvature of the loss of a residual, as a share of its slope over the residual (the
# weight of iterated reweighting, which always converges, but slowly). Triggs' second term reduces
# it to zero for large residuals: below 0.4, Rosenbrock's function needed more than 60 steps.
MIN_CURVATURE: Final = 0.5


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


DifferenceKind = Literal["one-sided", "central", "auto"]

Share = Annotated[float, Value(non_negative)]

DIFFERENCE_KINDS: Final[tuple[DifferenceKind, ...]] = get_args(DifferenceKind)

# Damping is relative to the largest diagonal entry of the Hessian.
FIRST_DAMPING: Final = 1e-3
# Share of the predicted gain above which the derivatives are corrected instead of computed again.
HALF_AS_GOOD: Final = 0.5
# With less, the damped matrix is singular to rounding.
MIN_DAMPING: Final = 1e-10
# Factor between the dampings of the trial steps of one batch.
SPREAD: Final = 10.0
# Failed batches of trial steps after which derivatives are computed again: with five steps per
# batch, the last ones are 1e10 times shorter than the first.
PATIENCE: Final = 2
# Distance from a bound [scales] that counts as on it.
ON_BOUND: Final = 1e-12

# A response this many times the roughness gives a slope with an error of a few per cent.
CLEAR: Final = 30.0
# A response this many times the roughness is still clear after a step ten times smaller.
PLAIN: Final = 1000.0
# Maximum number of probes of one unknown at one point: enough to grow from 1e-3 to 1 scale.
TRIES: Final = 4
GROWTH: Final = 10.0
# Smallest step over the first one; if it still fails, the point is at an edge of feasibility.
MIN_STEP_SHARE: Final = 1e-3

FAILED: Final = "no start could be evaluated"
SETTLED: Final = "the deviance no longer decreases"
STUCK: Final = "no step decreases the deviance"
NO_ANSWER: Final = "the residuals do not depend on any parameter"
NOTHING_FREE: Final = "no parameter is free"
EXHAUSTED: Final = "the maximum number of iterations was reached"


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
        Insignificant change of a residual [standard deviations].
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

    name: ClassVar[str] = "least-squares"
    loss: Loss = "squares"
    width: Size = 1.0
    starts: Count = 1
    differences: DifferenceKind = "auto"
    difference: Size = 1e-2
    largest_difference: Size = 0.3
    roughness: Share = 1e-2
    trials: Count = 5
    tolerance: Share = 1e-8
    enough: Share = 1e-8
    most_iterations: Count = 60
    secant: bool = False

    def __post_init__(self) -> None:
        check_name("LeastSquares.loss", self.loss, LOSSES)
        check_name("LeastSquares.differences", self.differences, DIFFERENCE_KINDS)
        check_fields(self, "LeastSquares")

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
        """Start a search; the seed and the test of points are for the random starts."""
        if prior is not None and len(prior.mean) != box.n:
            found = f"{len(prior.mean)} parameters"
            raise InvalidInput("prior", found=found, expected=f"{box.n}, the number of bounds")
        starts = box.start[None]
        if self.starts > 1:
            drawn = feasible_points(box, self.starts - 1, seed, feasible)
            starts = np.concatenate((starts, drawn))
        cost = self.cost(prior)
        return LeastSquaresSearch(
            box, tuple(Descent(self, box, cost, start[None]) for start in starts)
        )


class LeastSquaresFit(NamedTuple):
    """Result of a descent."""

    point: FloatArray  # (n,)
    deviance: float  # inf if no point could be evaluated
    hessian: FloatArray  # (n, n) half the second derivatives of the deviance (Gauss-Newton)
    gradient: FloatArray  # (n,) half the first derivatives, not zero on an active bound
    residual: FloatArray  # (m,); empty if no point could be evaluated
    columns: FloatArray  # (m, n) its derivatives, per scale of a parameter; may be empty
    steps: FloatArray  # (n,) of the latest differences [scales]
    evaluations: int
    reason: str


class LeastSquaresSearch:
    """Running descents from all starts, advanced by the residuals of the points they request."""

    def __init__(self, box: SearchBox, descents: tuple[Descent, ...]) -> None:
        self.box = box
        self.descents = descents  # descents, one per start

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
        points = [descent.ask() for descent in self._running]
        return np.concatenate(points) if points else np.zeros((0, self.box.n))

    @property
    def asking(self) -> IntArray:
        """Start (k,) of each requested point, from 0."""
        counts = [0 if own.done else len(own.ask()) for own in self.descents]
        return np.repeat(np.arange(len(counts)), counts)

    def tell(self, residuals: FloatArray) -> None:
        """Take the residuals (k, m) of the requested points; rows that are not finite failed."""
        answers = checked_residuals(residuals, self.ask())
        running = self._running
        ends = np.cumsum([len(descent.ask()) for descent in running])
        for descent, part in zip(running, np.split(answers, ends[:-1]), strict=True):
            descent.tell(part)

    @property
    def _running(self) -> list[Descent]:
        return [descent for descent in self.descents if not descent.done]


def checked_residuals(residuals: FloatArray, points: FloatArray) -> FloatArray:
    """Return residuals (k, m) of requested points (k, n), or raise `InvalidInput`."""
    rows = np.asarray(residuals, np.float64)
    if rows.ndim != 2 or len(rows) != len(points):
        expected = f"({len(points)}, m), one row per point"
        raise InvalidInput("residuals", found=f"shape {rows.shape}", expected=expected)
    return rows


def fit(search: LeastSquaresSearch, residuals: Residuals) -> LeastSquaresFit:
    """Run a search to its end and return the best fit."""
    while not search.done:
        search.tell(residuals(search.ask()))
    return search.fits[0]


class Descent:
    """Least-squares fit of some parameters from one start, or from the best of several (c, n).

    Parameters that are not free (n,) have the values of the start. Columns (m, n) are derivatives
    at another point near by, per scale of each parameter: one step is tried with them, and
    derivatives are computed only if it gains less than predicted. Differences begin with `steps`.
    """

    def __init__(
        self,
        options: LeastSquares,
        box: SearchBox,
        cost: Cost,
        starts: FloatArray,
        free: BoolArray | None = None,
        columns: FloatArray | None = None,
        steps: FloatArray | None = None,
    ) -> None:
        self.box, self.cost, self.reason = box, cost, ""
        self.evaluations, self.iterations = 0, 0
        self.point, self.deviance = np.array(starts[0]), math.inf
        self._options = options
        self._residual = np.zeros(0)
        self._free = np.ones(box.n, bool) if free is None else np.asarray(free, bool)
        self._starts = np.clip(starts, box.low, box.high)
        self._differences = Differences(
            box, options.difference, options.largest_difference, options.roughness
        )
        if steps is not None:
            self._differences.step = steps.copy()
        self._central = options.differences == "central"
        self._damping, self._failures = FIRST_DAMPING, 0
        self._model = Quadratic(np.zeros((box.n, box.n)), np.zeros(box.n))
        self._trials: FloatArray | None = None
        self._asked: FloatArray | None = None
        self._borrowed = columns
        self._columns = np.zeros((0, box.n))
        if len(self._starts) == 1 and columns is None:  # derivatives in the same batch
            self._differences.begin(self._starts[0], self._free, self._central)

    @property
    def done(self) -> bool:
        """Whether the descent has ended, for `reason`."""
        return bool(self.reason)

    @property
    def fit(self) -> LeastSquaresFit:
        """Best point so far, with the latest derivatives."""
        hessian = self._model.hessian / np.outer(self.box.scale, self.box.scale)
        return LeastSquaresFit(
            self.point,
            self.deviance,
            hessian,
            self._model.gradient / self.box.scale,
            self._residual,
            self._columns,
            self._differences.step,
            self.evaluations,
            self.reason,
        )

    def ask(self) -> FloatArray:
        """Return the points (k, n) to evaluate next; none at the end."""
        if self._asked is None:
            self._asked = np.zeros((0, self.box.n)) if self.done else self._next()
        return self._asked

    def tell(self, residuals: FloatArray) -> FloatArray:
        """Take the residuals (k, m) of the requested points and return their deviances (k,)."""
        points = self.ask()
        answers = checked_residuals(residuals, points)
        deviances = self.cost.deviance(points, answers)
        self._asked = None
        self.evaluations += len(points)
        if len(points):
            self._learn(points, answers, deviances)
        return deviances

    def _next(self) -> FloatArray:
        if self.evaluations == 0:
            waiting = len(self._starts) == 1 and self._differences.pending
            return (
                np.vstack((self._starts, self._differences.probes())) if waiting else self._starts
            )
        return self._differences.probes() if self._trials is None else self._trials

    def _learn(self, points: FloatArray, residuals: FloatArray, deviances: FloatArray) -> None:
        first = not self._residual.size
        self._keep_best(points, residuals, deviances)
        if first:
            self._learn_start(residuals, deviances)
        elif self._trials is None:
            self._learn_probes(residuals)
        else:
            self._learn_trials(deviances)

    def _keep_best(self, points: FloatArray, residuals: FloatArray, deviances: FloatArray) -> None:
        k = int(np.argmin(deviances))
        if deviances[k] < self.deviance:
            self.point, self.deviance = points[k].copy(), float(deviances[k])
            self._residual = residuals[k].copy()

    def _learn_start(self, residuals: FloatArray, deviances: FloatArray) -> None:
        count = len(self._starts)
        if not np.isfinite(deviances[:count]).any():
            self.reason = FAILED
        elif not self._free.any():
            self.reason = NOTHING_FREE
        elif len(residuals) > count:
            self._rebase(self._starts[0], residuals[0], float(deviances[0]))
            self._learn_probes(residuals[count:])
        elif self._borrowed is not None:
            self._rebase(self.point, self._residual, self.deviance)
            self._columns = self._borrowed
            self._model_from(self._borrowed)
        else:
            self._differentiate()

    def _differentiate(self) -> None:
        """Request derivatives at the best point."""
        self._borrowed = None
        self._rebase(self.point, self._residual, self.deviance)
        self._differences.begin(self._base, self._free, self._central)

    def _rebase(self, point: FloatArray, residual: FloatArray, deviance: float) -> None:
        self._base, self._base_residual, self._base_deviance = point, residual, deviance
        self._trials, self._failures = None, 0

    def _learn_probes(self, residuals: FloatArray) -> None:
        self._differences.learn(residuals, self._base_residual)
        if self._differences.pending:
            return
        self._columns = self._differences.columns(len(self._base_residual))
        self._model_from(self._columns)

    def _model_from(self, columns: FloatArray) -> None:
        """Plan the next steps with derivatives (m, n); end if the predicted gain is too small."""
        columns = np.where(self._free, columns, 0.0)
        self._model = self.cost.quadratic(self._base, self._base_residual, columns, self.box.scale)
        if not self._model.hessian.any():
            self.reason = NO_ANSWER
            return
        self._plan_trials()
        if self._most_to_gain() <= self._enough():
            self._confirm(SETTLED)

    def _learn_trials(self, deviances: FloatArray) -> None:
        if self.deviance < self._base_deviance:
            k = int(np.argmin(deviances))
            if deviances[k] <= self.deviance:  # and the lowest point was not a probe
                self._damping = float(self._dampings[k])
            self._accept(self._base_deviance - self.deviance)
            return
        if self._borrowed is not None:
            self._differentiate()
            return
        self._failures += 1
        self._damping = float(self._dampings[-1]) * SPREAD ** (1 - self._powers()[0])
        if self._failures < PATIENCE:
            self._plan_trials()
        else:
            self._damping = FIRST_DAMPING
            self._confirm(STUCK)

    def _accept(self, gain: float) -> None:
        self.iterations += 1
        if self.iterations >= self._options.most_iterations:
            self.reason = EXHAUSTED
        elif gain <= self._enough() or abs(self._most_to_gain() - gain) <= self._enough():
            self._confirm(SETTLED)  # the second: the gain was the largest that the model predicts
        elif self._options.secant and gain > HALF_AS_GOOD * self._most_to_gain():
            self._correct()
        else:
            self._differentiate()

    def _correct(self) -> None:
        """Continue with the present derivatives, corrected by the last step (Broyden's update)."""
        move = (self.point - self._base) / self.box.scale
        missed = self._residual - self._base_residual - self._columns @ move
        self._columns = self._columns + np.outer(missed, move / float(move @ move))
        self._borrowed = self._columns
        self._rebase(self.point, self._residual, self.deviance)
        self._model_from(self._columns)

    def _confirm(self, reason: str) -> None:
        """End, unless better derivatives may still give a descent direction."""
        if self._options.differences == "auto" and not self._central:
            self._central = True
            self._differentiate()
        elif reason == STUCK and self._options.differences == "auto" and self._differences.widen():
            self._differentiate()
        else:
            self.reason = reason

    def _enough(self) -> float:
        """Return the gain below which the descent ends."""
        return max(self._options.tolerance * self.deviance, self._options.enough)

    def _most_to_gain(self) -> float:
        return max(self._model.gain(step) for step in self._steps)

    def _plan_trials(self) -> None:
        """Compute the best steps within the bounds for several dampings."""
        self._dampings = np.maximum(MIN_DAMPING, self._damping * SPREAD ** self._powers())
        low = np.where(self._free, (self.box.low - self._base) / self.box.scale, 0.0)
        high = np.where(self._free, (self.box.high - self._base) / self.box.scale, 0.0)
        unit = float(np.diag(self._model.hessian).max())
        self._steps = [
            bounded_step(self._model, unit * damping, low, high) for damping in self._dampings
        ]
        self._trials = np.array([self._at(step, low, high) for step in self._steps])

    def _powers(self) -> FloatArray:
        trials = 1 if self._borrowed is not None else self._options.trials
        below = (trials - 1) // 2
        return np.arange(-below, trials - below).astype(np.float64)

    def _at(self, step: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the end (n,) of a step, exactly on a bound if it ends there."""
        box = self.box
        point = np.clip(self._base + step * box.scale, box.low, box.high)
        point = np.where(self._free & (step >= high), box.high, point)
        return np.asarray(np.where(self._free & (step <= low), box.low, point))


def bounded_step(model: Quadratic, damping: float, low: FloatArray, high: FloatArray) -> FloatArray:
    """Minimise a damped quadratic in a box about zero, by an active set that only grows.

    The damping is added to the diagonal of the Hessian. Bounds (n,) of the step [scales] include
    zero; both are zero for fixed parameters. The step (n,) is the exact minimum if no bound is
    active. Otherwise it lowers the quadratic for enough damping, which is sufficient for the
    Levenberg-Marquardt method.
    """
    hessian = model.hessian + damping * np.eye(len(low))
    step = np.zeros(len(low))
    outward = ((low > -ON_BOUND) & (model.gradient > 0.0)) | (
        (high < ON_BOUND) & (model.gradient < 0.0)
    )
    inside = (high - low > ON_BOUND) & ~outward
    while inside.any():
        right = -(model.gradient + hessian[:, ~inside] @ step[~inside])[inside]
        step[inside] = np.linalg.solve(hessian[np.ix_(inside, inside)], right)
        out = inside & ((step < low) | (step > high))
        if not out.any():
            break
        step = np.clip(step, low, high)
        inside &= ~out
    return step


# --- derivatives by differences -----------------------------------------------------------------


class Differences:
    """Finite-difference derivatives at one point after another.

    Each unknown has its own step, which is preserved between points. The step grows tenfold while
    no residual changes by more than `CLEAR` times the roughness, and shrinks again if one changes
    by more than `PLAIN` times. A failed probe is repeated on the other side and closer. If all
    probes of an unknown fail, its column is zero.

    The first and smallest step and the largest one are fractions of the scale. The roughness is an
    insignificant change of a residual [standard deviations].
    """

    def __init__(self, box: SearchBox, step: float, largest: float, roughness: float) -> None:
        self.box = box
        self.step = np.full(box.n, step)
        self._first = step
        self._limits = step, max(step, largest)
        self._roughness = roughness
        self._todo: list[int] = []

    @property
    def pending(self) -> bool:
        """Whether more probes are needed."""
        return bool(self._todo)

    def begin(self, point: FloatArray, which: FloatArray, central: bool) -> None:
        """Begin the columns of the unknowns `which` (n,) bool at a point (n,)."""
        self.point = point
        self.central = central
        self._columns: dict[int, FloatArray] = {}
        self._todo = [int(j) for j in np.flatnonzero(which)]
        self._tries = dict.fromkeys(self._todo, 0)
        self._side = dict.fromkeys(self._todo, 1.0)
        self._plan()

    def probes(self) -> FloatArray:
        """Return the points (k, n) to evaluate."""
        return self._probes

    def learn(self, residuals: FloatArray, base: FloatArray) -> None:
        """Take the residuals (k, m) of the probes; `base` (m,) are those of the point itself."""
        owner = np.array([j for j, _ in self._moves])
        moved = np.array([d for _, d in self._moves])
        todo = []
        for j in self._todo:
            rows = np.flatnonzero(owner == j)
            rows = rows[np.isfinite(residuals[rows]).all(axis=1)]
            if self._again(j, residuals[rows] - base, moved[rows]):
                todo.append(j)
        self._todo = todo
        self._plan()

    def columns(self, count: int) -> FloatArray:
        """Return derivatives (count, n) of each residual per scale of each unknown."""
        table = np.zeros((count, self.box.n))
        for j, column in self._columns.items():
            table[:, j] = column
        return table

    def widen(self) -> bool:
        """Increase the smallest step, for slopes across roughness; False if it is the largest."""
        least = max(self._limits[0], float(self.step.min()))
        self._limits = min(least * GROWTH, self._limits[1]), self._limits[1]
        self.step = np.maximum(self.step, self._limits[0])
        return self._limits[0] > least

    def _again(self, j: int, change: FloatArray, moved: FloatArray) -> bool:
        """Store the slope from changes (k, m) after moves (k,); True if j needs more probes."""
        self._tries[j] += 1
        last = self._tries[j] >= TRIES
        if not len(moved):
            self.step[j] = max(self.step[j] / GROWTH, MIN_STEP_SHARE * self._first)
            self._side[j] = -self._side[j]
            return j not in self._columns and not last
        self._columns[j] = _slope(change, moved)
        answer = float(np.abs(change).max(initial=0.0))
        if answer < CLEAR * self._roughness and self.step[j] < self._limits[1]:
            self.step[j] = min(self.step[j] * GROWTH, self._limits[1])
            return not last
        if answer > PLAIN * self._roughness and self.step[j] > self._limits[0]:
            self.step[j] = max(self.step[j] / GROWTH, self._limits[0])
        return False

    def _plan(self) -> None:
        moves = [(j, d) for j in self._todo for d in self._moves_of(j)]
        points = np.repeat(self.point[None], len(moves), axis=0)
        for row, (j, d) in zip(points, moves, strict=True):
            row[j] = np.clip(row[j] + d * self.box.scale[j], self.box.low[j], self.box.high[j])
        # Actual moves, after rounding and the bounds.
        self._moves = [
            (j, float((row[j] - self.point[j]) / self.box.scale[j]))
            for row, (j, _) in zip(points, moves, strict=True)
        ]
        self._probes = points

    def _moves_of(self, j: int) -> tuple[float, ...]:
        """Return the signed moves of unknown j within the bounds [scales]."""
        h, side = self.step[j], self._side[j]
        room = {
            1.0: (self.box.high[j] - self.point[j]) / self.box.scale[j],
            -1.0: (self.point[j] - self.box.low[j]) / self.box.scale[j],
        }
        if self.central and min(room.values()) >= h:
            return h, -h
        if room[side] < h and room[-side] > room[side]:
            side = -side
        reach = side * min(h, room[side])
        return (reach, 0.5 * reach) if self.central else (reach,)


def _slope(change: FloatArray, moved: FloatArray) -> FloatArray:
    """Return slopes (m,) at zero of the line or parabola through zero and changes (k, m)."""
    if len(moved) == 1:
        return np.asarray(change[0] / moved[0])
    a, b = moved
    return np.asarray((change[0] * b * b - change[1] * a * a) / (a * b * (b - a)))
