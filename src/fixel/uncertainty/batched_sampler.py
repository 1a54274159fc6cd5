"""Pool for dynesty whose proposals advance together, so that likelihoods are computed in one
compiled batch.

dynesty passes a pool a queue of proposals, each with its own random numbers, and expects one
likelihood at a time. Here all proposals take one step, their likelihoods are computed in one call,
and those that are finished leave the queue. A proposal depends only on its own random numbers, so
results are the same bit for bit in every run and for any number of threads of the
simulation.

The steps are those of `dynesty.internal_samplers`: uniform in the cube, uniform in the bound, and
random walks in an ellipsoid of the bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np

from fixel.typing import FloatArray

Batched = Callable[[FloatArray], FloatArray]

# Smallest batch: if fewer proposals are left, each tries several points.
WORTH: Final = 16


class BatchedSampler:
    """Pool with the interface that dynesty expects.

    The likelihood is a function of points (k, n) -> (k,), and the transform one of quantiles (k, n)
    in [0, 1] -> points (k, n). `count` is called with the number of points after each batch.
    """

    def __init__(
        self, log_likelihood: Batched, transform: Batched, count: Callable[[int], None]
    ) -> None:
        self._log_likelihood = log_likelihood
        self._transform = transform
        self._count = count

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> list[Any]:
        """Return the results of a function of dynesty, in the order of the arguments."""
        from dynesty import internal_samplers as own
        from dynesty.utils import LogLikelihood

        waiting = list(arguments)
        if isinstance(function, LogLikelihood):
            return _wrapped(self._evaluated(np.array(waiting, np.float64)))
        if function is own.UnitCubeSampler.sample:
            return self._uniform(waiting, lambda one, rng: rng.uniform(size=one.kwargs["ndim"]))
        if function is own.UniformBoundSampler.sample:
            return self._uniform(waiting, _in_bound)
        if function is own.RWalkSampler.sample:
            return self._walked(waiting)
        return [function(one) for one in waiting]

    def _evaluated(self, points: FloatArray) -> FloatArray:
        values = self._log_likelihood(np.ascontiguousarray(points))
        self._count(len(points))
        return values

    def _uniform(
        self, waiting: list[Any], drawn: Callable[[Any, np.random.Generator], FloatArray]
    ) -> list[Any]:
        """Draw points for each proposal until one is likelier than the limit."""
        rng = [_rng(one) for one in waiting]
        tries = [0] * len(waiting)
        found: list[Any] = [None] * len(waiting)
        left = list(range(len(waiting)))
        while left:
            each = -(-WORTH // len(left)) if len(left) < WORTH else 1
            slots = [k for k in left for _ in range(each)]
            unit = np.array([drawn(waiting[k], rng[k]) for k in slots])
            points = self._transform(unit)
            values = self._evaluated(points)
            for row, k in enumerate(slots):
                tries[k] += 1
                if found[k] is None and values[row] > float(waiting[k].loglstar):
                    found[k] = (unit[row], points[row], float(values[row]))
            left = [k for k in left if found[k] is None]
        return [
            _answer(one[0], one[1], one[2], tries[k], None, {"n_proposals": tries[k]})
            for k, one in enumerate(found)
        ]

    def _walked(self, waiting: list[Any]) -> list[Any]:
        """Let each proposal walk a number of steps in the region likelier than the limit."""
        walkers = [_Walker(one) for one in waiting]
        for _ in range(waiting[0].kwargs["walks"]):
            moved = [(walker, step) for walker in walkers if (step := walker.step()) is not None]
            if not moved:
                continue
            unit = np.array([step for _, step in moved])
            points = self._transform(unit)
            values = self._evaluated(points)
            for row, (walker, _) in enumerate(moved):
                walker.hear(unit[row], points[row], float(values[row]))
        self._stayed([walker for walker in walkers if not walker.accepted])
        return [walker.answer() for walker in walkers]

    def _stayed(self, walkers: list[_Walker]) -> None:
        """Set the walkers that never moved to their start points."""
        if walkers:
            unit = np.array([walker.unit for walker in walkers])
            points = self._transform(unit)
            for walker, point, value in zip(walkers, points, self._evaluated(points), strict=True):
                walker.point, walker.value = point, float(value)


class _Walker:
    """Random walk of one proposal."""

    def __init__(self, argument: Any) -> None:
        self._argument = argument
        self._rng = _rng(argument)
        self.unit = np.array(argument.u, np.float64)
        self.point = self.unit
        self.value = float(argument.loglstar)
        self.accepted = self.refused = 0

    def step(self) -> FloatArray | None:
        """Return the next point to evaluate; None outside of the cube, which counts as rejected."""
        from dynesty.internal_samplers import propose_ball_point

        own = self._argument
        unit, outside = propose_ball_point(
            self.unit,
            own.scale,
            own.axes,
            len(self.unit),
            own.axes.shape[0],
            rstate=self._rng,
            nonbounded=own.kwargs.get("nonbounded"),
        )
        if outside:
            self.refused += 1
            return None
        return np.asarray(unit)

    def hear(self, unit: FloatArray, point: FloatArray, value: float) -> None:
        if value > float(self._argument.loglstar):
            self.unit, self.point, self.value = unit, point, value
            self.accepted += 1
        else:
            self.refused += 1

    def answer(self) -> Any:
        own = self._argument
        counts = {"accept": self.accepted, "reject": self.refused, "scale": own.scale}
        stats = {"n_accept": self.accepted, "n_reject": self.refused}
        return _answer(self.unit, self.point, self.value, own.kwargs["walks"], counts, stats)


def _rng(argument: Any) -> np.random.Generator:
    from dynesty.utils import get_random_generator

    rng: np.random.Generator = get_random_generator(argument.rseed)
    return rng


def _in_bound(argument: Any, rng: np.random.Generator) -> FloatArray:
    bound = argument.kwargs["bound"]
    while True:
        unit = np.asarray(bound.samples(1, rstate=rng)).flatten()
        if ((unit > 0.0) & (unit < 1.0)).all():
            return unit


def _wrapped(values: FloatArray) -> list[Any]:
    """Return likelihoods in the type that dynesty expects."""
    from dynesty.utils import LoglOutput

    return [LoglOutput(float(value), False) for value in values]


def _answer(
    unit: FloatArray,
    point: FloatArray,
    value: float,
    calls: int,
    tuning: dict[str, Any] | None,
    stats: dict[str, int],
) -> Any:
    from dynesty.internal_samplers import SamplerReturn

    return SamplerReturn(
        u=unit,
        v=point,
        logl=_wrapped(np.array([value]))[0],
        ncalls=calls,
        evaluation_history=[],
        tuning_info=tuning,
        proposal_stats=stats,
    )
