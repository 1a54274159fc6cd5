"""Box2D 2.3: impulses by projected Gauss-Seidel, two dimensions, single precision."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fixel.model.parameters import BOX2D, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, model_of
from fixel.simulation.engines.task import PlainTask, planar_refusal
from fixel.typing import FloatArray

with warnings.catch_warnings():
    # Its wrapper warns while it is loaded, and crashes where warnings are errors.
    warnings.simplefilter("ignore")
    from Box2D import __version__

    from fixel.simulation.engines.scripts import run_box2d

MAX_CORNERS = 16  # of one polygon


@dataclass(frozen=True, slots=True, kw_only=True)
class Box2D(AbstractPhysicsEngine):
    """Engine Box2D.

    Every support point is a friction joint to the ground that yields at its largest friction force.

    Parameters
    ----------
    step : float
        Time step [s].
    iterations : int
        Iterations of the solver in each step, for velocities and for positions.
    unit : float
        Number of length units in a metre: the engine's fixed slop of 0.005 units should be small
        against the body.
    inertia_factor : float
        Factor of the moment of inertia: a remedy for contacts that the engine solves one after
        another, and no property of the body.
    """

    name: ClassVar[str] = "box2d"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = BOX2D
    at_bench_size: ClassVar[bool] = True

    step: float = 2e-3
    iterations: int = 10
    unit: float = 100.0
    inertia_factor: float = 1.0

    @property
    def version(self) -> str:
        return str(__version__)

    def refusal(self, task: PlainTask) -> str:
        obstacles = [] if task.pusher is None else [task.pusher.outline]
        outlines = [task.body.outline, *obstacles, *(fixel.outline for fixel in task.fixels)]
        most = max(len(piece) for outline in outlines for piece in outline.pieces)
        if most > MAX_CORNERS:
            return f"a convex piece with {most} corners; it takes at most {MAX_CORNERS}"
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        return np.array(run_box2d.simulate(model_of(self, task)))
