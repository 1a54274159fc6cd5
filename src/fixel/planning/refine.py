"""Improvement of one plan by CMA-ES, in batches that the caller evaluates."""

from __future__ import annotations

import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import Final, final

import numpy as np

from fixel.planning.candidates import Numbers
from fixel.planning.rollout import PlanSimulator
from fixel.typing import FloatArray, IntArray

WIDTH: Final = 0.05  # standard deviation of the first plans, in shares of the ranges


def can_refine() -> bool:
    """Return whether the package cma is installed."""
    return find_spec("cma") is not None


@final
class PlanRefinement:
    """Search by CMA-ES about one plan.

    Parameters
    ----------
    simulator : PlanSimulator
    plan : (k, d) float64
    seed : int

    Attributes
    ----------
    best : (k, d) float64
        Best plan so far.
    score : float
        Its score.

    Source
    ------
    Hansen & Ostermeier (2001); the package pycma.
    """

    def __init__(self, simulator: PlanSimulator, plan: FloatArray, seed: int) -> None:
        low, high = simulator.choice.bounds(simulator.scene)
        self._low = low
        self._wide = np.flatnonzero(high > low)
        k = len(plan)
        self._span = np.tile((high - low)[self._wide], k)
        begin = (plan[:, self._wide] - low[self._wide]).reshape(-1) / self._span
        names = simulator.choice.names(simulator.scene)
        self._around = np.tile([names[j] == "contact" for j in self._wide], k)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._search = import_module("cma").CMAEvolutionStrategy(
                begin, WIDTH, {"seed": 1 + seed, "verbose": -9}
            )
        self.best, self.score = plan, -np.inf

    @property
    def is_done(self) -> bool:
        """Whether CMA-ES itself stops."""
        return bool(self._search.stop())

    def ask(self) -> Numbers:
        """Return the plans to evaluate next."""
        self._points = np.array(self._search.ask())
        inside = np.where(self._around, self._points % 1.0, np.clip(self._points, 0.0, 1.0))
        self._plans = [_placed(self.best, self._wide, self._low, self._span * x) for x in inside]
        return self._plans

    def tell(self, scores: FloatArray) -> None:
        """Take the scores (m,) of these plans, larger for better ones."""
        off = np.abs(self._points - np.clip(self._points, 0.0, 1.0))
        outside = np.where(self._around, 0.0, off).sum(axis=1)
        self._search.tell(list(self._points), list(outside - scores))
        if scores.max() > self.score:
            self.best, self.score = self._plans[int(scores.argmax())], float(scores.max())


def _placed(plan: FloatArray, wide: IntArray, low: FloatArray, moved: FloatArray) -> FloatArray:
    found = plan.copy()
    found[:, wide] = low[wide] + moved.reshape(len(plan), -1)
    return found
