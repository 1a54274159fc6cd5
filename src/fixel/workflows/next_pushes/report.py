"""Experiments from which pushes are proposed, and their report: sentences, table and picture."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.domain.error_bound import min_experiments
from fixel.drawing.parts import next_pushes_chart
from fixel.errors import InvalidInput, check_name, counted, unknown_name
from fixel.formats.plan_file import load_plan, plan_text
from fixel.formats.scene_file import load_scene
from fixel.io.atomic import write_whole
from fixel.model import Disk, Experiment, LineDrive, Scene
from fixel.parts.model import PartModel
from fixel.parts.next_pushes import NextPushes, push_candidates
from fixel.sampling import FixelLayout, Plan, PlannedShape, SamplingRig
from fixel.sampling.offsets import Offset, OffsetList
from fixel.sampling.plan import object_pose
from fixel.workflows.analysis import Analysis, AnalysisReport, Picture, banner_over

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnswer

JSON: Final = ("seconds", "folder", "files")  # what `--json` has besides numbers


def report_of(found: PushProposal) -> AnalysisReport:
    """Return sentences, table, numbers and picture of a proposal, with what is unseen."""
    pushes, model, own = found.pushes, found.model, found.selection
    where = " on ".join(
        filter(None, (own.part.value or "the part of the scene", own.surface.value))
    )
    chart = next_pushes_chart(pushes, f"Next pushes of {where}")
    caption = "Outline of the part with the proposed pushes, the best first."
    parts = {own.part.name and str(one.conditions[own.part.name]) for one in own.known}
    known, of = counted(len(own.known), "push"), counted(len(parts), "part")
    analysis = Analysis(
        kind="next",
        title=f"Next pushes of {where}",
        question={},
        headline=(
            f"Next pushes of {where}, after {counted(pushes.pushes, 'push')}"
            f" ({pushes.candidates} candidates).",
            _headline(pushes),
            f"The bounds come from {len(model.parts)} parts that were left out. They prove at most"
            f" {100.0 * model.proved_level:.1f} %, and a guarantee of {100.0 * model.level:g} %"
            f" needs {min_experiments(model.level)} parts.",
        ),
        warnings=(
            *pushes.unseen,
            *pushes.gaps,
            *(f"{counted(n, 'experiment')} {why}: not used" for why, n in own.skipped.items()),
        ),
        tables=(pushes.table(),),
        notes=(pushes.notes[0], f"learned from {known} of {of}"),
        numbers=_numbers(found),
    )
    banner = banner_over(model.experiments)
    return AnalysisReport(analysis, [Picture("pushes", chart, banner, caption)])


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that performs the pushes, or writes them to a file."""
    if "out" in done.files:
        return ["testbed", "run", done.files["out"]]
    return [*done.again, "--out", "next.yaml"]


def _headline(pushes: NextPushes) -> str:
    if not pushes.bounded[0]:
        return "None of the intended pushes has a bound."
    return (
        f"Bounds now: {pushes.now}; expected after {counted(len(pushes.order), 'push')}:"
        f" {100.0 * pushes.shrinking[-1]:.0f} % of that."
    )


def _numbers(found: PushProposal) -> dict[str, Any]:
    """Return a proposal as plain values in SI units, for `--json` and the page."""
    own, selected = found.pushes, found.selection
    return {
        "unseen": list(own.unseen),
        "part": selected.part.value,
        "surface": selected.surface.value,
        "pushes_made": own.pushes,
        "candidates": own.candidates,
        "left_out_candidates": own.idle,
        "now": {"position_m": own.position, "angle_rad": own.angle},
        "without_bound": {"pushes": own.bounded[1] - own.bounded[0], "reasons": list(own.reasons)},
        "pushes": [
            {
                "candidate": own.order[k],
                "name": own.name_of(k),
                "start_m": own.start[k],
                "end_m": own.end[k],
                "expected_ratio": ratio,
                "position_m": ratio * own.position,
                "angle_rad": ratio * own.angle,
            }
            for k, ratio in enumerate(own.shrinking.tolist())
        ],
        "outline_m": own.outline,
        "radius_m": own.radius,
        "known_parts": list(found.model.parts),
        "level": found.model.level,
        "proved_level": found.model.proved_level,
        "skipped": selected.skipped,
    }


