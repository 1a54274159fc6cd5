"""Simulation of a plan in advance, to find the fixels that the object touches."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.model import PlannedExperiment, Scene, placed
from fixel.sampling.checks import PlanProblem
from fixel.sampling.plan import Plan
from fixel.simulation import QuasiStatic, simulate_batch
from fixel.typing import FloatArray

SAMPLES: Final = 61  # instants of the motion; one every 2.5 mm of the thesis's travel

# [m] Distance that counts as touching, as in the thesis's own synthetic tactile sensors.
TOUCH: Final = 0.95e-3


class Rehearsal(NamedTuple):
    """Results of a simulated plan.

    Attributes
    ----------
    touched : dict from name to (n_fixel,) bool
        Fixels to which the object came closer than 0.95 mm, by experiment.
    problems : tuple of PlanProblem
        Experiments that touch no fixel, or whose simulation did not finish.
    """

    touched: dict[str, list[bool]]
    problems: tuple[PlanProblem, ...]


def rehearse(plan: Plan) -> Rehearsal:
    """Simulate every experiment once, quasi-statically, with nominal friction."""
    # Repetitions have the same scene, so they are simulated once.
    distinct: dict[Scene, PlannedExperiment] = {}
    for experiment in plan.experiments:
        distinct.setdefault(experiment.scene, experiment)
    times = np.linspace(0.0, plan.rig.duration, SAMPLES)
    results = simulate_batch(list(distinct), motion=QuasiStatic(), times=times)
    assert isinstance(results, list)
    touched: dict[str, list[bool]] = {}
    problems = []
    for (scene, experiment), result in zip(distinct.items(), results, strict=True):
        contacts = _touched(scene, result.pose[0, :, 0])
        touched[experiment.name] = contacts
        if not result.converged[0]:
            sentence = f"the simulation stopped after {result.stopped_at[0]:.3g} s"
            problems.append(PlanProblem(experiment.name, sentence))
        elif scene.fixels and not any(contacts):
            problems.append(PlanProblem(experiment.name, "simulated, the object touches no fixel"))
    return Rehearsal(touched, tuple(problems))


def _touched(scene: Scene, poses: FloatArray) -> list[bool]:
    """Return the fixels that the object touches in one of its poses (n, 3) [m, m, rad]."""
    outline = scene.bodies[0].shape.outline
    path = shapely.polygons([placed(outline, pose) for pose in poses])
    pegs = [shapely.Polygon(placed(f.shape.outline, f.pose)) for f in scene.fixels]
    return [bool((shapely.distance(path, peg) < TOUCH).any()) for peg in pegs]
