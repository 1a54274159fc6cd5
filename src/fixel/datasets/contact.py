"""Scenes of pushes as measured, with pushers moved out of the object that they overlap."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.datasets.base import remark, scene_or_flag
from fixel.datasets.files import MM
from fixel.model import Body, Disk, Flag, PathDrive, Pusher, Scene, Shape
from fixel.model.overlap import gaps_and_normals
from fixel.model.shape import length_scale
from fixel.typing import FloatArray

# Registration errors up to this depth, less for small parts, are corrected by moving the pusher to
# contact; with larger ones its position is unknown [m].
MAX_CORRECTION: Final = 3e-3

# Usual duration of the correction of a path that starts inside the object [s].
FADE: Final = 0.5

# Gap after a correction, against rounding: in m, and for small objects relative to their radius.
CLEARANCE: Final = 1e-9, 1e-6
ROUNDING: Final = 1e-12  # largest overlap that is rounding, relative to the radius


def moved_to_contact(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return gaps (n,) as `gaps_and_normals`, and shifts (n, 2) that move tips out of the outline.

    Shifts are along the normal [m], zero for tips outside. They are exact for convex outlines.
    """
    gap, outward = gaps_and_normals(shape, radius, pose, tip)
    gap = np.where(np.abs(gap) < ROUNDING * shape.radius, 0.0, gap)
    clearance = min(CLEARANCE[0], CLEARANCE[1] * shape.radius)
    length = np.where(gap < 0.0, clearance - gap, 0.0)
    return gap, length[:, None] * outward


def corrected_path(path: FloatArray, offset: FloatArray, fade: float = math.inf) -> FloatArray:
    """Shift the start of a path (n, 4) of times [s] and poses [m, m, rad] by an offset (2,) [m].

    The correction fades to zero within `fade` [s], at most the whole path: its end is as measured.
    """
    time = path[:, 0] - path[0, 0]
    over = min(fade, float(time[-1])) if len(time) > 1 else 0.0
    share = np.clip(1.0 - time / over, 0.0, 1.0) if over > 0.0 else np.ones(len(time))
    moved = path.copy()
    moved[:, 1:3] += share[:, None] * offset
    return moved


def correction_flag(gap: float) -> Flag:
    """Create the flag of an experiment whose pusher was moved to contact."""
    detail = f"in the scene, in which it overlaps by {-gap * 1e3:.3g} mm at the start"
    return remark("pusher-moved-to-contact", detail)


def pushed_scene(
    body: Body,
    tip: Disk,
    path: FloatArray,
    *,
    friction: float,
    fade: float = math.inf,
    contact: tuple[float, FloatArray] | None = None,
    pusher: str = "pusher",
    words: tuple[str, str] = ("tip", "object"),
) -> tuple[Scene | None, tuple[Flag, ...]]:
    """Build the scene of a body pushed by a round tip along its measured path, from contact on.

    `path` (n, 4) has times [s] and poses [m, m, rad]. A path that starts inside the body is
    corrected during `fade` [s]; `contact` is the gap [m] and the shift [m] of its start by
    `moved_to_contact`, if they are known. `words` name pusher and body in flags. The scene is None
    if the tip starts too deep in the body or the scene is impossible; flags have the reason, or the
    correction.
    """
    if contact is None:
        gaps, offsets = moved_to_contact(body.shape, tip.radius, body.pose[None], path[:1, 1:3])
        contact = float(gaps[0]), offsets[0]
    gap, offset = contact
    if gap < -length_scale(body.shape) * MAX_CORRECTION:
        detail = f"the {words[0]} starts {-gap / MM:.3g} mm inside the {words[1]}"
        return None, (remark("no-scene", detail),)
    waypoints = corrected_path(path, offset, fade)

    def build() -> Scene:
        drive = PathDrive(waypoints=waypoints)
        driven = Pusher(
            name=pusher, shape=tip, pose=waypoints[0, 1:], drive=drive, friction=friction
        )
        return Scene(bodies=(body,), pushers=(driven,), duration=float(waypoints[-1, 0]))

    scene, flags = scene_or_flag(build)
    return scene, (*flags, correction_flag(gap)) if scene and gap < 0.0 else flags
