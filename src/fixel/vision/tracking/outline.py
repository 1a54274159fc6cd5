"""Where a flat rigid thing lies, from the edges it shows.

One engine for tags, silhouettes and cylinders: points on the thing's edges, a pose to start from,
edges looked for along their normals, and least squares for the pose that puts the points there.
The pose is planar: what moves on the plate cannot flip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple, final

import numpy as np

from fixel.model.fields import Comparable, settle
from fixel.typing import BoolArray, FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray
from fixel.vision.tracking.loops import box_of, edges_along, edges_expected
from fixel.vision.tracking.optics import optics_of
from fixel.vision.tracking.solver import plausible, solve_robustly

ROBUST: Final = 3.0  # scatters beyond which an edge counts for nothing
MIN_SCATTER: Final = 0.06  # [px] of edges that are as good as they get
MIN_SHARE: Final = 0.25  # of all points that must show an edge
BESIDE_IT: Final = 6.0  # [px] beside what is looked for, for brightness next to it
MIN_WINDOW: Final = 4  # [px] of a window
NEAR: Final = 3.2  # [px] that edges are looked for once the pose is known roughly
FORESEEN: Final = 0.2  # [px] likewise, of the first look, which reaches farther
MAX_SPREAD: Final = 1.0  # [px] of dark into bright, or of bright into dark
WHOLE: Final = 0.8  # of the edges: where fewer show, a spread cannot be told from a shift
SETTLED: Final = 0.35  # [px] of movement below which a second look at the same place adds nothing


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutlineEdges(Comparable):
    """Points on the edges of a thing.

    Attributes
    ----------
    point : (n, 2) float64
        In the frame of the thing [m].
    outward : (n, 2) float64
        From the dark side to the bright one, in the same frame [-].
    height : (n,) float64
        Above the plane [m].
    group : (n,) int64
        Which edge, or which mark, each belongs to: levels of brightness are shared within a group.
    """

    point: FloatArray
    outward: FloatArray
    height: FloatArray
    group: np.ndarray[tuple[int], np.dtype[np.int64]]
    thing: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        settle(self, thing=np.column_stack((self.point, self.outward, self.height)))


class PoseFit(NamedTuple):
    """A pose and how far to believe it.

    Attributes
    ----------
    pose : (3,) float64
        [m, m, rad].
    covariance : (3, 3) float64
        Of it, from the scatter of the edges.
    residual : float
        Root mean square distance of the edges used [px].
    share : float
        Of the points that show an edge [-].
    used : (n,) bool
        Which these are.
    found : (n, 3) float64
        Offset, darkness and brightness of each in the last look.
    spread : float
        How far dark reaches over into bright, all along the edges [px].
    """

    pose: FloatArray
    covariance: FloatArray
    residual: float
    share: float
    used: BoolArray
    found: FloatArray
    spread: float

    @property
    def deviations(self) -> FloatArray:
        """(3,) standard deviations of the pose [m, m, rad]."""
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
    """Move a pose until the edges lie where the picture has them.

    Parameters
    ----------
    picture : (height, width) uint8
    camera : Camera
    edges : OutlineEdges
    pose : (3,) float64
        To start from.
    reach : float
        How far the edges may be from there [px].
    turns : bool
        Whether the angle is looked for too.
    rounds : int
        Looks at the picture, at most.
    corner : (int, int)
        Where the upper left of `picture` is in the camera's, if it is a window of that [px].
    spread : float, optional
        How far dark reaches over into bright [px]; None, to find that too. Ink runs, and a camera
        whose grey levels are not in proportion to light makes all that is dark smaller.

    Returns
    -------
    PoseFit, or None where too few edges are to be seen to tell a pose.
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
    """As `fit_pose`, and how far dark spreads: as far as last time [px], where not all shows."""
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
    """What a fit may look at, and its corner in the picture; None where that is out of it."""
    box = np.empty((2, 2))
    if not box_of(optics_of(camera), edges.thing, pose, box):
        return None
    beyond = 2.0 * reach + BESIDE_IT  # the first look may move it by its reach
    width, height = frame.size
    left, top = (max(int(low - beyond), 0) for low in box[0])
    right = min(int(box[1, 0] + beyond) + 1, width)
    bottom = min(int(box[1, 1] + beyond) + 1, height)
    if right - left < MIN_WINDOW or bottom - top < MIN_WINDOW:
        return None
    # Always a copy: of each kind of array the loops would be compiled anew.
    return np.array(frame.luma_in(slice(top, bottom), slice(left, right))), (left, top)


def circle_edges(
    radius: float, height: float, *, dark_inside: bool, points: int = 40
) -> OutlineEdges:
    """Points on a circle about the origin."""
    angle = 2.0 * np.pi * np.arange(points) / points
    outward = np.column_stack((np.cos(angle), np.sin(angle)))
    return OutlineEdges(
        point=radius * outward,
        outward=outward if dark_inside else -outward,
        height=np.full(points, height),
        group=np.zeros(points, dtype=np.int64),
    )
