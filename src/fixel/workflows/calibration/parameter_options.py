"""Parameters from `--fit` and `--set` or from a file; options and calls that repeat a request."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any, Final

from fixel.calibration.noise import Noise
from fixel.calibration.usual_parameters import usual_in
from fixel.errors import InvalidInput
from fixel.io.document import read_document
from fixel.model import Scene
from fixel.model.parameters import in_si, info_of
from fixel.model.space import SHARE_OF_RANGE, ParameterSpace, Unknown, check_once
from fixel.registry import offered
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions

# Other unit, name of the SI unit, and bound beyond which values are in another unit.
_TOO_FAR: Final = {"m": ("_mm", "metres", 1.0), "rad": ("_deg", "radians", math.pi)}
# Functions that begin a run of another mode than joint or stored.
FUNCTIONS: Final = {"each": "calibrate_each", "campaign": "calibrate_campaign"}
# Parameters that let a wrong model fit better: pressure is hardly ever centred...
CENTRE: Final = ("friction_centre_x", "friction_centre_y")
PRESSURE: Final = "pressure_spread"  # ... and hardly ever on a tripod
IDEAL: Final = ("tripod_radius", "ellipsoid_force", "ellipsoid_torque")  # replaced by PRESSURE


def searched_unknowns(settings: Sequence[str], scenes: Sequence[Scene]) -> list[Unknown]:
    """Parse `--fit NAME`, `--fit NAME=LOW:HIGH` or `--fit NAME=LOW:HIGH:START`, in SI units or
    with the unit in the name: `tripod_radius_mm=10:60`."""
    found = [_fit(setting, scenes) for setting in settings]
    check_once("fit", [unknown.name for unknown in found])
    return found


def _fit(setting: str, scenes: Sequence[Scene]) -> Unknown:
    written, _, limits = setting.partition("=")
    name, factor = _named("fit", written)
    if not limits:
        return usual_in(name, scenes)
    try:
        numbers = [factor * float(text) for text in limits.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise InvalidInput(
            f"fit {written}", found=repr(limits), expected="LOW:HIGH or LOW:HIGH:START"
        )
    low, high = numbers[0], numbers[1]
    unknown = usual_in(name, scenes, (low, high))
    if unknown.unit in _TOO_FAR:
        ending, word, limit = _TOO_FAR[unknown.unit]
        if max(abs(low), abs(high)) > max(limit, 2.0 * abs(unknown.low), 2.0 * abs(unknown.high)):
            raise InvalidInput(
                f"fit {written}",
                found=f"{low:g} to {high:g} {unknown.unit}",
                expected=f"bounds in {word}, such as {unknown.low:g} to {unknown.high:g}",
                hint=f"write {unknown.name}{ending}=LOW:HIGH for other units",
            )
    nominal = numbers[2] if len(numbers) == 3 else unknown.nominal
    return replace(unknown, low=low, high=high, nominal=nominal, scale=None)


def fixed_unknowns(settings: Sequence[str]) -> list[Unknown]:
    """Parse `--set NAME=VALUE` into parameters that are fixed at a value."""
    found = []
    for setting in settings:
        written, _, text = setting.partition("=")
        name, factor = _named("fixed", written)
        try:
            value = factor * float(text)
        except ValueError:
            raise InvalidInput("fixed", found=repr(setting), expected="NAME=NUMBER") from None
        found.append(Unknown.fixed(name, value))
    check_once("fixed", [unknown.name for unknown in found])
    return found


def _named(option: str, written: str) -> tuple[str, float]:
    """Return name and factor of a parameter; raise at its option if there is no such one."""
    name, factor = in_si(written.strip())
    try:
        info_of(name)
    except InvalidInput as problem:
        raise problem.at(option + problem.where.removeprefix("parameters")) from None
    return name, factor


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
            expected="the keys low, high, start, and if wanted scale, prior, frozen, where",
        )
    missing = [key for key in ("low", "high", "start") if entry.get(key) is None]
    if missing:
        raise InvalidInput(where, found="no " + ", no ".join(missing), expected="low, high, start")
    numbers: dict[str, Any] = {}
    for key in ("low", "high", "start", "scale", "prior"):
        if (value := entry.get(key)) is not None:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InvalidInput(f"{where}.{key}", found=repr(value), expected="a number")
            numbers["nominal" if key == "start" else key] = factor * value
    frozen, conditions = bool(entry.get("frozen", False)), dict(entry.get("where") or {})
    return Unknown(name=name, **numbers, frozen=frozen, where=conditions)


# --- options of a stored request ----------------------------------------------------------------


def options_of(request: CalibrationRequest, experiments: Iterable[int | str]) -> dict[str, Any]:
    """Return the options of the command that repeats a calibration of experiments.

    Its parameters must not be restricted to conditions, which needs a file.
    """
    capability = offered("capability", "calibrate")
    free = (u for u in request.unknowns if not u.frozen)
    own = {name: getattr(request, name, None) for name in capability.options}
    own = {k: v.name if isinstance(v, NamedOptions) else v for k, v in own.items()}
    own |= {
        **request.error.options,
        "space": None,  # stated by the next two
        "experiments": [*map(str, experiments)],
        "fit": [f"{u.name}={u.low:.9g}:{u.high:.9g}:{u.nominal:.9g}" for u in free],
        "fixed": [f"{u.name}={u.nominal:.9g}" for u in request.unknowns if u.frozen],
        "option": [f"{name}={value}" for name, value in request.optimiser.options.items()],
    }
    known = {k: v for k, v in own.items() if k in capability.options and v is not None}
    plain: dict[str, Any] = capability.request(known).model_dump(mode="json")
    return plain


def call_of(request: CalibrationRequest, source: str) -> str:
    """Return the Python expression of a calibration; `source` is that of the experiments."""

    def text(value: Any) -> str:
        if isinstance(value, Noise):
            return f"fixel.Noise(position_m={value.position_m!r}, angle_rad={value.angle_rad!r})"
        if isinstance(value, NamedOptions):
            return repr({"name": value.name, **value.options} if value.options else value.name)
        return repr(value)

    space = ", ".join(f"{u.label!r}: {_bounds_text(u)}" for u in request.unknowns)
    words = [source, f"{{{space}}}"]
    for name, usual in signature(offered("capability", "calibrate").of).parameters.items():
        own = text(getattr(request, name, usual.default))
        if own != repr(usual.default) and name != "name":
            words.append(f"{name}={own}")
    return f"fixel.{FUNCTIONS.get(request.mode, 'calibrate')}({', '.join(words)})"


def _bounds_text(unknown: Unknown) -> str:
    """Expression of the bounds of a parameter, or of its value if it is fixed."""
    if unknown.frozen:
        return repr(unknown.nominal)
    words = [repr(unknown.low), repr(unknown.high)]
    if unknown.prior is None:
        words.append(f"start={unknown.nominal!r}")
    else:
        words.append(f"prior={(unknown.nominal, unknown.prior)!r}")
    if unknown.scale != SHARE_OF_RANGE * (unknown.high - unknown.low):
        words.append(f"scale={unknown.scale!r}")
    return f"fixel.Parameter({', '.join(words)})"


def command_of(options: Mapping[str, Any]) -> str:
    """Return the shell command with these options, of which `project` is the project's folder."""
    capability, own = offered("capability", "calibrate"), dict(options)
    folder = Path(own.pop("project", ""))
    command: str = capability.command(capability.request(own), folder)
    return command


def enlarged_command(options: Mapping[str, Any], request: CalibrationRequest) -> str:
    """Return the command that calibrates a larger model; empty if there is no larger model.

    `options` are those of the command of the calibration.
    """
    known = {unknown.name for unknown in request.unknowns}
    replaced = known & {*IDEAL}
    more = [*([PRESSURE] if replaced else []), *(() if known & {*CENTRE} else CENTRE)]
    # A file defines the parameters completely, so that no other can be added.
    if "project" not in options or not more or options.get("space") or options.get("dakota"):
        return ""
    fit = options.get("fit") or [u.name for u in request.unknowns if not u.frozen]
    own = {
        name: [one for one in settings if in_si(one.partition("=")[0].strip())[0] not in replaced]
        for name, settings in (("fit", fit), ("fixed", options.get("fixed", ())))
    }
    return command_of({**options, **own, "fit": [*own["fit"], *more]})
