"""Parameters that a calibration searches by default, with their usual bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Disk, Ellipsoid, Scene, SupportPoints, Tripod, UniformPressure
from fixel.model.parameters import info_of
from fixel.model.space import Unknown
from fixel.simulation.uneven_table import TABLE_NAMES

MAX_FRICTION: Final = 1.0
MIN_RADIUS: Final = 1e-3  # [m] of a tripod: with zero all loads would act at one point
MIN_FRICTION: Final = 0.01  # of the plane: without friction nothing stops the body

# Half width of the bounds of parameters that are offsets from an assumed value.
_AROUND_ZERO: Final = {
    "friction_centre_x": 5e-3,
    "friction_centre_y": 5e-3,
    "pressure_spread": 2.0,
    "anisotropy_xy": 0.3,
    "anisotropy_diagonal": 0.3,
    "registration_x": 5e-3,
    "registration_y": 5e-3,
    "registration_theta": 0.02,
    "start_x": 1e-3,
    "start_y": 1e-3,
    "start_theta": 0.02,
    "outline_x": 2e-3,
    "outline_y": 2e-3,
    "outline_theta": 0.05,
    "contact_offset": 1e-3,
}
# The same for parameters that redistribute the loads. Real boards reached 1.8.
_TABLE: Final = dict(zip(TABLE_NAMES, (1.5, 2.0, 2.0, 1.0, 1.0), strict=True))


def default_unknowns(scenes: Sequence[Scene]) -> list[Unknown]:
    """Return the parameters of the thesis, or of the ASME paper for bodies on three points."""
    scene = scenes[0]
    names = ["mu_pusher"] if scene.pushers else []
    if any(s.fixels for s in scenes):
        names.append("mu_fixel")
    support = scene.bodies[0].support
    if isinstance(support, Ellipsoid):
        names += ["ellipsoid_torque"]
    else:
        names += ["mu_support"]
    if isinstance(support, Tripod):
        names.append("tripod_radius")
    if isinstance(support, SupportPoints) and len(support.points) == 3:
        names += [f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy"]
    return [usual_unknown(name, scene) for name in names]


def usual_unknown(name: str, scene: Scene) -> Unknown:
    """Return a parameter with its usual bounds, starting at the value of the scene."""
    info_of(name)
    if name in _AROUND_ZERO:
        width = _AROUND_ZERO[name]
        return Unknown(name=name, low=-width, high=width, nominal=0.0)
    body = scene.bodies[0]
    support = body.support
    if name in ("mu_pusher", "mu_fixel"):
        things = scene.pushers if name == "mu_pusher" else scene.fixels
        if not things:
            raise InvalidInput(
                name,
                found=f"no {name.removeprefix('mu_')} in any of the experiments",
                expected="an experiment that could inform it",
                hint="leave it out",
            )
        mu = scene.friction(body.name, things[0].name)
        return Unknown(name=name, low=0.0, high=MAX_FRICTION, nominal=min(mu, MAX_FRICTION))
    if name == "mu_support":
        mu = float(np.mean(getattr(support, "friction", 0.3)))
        mu = min(max(mu, MIN_FRICTION), MAX_FRICTION)
        return Unknown(name=name, low=MIN_FRICTION, high=MAX_FRICTION, nominal=mu)
    reach = _reach(scene)
    if name == "tripod_radius" and isinstance(support, Tripod):
        return Unknown(name=name, low=MIN_RADIUS, high=reach, nominal=support.radius)
    if name.startswith("support_") and isinstance(support, SupportPoints):
        return _corner(name, scene, support)
    if name.startswith("ellipsoid_") and isinstance(support, Ellipsoid):
        value = support.force if name.endswith("force") else support.torque
        return Unknown(name=name, low=value / 10.0, high=value * 4.0, nominal=value)
    if name in _TABLE and isinstance(support, SupportPoints | UniformPressure):
        width = _TABLE[name]
        return Unknown(name=name, low=-width, high=width, nominal=0.0)
    if name == "mass":
        return Unknown(name=name, low=body.mass / 4.0, high=4.0 * body.mass, nominal=body.mass)
    if name.startswith("load_"):
        return Unknown(name=name, low=0.0, high=10.0, nominal=1.0)
    raise InvalidInput(
        f"--fit {name}",
        found=f"a body on {type(support).__name__}",
        expected="a support that this parameter could change",
        hint=f"{name} is the {info_of(name).meaning}",
    )


def _corner(name: str, scene: Scene, support: SupportPoints) -> Unknown:
    k, axis = int(name[8]) - 1, "xy".index(name[10])
    outline = scene.bodies[0].shape.outline
    low, high = float(outline[:, axis].min()), float(outline[:, axis].max())
    nominal = float(support.points[k, axis]) if k < len(support.points) else 0.0
    return Unknown(name=name, low=low, high=high, nominal=min(max(nominal, low), high))


def _reach(scene: Scene) -> float:
    """Distance from the centre of mass to the farthest point of the body [m]."""
    body = scene.bodies[0]
    shape = body.shape
    if isinstance(shape, Disk):
        return float(shape.radius + np.hypot(*body.com))
    return float(np.hypot(*(shape.outline - body.com).T).max())
