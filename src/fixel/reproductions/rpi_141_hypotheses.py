"""Hypotheses on errors of simulations of RPI's experiment 141: data, registration, model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, final

import numpy as np

from fixel.model import (
    Body,
    Experiment,
    PathDrive,
    Scene,
    Support,
    SupportPoints,
    UniformPressure,
)
from fixel.simulation.motion import AbstractMotionModel, Dynamic, QuasiStatic
from fixel.typing import FloatArray

# (low, high, nominal) of parameters that can be fitted; nominal values are the laboratory's.
BOUNDS: Final[Mapping[str, tuple[float, float, float]]] = {
    "mu_pusher": (0.0, 1.0, 0.3622),
    "mu_support": (0.02, 1.0, 0.4616),
    "mu_fixel": (0.0, 1.5, 0.4209),
    "tripod_radius": (1e-3, 60e-3, 37.2621e-3),
    "registration_x": (-20e-3, 20e-3, 0.0),
    "registration_y": (-5e-3, 5e-3, 0.0),
    "registration_theta": (-0.1, 0.1, 0.0),
    "friction_centre_x": (-30e-3, 30e-3, 0.0),
    "friction_centre_y": (-30e-3, 30e-3, 0.0),
    "anisotropy_xy": (-0.9, 0.9, 0.0),
    "anisotropy_diagonal": (-0.9, 0.9, 0.0),
    "outline_x": (-20e-3, 20e-3, 0.0),
    "outline_y": (-20e-3, 20e-3, 0.0),
    "outline_theta": (-0.1, 0.1, 0.0),
    "start_x": (-3e-3, 3e-3, 0.0),
    "start_y": (-3e-3, 3e-3, 0.0),
    "start_theta": (-0.05, 0.05, 0.0),
    "support_1_x": (-53e-3, 53e-3, 0.0),
    "support_1_y": (-53e-3, 53e-3, 30e-3),
    "support_2_x": (-53e-3, 53e-3, -30e-3),
    "support_2_y": (-53e-3, 53e-3, -20e-3),
    "support_3_x": (-53e-3, 53e-3, 30e-3),
    "support_3_y": (-53e-3, 53e-3, -20e-3),
}
CORNERS: Final = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")
NET: Final = SupportPoints(
    points=np.array([[0.0, 30e-3], [-30e-3, -20e-3], [30e-3, -20e-3]]), friction=0.4616
)
EVEN: Final = UniformPressure(friction=0.4616)

# Largest forward shift of the centre of pressure by the push of a head 29.8 mm high: friction of
# the plane, 0.46, times that height [m]. It is along the body's x axis, the direction of the push.
TILT: Final = 13.7e-3

Change = Callable[[Experiment], Experiment]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """Hypothesis on an error of the simulation, or a combination of several.

    Parameters
    ----------
    name : str
    fitted : tuple of str
        Names of fitted parameters; the others have the laboratory's values.
    changes : tuple of callables
        Changes that it applies to the experiment.
    motion : AbstractMotionModel
    together : bool
        Whether the hypothesis is a combination of several.
    verdict : str
        Further evidence for or against it.
    """

    name: str
    fitted: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    motion: AbstractMotionModel = field(default_factory=QuasiStatic)
    together: bool = False
    verdict: str = ""


def hypotheses() -> list[Hypothesis]:
    """List all hypotheses, from possible faults of the data to those of the model."""
    friction = ("mu_pusher",)
    place = ("registration_x", "registration_y")
    centre = ("friction_centre_x", "friction_centre_y")
    plane = ("anisotropy_xy", "anisotropy_diagonal")
    stands = _standing(NET)
    even, tilted = _standing(EVEN), _leaning(TILT)
    return [
        Hypothesis(name="as recorded", verdict="the start of this table"),
        Hypothesis(name="inertia", motion=Dynamic(), verdict="slow push: inertia is nothing"),
        Hypothesis(
            name="smoothed actuator path",
            changes=(_smoothed,),
            verdict="runs on after the stall; no difference before it",
        ),
        Hypothesis(
            name="gravity as in the laboratory's code",
            changes=(_light,),
            motion=Dynamic(),
            verdict="a slip of units: the square coasts",
        ),
        Hypothesis(name="speed of the actuator", changes=(_faster,), verdict="10 % faster"),
        Hypothesis(name="friction of the fixels", fitted=("mu_fixel",), verdict="not felt"),
        Hypothesis(
            name="friction of the plane",
            fitted=("mu_support",),
            motion=Dynamic(),
            verdict="not felt but by inertia",
        ),
        Hypothesis(name="tripod radius", fitted=("tripod_radius",)),
        Hypothesis(name="friction of the actuator", fitted=friction),
        Hypothesis(
            name="registration",
            fitted=place,
            verdict="the gap to the corner is a steady 0.3 mm: centimetres are not there",
        ),
        Hypothesis(name="registration, turned", fitted=("registration_theta",)),
        Hypothesis(
            name="start pose",
            fitted=("start_x", "start_y", "start_theta"),
            verdict="noise of the pose is 0.05 mm",
        ),
        Hypothesis(
            name="stickers off the centre", fitted=("outline_x", "outline_y", "outline_theta")
        ),
        Hypothesis(name="even pressure", changes=(even,)),
        Hypothesis(
            name="push above the plane",
            changes=(even, tilted),
            verdict="a force at a height h moves the centre of pressure by mu h, 13.7 mm at most",
        ),
        Hypothesis(name="centre of friction", fitted=centre),
        Hypothesis(name="support points anywhere", fitted=CORNERS, changes=(stands,)),
        Hypothesis(
            name="plane with a grain",
            fitted=plane,
            verdict="would show in every trial of the rig",
        ),
        _both("the laboratory's four parameters", ("mu_pusher", "tripod_radius", "mu_fixel")),
        _both("four parameters, registration", ("mu_pusher", "tripod_radius", *place)),
        _both("even pressure, friction", friction, even),
        _both("push above the plane, friction", friction, even, tilted),
        _both("push above the plane, friction, registration", (*friction, *place), even, tilted),
        _both("centre of friction, friction", (*friction, *centre), even),
        _both("support points, friction", (*friction, *CORNERS), stands),
        _both("plane with a grain, friction", (*friction, *plane), even),
    ]


def _both(name: str, fitted: tuple[str, ...], *changes: Change) -> Hypothesis:
    return Hypothesis(name=name, fitted=fitted, changes=changes, together=True)


def scene_of(experiment: Experiment) -> Scene:
    """Scene of an experiment that is known to have one."""
    assert experiment.scene is not None
    return experiment.scene


def _with_body(change: Callable[[Body], Body]) -> Change:
    def changed(experiment: Experiment) -> Experiment:
        scene = scene_of(experiment)
        return replace(experiment, scene=replace(scene, bodies=(change(scene.bodies[0]),)))

    return changed


def _standing(support: Support) -> Change:
    return _with_body(lambda body: replace(body, support=support))


def _leaning(forward: float) -> Change:
    """Shift the centre of pressure along the body's x axis by a linear tilt of the pressure.
    Without inertia, the centre of mass has no other effect."""
    return _with_body(lambda body: replace(body, centre_of_mass=np.array([forward, 0.0])))


def _light(experiment: Experiment) -> Experiment:
    """Set gravity to 9.810 mm/s^2, as in the laboratory's code."""
    return replace(experiment, scene=replace(scene_of(experiment), gravity=9.81e-3))


def _on_path(experiment: Experiment, waypoints: FloatArray) -> Experiment:
    scene = scene_of(experiment)
    pusher = scene.pushers[0]
    drive = PathDrive(waypoints=waypoints, force_limit=pusher.drive.force_limit)
    pusher = replace(pusher, pose=waypoints[0, 1:], drive=drive)
    return replace(experiment, scene=replace(scene, pushers=(pusher,)))


def _waypoints(experiment: Experiment) -> FloatArray:
    drive = scene_of(experiment).pushers[0].drive
    assert isinstance(drive, PathDrive)
    return np.array(drive.waypoints)


def _smoothed(experiment: Experiment) -> Experiment:
    """Move the actuator along the path of the laboratory's filter."""
    path = _waypoints(experiment)
    path[:, 1:3] = next(c for c in experiment.channels if c.name == "actuator-filtered").values
    return _on_path(experiment, path)


def _faster(experiment: Experiment) -> Experiment:
    """Increase the actuator's travel by 10 % in the same time."""
    path = _waypoints(experiment)
    path[:, 1:3] = path[0, 1:3] + 1.1 * (path[:, 1:3] - path[0, 1:3])
    return _on_path(experiment, path)
