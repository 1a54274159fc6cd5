"""One grasp: 11 s of pushing a square into a seat between head and pegs."""

from __future__ import annotations

from benchmarks.accuracy import ANGLE_BAR, FINE, POSITION_BAR, apart, characteristic_length
from benchmarks.figures import Figure, Size, at_most, seconds
from fixel.model import Scene
from fixel.simulation import Adaptive, Simulation, StewartTrinkle, simulate
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import grasp

FIXED = StewartTrinkle(step=0.01)


def run(size: Size) -> list[Figure]:
    """Time of one call of `simulate`, packing and unpacking included, at the end pose only."""
    scene = grasp("seated")
    return [
        Figure("grasp, 1100 fixed steps", "ms", _milliseconds(scene, FIXED, size), at_most(1.3)),
        Figure("grasp, default stepper", "ms", _milliseconds(scene, None, size), at_most(0.35)),
        *_errors(scene),
    ]


def _once(scene: Scene, stepper: AbstractStepper | None) -> Simulation:
    return simulate(scene, stepper=stepper, output_interval=scene.duration)


def _milliseconds(scene: Scene, stepper: AbstractStepper | None, size: Size) -> tuple[float, ...]:
    return tuple(1e3 * s for s in seconds(lambda: _once(scene, stepper), size.calls))


def _errors(scene: Scene) -> list[Figure]:
    """The default stepper's final pose against a converged one."""
    fine = _once(scene, Adaptive(tolerance=FINE * characteristic_length(scene)))
    distance, angle = apart(_once(scene, None).pose["object"][-1], fine.pose["object"][-1])
    return [
        Figure("grasp, default stepper, error", "mm", (float(distance),), at_most(POSITION_BAR)),
        Figure("grasp, default stepper, error", "deg", (float(angle),), at_most(ANGLE_BAR)),
    ]
