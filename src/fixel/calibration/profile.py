"""Profile likelihoods: how far each unknown may move while the others make the best of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import (
    FAILED,
    Cost,
    Descent,
    LeastSquares,
    LeastSquaresFit,
    NormalPrior,
    checked_residuals,
)
from fixel.calibration.optimiser import Best, Count, CountOrZero, SearchBox
from fixel.calibration.profile_branch import Node, ProfileBranch, Slice, Slicer
from fixel.errors import InvalidInput
from fixel.model.fields import check_fields, positive
from fixel.model.records import ProfileRecord
from fixel.typing import FloatArray

# All gains of deviance below are shares of the threshold.
# A descent at a fixed value ends when it gains less: an end of an interval is off by 1 % of the
# distance then.
PRECISION: Final = 0.02
# Length of a node from which the next has starts elsewhere: no flat profile needs them.
WORTH: Final = 0.15
# A gain less than this share of the roughness means nothing.
MEANINGLESS: Final = 0.25
# The profiles begin again from a point that is better than the best by more; what was found stays.
RESTART_GAIN: Final = 0.05
MAX_RESTARTS: Final = 4
# Share of the range above which an interval is so wide that its partners are looked for.
WIDE: Final = 0.5
# Points that a phase takes for each side of an unknown, for the estimate of what is left.
USUAL: Final = {"profiles": 5.0, "bounds": 2.0, "slices": 2.5, "partners": 1.0}
# Distance from the best [radii of the predicted interval] of the points that measure roughness, and
# how many an unknown: a smooth deviance rises by a hundredth of the threshold there.
DENT: Final = 0.1
DENT_POINTS: Final = 3
# Quantile of their rise that is taken: bumps differ, and an interval should end at none.
DENT_QUANTILE: Final = 0.75
# Share of the roughness that is no better optimum, only a deeper dent.
DEEPER: Final = 0.5
# Steps of a descent at a value past the crossing, where only a second minimum is looked for.
SCAN_ITERATIONS: Final = 3
# Damped steps tried at once at a fixed value: a neighbour's answer is near, few are needed.
TRIALS: Final = 2
# Share of the largest eigenvalue added to the Hessian before its inverse predicts anything.
RIDGE: Final = 1e-12

Task = Generator[FloatArray, FloatArray, None]
"""Yields points (k, n), is sent their residuals (k, m)."""


class Profile(NamedTuple):
    """One unknown. Lengths over `values`: k values, ascending, the best among them."""

    unknown: int  # its number
    values: FloatArray  # (k,)
    deviances: FloatArray  # (k,) least over the others; inf where none could be evaluated
    points: FloatArray  # (k, n) where it is least
    low: float | None  # ends of the interval about the best; None: not inside the bounds
    high: float | None
    slice: Slice  # the others held at the best
    moved: FloatArray  # (n,) how far the others went, to the ends [scales]
    rise: FloatArray  # (n,) of the deviance when each is put back to the best there [thresholds]


class Profiles(NamedTuple):
    """All unknowns."""

    best: Best  # the lowest deviance seen
    threshold: float  # significant rise of the deviance
    roughness: float  # rise that means nothing; intervals end at the sum of both
    hessian: FloatArray  # (n, n) half the second derivatives of the deviance at the best
    profiles: tuple[Profile, ...]  # one an unknown; empty if the best could not be evaluated
    evaluations: int

    @property
    def limit(self) -> float:
        """Rise of the deviance at the ends of the intervals."""
        return self.threshold + self.roughness

    def records(self, labels: Sequence[str]) -> tuple[ProfileRecord, ...]:
        """Return the profiles as results contain them, above the smallest deviance."""
        least = self.best.error
        return tuple(
            ProfileRecord(
                label=labels[one.unknown],
                values=one.values,
                deviances=one.deviances - least,
                slice_values=one.slice.values,
                slice_deviances=one.slice.deviances - least,
                low=one.low,
                high=one.high,
                threshold=self.limit,
            )
            for one in self.profiles
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileLikelihood:
    """Fix an unknown, fit the others, step outwards until the deviance has risen by the threshold.

    Simulations with adaptive steps make a rough surface, and a best that was searched for lies in
    one of its dents. How much higher the deviance is close by is measured first and added to the
    threshold: with ten thousand residuals it can be ten times as much, and intervals that ignore it
    end at the nearest bump.

    Each fixed value begins with the derivatives of the value before, corrected by what was met on
    the way; its own are taken only where these mislead. An interval contains every point
    below the threshold that profiles met. Where the deviance is a parabola, one value a side
    confirms what the curvature predicts, and an unknown costs some 20 evaluations; on rough or bent
    surfaces several times as much. A better optimum than the one given becomes the new base: the
    values known already stay.

    Source
    ------
    Venzon & Moolgavkar (1988) for intervals from the profile; Raue et al. (2009) for open ones as
    the sign of what cannot be identified.
    """

    # Fits the others. Its loss and roughness count; when it ends is set here.
    descent: LeastSquares = field(default_factory=LeastSquares)
    most_iterations: Count = 20  # steps of one fit
    # Values between the crossing and the bound that are fitted too, on each side: they show on a
    # plot, and may find a second minimum.
    scan: CountOrZero = 1
    batch: Count = 512  # points of one ask, about

    def __post_init__(self) -> None:
        check_fields(self, "ProfileLikelihood")

    def start(
        self,
        box: SearchBox,
        point: FloatArray,
        threshold: float,
        prior: NormalPrior | None = None,
        fitted: LeastSquaresFit | None = None,
    ) -> ProfileSearch:
        """Begin at the calibration's best point (n,).

        Ends of intervals are at a rise of the deviance by the threshold (`Dispersion.threshold`). A
        fit of all parameters that ends at the point, without a prior, saves fitting again.
        """
        given = np.asarray(point, np.float64)
        if given.shape != (box.n,):
            raise InvalidInput("point", found=f"shape {given.shape}", expected=f"({box.n},)")
        threshold = positive(threshold, "threshold")
        return ProfileSearch(self, box, given, threshold, self.descent.cost(prior), fitted)


class ProfileSearch:
    """Running profiles, advanced by residuals; the same residuals give the same points."""

    def __init__(
        self,
        options: ProfileLikelihood,
        box: SearchBox,
        point: FloatArray,
        threshold: float,
        cost: Cost,
        fitted: LeastSquaresFit | None = None,
    ) -> None:
        self.box, self.reason, self.evaluations = box, "", 0
        self._fitted = fitted if fitted is not None and fitted.columns.size else None
        self._steps: FloatArray | None = None  # of differences
        self._options, self._nominal, self._cost = options, threshold, cost
        self._roughness = 0.0
        self._best = Best(np.clip(point, box.low, box.high), math.inf)
        self._met: dict[bytes, float] = {}  # deviance of each point evaluated
        self._hessian = np.zeros((box.n, box.n))
        self._sides: list[ProfileBranch] = []
        self._slicers: list[Slicer] = []
        self._restarts = 0
        self._begin()

    @property
    def _threshold(self) -> float:
        return self._nominal + self._roughness

    @property
    def _fitting(self) -> LeastSquares:
        """Options of the descents at fixed values."""
        return replace(
            self._options.descent,
            differences="one-sided",
            secant=True,
            enough=PRECISION * self._nominal + MEANINGLESS * self._roughness,
            tolerance=0.0,
            trials=min(TRIALS, self._options.descent.trials),
            most_iterations=self._options.most_iterations,
        )

    @property
    def done(self) -> bool:
        """Whether the search has ended, for `reason`."""
        return bool(self.reason)

    def ask(self) -> FloatArray:
        """(k, n) points to evaluate next; none once done. Asking again gives the same."""
        return np.zeros((0, self.box.n)) if self.done else self._tasks.ask()

    def tell(self, residuals: FloatArray) -> None:
        """Residuals (k, m) of the points asked for; a row that is not finite has failed."""
        points = self.ask()
        answers = checked_residuals(residuals, points)
        if self.done:
            return
        self.evaluations += len(points)
        self._note(points, self._cost.deviance(points, answers))
        self._tasks.tell(answers)
        if self._must_restart():
            self._restarts += 1
            self._begin()
        while self._tasks.done and not self.done:
            self._next_phase()

    @property
    def left(self) -> int | None:
        """Estimated number of points after the requested ones; None while unknown."""
        if self.done:
            return 0
        if not self._sides:
            return None
        now = self._expected(self.phase) - (self.evaluations - self._phase_begun) - len(self.ask())
        return max(0, now) + sum(self._expected(name) for name, _ in self._phases)

    def _expected(self, phase: str) -> int:
        return int(USUAL.get(phase, 0.0) * 2 * self.box.n)

    @property
    def profiles(self) -> Profiles:
        """Profiles as far as they are known; complete at the end."""
        return Profiles(
            best=self._best,
            threshold=self._nominal,
            roughness=self._roughness,
            hessian=self._hessian,
            profiles=tuple(map(self._profile, range(self.box.n))) if self._slicers else (),
            evaluations=self.evaluations,
        )

    def _note(self, points: FloatArray, deviances: FloatArray) -> None:
        self._met.update(zip(map(bytes, points), deviances.tolist(), strict=True))
        k = int(np.argmin(deviances))
        if deviances[k] < self._best.error:
            self._best = Best(points[k].copy(), float(deviances[k]))

    def _must_restart(self) -> bool:
        """Whether the profiles stand on a point that turned out not to be the best."""
        if not self._sides or self._restarts >= MAX_RESTARTS:
            return False
        worth = RESTART_GAIN * self._nominal + DEEPER * self._roughness
        return self._best.error < self._sides[0].nodes[0].deviance - worth

    # Phases, in order; each makes tasks that run side by side.

    def _begin(self) -> None:
        # Of each parameter, both sides together: a node may change sides.
        self._known: list[list[Node]] = [[] for _ in range(self.box.n)]
        for side in self._sides:
            self._known[side.index] += [*side.nodes[1:], *side.beyond]
        self._sides, self._slicers = [], []
        self._moved, self._rise = np.zeros((2, self.box.n, self.box.n))
        self._phases: list[tuple[str, Callable[[], list[Task]]]] = [
            ("profiles", lambda: list(map(self._trace, self._sides))),
            ("bounds", lambda: list(map(self._scan, self._sides))),
            ("slices", self._make_slices),
            ("ends", lambda: list(map(self._extend, self._sides))),
            ("partners", lambda: list(map(self._hold, self._sides))),
        ]
        self.phase, self._phase_begun = "best fit", self.evaluations
        self._tasks = Tasks([self._fit_all()], self._options.batch)

    def _next_phase(self) -> None:
        if not self._sides:
            self.reason = FAILED
        elif not self._phases:
            self.reason = "all profiles are complete"
        else:
            self.phase, make = self._phases.pop(0)
            self._phase_begun = self.evaluations
            self._tasks = Tasks(make(), self._options.batch)

    def _fit_all(self) -> Task:
        """Fit all parameters from the best point, for the Hessian; then set up the sides."""
        if self._fitted is None or self._restarts:
            options = replace(
                self._fitting, differences="auto", enough=0.025 * self._fitting.enough
            )
            descent = Descent(options, self.box, self._cost, self._best.point[None])
            yield from _run(descent)
            fitted = descent.fit
        else:
            fitted = self._fitted
            self._note(fitted.point[None], np.array([fitted.deviance]))
        self._hessian, self._steps = fitted.hessian, fitted.steps
        if math.isfinite(fitted.deviance):
            covariance = self._covariance()
            if not self._restarts:
                yield from self._look_around(covariance, fitted.gradient)
            self._set_sides(covariance, fitted)

    def _covariance(self) -> FloatArray:
        """Return the inverse (n, n) of the Hessian, very large where there is no information."""
        scale = np.outer(self.box.scale, self.box.scale)
        hessian = self._hessian * scale
        ridge = RIDGE * max(float(np.diag(hessian).max()), np.finfo(float).tiny / RIDGE)
        return np.asarray(np.linalg.inv(hessian + ridge * np.eye(self.box.n)) * scale)

    def _look_around(self, covariance: FloatArray, gradient: FloatArray) -> Task:
        """Measure the roughness: how much higher the deviance is than a smooth one, close by."""
        n, best = self.box.n, self._best
        directions = np.random.default_rng(n).normal(size=(DENT_POINTS * n, n))
        # Each unknown moves by its share of the interval it would have alone, no more: along a
        # valley the curvature may promise any distance.
        alone = 1.0 / np.sqrt(np.maximum(np.diag(np.linalg.inv(covariance)), np.finfo(float).tiny))
        radius = DENT * np.minimum(math.sqrt(self._nominal) * alone, self.box.scale)
        moves = directions / np.linalg.norm(directions, axis=1, keepdims=True) * radius
        points = np.clip(best.point + moves, self.box.low, self.box.high)
        deviances = self._cost.deviance(points, (yield points))
        apart = points - best.point
        held = (best.point <= self.box.low) | (best.point >= self.box.high)
        smooth = np.einsum("ki,ij,kj->k", apart, self._hessian, apart)
        smooth += 2.0 * apart @ np.where(held, gradient, 0.0)
        rise = (deviances - self._best.error - smooth)[np.isfinite(deviances)]
        self._roughness = max(0.0, float(np.quantile(rise, DENT_QUANTILE))) if len(rise) else 0.0

    def _set_sides(self, covariance: FloatArray, fitted: LeastSquaresFit) -> None:
        """Both sides of each unknown, with what the curvature predicts and what is known."""
        for j in range(self.box.n):
            variance = max(float(covariance[j, j]), np.finfo(float).tiny)
            reach = math.sqrt(self._threshold) * math.sqrt(variance)
            node = Node(float(self._best.point[j]), self._best.error, self._best.point)
            for sign in (-1, 1):
                slope = covariance[:, j] / variance
                side = ProfileBranch(self.box, j, sign, node, reach, slope)
                side.begin(fitted.point, fitted.residual, fitted.columns)
                for known in self._known[j]:
                    if sign * (known.value - node.value) > 0.0:
                        side.add(known)
                self._sides.append(side)

    def _trace(self, side: ProfileBranch) -> Task:
        """Step outwards, then close in on the crossing."""
        while (value := side.next_value(self._threshold)) is not None:
            starts = side.guesses(value)
            if side.lengths(self._threshold)[-1] > WORTH:
                # Descents from the values before it end in dents, or leave valleys that bend.
                nodes = (*self._beyond(side, value)[:1], side.nodes[0])
                starts += [node.point for node in nodes]
            side.add((yield from self._fixed(side, value, starts, self._fitting)))

    def _extend(self, side: ProfileBranch) -> Task:
        """Go on outwards from the farthest good point that any profile met past the crossing."""
        while (above := side.first_above(self._threshold)) is not None:
            farthest = self._beyond(side, side.nodes[above].value)[-1:]
            if not farthest:
                return
            side.add(farthest[0])
            side.beyond = []  # from descents that began elsewhere
            yield from self._trace(side)
            yield from self._scan(side)

    def _beyond(self, side: ProfileBranch, value: float) -> list[Node]:
        """Return the known points past a value that are below the threshold, the nearest first."""
        limit, j = side.nodes[0].deviance + self._threshold, side.index
        good = [(np.frombuffer(key), known) for key, known in self._met.items() if known < limit]
        nodes = [Node(float(point[j]), known, point) for point, known in good]
        past = [node for node in nodes if side.sign * (node.value - value) > 0.0]
        return sorted(past, key=lambda node: side.sign * node.value)

    def _scan(self, side: ProfileBranch) -> Task:
        """Look at the rest of the way to the bound."""
        if side.crossing(self._threshold) is None or side.nodes[-1].value == side.bound:
            return
        outer, options = side.nodes[-1], replace(self._fitting, most_iterations=SCAN_ITERATIONS)
        for value in np.linspace(outer.value, side.bound, self._options.scan + 1)[1:].tolist():
            near = side.beyond[-1] if side.beyond else outer
            starts = [near.point, side.nodes[0].point]
            node = yield from self._fixed(side, value, starts, options)
            if math.isfinite(node.deviance):
                side.beyond.append(node)

    def _make_slices(self) -> list[Task]:
        base = self._sides[0].nodes[0]
        best = Best(base.point, base.deviance)
        with np.errstate(divide="ignore"):
            reach = np.sqrt(self._threshold / np.maximum(np.diag(self._hessian), 0.0)).tolist()
        self._slicers = [
            Slicer(self.box, j, best, self._threshold, reach[j]) for j in range(self.box.n)
        ]
        return list(map(self._slice, self._slicers))

    def _deviances(self, points: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        """Deviances (k,) of points (k, n); those evaluated before are not asked for again."""
        new = [point for point in points if bytes(point) not in self._met]
        if new:
            yield np.array(new)
        return np.array([self._met[bytes(point)] for point in points])

    def _slice(self, slicer: Slicer) -> Task:
        while not slicer.done:
            slicer.tell((yield from self._deviances(slicer.ask())))

    def _hold(self, side: ProfileBranch) -> Task:
        """At the end of the interval put each other parameter back, to see which one it needs."""
        if self._width(side.index) <= WIDE * (self.box.high - self.box.low)[side.index]:
            return
        j, base, edge = side.index, side.nodes[0], side.edge(self._threshold)
        others = np.array([k for k in range(self.box.n) if k != j and edge is not base], int)
        points = np.repeat(edge.point[None], len(others), axis=0)
        points[np.arange(len(others)), others] = base.point[others]
        deviances = yield from self._deviances(points)
        # One that fails says no less than one that fits badly; the largest number stands for it.
        rise = np.minimum((deviances - edge.deviance) / self._threshold, np.finfo(float).max)
        self._rise[j, others] = np.maximum(self._rise[j, others], rise)
        moved = np.abs(edge.point - base.point)[others] / self.box.scale[others]
        self._moved[j, others] = np.maximum(self._moved[j, others], moved)

    def _width(self, j: int) -> float:
        """Return the width of the interval, up to the bound on an open side."""
        ends = [
            side.bound if (end := side.crossing(self._threshold)) is None else end
            for side in self._sides[2 * j : 2 * j + 2]
        ]
        return ends[1] - ends[0]

    def _fixed(
        self, side: ProfileBranch, value: float, starts: Sequence[FloatArray], options: LeastSquares
    ) -> Generator[FloatArray, FloatArray, Node]:
        """Fit the others with one unknown fixed, from the best of some starts (n,)."""
        points = np.array(starts)
        points[:, side.index] = value
        free, near = np.arange(self.box.n) != side.index, (side.columns, self._steps)
        descent = Descent(options, self.box, self._cost, points, free, *near)
        yield from _run(descent)
        self._steps = descent.fit.steps
        if math.isfinite(descent.deviance):
            side.learn(descent.fit, free)
        return Node(value, descent.deviance, descent.point)

    def _profile(self, j: int) -> Profile:
        down, up = self._sides[2 * j], self._sides[2 * j + 1]
        nodes = sorted(
            (*down.beyond, *down.nodes[1:], *up.nodes, *up.beyond), key=lambda node: node.value
        )
        return Profile(
            unknown=j,
            values=np.array([node.value for node in nodes]),
            deviances=np.array([node.deviance for node in nodes]),
            points=np.array([node.point for node in nodes]),
            low=down.crossing(self._threshold),
            high=up.crossing(self._threshold),
            slice=self._slicers[j].slice,
            moved=self._moved[j],
            rise=self._rise[j],
        )


def _run(descent: Descent) -> Task:
    while not descent.done:
        descent.tell((yield descent.ask()))


class Tasks:
    """Several tasks whose points are combined into batches of at most `most` points.

    A task that alone requests more has a batch of its own.
    """

    def __init__(self, tasks: Iterable[Task], most: int) -> None:
        self._most = most
        self._running: list[tuple[Task, FloatArray]] = []
        for task in tasks:
            self._advance(task, None)

    @property
    def done(self) -> bool:
        """Whether all tasks have ended."""
        return not self._running

    def ask(self) -> FloatArray:
        """Return the points (k, n) of the next tasks."""
        return np.concatenate([points for _, points in self._turn()])

    def tell(self, residuals: FloatArray) -> None:
        """Take the residuals (k, m) of the requested points."""
        turn = self._turn()
        waiting = self._running[len(turn) :]
        self._running = []
        begin = 0
        for task, points in turn:
            self._advance(task, residuals[begin : begin + len(points)])
            begin += len(points)
        # Tasks that waited go first; otherwise the first tasks would run alone until they end.
        self._running = waiting + self._running

    def _turn(self) -> list[tuple[Task, FloatArray]]:
        total = np.cumsum([len(points) for _, points in self._running])
        count = max(1, int(np.searchsorted(total, self._most, side="right")))
        return self._running[:count]

    def _advance(self, task: Task, residuals: FloatArray | None) -> None:
        """Run a task until it requests points; empty requests are answered at once."""
        try:
            points = next(task) if residuals is None else task.send(residuals)
            while not len(points):
                points = task.send(np.zeros((0, 0)))
        except StopIteration:
            return
        self._running.append((task, points))
