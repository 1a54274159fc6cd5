"""Plan of equal pushes over a table, for `fixel table check`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from math import cos, radians, sin
from typing import Final

import numpy as np

from fixel.model import Disk, UniformPressure
from fixel.sampling.offsets import Offset, OffsetList, Triple
from fixel.sampling.plan import Plan, object_pose
from fixel.sampling.published import SUPPORT_FRICTION, thesis_plan
from fixel.sampling.rig import FixelLayout

OFF_CENTRE: Final = 0.025  # [m] of the contact, so that the part turns and its loads matter
# Starts of the part. Thirds of a turn tell a saddle from a flat table, halves do not.
GRID: Final = ((0.0, 0.15, 0.3), (-0.15, 0.0, 0.15))  # [m]
ANGLES: Final = (0.0, radians(120.0), radians(240.0))


@cache
def table_plan(seed: int = 0) -> Plan:
    """Return a plan of 54 equal pushes of the thesis's square at 9 places in 3 orientations.

    Each is made twice, in shuffled order, so that a drift in time is not taken for a place. The
    plan separates noise from run to run, place, orientation and a tilt of the table. It cannot
    separate drift between sessions, unless it is run in several, nor show whether pushes at other
    contacts or of other parts behave alike.

    The tip moves along +x of the rig, so the rig moves to each place and turns: as a robot does, or
    as a table does that is moved and turned under a fixed axis. Poses must be measured in the frame
    of the table. A fixed axis over a fixed table can only move a part along its own line.
    """
    usual, tip = thesis_plan(), Disk(4.75e-3)
    rig = replace(usual.rig, head=tip, travel=0.05, gap=0.002, angle=0.0, head_friction=0.25)
    square = replace(usual.shapes[0], support=UniformPressure(friction=SUPPORT_FRICTION))
    x, y, _ = object_pose(rig, square, Offset(axis="list", step=1.0, y=OFF_CENTRE)).tolist()
    places: list[Triple] = []
    for to_x, to_y, angle in product(*GRID, ANGLES):
        c, s = cos(angle), sin(angle)
        places.append((to_x - c * x + s * y, to_y - s * x - c * y, angle))
    order = np.random.default_rng(seed).permutation(2 * len(places)) % len(places)
    return replace(
        usual,
        name="table",
        rig=rig,
        shapes=(square,),
        layouts=(FixelLayout(name="open", pegs=()),),
        schemes=(OffsetList(((0.0, OFF_CENTRE, 0.0),)),),
        places=tuple(places[k] for k in order),
    )
