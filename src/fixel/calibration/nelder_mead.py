"""Nelder-Mead search, with a simplex that moves downhill and shrinks."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import ClassVar, Final, final

import numpy as np

from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Count,
    CountOrZero,
    Feasible,
    GeneratorSearch,
    Moves,
    Search,
    SearchBox,
    Size,
    feasible_points,
    inside,
)
from fixel.model.fields import check_fields
from fixel.typing import FloatArray

# Distances of the trials beyond the centre of the other vertices, over that of the worst vertex.
REFLECTION, EXPANSION, OUTSIDE, INSIDE = range(4)
_PLACE: Final = np.array([1.0, 2.0, 0.5, -0.5])
_SHRINK: Final = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NelderMead(AbstractOptimiser):
    """Nelder-Mead on n + 1 vertices, the search of the 2006 paper.

    Good with few unknowns (up to about eight) and rough errors. It finds at most one minimum and
    may stop at a point that is none, so run it from several starts (`MultiStart`).

    Parameters
    ----------
    size : float
        Mean distance of the vertices from their centre at which the search ends, in scales of the
        box. The size at the end is reported as the uncertainty of the minimum.
    step : float
        Distance from the start to the other vertices of the first simplex, in scales.
    random_simplex : bool
        Use random feasible points as the other first vertices instead, as in the paper.
    speculative : bool
        Request the reflected point, the expanded one and both contractions at once. The decisions
        are the same, in the time of one evaluation instead of two, with more evaluations.
    restarts : int
        Maximum number of new simplices of the first size about the best point, as long as each
        finds a better one: a simplex can collapse at a crease that is no minimum.
    max_evaluations : int
        Number of evaluations after which no new step begins.

    Notes
    -----
    A point outside the bounds counts as failed and is not requested.

    Source
    ------
    Nelder & Mead (1965); the rules are those of Lagarias et al. (1998), with coefficients 1, 2,
    1/2, 1/2; size, random vertices and failed points as in the ASME paper (2006); restarts after
    Kelley (1999), from the plain simplex.
    """

    name: ClassVar[str] = "nelder-mead"
    size: Size = 1e-4
    step: Size = 1.0
    random_simplex: bool = False
    speculative: bool = True
    restarts: CountOrZero = 0
    max_evaluations: Count = 20_000

    def __post_init__(self) -> None:
        check_fields(self, "NelderMead")

    def start(
        self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None
    ) -> NelderMeadSearch:
        if self.random_simplex:
            others = feasible_points(box, box.n, seed, feasible)
            if len(others) == box.n:
                return NelderMeadSearch(box, self, np.concatenate((box.start[None], others)))
        return NelderMeadSearch(box, self, stepped_simplex(box, self.step))


@final
class NelderMeadSearch(GeneratorSearch):
    """Running Nelder-Mead search."""

    def __init__(self, box: SearchBox, options: NelderMead, vertices: FloatArray) -> None:
        super().__init__(box, self._descents)
        self.options = options
        self.vertices = vertices  # vertices of the simplex, the best first
        # Mean distance of the vertices from their centre, in scales.
        self.size = simplex_size(box, vertices)

    def _descents(self, _search: Search) -> Moves:
        reason = yield from self._descent()
        for _ in range(self.options.restarts):
            point, error = self.best
            self.vertices = stepped_simplex(self.box._replace(start=point), self.options.step)
            reason = yield from self._descent()
            if not self.best.error < error:
                break
        return reason

    def _descent(self) -> Moves:
        errors = yield from self._errors(self.vertices)
        while True:
            order = np.argsort(errors, kind="stable")
            self.vertices, errors = self.vertices[order], errors[order]
            self.size = simplex_size(self.box, self.vertices)
            if self.size < self.options.size:
                return f"the simplex shrank to {self.options.size:g} of the scale"
            if self.evaluations >= self.options.max_evaluations:
                return f"{self.options.max_evaluations} evaluations were made"
            errors = yield from self._step(errors)

    def _step(self, errors: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        """Replace the worst vertex, or shrink; return the new errors, unsorted."""
        centre = self.vertices[:-1].mean(axis=0)
        trials = centre + _PLACE[:, None] * (centre - self.vertices[-1])
        found = np.full(len(trials), math.inf)
        first = slice(None) if self.options.speculative else slice(1)
        found[first] = yield from self._errors(trials[first])
        other = _after_reflection(found[REFLECTION], errors)
        if other != REFLECTION and not self.options.speculative:
            found[other] = (yield from self._errors(trials[other][None]))[0]
        chosen = _choice(found, other, errors[-1])
        if chosen is None:
            return (yield from self._shrink(errors))
        self.vertices = np.concatenate((self.vertices[:-1], trials[chosen][None]))
        return np.append(errors[:-1], found[chosen])

    def _shrink(self, errors: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        best = self.vertices[0]
        shrunk = best + _SHRINK * (self.vertices[1:] - best)
        self.vertices = np.concatenate((best[None], shrunk))
        return np.append(errors[:1], (yield from self._errors(shrunk)))

    def _errors(self, points: FloatArray) -> Generator[FloatArray, FloatArray, FloatArray]:
        """Return errors (k,) of points (k, n); inf for points out of bounds, without a request."""
        errors = np.full(len(points), math.inf)
        within = inside(self.box, points)
        if within.any():
            errors[within] = yield points[within]
        return errors


def stepped_simplex(box: SearchBox, step: float) -> FloatArray:
    """Return vertices (n + 1, n): the start, and one step from it along every unknown, downwards if
    the upper bound is too close and the lower one is farther."""
    vertices = np.tile(box.start, (box.n + 1, 1))
    for i in range(box.n):
        above, below = box.high[i] - box.start[i], box.start[i] - box.low[i]
        length = min(step * box.scale[i], max(above, below))
        vertices[i + 1, i] += length if length <= above else -length
    return np.clip(vertices, box.low, box.high)


def simplex_size(box: SearchBox, vertices: FloatArray) -> float:
    """Return the mean distance of vertices (k, n) from their centre, in scales."""
    places = vertices / box.scale
    return float(np.linalg.norm(places - places.mean(axis=0), axis=1).mean())


def _after_reflection(reflected: float, errors: FloatArray) -> int:
    """Return the trial to compare with the reflected point, or this one if it is accepted."""
    if reflected < errors[0]:
        return EXPANSION
    if reflected < errors[-2]:
        return REFLECTION
    return OUTSIDE if reflected < errors[-1] else INSIDE


def _choice(found: FloatArray, other: int, worst: float) -> int | None:
    """Return the trial that replaces the worst vertex; None to shrink."""
    if other in (REFLECTION, EXPANSION):
        return other if found[other] < found[REFLECTION] else REFLECTION
    if other == OUTSIDE:
        return OUTSIDE if found[OUTSIDE] <= found[REFLECTION] else None
    return INSIDE if found[INSIDE] < worst else None
