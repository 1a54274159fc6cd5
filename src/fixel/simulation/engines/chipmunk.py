"""Chipmunk, by its Python package pymunk: impulses by projected Gauss-Seidel, two dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pymunk

from fixel.model.parameters import CHIPMUNK, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, model_of
from fixel.simulation.engines.scripts import run_pymunk
from fixel.simulation.engines.task import PlainTask, planar_refusal
from fixel.typing import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Chipmunk(AbstractPhysicsEngine):
    """Engine pymunk.

    Every support point is a pivot to the ground that yields at its largest friction force.

    Parameters
    ----------
    step : float
        Time step [s].
    iterations : int
        Iterations of the solver in each step.
    slop : float
        Overlap that is allowed [m].
    inertia_factor : float
        Factor of the moment of inertia: a remedy for contacts that the engine solves one after
        another, and no property of the body.
    """

    name: ClassVar[str] = "pymunk"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = CHIPMUNK
    at_bench_size: ClassVar[bool] = True

    step: float = 1e-3
    iterations: int = 10
    slop: float = 1e-7
    inertia_factor: float = 1.0

    @property
    def version(self) -> str:
        return str(pymunk.version)

    def refusal(self, task: PlainTask) -> str:
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        return np.array(run_pymunk.simulate(model_of(self, task)))
