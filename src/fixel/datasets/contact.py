"""A measured pusher beside a measured object: how far apart, and out of each other."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.calibration.registration import gaps_and_normals
from fixel.model import Flag, Shape
from fixel.typing import FloatArray

# Registration errors up to here are taken back by moving the pusher to contact; with larger ones
# nobody knows where it was [m].
MAX_CORRECTION: Final = 3e-3

# Left between the shapes after a correction, against rounding [m].
CLEARANCE: Final = 1e-9


def moved_to_contact(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far a round tip must move, along the normal, to lie outside an outline.

    Exact for convex outlines.

    Parameters
    ----------
    shape : Shape
        Of the object.
    radius : float
        Of the tip [m].
    pose : (n, 3) float64
        Of the object [m, m, rad].
    tip : (n, 2) float64
        Centre of the tip [m].

    Returns
    -------
    gap : (n,) float64
        From the surface of the tip to the outline as measured, negative in overlap [m].
    offset : (n, 2) float64
        In the world [m]; zero for tips outside.
    """
    gap, outward = gaps_and_normals(shape, radius, pose, tip)
    length = np.where(gap < 0.0, CLEARANCE - gap, 0.0)
    return gap, length[:, None] * outward


def corrected_path(path: FloatArray, offset: FloatArray, fade: float = math.inf) -> FloatArray:
    """A path whose start is moved; the correction fades to nothing, so that its end is as measured.

    Parameters
    ----------
    path : (n, 4) float64
        Time [s], pose [m, m, rad].
    offset : (2,) float64
        Of the start [m].
    fade : float
        Over how long [s]; at most over the whole path.
    """
    time = path[:, 0] - path[0, 0]
    over = min(fade, float(time[-1])) if len(time) > 1 else 0.0
    share = np.clip(1.0 - time / over, 0.0, 1.0) if over > 0.0 else np.ones(len(time))
    moved = path.copy()
    moved[:, 1:3] += share[:, None] * offset
    return moved


def correction_flag(gap: float) -> Flag:
    """What to say of a pusher that was moved to contact."""
    detail = f"in the scene, which it starts {-gap * 1e3:.3g} mm in"
    return Flag("pusher-moved-to-contact", detail, fault=False)
