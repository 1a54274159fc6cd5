"""Parameters to search and their bounds, from scenes, from `--fit` or from a file."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.dakota_file import load_dakota
from fixel.io.document import read_document
from fixel.model import Disk, Ellipsoid, Scene, SupportPoints, Tripod, UniformPressure
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.simulation.uneven_table import TABLE_NAMES
from fixel.workflows.calibration.request import NamedOptions

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
_UNITS: Final = {"_mm": 1e-3, "_deg": math.pi / 180.0, "_mrad": 1e-3}


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
    return [usual(name, scene) for name in names]


def usual(name: str, scene: Scene) -> Unknown:
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


def fitted(settings: Sequence[str], scenes: Sequence[Scene]) -> list[Unknown]:
    """Parse `--fit NAME`, `--fit NAME=LOW:HIGH` or `--fit NAME=LOW:HIGH:START`, in SI units or
    with the unit in the name: `tripod_radius_mm=10:60`."""
    return [_fit(setting, scenes) for setting in settings]


def _fit(setting: str, scenes: Sequence[Scene]) -> Unknown:
    written, _, limits = setting.partition("=")
    name, factor = in_si(written.strip())
    # An experiment that informs the parameter, if any: only some may have fixels.
    scene = next((s for s in scenes if name != "mu_fixel" or s.fixels), scenes[0])
    unknown = usual(name, scene)
    if not limits:
        return unknown
    try:
        numbers = [factor * float(text) for text in limits.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise InvalidInput(
            f"--fit {written}", found=repr(limits), expected="LOW:HIGH or LOW:HIGH:START"
        )
    low, high = numbers[0], numbers[1]
    nominal = numbers[2] if len(numbers) == 3 else unknown.nominal
    return replace(unknown, low=low, high=high, nominal=nominal, scale=None)


def held(settings: Sequence[str]) -> list[Unknown]:
    """Parse `--set NAME=VALUE` into parameters that are fixed at a value."""
    found = []
    for setting in settings:
        written, _, text = setting.partition("=")
        name, factor = in_si(written.strip())
        try:
            value = factor * float(text)
        except ValueError:
            raise InvalidInput("--set", found=repr(setting), expected="NAME=NUMBER") from None
        found.append(_frozen(name, value))
    return found


def _frozen(name: str, value: float) -> Unknown:
    margin = max(abs(value), 1.0)
    low = max(value - margin, info_of(name).lowest)
    return Unknown(name=name, low=low, high=value + margin, nominal=value, frozen=True)


def read_space(path: Path) -> ParameterSpace:
    """Load a space file: YAML or JSON, a mapping from names to low, high and start.

    Names may end in `_mm`, `_deg` or `_mrad`; otherwise values are SI.
    """
    content = read_document(path)
    entries = content.get("parameters", content) if isinstance(content, Mapping) else None
    if not isinstance(entries, Mapping) or not entries:
        raise InvalidInput(str(path), found="no parameters", expected="NAME: {low, high, start}")
    return ParameterSpace(
        unknowns=tuple(_entry(str(name), entry, path) for name, entry in entries.items())
    )


_KEYS: Final = {"low", "high", "start", "scale", "frozen", "prior", "where"}


def _entry(written: str, entry: Any, path: Path) -> Unknown:
    name, factor = in_si(written)
    where = f"{path}: {written}"
    if not isinstance(entry, Mapping) or not set(entry) <= _KEYS:
        raise InvalidInput(
            where,
            found=", ".join(map(str, entry)) if isinstance(entry, Mapping) else repr(entry),
            expected="low, high, start, and if wanted scale, prior, frozen, where",
        )
    missing = [key for key in ("low", "high", "start") if key not in entry]
    if missing:
        raise InvalidInput(where, found="no " + ", no ".join(missing), expected="low, high, start")

    def number(key: str) -> float | None:
        value = entry.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InvalidInput(f"{where}.{key}", found=repr(value), expected="a number")
        return factor * value

    return Unknown(
        name=name,
        low=number("low") or 0.0,
        high=number("high") or 0.0,
        nominal=number("start") or 0.0,
        scale=number("scale"),
        prior=number("prior"),
        frozen=bool(entry.get("frozen", False)),
        where=dict(entry.get("where") or {}),
    )


def in_si(written: str) -> tuple[str, float]:
    """Return the name of a parameter and the factor from the unit in its written name to SI."""
    for ending, factor in _UNITS.items():
        name = written.removesuffix(ending)
        if name != written and (name in KNOWN_PARAMETERS or re.fullmatch(r"load_\d+", name)):
            return name, factor
    return written, 1.0


def from_dakota(path: Path) -> tuple[NamedOptions, list[Unknown]]:
    """Return the pattern search and the parameters that the file defines."""
    found = load_dakota(path)
    options = {
        field.name: getattr(found.optimiser, field.name)
        for field in dataclasses.fields(found.optimiser)
    }
    return NamedOptions(name=found.optimiser.name, options=options), list(found.space.unknowns)
