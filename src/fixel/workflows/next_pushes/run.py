"""Propose the next pushes of a part of a project, from pushes of its other parts."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.errors import InvalidInput, unknown_name
from fixel.formats.plan_file import load_plan
from fixel.formats.scene_file import load_scene
from fixel.model import Disk, Experiment, LineDrive, Scene
from fixel.parts.candidates import push_candidates
from fixel.parts.model import PartModel
from fixel.parts.next_pushes import NextPushes
from fixel.progress import ProgressOption
from fixel.typing import Notify
from fixel.workflows.parts import part_model

STORE: Final = Path("cache") / "parts"  # finished fits, in the project


@final
@dataclass(frozen=True, kw_only=True)
class NextPushesRequest:
    """Request for the next pushes of a part.

    Parameters
    ----------
    part, surface : str
        Value of the condition that names the part or the surface, also as NAME=VALUE; empty for
        the part of a scene file, and for the only surface.
    scene : str
        Scene file of the part; by default its first experiment.
    candidates : str
        Plan file with the pushes that can be made; by default they are generated.
    where : tuple of str
        Filters that select experiments.
    n : int
        Number of pushes to propose.
    chosen : bool
        Whether the part's pushes so far were proposed in this way.
    contacts : int
        Number of contacts around the outline.
    travel, speed, radius : float, optional
        Travel [m], speed [m/s] and radius [m] of the pusher; by default those of the experiments.
    seed : int
    """

    part: str = ""
    surface: str = ""
    scene: str = ""
    candidates: str = ""
    where: tuple[str, ...] = ()
    n: int = 5
    chosen: bool = False
    contacts: int = 24
    travel: float | None = None
    speed: float | None = None
    radius: float | None = None
    seed: int = 0


class PushProposal(NamedTuple):
    """Proposed pushes of a part.

    Attributes
    ----------
    request : NextPushesRequest
    part, surface : str
        Part and surface of the pushes; empty if not given.
    model : PartModel
        Model after the part's own pushes.
    pushes : NextPushes
    scenes : tuple of Scene
        Proposed pushes, the best first.
    skipped : dict of str to int
        Reasons why experiments were not used, with their numbers.
    seconds : float
        Wall time [s].
    """

    request: NextPushesRequest
    part: str
    surface: str
    model: PartModel
    pushes: NextPushes
    scenes: tuple[Scene, ...]
    skipped: dict[str, int]
    seconds: float


def propose_pushes(
    project: Project,
    request: NextPushesRequest,
    *,
    notify: Notify | None = None,
    progress: ProgressOption = None,
    threads: int | None = None,
) -> PushProposal:
    """Propose the next pushes of a part; experiments of the other parts are the known ones.

    Raises
    ------
    InvalidInput
        There are no usable experiments of other parts, the part is unknown and has no scene, or
        no candidate moves it.
    """
    began = time.monotonic()
    scene = load_scene(request.scene).scene if request.scene else None
    given = list(load_plan(request.candidates).experiments) if request.candidates else []
    usable, skipped = _usable(project.experiments(*request.where))
    part, part_value = _condition("part", request.part, PARTS, usable)
    surface, surface_value = _condition("surface", request.surface, SURFACES, usable)
    named = [own for own in usable if part in own.conditions]
    mine = [own for own in named if str(own.conditions[part]) == part_value]
    known = [own for own in named if str(own.conditions[part]) != part_value]
    if not known:
        reasons = "; ".join(f"{n} {why}" for why, n in skipped.items())
        raise InvalidInput(
            "experiments",
            found="no usable push of another part" + (f" ({reasons})" if reasons else ""),
            expected="pushes of other parts, each of one part by one round pusher",
            hint="import some with: fixel import",
        )
    if scene is None and not given and not mine:
        raise _no_part(part, part_value, known)
    surface_value = surface_value or _only_surface(mine, surface)
    mine = [
        own for own in mine if not surface_value or own.conditions.get(surface) == surface_value
    ]
    if notify is not None:
        parts = {own.conditions[part] for own in known}
        notify(f"learning from {len(known)} pushes of {len(parts)} parts")
    model = part_model(
        known,
        part=part,
        surface=surface,
        seed=request.seed,
        threads=threads,
        store=_store(project),
        progress=progress,
    )
    if mine:
        model = model.after(mine, chosen=request.chosen, progress=progress)
    first = scene or (mine[0].scene if mine else None)
    offered = [own.scene for own in given] or _candidates(first, [*mine, *known], request)
    labels: Any = {name: x for name, x in ((part, part_value), (surface, surface_value)) if x}
    pushes = model.next_pushes(offered, n=request.n, **labels)
    return PushProposal(
        request,
        part_value,
        surface_value,
        model,
        pushes,
        tuple(offered[k] for k in pushes.order),
        skipped,
        time.monotonic() - began,
    )


def _store(project: Project) -> Path:
    folder = project.folder / STORE
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _usable(experiments: Sequence[Experiment]) -> tuple[list[Experiment], dict[str, int]]:
    """Return experiments of one part and one round pusher, and why others are not used."""
    used, skipped = [], Counter[str]()
    for own in experiments:
        scene = own.scene
        if scene is None:
            skipped["without a scene"] += 1
        elif len(scene.bodies) != 1 or len(scene.pushers) != 1:
            skipped["not of one part and one pusher"] += 1
        elif not isinstance(scene.pushers[0].shape, Disk):
            skipped["with a pusher that is not round"] += 1
        else:
            try:
                target_of(own)
            except InvalidInput:
                skipped["without measured motion"] += 1
            else:
                used.append(own)
    return used, dict(skipped)


def _condition(
    what: str, value: str, names: tuple[str, ...], experiments: Sequence[Experiment]
) -> tuple[str, str]:
    """Return the name of the condition of parts or surfaces, and the value asked for."""
    name, equals, text = value.partition("=")
    if equals:
        return name, text
    counts = {n: sum(n in own.conditions for own in experiments) for n in names}
    have = max(names, key=lambda n: counts[n])  # the first of those that most have
    if not counts[have] and what == "part":
        conditions = sorted({n for own in experiments for n in own.conditions})
        raise InvalidInput(
            "--part",
            found="no experiment with a condition that names its part",
            expected="one of " + ", ".join(names),
            hint=f"name it: --part NAME=VALUE, of {', '.join(conditions)}" if conditions else None,
        )
    return have, value


def _no_part(part: str, value: str, known: Sequence[Experiment]) -> InvalidInput:
    values = sorted({str(own.conditions[part]) for own in known})
    if value and values:
        error = unknown_name("--part", value, values)
        return InvalidInput(
            "--part",
            found=f"{value!r}, of which there is no experiment",
            expected=error.expected,
            hint="a part without experiments needs its scene file: --scene part.yaml",
        )
    return InvalidInput(
        "--part",
        found="none",
        expected="one of " + ", ".join(values[:20]),
        hint="a part without experiments needs its scene file: --scene part.yaml",
    )


def _only_surface(mine: Sequence[Experiment], surface: str) -> str:
    values = sorted({str(own.conditions.get(surface, "")) for own in mine})
    if len(values) > 1:
        raise InvalidInput("--surface", found="none", expected="one of " + ", ".join(values))
    return values[0] if values else ""


def _candidates(
    first: Scene | None, experiments: Sequence[Experiment], request: NextPushesRequest
) -> list[Scene]:
    """Return pushes around the outline, as long and as fast as those of the experiments."""
    assert first is not None
    tips = [own.scene.pushers[0] for own in experiments if own.scene is not None]
    spans = [_span(own) for own in experiments]
    travel = request.travel or float(np.median([own[0] for own in spans]))
    speed = request.speed or float(np.median([own[1] for own in spans]))
    tip = first.pushers[0] if first.pushers else tips[0]
    radius = request.radius or float(getattr(tip.shape, "radius", 5e-3))
    return push_candidates(
        replace(first, pushers=()),
        radius=radius,
        travel=travel,
        speed=speed,
        friction=tip.friction,
        contacts=request.contacts,
    )


def _span(experiment: Experiment) -> tuple[float, float]:
    """Return travel [m] and mean speed [m/s] of a pusher."""
    scene = experiment.scene
    assert scene is not None
    drive = scene.pushers[0].drive
    if isinstance(drive, LineDrive):
        travel = min(drive.travel, drive.speed * scene.duration)
        return float(travel), float(drive.speed)
    steps = np.diff(drive.waypoints, axis=0)
    travel = float(np.hypot(steps[:, 1], steps[:, 2]).sum())
    return travel, travel / max(float(steps[:, 0].sum()), 1e-9)
