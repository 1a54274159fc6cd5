"""Page of one experiment: its scene, its motion, and simulations of it."""

from __future__ import annotations

import shlex
from math import degrees
from typing import TYPE_CHECKING, Any, NamedTuple

from fastapi import Request

from fixel.errors import NotStored
from fixel.model import Experiment
from fixel.testbed.simulated import TRUTH
from fixel.units import displayed, split_unit
from fixel.web.values import MAX_ID
from fixel.workflows.project.compare import compare_path, summary

if TYPE_CHECKING:
    from fixel.web.context import ProjectContext


class Fact(NamedTuple):
    """Line in a list of facts."""

    name: str
    value: str
    unit: str = ""


def number_in(request: Request, what: str, hint: str) -> int:
    """Return the id in an address; raise `NotStored` for one that no record can have."""
    given = str(request.path_params["number"])
    number = int(given) if given.isdecimal() and len(given) < 11 else 0
    if not 0 < number <= MAX_ID:
        raise NotStored(f"{what} {given!r}", hint=hint)
    return number


def experiment_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/experiments/{number}`."""
    number = number_in(request, "experiment", "the page Experiments lists all")
    experiment = context.store.experiment(number)
    return {
        "title": experiment.key,
        "number": number,
        "key": experiment.key,
        "real": experiment.real,
        "simulated_by": experiment.simulated_by,
        "deleted": context.store.deleted(number),
        "has_scene": experiment.scene is not None,
        "has_video": bool(experiment.video),
        "facts": facts(experiment),
        "published": published_facts(context, number, experiment),
        "conditions": conditions(experiment, truth=False),
        "truth": conditions(experiment, truth=True),
        "provenance": provenance(experiment),
        "command": command(context, experiment),
        "python": python(context, experiment),
    }


def facts(experiment: Experiment) -> list[Fact]:
    """Facts on what was measured, in units for display."""
    known = summary(experiment)
    rate, useful = known["rate_hz"], known["effective_s"]
    found = [
        Fact("time", _fixed(known["duration_s"], 2), "s"),
        Fact("frames", f"{known['frames']}" + ("" if rate is None else f" at {rate:.3g} Hz")),
        Fact("way", _fixed(1e3 * known["travelled_m"], 1), "mm"),
        Fact("turned", _fixed(degrees(known["turned_rad"]), 1), "deg"),
        Fact("start", *_pose(known["start"])),
        Fact("end", *_pose(known["end"])),
    ]
    if useful is not None:
        found.append(Fact("useful", f"{_fixed(useful[0], 2)} to {_fixed(useful[1], 2)}", "s"))
    if known["contact_mode"]:
        found.append(Fact("contacts at the end", _touched(known["contact_mode"])))
    channels = ", ".join(channel.name for channel in experiment.channels)
    return [*found, Fact("signals", channels)] if channels else found


def published_facts(context: ProjectContext, number: int, experiment: Experiment) -> list[Fact]:
    """Facts on the simulation by the publisher of the experiment; none without one."""
    simulation = context.store.published_simulations().get(number)
    if simulation is None:
        return []
    found = compare_path(experiment, context.store.simulation(simulation))
    shown = [
        Fact("error, root of E", _fixed((found.error_mm2 or 0.0) ** 0.5, 2), "mm"),
        Fact("distance, rms", _fixed(1e3 * (found.position_rms or 0.0), 2), "mm"),
        Fact("distance, end", _fixed(1e3 * (found.final_position or 0.0), 2), "mm"),
        Fact("angle, end", _fixed(degrees(found.final_angle or 0.0), 2), "deg"),
    ]
    mode = found.contact_mode
    return [*shown, Fact("contacts at the end", _touched(mode))] if mode else shown


def conditions(experiment: Experiment, truth: bool) -> list[Fact]:
    """Facts on the stored conditions, or on the truths of a simulated testbed."""
    chosen = [
        (name, value)
        for name, value in experiment.conditions.items()
        if name.startswith(TRUTH) == truth
    ]
    return [_condition(name.removeprefix(TRUTH), value) for name, value in chosen]


def _touched(mode: str) -> str:
    touched = [str(k) for k, digit in enumerate(mode, 1) if digit == "1"]
    return "fixel " + " and ".join(touched) if touched else "no fixel"


def _pose(pose: list[float]) -> tuple[str, str]:
    x, y, angle = pose
    place = f"{_fixed(1e3 * x, 1)}, {_fixed(1e3 * y, 1)} mm"
    return f"{place}, {_fixed(degrees(angle), 1)}", "deg"


def _fixed(value: float, digits: int) -> str:
    """Format a number with a true minus sign, and none before a zero."""
    text = f"{abs(value):.{digits}f}"
    return f"\u2212{text}" if value < 0.0 and float(text) else text


def _condition(name: str, value: str | float) -> Fact:
    """Format a condition, as `condition` of units.js does."""
    if isinstance(value, str):
        return Fact(name.replace("_", " "), value)
    stem, si = split_unit(name)
    unit, factor = displayed(si)
    text = f"{factor * value:.4g}".replace("-", "\u2212", 1)
    return Fact(stem.removesuffix("_ratio").replace("_", " "), text, unit)


def provenance(experiment: Experiment) -> list[Fact]:
    """Facts on the origin of an experiment."""
    origin = experiment.provenance
    given = (
        ("stored", _instant(origin.created)),
        ("fixel version", origin.version),
        ("command", origin.command),
        ("simulated by", experiment.simulated_by),
        ("source file", origin.source),
        ("SHA-256 of the source file", origin.sha256),
        ("seed", "" if origin.seed is None else str(origin.seed)),
        ("SHA-256 of the video", experiment.video),
    )
    return [Fact(name, _short(name, value)) for name, value in given if value]


def _short(name: str, value: str) -> str:
    """Shorten checksums to their beginning, which identifies them; the JSON has all of it."""
    return f"{value[:16]}\u2026" if name.endswith("SHA-256") else value


def _instant(iso: str) -> str:
    return f"{iso[:10]} {iso[11:16]} UTC" if len(iso) >= 16 else iso


def command(context: ProjectContext, experiment: Experiment) -> str:
    """Return the command that shows the experiment."""
    folder = str(context.folder)
    return shlex.join(["fixel", "show", experiment.key, "--project", folder, "--plot", "run.png"])


def python(context: ProjectContext, experiment: Experiment) -> str:
    """Return a script that loads the experiment."""
    return (
        "import fixel\n\n"
        f"lab = fixel.Project({str(context.folder)!r})\n"
        f"experiment = lab.experiment({experiment.key!r})\n"
        "print(experiment)\n"
        "experiment.plot()\n"
    )
