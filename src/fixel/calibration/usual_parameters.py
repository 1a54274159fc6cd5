"""Parameters that a calibration searches: the usual ones with their bounds, and stated ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from fixel import model
from fixel.calibration.target import Target
from fixel.errors import InvalidInput, number_of, unknown_name
from fixel.model.fields import finite, instance, texts
from fixel.model.parameters import KNOWN_PARAMETERS, in_si, info_of
from fixel.model.space import Parameter, ParameterSpace, Unknown, check_once, split_label
from fixel.simulation.load_profile import TABLE_NAMES
from fixel.table import Table

MAX_FRICTION: Final = 1.0
# [m] of a tripod, and relative to a small part: with zero all loads would act at one point.
MIN_RADIUS, MIN_SHARE = 1e-3, 0.1
MIN_FRICTION: Final = 0.01  # of the plane: without friction nothing stops the body

# Half width of the bounds of parameters that are offsets from an assumed value.
_AROUND_ZERO: Final = {
    "friction_centre_x": 5e-3,
    "friction_centre_y": 5e-3,
    "pressure_spread": 2.0,
    "pressure_rim": 4.0,
    "pressure_corner": 3.0,
    "pressure_xy": 3.0,
    "pressure_diagonal": 3.0,
    "pressure_tilt_x": 1.0,
    "pressure_tilt_y": 1.0,
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


def default_unknowns(scenes: Sequence[model.Scene]) -> list[Unknown]:
    """Return the parameters of the thesis, or of the ASME paper for bodies on three points."""
    scene = scenes[0]
    names = ["mu_pusher"] if scene.pushers else []
    if any(s.fixels for s in scenes):
        names.append("mu_fixel")
    support = scene.bodies[0].support
    if isinstance(support, model.Ellipsoid):
        names += ["ellipsoid_torque"]
    else:
        names += ["mu_support"]
    if isinstance(support, model.Tripod):
        names.append("tripod_radius")
    if isinstance(support, model.SupportPoints) and len(support.points) == 3:
        names += [f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy"]
    return [usual_unknown(name, scene) for name in names]


def usual_unknown(name: str, scene: model.Scene) -> Unknown:
    """Return a parameter with its usual bounds, starting at the value of the scene."""
    info_of(name)
    if name in _AROUND_ZERO:
        width = _AROUND_ZERO[name]
        return Unknown(name=name, low=-width, high=width, nominal=0.0)
    body = scene.bodies[0]
    support = body.support
    if contact := info_of(name).contact:
        things = touched_by(contact, scene)
        if not things:
            raise InvalidInput(
                name,
                found=f"no {contact} in any of the experiments",
                expected="an experiment that depends on it",
                hint="leave the parameter out",
            )
        mu = scene.friction(body.name, things[0].name)
        return Unknown(name=name, low=0.0, high=MAX_FRICTION, nominal=min(mu, MAX_FRICTION))
    if name == "mu_support":
        mu = float(np.mean(getattr(support, "friction", 0.3)))
        mu = min(max(mu, MIN_FRICTION), MAX_FRICTION)
        return Unknown(name=name, low=MIN_FRICTION, high=MAX_FRICTION, nominal=mu)
    reach = _reach(scene)
    if name == "tripod_radius" and isinstance(support, model.Tripod):
        low = min(MIN_RADIUS, MIN_SHARE * reach)
        return Unknown(name=name, low=low, high=reach, nominal=support.radius)
    if name.startswith("support_") and isinstance(support, model.SupportPoints):
        return _corner(name, scene, support)
    if name.startswith("ellipsoid_") and isinstance(support, model.Ellipsoid):
        value = support.force if name.endswith("force") else support.torque
        return Unknown(name=name, low=value / 10.0, high=value * 4.0, nominal=value)
    if name in _TABLE and isinstance(support, model.SupportPoints | model.UniformPressure):
        width = _TABLE[name]
        return Unknown(name=name, low=-width, high=width, nominal=0.0)
    if name == "mass":
        return Unknown(name=name, low=body.mass / 4.0, high=4.0 * body.mass, nominal=body.mass)
    if name.startswith("load_"):
        return Unknown(name=name, low=0.0, high=10.0, nominal=1.0)
    raise InvalidInput(
        name,
        found=f"a body on {type(support).__name__}",
        expected="a support that has this parameter",
        hint=f"{name} is the {info_of(name).meaning}",
    )


def known_parameters() -> Table:
    """Return the parameters that a calibration can search, with units, meanings and usual bounds.

    Bounds that depend on the scene are missing in the table: friction of the plane, for example,
    starts at the scene's own value, and a tripod is never larger than its body.

    Returns
    -------
    Table
        Columns `parameter`, `unit`, `meaning`, `low` and `high`, in SI units.

    Examples
    --------
    >>> known_parameters().records()[3]["parameter"]
    'mu_pusher'
    """
    rows = []
    for name, info in KNOWN_PARAMETERS.items():
        width = _AROUND_ZERO.get(name, _TABLE.get(name))
        bounds = (None, None) if width is None else (-width, width)
        if name.startswith("mu_"):
            bounds = (MIN_FRICTION if name == "mu_support" else 0.0, MAX_FRICTION)
        rows.append((name, info.unit, info.meaning, *bounds))
    return Table(("parameter", "unit", "meaning", "low", "high"), rows, left=3)


def touched_by(contact: str, scene: model.Scene) -> Sequence[model.Pusher | model.Fixel]:
    """Return the bodies of a scene of one kind: `"pusher"` or `"fixel"`."""
    return scene.pushers if contact == "pusher" else scene.fixels


# --- spaces of one's own ------------------------------------------------------------------------

Bounds = tuple[float, float] | float | Parameter | None
Space = Mapping[str, Bounds] | Sequence[str] | ParameterSpace | None


def search_space(
    parameters: Space, targets: Sequence[Target], start: Mapping[str, float] | None = None
) -> ParameterSpace:
    """Return the space in which a calibration searches.

    `{"mu_pusher": (0, 1)}` is free within bounds, `{"mu_pusher": 0.3}` is fixed, and
    `["mu_pusher"]` has its usual bounds. None selects the usual parameters. Keys may be labels such
    as `"mu_pusher[surface=abs]"`. Scenes and conditions of the targets decide about usual bounds
    and starts. Every parameter must be known, and informed by an experiment.
    """
    if isinstance(parameters, ParameterSpace):
        space = parameters
    elif parameters is None:
        scenes = [target.case.scene for target in targets]
        space = ParameterSpace(unknowns=tuple(default_unknowns(scenes)))
    else:
        is_mapping = isinstance(parameters, Mapping) or hasattr(parameters, "columns")
        named: Any = parameters if is_mapping else dict.fromkeys(texts(parameters, "parameters"))
        space = ParameterSpace(
            unknowns=tuple(u for key, own in named.items() for u in _unknowns(key, own, targets))
        )
    return space if start is None else _started(space, start)


def _started(space: ParameterSpace, start: Mapping[str, float]) -> ParameterSpace:
    instance(start, Mapping, "start", "values by name of parameter")
    for name in set(start) - {name for u in space.unknowns for name in (u.label, u.name)}:
        raise unknown_name("start", name, space.labels)
    begun = {u.label: start.get(u.label, start.get(u.name, u.nominal)) for u in space.free}
    own = (replace(u, nominal=begun.get(u.label, u.nominal)) for u in space.unknowns)
    return ParameterSpace(unknowns=tuple(own))


def _unknowns(key: str, entry: Bounds, targets: Sequence[Target]) -> list[Unknown]:
    """Return the unknowns of an entry of a space; several where conditions have their own."""
    name, where = _named(key, targets)
    if isinstance(entry, int | float | np.number):
        return [Unknown.fixed(name, finite(entry, key), where)]
    if isinstance(entry, tuple | list):
        if len(entry) != 2:
            raise InvalidInput(key, found=f"{len(entry)} numbers", expected="two bounds")
        entry = _at(key, lambda pair: Parameter(*pair), entry)
    if not isinstance(entry, Parameter | None):
        raise InvalidInput(
            key, found=entry, expected="(low, high), a number to fix it, or a fixel.Parameter"
        )
    by = () if entry is None else entry.by
    groups = dict.fromkeys(
        tuple((name, target.conditions[name]) for name in by)
        for target in targets
        if all(name in target.conditions for name in by) and _covers(where, target)
    )
    if not groups:
        conditions = sorted({name for target in targets for name in target.conditions})
        found = f"no experiment with {', '.join(by) or key}"
        expected = f"an experiment that depends on it, with {', '.join(conditions)}"
        raise InvalidInput(key, found=found, expected=expected)
    return [_unknown(name, entry, where | dict(group), targets) for group in groups]


def _unknown(
    name: str, entry: Parameter | None, where: Mapping[str, str | float], targets: Sequence[Target]
) -> Unknown:
    scenes = [t.case.scene for t in targets if _covers(where, t)]
    bounds = None if entry is None else (entry.low, entry.high)
    usual = replace(usual_in(name, scenes, bounds), where=where)
    if entry is None:
        return usual
    start = usual.nominal if entry.start is None else entry.start
    return replace(
        usual,
        low=entry.low,
        high=entry.high,
        nominal=min(max(start, entry.low), entry.high) if entry.start is None else start,
        scale=entry.scale,
        prior=None if entry.prior is None else entry.prior[1],
    )


def usual_in(
    name: str, scenes: Sequence[model.Scene], bounds: tuple[float, float] | None = None
) -> Unknown:
    """Return a parameter with its usual bounds in the first of the scenes that can inform it.

    Those of other engines do not depend on a scene, and may have the given bounds only.
    """
    if "." in name:
        usual = info_of(name).usual
        if usual is None and bounds is not None:
            usual = bounds[0], 0.5 * (bounds[0] + bounds[1]), bounds[1]
        if usual is None:
            raise InvalidInput(name, found="no bounds", expected="bounds such as (0.1, 2.0)")
        return Unknown(name=name, low=usual[0], high=usual[2], nominal=usual[1])
    contact = info_of(name).contact
    able = (scene for scene in scenes if not contact or touched_by(contact, scene))
    return usual_unknown(name, next(able, scenes[0]))


def _covers(where: Mapping[str, str | float], target: Target) -> bool:
    return all(target.conditions.get(name) == value for name, value in where.items())


def _named(key: str, targets: Sequence[Target]) -> tuple[str, dict[str, str | float]]:
    """Return the parameter and the conditions of a key."""
    name, written = split_label(key)
    if (bare := in_si(name)[0]) != name:
        unit = name.rpartition("_")[2]
        raise InvalidInput(
            key,
            found="a unit in the name",
            expected=f"{bare!r} in SI units",
            hint=f'write {{"{bare}": (10 * {unit}, 60 * {unit})}} with fixel.units',
        )
    info_of(name)
    where: dict[str, str | float] = {}
    for condition, text in written.items():
        values = (target.conditions.get(condition) for target in targets)
        where[condition] = next((x for x in values if x is not None and str(x) == text), text)
    return name, where


def _at(key: str, make: Callable[[Any], Parameter], entry: object) -> Parameter:
    """Make a parameter; a refusal names the key."""
    try:
        return make(entry)
    except InvalidInput as problem:
        raise problem.at(problem.where.replace("parameter", key, 1)) from None


def _corner(name: str, scene: model.Scene, support: model.SupportPoints) -> Unknown:
    k, axis = int(name[8]) - 1, "xy".index(name[10])
    outline = scene.bodies[0].shape.outline
    low, high = float(outline[:, axis].min()), float(outline[:, axis].max())
    nominal = float(support.points[k, axis]) if k < len(support.points) else 0.0
    return Unknown(name=name, low=low, high=high, nominal=min(max(nominal, low), high))


def _reach(scene: model.Scene) -> float:
    """Distance from the centre of mass to the farthest point of the body [m]."""
    body = scene.bodies[0]
    shape = body.shape
    if isinstance(shape, model.Disk):
        return float(shape.radius + np.hypot(*body.com))
    return float(np.hypot(*(shape.outline - body.com).T).max())


# --- parameters as options state them ------------------------------------------------------------

# Other unit, name of the SI unit, and bound beyond which values are in another unit.
_TOO_FAR: Final = {"m": ("_mm", "metres", 1.0), "rad": ("_deg", "radians", math.pi)}


def searched_unknowns(settings: Sequence[str], scenes: Sequence[model.Scene]) -> list[Unknown]:
    """Parse `--fit NAME`, `--fit NAME=LOW:HIGH` or `--fit NAME=LOW:HIGH:START`, in SI units or
    with the unit in the name: `tripod_radius_mm=10:60`."""
    found = [_fit(setting, scenes) for setting in settings]
    check_once("fit", [unknown.name for unknown in found])
    return found


def check_fit(settings: Sequence[str]) -> None:
    """Raise `InvalidInput` for parameters or bounds of `--fit` that no scene can have."""
    for setting in settings:
        _bounds(setting)


def _bounds(setting: str) -> tuple[str, str, list[float]]:
    """Return where `--fit` is stated, its parameter, and its bounds and start, if any."""
    where, name, factor, limits = _stated("fit", setting)
    numbers = [factor * number_of(text, where) for text in limits.split(":") if limits]
    if len(numbers) not in (0, 2, 3):
        raise InvalidInput(where, found=repr(limits), expected="LOW:HIGH or LOW:HIGH:START")
    try:
        if numbers:
            Unknown(name=name, low=numbers[0], high=numbers[1], nominal=(*numbers, numbers[0])[2])
    except InvalidInput as problem:
        raise problem.at(where + problem.where.removeprefix(name)) from None
    return where, name, numbers


def _fit(setting: str, scenes: Sequence[model.Scene]) -> Unknown:
    where, name, numbers = _bounds(setting)
    try:
        unknown = usual_in(name, scenes, (numbers[0], numbers[1]) if numbers else None)
    except InvalidInput as problem:
        raise problem.at(where) from None
    if not numbers:
        return unknown
    low, high, *start = numbers
    if unknown.unit in _TOO_FAR:
        ending, word, limit = _TOO_FAR[unknown.unit]
        if max(abs(low), abs(high)) > max(limit, 2.0 * abs(unknown.low), 2.0 * abs(unknown.high)):
            raise InvalidInput(
                where,
                found=f"{low:g} to {high:g} {unknown.unit}",
                expected=f"bounds in {word}, such as {unknown.low:g} to {unknown.high:g}",
                hint=f"write {unknown.name}{ending}=LOW:HIGH for other units",
            )
    nominal = start[0] if start else unknown.nominal
    return replace(unknown, low=low, high=high, nominal=nominal, scale=None)


def fixed_unknowns(settings: Sequence[str]) -> list[Unknown]:
    """Parse `--set NAME=VALUE` into parameters that are fixed at a value."""
    found = []
    for setting in settings:
        where, name, factor, text = _stated("fixed", setting)
        value = number_of(text, where, f"a number, as in {where.partition(' ')[2]}=0.3")
        try:
            found.append(Unknown.fixed(name, factor * value))
        except InvalidInput as problem:
            raise problem.at(where) from None
    check_once("fixed", [unknown.name for unknown in found])
    return found


def _stated(option: str, setting: str) -> tuple[str, str, float, str]:
    """Return where `NAME=...` is stated, the parameter, its factor to SI, and what follows."""
    written, _, text = setting.partition("=")
    name, factor = in_si(written.strip())
    try:
        info_of(name)
    except InvalidInput as problem:
        raise problem.at(option + problem.where.removeprefix("parameters")) from None
    return f"{option} {written}", name, factor, text
