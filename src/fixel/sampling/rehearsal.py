"""A plan simulated beforehand: which fixels the object comes to touch."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.model import PlannedExperiment, Scene, placed
from fixel.sampling.checks import PlanProblem
from fixel.sampling.plan import Plan
from fixel.simulation import QuasiStatic, simulate_batch
from fixel.typing import FloatArray

SAMPLES: Final = 61  # of the motion; at 13.5 mm/s one every 2.5 mm

# [m] Distance that counts as touching, as in the thesis's own synthetic tactile sensors.
TOUCH: Final = 0.95e-3


class Rehearsal(NamedTuple):
    """What a simulation says of a plan.

    Attributes
    ----------
    touched : dict from name to (n_fixel,) bool
        By experiment: which fixels the object came to within 0.95 mm of.
    problems : tuple of PlanProblem
        Experiments that touch none, or did not simulate to the end.
    """

    touched: dict[str, list[bool]]
    problems: tuple[PlanProblem, ...]


def rehearse(plan: Plan) -> Rehearsal:
    """Simulate every experiment once, quasi-statically, with nominal friction."""
    # Repetitions differ in nothing a simulation knows.
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
    """Which fixels come close to the object in one of its poses (n, 3) [m, m, rad]."""
    outline = scene.bodies[0].shape.outline
    path = shapely.polygons([placed(outline, pose) for pose in poses])
    pegs = [shapely.Polygon(placed(f.shape.outline, f.pose)) for f in scene.fixels]
    return [bool((shapely.distance(path, peg) < TOUCH).any()) for peg in pegs]
