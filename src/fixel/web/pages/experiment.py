"""Page of one experiment: its scene, its motion, and simulations of it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from math import degrees
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlencode

from fastapi import Request

from fixel.errors import NotStored
from fixel.model import Experiment
from fixel.testbed.simulated import TRUTH
from fixel.web.pages.compare import judged
from fixel.web.values import MAX_ID, condition, fixed, instant, touched
from fixel.workflows.project.compare import compare_path, summary
from fixel.workflows.project.filters import view_of

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
    """Fill `/experiments/{number}?filter=&sort=&descending=`, a row of that table."""
    number = number_in(request, "experiment", "the page Experiments lists all")
    store, experiment = context.store, context.store.experiment(number)
    asked = {name: request.query_params.get(name, "") for name in ("filter", "sort", "descending")}
    given = {name: value for name, value in asked.items() if value}
    previous, following = _neighbours(context, number, given)
    return {
        "title": experiment.key,
        "number": number,
        "key": experiment.key,
        "query": f"?{urlencode(given)}" if given else "",
        "previous": previous,
        "following": following,
        "real": experiment.real,
        "simulated_by": experiment.simulated_by,
        "deleted": store.deleted(number),
        "replacement": store.replacement(number),
        "flags": experiment.flags,
        "flag_names": list(store.flags()),
        "notes": store.notes(number),
        "has_scene": experiment.scene is not None,
        "judged": None if experiment.scene is None else judged(context, number),
        "has_video": bool(experiment.video),
        "facts": facts(experiment),
        "published": published_facts(context, number, experiment),
        "conditions": conditions(experiment, truth=False),
        "truth": conditions(experiment, truth=True),
        "provenance": provenance(experiment),
        "command": command(context, experiment),
        "python": python(context, experiment),
    }


def _neighbours(
    context: ProjectContext, number: int, given: Mapping[str, str]
) -> tuple[int | None, int | None]:
    """Return the experiments before and after one in the table that it was opened from."""
    view = view_of(
        given.get("filter", ""),
        sort=given.get("sort", "id"),
        descending=bool(given.get("descending")),
    )
    ids = context.store.experiment_ids(view)
    if number not in ids:
        ids = context.store.experiment_ids(view_of(""))
    if number not in ids:
        return None, ids[0] if ids else None
    place = ids.index(number)
    return (ids[place - 1] if place else None), (ids[place + 1] if place + 1 < len(ids) else None)


def facts(experiment: Experiment) -> list[Fact]:
    """Facts on what was measured, in units for display."""
    known = summary(experiment)
    rate, useful = known["rate_hz"], known["effective_s"]
    found = [
        Fact("time", fixed(known["duration_s"], 2), "s"),
        Fact("frames", f"{known['frames']}" + ("" if rate is None else f" at {rate:.3g} Hz")),
        Fact("way", fixed(1e3 * known["travelled_m"], 1), "mm"),
        Fact("turned", fixed(degrees(known["turned_rad"]), 1), "deg"),
        Fact("start", *_pose(known["start"])),
        Fact("end", *_pose(known["end"])),
    ]
    if useful is not None:
        found.append(Fact("useful", f"{fixed(useful[0], 2)} to {fixed(useful[1], 2)}", "s"))
    if known["contact_mode"]:
        found.append(Fact("contacts at the end", touched(known["contact_mode"])))
    channels = ", ".join(channel.name for channel in experiment.channels)
    return [*found, Fact("signals", channels)] if channels else found


def published_facts(context: ProjectContext, number: int, experiment: Experiment) -> list[Fact]:
    """Facts on the simulation by the publisher of the experiment; none without one."""
    simulation = context.store.published_simulations().get(number)
    if simulation is None:
        return []
    found = compare_path(experiment, context.store.simulation(simulation))
    shown = [
        Fact("error, root of E", fixed((found.error_mm2 or 0.0) ** 0.5, 2), "mm"),
        Fact("distance, rms", fixed(1e3 * (found.position_rms or 0.0), 2), "mm"),
        Fact("distance, end", fixed(1e3 * (found.final_position or 0.0), 2), "mm"),
        Fact("angle, end", fixed(degrees(found.final_angle or 0.0), 2), "deg"),
    ]
    mode = found.contact_mode
    return [*shown, Fact("contacts at the end", touched(mode))] if mode else shown


def conditions(experiment: Experiment, truth: bool) -> list[Fact]:
    """Facts on the stored conditions, or on the truths of a simulated testbed."""
    chosen = [
        (name, value)
        for name, value in experiment.conditions.items()
        if name.startswith(TRUTH) == truth
    ]
    return [Fact(*condition(name.removeprefix(TRUTH), value)) for name, value in chosen]


def _pose(pose: list[float]) -> tuple[str, str]:
    x, y, angle = pose
    place = f"{fixed(1e3 * x, 1)}, {fixed(1e3 * y, 1)} mm"
    return f"{place}, {fixed(degrees(angle), 1)}", "deg"


def provenance(experiment: Experiment) -> list[Fact]:
    """Facts on the origin of an experiment."""
    origin = experiment.provenance
    given = (
        ("stored", f"{instant(origin.created)} UTC"),
        ("fixel version", origin.version),
        ("command", origin.command),
        ("simulated by", experiment.simulated_by),
        ("source file", origin.source),
        ("SHA-256 of the source file", origin.sha256),
        ("seed", "" if origin.seed is None else str(origin.seed)),
        ("SHA-256 of the video", experiment.video),
    )
    # The beginning of a checksum identifies the file; the JSON has all of it.
    return [
        Fact(name, f"{value[:16]}\u2026" if name.startswith("SHA-256") else value)
        for name, value in given
        if value
    ]


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
