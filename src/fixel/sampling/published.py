"""Plans that come with fixel: of the thesis, of the ASME paper, and of equal pushes on a table.

The thesis: two shapes, ten layouts, 21 configurations, 420 experiments.

Source: RPI thesis (2011), sections 1.3, 4.2 and 5.3. Its sizes and steps are used where they are
legible. Mass and side of the square, head and radius of the fixels are those of the laboratory's
public files (2dgad). Ours are the coordinates of the pegs, which the thesis only draws, the
frictions, and the tripod radii: mean distances from the centre, as under uniform pressure.
Ambiguous passages are read as follows:

- The pentagon's "107.5 mm" is the length of a side. Then its inradius exceeds the square's by the
  20 mm by which its fixel zone starts later.
- "5 cm along the direction of motion" is a gap from the head's face to the nearest point of the
  object: as a distance of the centres it would be too small.
- The step of theta, lost in print, is pi/10: figures show 4 pi/10.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from math import cos, pi, radians, sin
from typing import Final

import numpy as np

from fixel.model import Disk, Polygon, SupportPoints, Tripod, UniformPressure
from fixel.sampling.offsets import Nominal, Offset, OffsetAxis, OffsetList, Triple
from fixel.sampling.plan import Plan, object_pose
from fixel.sampling.rig import FixelLayout, PlannedShape, RegularPolygon, SamplingRig

MASS: Final = 0.2564  # [kg] mass of the square; that of the pentagon is unknown and assumed equal
SUPPORT_FRICTION: Final = 0.25

# Unit coordinates (u along the motion, v from right to left); ours. Pegs do not overlap the object
# at any offset, and in quasi-static simulation the object touches one in all but 19 of the 420
# experiments: at offsets of 24 mm or more along y, it slides past the pegs. "Tight" and "wide"
# lines are normal to the motion, the others at 45 degrees to it: plus is near on the right and
# far on the left. A concave layout is such a line whose middle peg is moved away from
# the object. The thesis calls its layouts "fixel configurations" by numbers from 1 to 10: the four
# collinear ones, read in the order of its section 4.2.4.3, then the six concave ones of section
# 4.2.4.4. Captions of figures 4.10 and 4.12 name the wide layout first, the text, which we follow,
# the tight one.
LAYOUTS: Final = (
    FixelLayout(number=1, name="collinear-tight", pegs=((0.60, 0.34), (0.60, 0.50), (0.60, 0.66))),
    FixelLayout(number=2, name="collinear-wide", pegs=((0.56, 0.22), (0.56, 0.50), (0.56, 0.78))),
    FixelLayout(number=3, name="collinear-plus45", pegs=((0.54, 0.29), (0.65, 0.40), (0.76, 0.51))),
    FixelLayout(
        number=4, name="collinear-minus45", pegs=((0.54, 0.71), (0.65, 0.60), (0.76, 0.49))
    ),
    FixelLayout(number=5, name="concave-tight", pegs=((0.53, 0.27), (0.69, 0.50), (0.53, 0.73))),
    FixelLayout(number=6, name="concave-wide", pegs=((0.46, 0.12), (0.70, 0.50), (0.46, 0.88))),
    FixelLayout(number=7, name="concave-plus45", pegs=((0.50, 0.26), (0.72, 0.26), (0.72, 0.48))),
    FixelLayout(number=8, name="concave-minus45", pegs=((0.50, 0.74), (0.72, 0.74), (0.72, 0.52))),
    FixelLayout(number=9, name="asymmetric-a", pegs=((0.57, 0.21), (0.65, 0.58), (0.47, 0.80))),
    FixelLayout(number=10, name="asymmetric-b", pegs=((0.53, 0.31), (0.59, 0.42), (0.52, 0.75))),
)


@cache
def thesis_plan() -> Plan:
    """Return the plan of the thesis with 420 experiments and our own peg coordinates."""
    return Plan(
        name="thesis",
        rig=SamplingRig(
            head=RegularPolygon(sides=4, side=0.0287),
            speed=0.0135,
            travel=0.150,
            force_limit=34.3,
            head_friction=0.2,
            fixel_friction=0.2,
            fixel_radius=0.0047625,
            zone_side=0.210,
            gap=0.050,
            angle=pi / 8,
        ),
        shapes=(
            PlannedShape(
                name="square",
                outline=RegularPolygon(sides=4, side=0.1068),
                mass=MASS,
                support=Tripod(radius=0.0409, friction=SUPPORT_FRICTION),
                zone_start=0.125,
            ),
            PlannedShape(
                name="pentagon",
                outline=RegularPolygon(sides=5, side=0.1075),
                mass=MASS,
                support=Tripod(radius=0.0534, friction=SUPPORT_FRICTION),
                zone_start=0.145,
            ),
        ),
        layouts=LAYOUTS,
        schemes=(
            Nominal(),
            OffsetAxis(name="x", step=0.005, first=1, last=5),
            OffsetAxis(name="y", step=0.008, first=-5, last=5),
            OffsetAxis(name="theta", step=pi / 10, first=1, last=5),
        ),
    )


# --- eight pushes from which the ASME paper identifies the support of a small part ---------------
#
# Source: ASME 2006 paper on meso-scale manipulation, "Design of Experiments", figures 4 and 5,
# table 1: five pushes on the long side of the part, three on the short one, each of about 700 um,
# at least three trials of each. Of the numbers of the pushes only the first is legible; the speed
# is not. An offset of half a side from the midpoint is read as a probe flush with the corner.

PART_WIDTH: Final = 842e-6  # [m], along the part's x axis
PART_LENGTH: Final = 1621e-6  # [m], along the part's y axis
# [kg], beryllium copper of 8250 kg/m^3, 1.5 mil thick.
PART_MASS: Final = 8250.0 * PART_WIDTH * PART_LENGTH * 38.1e-6
PROBE_SIDE: Final = 25e-6  # [m]
PROBE_TRAVEL: Final = 700e-6  # [m]
PROBE_SPEED: Final = 1e-4  # [m/s]; ours

# Column p1* of table 1 with restored decimal points: support points [m], friction.
SUPPORT: Final = ((411.3e-6, -563.3e-6), (-409.1e-6, 605.9e-6), (-273.2e-6, -102.1e-6))
MU_PROBE: Final = 0.666
MU_PLANE: Final = 0.757

# Position of the probe on the side, from its midpoint, over its length: points C, B, D, A, E of the
# long side, then G, F, H of the short one.
PLACES: Final = (0.0, 0.25, -0.25, 0.5, -0.5, 0.0, 0.5, -0.5)
LONG: Final = 5  # number of these on the long side


def probe_offset(test: int) -> float:
    """Return the position of the probe in test 1 to 8, from the midpoint of the side [m]."""
    side = PART_LENGTH if test <= LONG else PART_WIDTH
    reach = 0.5 * (side - PROBE_SIDE)
    return float(np.clip(PLACES[test - 1] * side, -reach, reach))


def eight_push_plan() -> Plan:
    """Return the eight pushes as a plan, three trials of each; no fixels stand on the plate.

    Offsets 1 to 8 are the tests. The part rests on the three points of the paper's first estimate.
    """
    farther = 0.5 * (PART_LENGTH - PART_WIDTH)  # a rotated part is deeper along the motion
    pushes = [(test > LONG, -probe_offset(test)) for test in range(1, len(PLACES) + 1)]
    rows = tuple((farther, y, 0.5 * pi) if turned else (0.0, y, 0.0) for turned, y in pushes)
    return Plan(
        name="eight-push",
        rig=SamplingRig(
            head=Polygon.rectangle(PROBE_SIDE, PROBE_SIDE),
            speed=PROBE_SPEED,
            travel=PROBE_TRAVEL,
            force_limit=None,
            head_friction=MU_PROBE,
            fixel_friction=MU_PROBE,
            fixel_radius=PROBE_SIDE,
            zone_side=PART_LENGTH,
            gap=0.0,
            angle=0.0,
        ),
        shapes=(
            PlannedShape(
                name="part",
                outline=Polygon.rectangle(PART_WIDTH, PART_LENGTH),
                mass=PART_MASS,
                support=SupportPoints(points=np.array(SUPPORT), friction=MU_PLANE),
                zone_start=PROBE_TRAVEL + 2.0 * PART_LENGTH,
            ),
        ),
        layouts=(FixelLayout(name="open", pegs=()),),
        schemes=(OffsetList(rows),),
        repetitions=3,
    )


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


# --- what the publications print, for people who rely on it ---------------------------------------

_THESIS: Final = (
    ("drive, fixel zones, nominal angle, steps in x and y", "printed in the thesis"),
    ("side of the pentagon, gap, step of theta", "printed, but ambiguous or lost; our reading"),
    ("square (mass, side), head, radius of the fixels", "public files of the laboratory"),
    ("tripod radii, frictions, mass of the pentagon, pegs", "ours"),
)
_EIGHT_PUSH: Final = (
    ("size, material and thickness of the part, probe, places, travel", "printed in the paper"),
    ("support points, frictions", "first estimate of the paper, decimal points restored"),
    ("speed, numbers of tests 2 to 8", "ours"),
)


def sources_of(plan: Plan) -> tuple[tuple[str, str], ...]:
    """Return groups of values of a published plan with their sources; none for another plan."""
    if plan == thesis_plan():
        return _THESIS
    return _EIGHT_PUSH if plan == eight_push_plan() else ()
