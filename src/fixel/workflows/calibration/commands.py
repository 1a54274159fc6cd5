"""Options of the command that reproduces a calibration, or calibrates a larger model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any, Final

from fixel.calibration.noise import Noise
from fixel.model.space import SHARE_OF_RANGE, Unknown
from fixel.registry import offered
from fixel.workflows.calibration.parameter_options import in_si
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions

# Functions that begin a run, by its mode.
FUNCTIONS: Final = {
    "joint": "calibrate",
    "each": "calibrate_each",
    "campaign": "calibrate_campaign",
    "stored": "calibrate",
}
# Parameters that let a wrong model fit better: pressure is hardly ever centred...
CENTRE: Final = ("friction_centre_x", "friction_centre_y")
PRESSURE: Final = "pressure_spread"  # ... and hardly ever on a tripod
IDEAL: Final = ("tripod_radius", "ellipsoid_force", "ellipsoid_torque")  # replaced by PRESSURE


def options_of(request: CalibrationRequest, keys: Sequence[str]) -> dict[str, Any]:
    """Return the options of the command that repeats a calibration, as plain content.

    Parameters
    ----------
    request : CalibrationRequest
        Request; its parameters must not be restricted to conditions, which needs a file.
    keys : sequence of str
        Ids or names of the experiments.
    """
    capability = offered("capability", "calibrate")
    free = (u for u in request.unknowns if not u.frozen)
    own = {name: getattr(request, name) for name in (*CalibrationRequest.model_fields, "noise")}
    own = {k: v.name if isinstance(v, NamedOptions) else v for k, v in own.items()}
    own |= {
        **request.error.options,
        "experiments": keys,
        "fit": [f"{u.name}={u.low:.9g}:{u.high:.9g}:{u.nominal:.9g}" for u in free],
        "fixed": [f"{u.name}={u.nominal:.9g}" for u in request.unknowns if u.frozen],
        "option": [f"{name}={value}" for name, value in request.optimiser.options.items()],
    }
    known = {k: v for k, v in own.items() if k in capability.options and v is not None}
    plain: dict[str, Any] = capability.request(known).model_dump(mode="json")
    return plain


def call_of(request: CalibrationRequest, source: str) -> str:
    """Return the Python expression of a calibration.

    Parameters
    ----------
    request : CalibrationRequest
    source : str
        Expression of the experiments.
    """

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
    return f"fixel.{FUNCTIONS[request.mode]}({', '.join(words)})"


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

    Parameters
    ----------
    options : mapping
        Options of the command of the calibration.
    request : CalibrationRequest
    """
    known = {unknown.name for unknown in request.unknowns}
    replaced = known & {*IDEAL}
    more = [*([PRESSURE] if replaced else []), *(() if known & {*CENTRE} else CENTRE)]
    # A file defines the parameters completely, so that no other can be added.
    if not options or not more or options.get("space") or options.get("dakota"):
        return ""
    fit = options.get("fit") or [u.name for u in request.unknowns if not u.frozen]
    own = {
        "fit": [*_without(fit, replaced), *more],
        "fixed": _without(options.get("fixed", ()), replaced),
    }
    return command_of({**options, **own})


def _without(settings: Sequence[str], names: set[str]) -> list[str]:
    """Remove the settings of some parameters."""
    return [own for own in settings if in_si(own.partition("=")[0].strip())[0] not in names]