class Condition(NamedTuple):
    """Condition that names parts or surfaces, with the value of one; empty if not given."""

    name: str
    value: str

    def is_of(self, experiment: Experiment) -> bool:
        """Whether an experiment has this value."""
        return str(experiment.conditions.get(self.name, "")) == self.value


class NextSelection(NamedTuple):
    """Experiments and pushes among which the next ones of a part are chosen."""

    part: Condition
    surface: Condition
    # Usable pushes of other parts, and of the part itself.
    known: list[Experiment]
    mine: list[Experiment]
    scene: Scene | None  # scene of the part
    offered: list[Scene]  # pushes that can be made; none if they are to be generated
    skipped: dict[str, int]  # reasons why experiments were not used, with their numbers

    @property
    def labels(self) -> dict[str, Any]:
        """Values of the conditions that are known."""
        return {name: value for name, value in (self.part, self.surface) if value}

    def around(self, contacts: int, **given: float | None) -> list[Scene]:
        """Return pushes around the outline, as long and as fast as those of the experiments.

        `travel` [m], `speed` [m/s] and `radius` [m] of the pusher may be given.
        """
        first, experiments = self.scene, [*self.mine, *self.known]
        assert first is not None
        tips = [own.scene.pushers[0] for own in experiments if own.scene is not None]
        spans = [_span(own) for own in experiments]
        tip = first.pushers[0] if first.pushers else tips[0]
        usual = {
            "travel": float(np.median([own[0] for own in spans])),
            "speed": float(np.median([own[1] for own in spans])),
            "radius": float(getattr(tip.shape, "radius", 5e-3)),
        }
        chosen = {name: value for name, value in given.items() if value is not None}
        return push_candidates(
            replace(first, pushers=()), friction=tip.friction, contacts=contacts, **usual | chosen
        )


class PushProposal(NamedTuple):
    """Proposed pushes of a part."""

    selection: NextSelection
    model: PartModel  # model after the part's own pushes
    pushes: NextPushes
    scenes: tuple[Scene, ...]  # proposed pushes, the best first


def select(project: Project, asked: Any) -> NextSelection:
    """Select the experiments of a part and of the other parts, for a request for pushes."""
    first = load_scene(asked.scene).scene if asked.scene else None
    offered = list(load_plan(asked.candidates).experiments) if asked.candidates else []
    usable, skipped = _usable(project.experiments(*asked.where))
    of_part = _condition("part", asked.part, PARTS, usable)
    of_surface = _condition("surface", asked.surface, SURFACES, usable)
    named = [own for own in usable if of_part.name in own.conditions]
    mine = [own for own in named if of_part.is_of(own)]
    known = [own for own in named if not of_part.is_of(own)]
    if not known:
        reasons = "; ".join(f"{n} {why}" for why, n in skipped.items())
        raise InvalidInput(
            "experiments",
            found="no usable push of another part" + (f" ({reasons})" if reasons else ""),
            expected="pushes of other parts, each of one part by one round pusher",
            hint="import some with: fixel import",
        )
    if first is None and not offered and not mine:
        raise _no_part(of_part, known)
    surfaces = sorted({str(own.conditions.get(of_surface.name, "")) for own in mine} - {""})
    if not of_surface.value:
        if len(surfaces) > 1:
            raise InvalidInput("surface", found="none", expected="one of " + ", ".join(surfaces))
        of_surface = Condition(of_surface.name, surfaces[0] if surfaces else "")
    elif first is None and not offered:
        check_name("surface", of_surface.value, surfaces)
    mine = [own for own in mine if of_surface.is_of(own)]
    return NextSelection(
        part=of_part,
        surface=of_surface,
        known=known,
        mine=mine,
        scene=first or (mine[0].scene if mine else None),
        offered=[own.scene for own in offered],
        skipped=skipped,
    )


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
) -> Condition:
    """Return the condition of parts or surfaces with the value asked for."""
    name, equals, text = value.partition("=")
    conditions = sorted({n for own in experiments for n in own.conditions})
    if equals:
        check_name(what, name, conditions or [name])
        return Condition(name, text)
    counts = {n: sum(n in own.conditions for own in experiments) for n in names}
    have = max(names, key=lambda n: counts[n])  # the first of those that most have
    if experiments and not counts[have] and what == "part":
        raise InvalidInput(
            "part",
            found="no experiment with a condition that names its part",
            expected="one of " + ", ".join(names),
            hint=f"name it: part=NAME=VALUE; NAME: {', '.join(conditions)}" if conditions else None,
        )
    return Condition(have if counts[have] else "", value)


