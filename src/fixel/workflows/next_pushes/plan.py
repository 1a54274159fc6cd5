"""Plan file of proposed pushes."""

from __future__ import annotations

import math
import re
from pathlib import Path

from fixel.errors import InvalidInput
from fixel.formats.plan_file import plan_text
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.model import LineDrive, Scene
from fixel.sampling import FixelLayout, Plan, PlannedShape, SamplingRig
from fixel.sampling.offsets import Offset, OffsetList
from fixel.sampling.plan import object_pose
from fixel.workflows.next_pushes.selection import PushProposal


def plan_of(proposal: PushProposal, name: str = "next") -> Plan:
    """Return a plan of the proposed pushes: the pusher moves along +x, the part is placed for it.

    Raises
    ------
    InvalidInput
        Pushes differ in tip, travel or speed, are not straight, or have fixels.
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


def write_plan(proposal: PushProposal, path: Path) -> Path:
    """Write the proposed pushes as a plan file, whole or not at all."""
    text = plan_text(plan_of(proposal, _plain(path.stem, "next")))
    with written_whole(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    return path


def refuse_plan(path: Path) -> None:
    """Reject a plan file that cannot be written, before any work."""
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise InvalidInput(str(path), found="another ending", expected="a plan file: .yaml, .yml")
    refuse_unwritable(path)
