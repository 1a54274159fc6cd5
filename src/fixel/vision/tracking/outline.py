"""Where a flat rigid thing lies, from the edges it shows.

One engine for tags, silhouettes and cylinders: points on the thing's edges, a pose to start from,
edges looked for along their normals, and least squares for the pose that puts the points there.
The pose is planar: what moves on the plate cannot flip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.kernels.arrays import FloatArray
from fixel.model.fields import BoolArray, Comparable
from fixel.vision.camera import Camera
from fixel.vision.frame import Gray
from fixel.vision.tracking.edges import EdgeLine, Found, find_edges
from fixel.vision.tracking.loops import solve_robustly

NUDGE: Final = 1e-5  # [m], for derivatives of pixels by places
ROBUST: Final = 3.0  # scatters beyond which an edge counts for nothing
LEAST_SCATTER: Final = 0.06  # [px] of edges that are as good as they get
LEVEL: Final = 0.35  # how far from the usual, as a share of the contrast, brightness may be
LEAST_SHARE: Final = 0.25  # of all points that must show an edge
NEAR: Final = 3.2  # [px] that edges are looked for once the pose is known roughly
FORESEEN: Final = 0.2  # [px] likewise, of the first look, which reaches farther
SETTLED: Final = 0.35  # [px] of movement below which a second look at the same place adds nothing


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edges(Comparable):
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


class Fit(NamedTuple):
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
    """

    pose: FloatArray
    covariance: FloatArray
    residual: float
    share: float
    used: BoolArray


def fit_pose(
    picture: Gray,
    camera: Camera,
    edges: Edges,
    pose: FloatArray,
    *,
    reach: float,
    turns: bool = True,
    rounds: int = 4,
    corner: tuple[int, int] = (0, 0),
) -> Fit | None:
    """Move a pose until the edges lie where the picture has them.

    Parameters
    ----------
    picture : (height, width) uint8
    camera : Camera
    edges : Edges
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

    Returns
    -------
    Fit, or None where too few edges are to be seen to tell a pose.
    """
    n_unknown = 3 if turns else 2
    fit: Fit | None = None
    for round_ in range(rounds):
        line, slope = _expected(camera, edges, pose)
        look = reach if round_ == 0 else min(reach, NEAR)
        found = find_edges(picture, line._replace(pixel=line.pixel - corner), look)
        usable = found.clear & _plausible(found, edges.group)
        solved = _solved(np.ascontiguousarray(slope[:, :n_unknown]), found.offset, usable)
        if solved is None:
            return None
        step, covariance, residual, used = solved
        pose = pose + np.pad(step, (0, 3 - n_unknown))
        full = np.zeros((3, 3))
        full[:n_unknown, :n_unknown] = covariance
        fit = Fit(pose, full, residual, float(used.mean()), used)
        if np.abs(slope[:, :n_unknown] @ step).max() < (SETTLED if round_ else FORESEEN):
            break
    return fit


def circle_edges(radius: float, height: float, *, dark_inside: bool, points: int = 40) -> Edges:
    """Points on a circle about the origin."""
    angle = 2.0 * np.pi * np.arange(points) / points
    outward = np.column_stack((np.cos(angle), np.sin(angle)))
    return Edges(
        point=radius * outward,
        outward=outward if dark_inside else -outward,
        height=np.full(points, height),
        group=np.zeros(points, dtype=np.int64),
    )


def _expected(camera: Camera, edges: Edges, pose: FloatArray) -> tuple[EdgeLine, FloatArray]:
    """Where edges are expected, and (n, 3) how they move along their normals with the pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s], [s, c]])
    place = edges.point @ turn.T
    outward = edges.outward @ turn.T
    around = np.empty((3, len(place), 3))
    around[:, :, :2] = place + pose[:2]
    around[:, :, 2] = edges.height
    around[1, :, 0] += NUDGE
    around[2, :, 1] += NUDGE
    pixel, by_x, by_y = camera.project(around)
    by_x = (by_x - pixel) / NUDGE
    by_y = (by_y - pixel) / NUDGE
    along = by_x * -outward[:, 1:] + by_y * outward[:, :1]  # the edge itself, in the picture
    normal = np.column_stack((along[:, 1], -along[:, 0]))
    normal /= np.hypot(*normal.T)[:, None]
    # The picture is mirrored against the plane; the normal has to point as `outward` does.
    across = by_x * outward[:, :1] + by_y * outward[:, 1:]
    normal *= np.sign((normal * across).sum(1))[:, None]
    dx, dy = (by_x * normal).sum(1), (by_y * normal).sum(1)
    turning = -place[:, 1] * dx + place[:, 0] * dy
    return EdgeLine(pixel, normal), np.column_stack((dx, dy, turning))


def _plausible(found: Found, group: np.ndarray[tuple[int], np.dtype[np.int64]]) -> BoolArray:
    """Which edges are as dark and as bright beside them as others of their group.

    What covers a mark shows edges of its own; they rarely are from the mark's black to its white.
    """
    keep = found.clear.copy()
    for index in range(int(group[-1]) + 1):
        own = np.flatnonzero((group == index) & found.clear)
        if len(own) < 4:
            keep[own] = False
            continue
        dark, bright = found.dark[own], found.bright[own]
        usual_dark, usual_bright = _middle(dark), _middle(bright)
        slack = LEVEL * (usual_bright - usual_dark)
        keep[own] = (np.abs(dark - usual_dark) < slack) & (np.abs(bright - usual_bright) < slack)
    return np.asarray(keep)


def _middle(values: FloatArray) -> float:
    """A median, without the care of NumPy's."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def _solved(
    slope: FloatArray, offset: FloatArray, usable: BoolArray
) -> tuple[FloatArray, FloatArray, float, BoolArray] | None:
    """Step of the pose, its covariance, scatter and the edges used; or none."""
    n, m = slope.shape
    count = int(np.count_nonzero(usable))
    if count < LEAST_SHARE * n or count < 2 * m + 2:
        return None
    step, covariance, used = np.empty(m), np.empty((m, m)), np.empty(n, dtype=np.bool_)
    residual = solve_robustly(
        slope,
        offset,
        usable,
        LEAST_SCATTER,
        ROBUST,
        step,
        covariance,
        used,
        np.empty((4, n)),
        np.empty((m + 2, m)),
    )
    return None if residual < 0.0 else (step, covariance, residual, used)