def _no_part(part: Condition, known: Sequence[Experiment]) -> InvalidInput:
    values = sorted({str(own.conditions[part.name]) for own in known})
    found, expected = "none", "one of " + ", ".join(values[:20])
    hint = "a part without experiments needs its scene file: scene=part.yaml"
    if part.value:
        found = f"{part.value!r}, of which there is no experiment"
        expected = unknown_name("part", part.value, values).expected or expected
    return InvalidInput("part", found=found, expected=expected, hint=hint)


def _span(experiment: Experiment) -> tuple[float, float]:
    """Return travel [m] and mean speed [m/s] of a pusher."""
    scene = experiment.scene
    assert scene is not None
    drive = scene.pushers[0].drive
    if isinstance(drive, LineDrive):
        return drive.distance(scene.duration), drive.speed
    steps = np.diff(drive.waypoints, axis=0)
    travel = float(np.hypot(steps[:, 1], steps[:, 2]).sum())
    return travel, travel / max(float(steps[:, 0].sum()), 1e-9)


def plan_of(proposal: PushProposal, name: str = "next") -> Plan:
    """Return a plan of the proposed pushes: the pusher moves along +x, the part is placed for it.

    Raise `InvalidInput` for pushes that differ in tip, travel or speed, are not straight, or have
    fixels.
    """
    body, tips = proposal.scenes[0].bodies[0], [own.pushers[0] for own in proposal.scenes]
    drives = [tip.drive for tip in tips if isinstance(tip.drive, LineDrive)]
    common = {(tip.shape, tip.friction, own.speed, own.travel, own.force_limit)
              for tip, own in zip(tips, drives, strict=False)}  # fmt: skip
    if len(drives) < len(tips) or len(common) > 1:
        raise InvalidInput(
            "out", found="pushes that differ in tip, travel or speed", expected="pushes alike"
        )
    if any(own.fixels for own in proposal.scenes):
        raise InvalidInput("out", found="pushes with fixels", expected="pushes on an open plate")
    drive, tip = drives[0], tips[0]
    rig = SamplingRig(
        head=tip.shape,
        speed=drive.speed,
        travel=drive.travel,
        force_limit=drive.force_limit,
        head_friction=tip.friction,
        fixel_friction=0.3,
        fixel_radius=5e-3,
        zone_side=0.1,
        gap=0.0,
        angle=0.0,
    )
    planned = PlannedShape(
        name=_plain(proposal.selection.part.value or body.name, "part"),
        outline=body.shape,
        mass=body.mass,
        support=body.support,
        zone_start=0.0,
    )
    rows = [_offset(rig, planned, own) for own in proposal.scenes]
    return Plan(
        name=name,
        rig=rig,
        shapes=(planned,),
        layouts=(FixelLayout(name="open", pegs=()),),
        schemes=(OffsetList(tuple(rows)),),
    )


def _plain(text: str, other: str) -> str:
    """Return a text as a name of a plan; another one if nothing of it is left."""
    return re.sub(r"[^A-Za-z0-9_-]", "-", text).strip("-_")[:60] or other


def _offset(rig: SamplingRig, shape: PlannedShape, scene: Scene) -> tuple[float, float, float]:
    """Return the offset with which the head at the origin makes a push."""
    body, tip = scene.bodies[0], scene.pushers[0]
    assert isinstance(tip.drive, LineDrive)
    heading = math.atan2(tip.drive.direction[1], tip.drive.direction[0])
    c, s = math.cos(heading), math.sin(heading)
    x, y = body.pose[:2] - tip.pose[:2]
    turn = math.remainder(float(body.pose[2]) - heading, 2.0 * math.pi)
    at = object_pose(rig, shape, Offset(axis="list", step=1.0, theta=turn))
    return float(c * x + s * y - at[0]), float(c * y - s * x - at[1]), turn


def write_plan(proposal: PushProposal, path: Path) -> None:
    """Write the proposed pushes as a plan file, whole or not at all."""
    write_whole(path, plan_text(plan_of(proposal, _plain(path.stem, "next"))))
