"""Commands and scripts that reproduce or load a calibration."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

from fixel.simulation.engine_names import motion_words
from fixel.workflows.calibration.parameter_options import in_si
from fixel.workflows.calibration.request import CalibrationRequest


def command_of(folder: Path, request: CalibrationRequest, keys: Sequence[str]) -> str:
    """Return the command that repeats a calibration.

    Parameters
    ----------
    folder : Path
        Folder of the project.
    request : CalibrationRequest
        Request; its parameters must not be restricted to conditions, which needs a file.
    keys : sequence of str
        Ids or names of the experiments.
    """
    usual = CalibrationRequest(unknowns=request.unknowns)
    words = ["fixel", "calibrate", *keys, "--project", str(folder), "--mode", request.mode]
    for unknown in request.unknowns:
        if unknown.frozen:
            words += ["--set", f"{unknown.name}={unknown.nominal:.9g}"]
        else:
            ends = f"{unknown.low:.9g}:{unknown.high:.9g}:{unknown.nominal:.9g}"
            words += ["--fit", f"{unknown.name}={ends}"]
    if request.motion != usual.motion:
        words += motion_words(request.motion)
    for name in ("combine", "starts", "seed", "level", "name", "budget"):
        value = getattr(request, name)
        if value != getattr(usual, name):
            words += [f"--{name}", str(value)]
    if request.error.name != usual.error.name:
        words += ["--error", request.error.name]
    if "angle_scale" in request.error.options:
        words += ["--angle-scale-mm", f"{1e3 * request.error.options['angle_scale']:.9g}"]
    if request.noise is not None:
        words += ["--noise-mm", f"{1e3 * request.noise.position_m:.9g}"]
        words += ["--noise-mrad", f"{1e3 * request.noise.angle_rad:.9g}"]
    words += ["--optimiser", request.optimiser.name]
    for name, value in request.optimiser.options.items():
        words += ["--option", f"{name}={value}"]
    return shlex.join(words if request.verdicts else [*words, "--no-verdicts"])


# Parameters that let a wrong model fit better: pressure is hardly ever centred...
CENTRE: Final = ("friction_centre_x", "friction_centre_y")
PRESSURE: Final = "pressure_spread"  # ... and hardly ever on a tripod
IDEAL: Final = ("tripod_radius", "ellipsoid_force", "ellipsoid_torque")  # replaced by PRESSURE
# Options that define the parameters completely, so that --fit cannot add any.
_ELSEWHERE: Final = ("--space", "--dakota")


def enlarged_command(command: str, request: CalibrationRequest) -> str:
    """Return the command that calibrates a larger model; empty if there is no larger model.

    Parameters
    ----------
    command : str
        Command of the calibration.
    request : CalibrationRequest
    """
    words = _separated(shlex.split(command))
    known = {unknown.name for unknown in request.unknowns}
    replaced = known & {*IDEAL}
    more = [*([PRESSURE] if replaced else []), *(() if known & {*CENTRE} else CENTRE)]
    if words[:2] != ["fixel", "calibrate"] or not more or {*words} & {*_ELSEWHERE}:
        return ""
    free = () if "--fit" in words else [u.name for u in request.unknowns if not u.frozen]
    words = _without(words, replaced)
    for name in (*(name for name in free if name not in replaced), *more):
        words += ["--fit", name]
    return shlex.join(words)


def _separated(words: Sequence[str]) -> list[str]:
    """Split `--fit=...` and `--set=...` into option and value."""
    joined = ("--fit=", "--set=")
    return [part for w in words for part in (w.split("=", 1) if w.startswith(joined) else (w,))]


def _without(words: Sequence[str], names: Collection[str]) -> list[str]:
    """Remove the `--fit` and `--set` of some parameters."""
    left: list[str] = []
    for word in words:
        setting = left and left[-1] in ("--fit", "--set")
        if setting and in_si(word.partition("=")[0].strip())[0] in names:
            left.pop()
        else:
            left.append(word)
    return left
