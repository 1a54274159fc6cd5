"""Registration of the pusher, from its apparent gaps to the object that it touches.

A tracker and a robot each have a frame. If the shift between them is unknown, a tip that touches
the object seems to be a millimetre away from it on one side, and a millimetre inside on the other.
The shift can be found without simulation.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import Shape
from fixel.model.fields import positive
from fixel.model.overlap import gaps_and_normals
from fixel.typing import BoolArray, FloatArray

# Gaps above this belong to pushers that have left the object [m].
LARGEST_GAP: Final = 2.5e-3
# Scatter of gaps when the frames agree; larger gaps have decreasing weights [m].
SCATTER: Final = 0.25e-3
# Iterations of reweighting; the shift settles to a micrometre in about ten.
ROUNDS: Final = 50
# After this number of rounds, gaps above three times the scatter and `MIN_CUT` [m] are ignored.
WARM_UP: Final = 4
MIN_CUT: Final = 0.8e-3


class Registration(NamedTuple):
    """Shift from the recorded to the real position of the pusher, in the world."""

    shift: FloatArray  # (2,) [m]: `registration_x`, `registration_y`
    n_touching: int  # poses that count as contact
    scatter_before: float  # median absolute gap of these, as recorded [m]
    scatter_after: float  # the same with the shift [m]


def registration_from_gaps(
    shape: Shape,
    radius: float,
    pose: FloatArray,
    tip: FloatArray,
    *,
    prior: ArrayLike = (0.0, 0.0),
    prior_sd: float = 1e-3,
) -> Registration:
    """Estimate the shift of a round tip that brings it into contact with the object.

    Solves gap + normal . shift = 0 over all poses, robustly: poses of a tip that has left the
    object get the weight zero.

    Parameters
    ----------
    shape, radius, pose, tip
        Arguments of `gaps_and_normals`; the tip should touch at most poses (ends of pushes).
    prior : (2,) array_like
        Expected shift [m].
    prior_sd : float
        Standard deviation of the expected shift [m]. It determines the shift where the poses are
        few or were all pushed from one side.

    Source
    ------
    Iterated reweighting: Holland & Welsch (1977), with the weight of soft L1.
    """
    positive(prior_sd, "prior_sd", "m")
    gap, normal = gaps_and_normals(shape, radius, pose, tip)
    near = np.abs(gap) < LARGEST_GAP
    if not near.any():
        raise InvalidInput(
            "registration",
            found="no tip close to the object",
            expected=f"gaps below {LARGEST_GAP * 1e3:g} mm, at the ends of pushes",
        )
    expected = np.asarray(prior, np.float64)
    shift, used = np.array(expected), near
    for k in range(ROUNDS):
        rest = gap + normal @ shift
        used = near if k < WARM_UP else _touching(rest)
        weight = used / np.sqrt(1.0 + (rest / SCATTER) ** 2)
        rows = np.vstack((normal * weight[:, None], np.eye(2) * SCATTER / prior_sd))
        right = np.concatenate((-gap * weight, expected * SCATTER / prior_sd))
        shift = np.asarray(np.linalg.lstsq(rows, right)[0], np.float64)
    rest = gap + normal @ shift
    return Registration(
        shift,
        int(used.sum()),
        float(np.median(np.abs(gap[used]))),
        float(np.median(np.abs(rest[used]))),
    )


def _touching(rest: FloatArray) -> BoolArray:
    near = np.abs(rest) < LARGEST_GAP
    scatter = 1.48 * np.median(np.abs(rest[near])) if near.any() else 0.0
    return np.asarray(np.abs(rest) < max(MIN_CUT, 3.0 * float(scatter)))
