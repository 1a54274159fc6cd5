"""Planar pose of a flat rigid thing from its edges in a picture.

Common to tags, silhouettes and cylinders: from a start pose, edges are found along the normals of
points on the thing, and least squares give the pose that fits the points to them. The pose is
planar, so that it cannot flip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple, final

import numpy as np

from fixel.model.fields import Comparable, settle
from fixel.typing import BoolArray, FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray
from fixel.vision.tracking.loops import box_of, edges_along, edges_expected, optics_of
from fixel.vision.tracking.solver import plausible, solve_robustly

ROBUST: Final = 3.0  # scatters beyond which an edge is left out
MIN_SCATTER: Final = 0.06  # [px] of the best edges
MIN_SHARE: Final = 0.25  # of all points that must have an edge
BESIDE_IT: Final = 6.0  # [px] margin for the brightness next to edges
MIN_WINDOW: Final = 4  # [px] of a window
NEAR: Final = 3.2  # [px] reach once the pose is known roughly
FORESEEN: Final = 0.2  # [px] likewise after the first round, which reaches farther
MAX_SPREAD: Final = 1.0  # [px] of dark into bright, or of bright into dark
WHOLE: Final = 0.8  # of the edges: with fewer, spread and shift are indistinguishable
SETTLED: Final = 0.35  # [px] of movement at which the rounds end


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutlineEdges(Comparable):
    """Points on the edges of a flat thing."""

    point: FloatArray  # (n, 2) points in the frame of the thing [m]
    # (n, 2) Unit vectors from the dark side to the bright one, in the same frame [-].
    outward: FloatArray
    height: FloatArray  # (n,) heights above the plane [m]
    # Edge or marker of each point: levels of brightness are common to a group.
    group: np.ndarray[tuple[int], np.dtype[np.int64]]
    thing: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        settle(self, thing=np.column_stack((self.point, self.outward, self.height)))


class PoseFit(NamedTuple):
    """Fitted pose with its uncertainty."""

    pose: FloatArray  # (3,) fitted pose [m, m, rad]
    covariance: FloatArray  # (3, 3) covariance of the pose, from the scatter of the edges
    residual: float  # root mean square distance of the edges used [px]
    share: float  # share of the points whose edge was used [-]
    used: BoolArray  # (n,) mask of these points
    # (n, 3) Offset and brightness on the dark and the bright side of each, in the last round.
    found: FloatArray
    spread: float  # distance by which dark extends into bright along all edges [px]

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (3,) of the pose [m, m, rad]."""
        return np.sqrt(np.diag(self.covariance))


def fit_pose(
    picture: Gray,
    camera: Camera,
    edges: OutlineEdges,
    pose: FloatArray,
    *,
    reach: float,
    turns: bool = True,
    rounds: int = 4,
    corner: tuple[int, int] = (0, 0),
    spread: float | None = 0.0,
) -> PoseFit | None:
    """Fit a pose to the edges in a picture.

    Parameters
    ----------
    picture : (height, width) uint8
    camera : Camera
    edges : OutlineEdges
    pose : (3,) float64
        Start of the fit.
    reach : float
        Largest distance of edges from the start [px].
    turns : bool
        Whether to fit the angle too.
    rounds : int
        Largest number of rounds of edge detection.
    corner : (int, int)
        Upper left corner of `picture` in the camera's, if it is a window of that [px].
    spread : float, optional
        Distance by which dark extends into bright [px]; None to fit it too. Ink runs, and a camera
        whose grey levels are not proportional to light makes dark areas smaller.

    Returns
    -------
    PoseFit, or None where too few edges are visible.
    """
    n, m = len(edges.point), 3 if turns else 2
    free = m + (spread is None)
    optics = optics_of(camera)
    origin = np.array(corner, dtype=np.float64)
    pose = np.array(pose, dtype=np.float64)
    pixel, normal, slope = np.empty((n, 2)), np.empty((n, 2)), np.ones((n, free))
    found, room = np.empty((n, 3)), np.empty((4, n))
    clear, usable, used = (np.empty(n, dtype=np.bool_) for _ in range(3))
    step, covariance = np.empty(free), np.empty((free, free))
    square = np.empty((free + 2, free))
    residual = 0.0
    for look in range(rounds):
        if not edges_expected(optics, origin, edges.thing, pose, pixel, normal, slope):
            return None
        edges_along(picture, pixel, normal, min(reach, NEAR) if look else reach, found, clear)
        found[:, 0] -= spread or 0.0
        count = plausible(found, edges.group, clear, usable)
        if count < MIN_SHARE * n or count < 2 * free + 2:
            return None
        residual = solve_robustly(
            slope, found, usable, MIN_SCATTER, ROBUST, step, covariance, used, room, square
        )
        if residual < 0.0:
            return None
        pose[:m] += step[:m]
        if np.abs(slope[:, :m] @ step[:m]).max() < (SETTLED if look else FORESEEN):
            break
    full = np.zeros((3, 3))
    full[:m, :m] = covariance[:m, :m]
    share = np.count_nonzero(used) / n
    spread = float(step[m]) if spread is None else spread
    return PoseFit(pose, full, float(residual), share, used, found, spread)


def fit_spread(
    picture: Gray,
    camera: Camera,
    edges: OutlineEdges,
    pose: FloatArray,
    *,
    reach: float,
    last: float,
    rounds: int = 4,
    corner: tuple[int, int] = (0, 0),
) -> PoseFit | None:
    """Call `fit_pose` with a free spread; with that of the `last` fit [px] if parts are hidden."""
    fit: PoseFit | None = None
    for spread in (None, last):
        fit = fit_pose(
            picture, camera, edges, pose, reach=reach, rounds=rounds, corner=corner, spread=spread
        )
        if fit is not None and fit.share > WHOLE and abs(fit.spread) < MAX_SPREAD:
            break
    return fit


def window_of(
    frame: Frame, camera: Camera, edges: OutlineEdges, pose: FloatArray, reach: float
) -> tuple[Gray, tuple[int, int]] | None:
    """Return the window for a fit and its corner in the picture; None outside the picture."""
    box = np.empty((2, 2))
    if not box_of(optics_of(camera), edges.thing, pose, box):
        return None
    beyond = 2.0 * reach + BESIDE_IT  # the first round may move it by its reach
    width, height = frame.size
    left, top = (max(int(low - beyond), 0) for low in box[0])
    right = min(int(box[1, 0] + beyond) + 1, width)
    bottom = min(int(box[1, 1] + beyond) + 1, height)
    if right - left < MIN_WINDOW or bottom - top < MIN_WINDOW:
        return None
    # Always a copy: the loops would be recompiled for each memory layout.
    return np.array(frame.luma[top:bottom, left:right]), (left, top)


def circle_edges(
    radius: float, height: float, *, dark_inside: bool, points: int = 40
) -> OutlineEdges:
    """Create edges on a circle about the origin."""
    angle = 2.0 * np.pi * np.arange(points) / points
    outward = np.column_stack((np.cos(angle), np.sin(angle)))
    return OutlineEdges(
        point=radius * outward,
        outward=outward if dark_inside else -outward,
        height=np.full(points, height),
        group=np.zeros(points, dtype=np.int64),
    )
