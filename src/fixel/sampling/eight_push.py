"""Eight pushes from which the ASME paper identifies the support of a small part.

Source: ASME 2006 paper on meso-scale manipulation, "Design of Experiments", figures 4 and 5, table
1: five pushes on the long side of the part, three on the short one, each of about 700 um, at least
three trials of each. Of the numbers of the pushes only the first is legible; the speed is not. An
offset of half a side from the midpoint is read as a probe flush with the corner.
"""

from __future__ import annotations

from math import pi
from typing import Final

import numpy as np

from fixel.model import Polygon, SupportPoints
from fixel.sampling.offsets import OffsetList
from fixel.sampling.plan import Plan
from fixel.sampling.rig import FixelLayout, PlannedShape, SamplingRig

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
    half = np.array([0.5 * PART_WIDTH, 0.5 * PART_LENGTH])
    probe = 0.5 * PROBE_SIDE * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    farther = float(half[1] - half[0])  # a rotated part is deeper along the motion
    pushes = [(test > LONG, -probe_offset(test)) for test in range(1, len(PLACES) + 1)]
    rows = tuple((farther, y, 0.5 * pi) if turned else (0.0, y, 0.0) for turned, y in pushes)
    return Plan(
        name="eight-push",
        rig=SamplingRig(
            head=Polygon(probe),
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
                outline=Polygon(half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])),
                mass=PART_MASS,
                support=SupportPoints(points=np.array(SUPPORT), friction=MU_PLANE),
                zone_start=PROBE_TRAVEL + 2.0 * PART_LENGTH,
            ),
        ),
        layouts=(FixelLayout(name="open", pegs=()),),
        schemes=(OffsetList(rows),),
        repetitions=3,
    )
