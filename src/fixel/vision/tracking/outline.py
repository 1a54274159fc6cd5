"""Planar pose of a flat rigid thing from its edges in a picture.

Common to tags, silhouettes and cylinders: from a start pose, edges are found along the normals of
points on the thing, and least squares give the pose that fits the points to them. The pose is
planar, so that it cannot flip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.kernels.jit import entry, kernel
from fixel.model.fields import Comparable, settle
from fixel.typing import BoolArray, FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray
from fixel.vision.tracking.base import PartObservation
from fixel.vision.tracking.loops import box_of, edges_along, edges_expected, optics_of

ROBUST: Final = 3.0  # scatters beyond which an edge is left out
MIN_SCATTER: Final = 0.06  # [px] of the best edges
MIN_SHARE: Final = 0.25  # of all points that must have an edge
MARGIN: Final = 6.0  # [px] margin for the brightness next to edges
MIN_WINDOW: Final = 4  # [px] of a window
NEAR: Final = 3.2  # [px] reach once the pose is known roughly
FORESEEN: Final = 0.2  # [px] likewise after the first round, which reaches farther
MAX_SPREAD: Final = 1.0  # [px] of dark into bright, or of bright into dark
WHOLE: Final = 0.8  # of the edges: with fewer, spread and shift are indistinguishable
SETTLED: Final = 0.35  # [px] of movement at which the rounds end


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

    def observed(self, scale: float, sd: FloatArray, marks: int) -> PartObservation:
        """Return the pose as a measurement of a part."""
        pose, rest, share = self.pose, self.residual, self.share
        return PartObservation(
            pose=pose, residual=rest, scale=scale, sd=sd, marks=marks, share=share
        )


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
    """Fit a pose (3,) to edges in a picture (height, width) uint8; None where few are visible.

    The fit begins at `pose`, uses edges within `reach` of it [px], and has at most `rounds` rounds
    of edge detection. `corner` is the upper left corner of the picture in the camera's, of which it
    may be a window [px]. `turns` states whether the angle is fitted too. `spread` is the distance
    by which dark extends into bright [px], fitted if it is None: ink runs, and a camera whose grey
    levels are not proportional to light makes dark areas smaller.
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
    beyond = 2.0 * reach + MARGIN  # the first round may move it by its reach
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


LEVEL = 0.35  # largest deviation of brightness from the median, as a share of the contrast
MIN_LEVELS = 4  # edges that a group needs for a median

ROUNDS = 12  # largest number of weightings
CONVERGED_PX = 0.005  # [px] change between them at convergence
OPEN = 1e-3  # least over largest pivot, below which the pose is undetermined


@entry
def plausible(
    found: FloatArray, group: NDArray[np.int64], clear: BoolArray, usable: BoolArray
) -> int:
    """Write which edges have the same dark and bright levels as others of their group.

    Edges of an object that covers a marker rarely have the marker's black and white. Returns the
    number of edges selected.
    """
    n = len(group)
    dark, bright = np.empty(n), np.empty(n)
    total, start = 0, 0
    while start < n:
        end, count = start, 0
        while end < n and group[end] == group[start]:
            usable[end] = False
            if clear[end]:
                dark[count], bright[count] = found[end, 1], found[end, 2]
                count += 1
            end += 1
        if count >= MIN_LEVELS:
            half = count // 2
            low, high = np.sort(dark[:count])[half], np.sort(bright[:count])[half]
            slack = LEVEL * (high - low)
            for i in range(start, end):
                usable[i] = (
                    clear[i] and abs(found[i, 1] - low) < slack and abs(found[i, 2] - high) < slack
                )
                total += usable[i]
        start = end
    return total


@kernel
def _substitute(factor: FloatArray, column: FloatArray) -> None:
    """Solve equations with this Cholesky factor for a column, in place."""
    m = len(factor)
    for j in range(m):
        for k in range(j):
            column[j] -= factor[j, k] * column[k]
        column[j] /= factor[j, j]
    for j in range(m - 1, -1, -1):
        for k in range(j + 1, m):
            column[j] -= factor[k, j] * column[k]
        column[j] /= factor[j, j]


@kernel
def _solve(
    slope: FloatArray,
    offset: FloatArray,
    usable: BoolArray,
    weight: FloatArray,
    size: FloatArray,
    factor: FloatArray,
    step: FloatArray,
) -> bool:
    """Solve weighted least squares by a Cholesky factor of the normal equations, also written."""
    n, m = slope.shape
    factor[:] = 0.0
    step[:] = 0.0
    for i in range(n):
        if usable[i]:
            for j in range(m):
                row = weight[i] * slope[i, j] / size[j]
                step[j] += row * offset[i]
                for k in range(j + 1):
                    factor[j, k] += row * slope[i, k] / size[k]
    largest = 0.0
    for j in range(m):
        largest = max(largest, factor[j, j])
    for j in range(m):
        for k in range(j + 1):
            total = factor[j, k]
            for q in range(k):
                total -= factor[j, q] * factor[k, q]
            if j > k:
                factor[j, k] = total / factor[k, k]
            elif total < OPEN * largest or total <= 0.0:
                return False
            else:
                factor[j, j] = math.sqrt(total)
    _substitute(factor, step)
    for j in range(m):
        step[j] /= size[j]
    return True


@kernel
def _inverse(factor: FloatArray, column: FloatArray, inverse: FloatArray) -> None:
    """Write the inverse of the matrix with this Cholesky factor."""
    m = len(factor)
    for c in range(m):
        column[:] = 0.0
        column[c] = 1.0
        _substitute(factor, column)
        for j in range(m):
            inverse[j, c] = column[j]


@kernel
def _rest(slope: FloatArray, step: FloatArray, offset: FloatArray, i: int) -> float:
    """Offset of an edge that a step leaves [px]."""
    left = offset[i]
    for j in range(len(step)):
        left -= slope[i, j] * step[j]
    return float(left)


@entry
def solve_robustly(
    slope: FloatArray,
    found: FloatArray,
    usable: BoolArray,
    least: float,
    cut: float,
    step: FloatArray,
    covariance: FloatArray,
    used: BoolArray,
    room: FloatArray,
    square: FloatArray,
) -> float:
    """Solve `slope @ step = offset` by least squares without outliers.

    The offsets are the first column of `found`.
    Cauchy's weights identify the rows that agree; only these are used in the final solution.
    Writes the step (m,), its covariance (m, m), and which rows were used (n,); `room` (4, n) and
    `square` (m + 2, m) are workspace. Returns the root mean square residual [px], or -1 where the
    rows do not determine the step.
    """
    n, m = slope.shape
    offset = found[:, 0]
    weight, rest, before, sizes = room
    size, factor = square[m], square[:m]
    weight[:] = 1.0
    before[:] = 0.0
    for j in range(m):
        size[j] = np.abs(slope[:, j]).max()
        if not size[j] > 0.0:
            return -1.0
    scatter = least
    for _ in range(ROUNDS):
        if not _solve(slope, offset, usable, weight, size, factor, step):
            return -1.0
        change, count = 0.0, 0
        for i in range(n):
            if usable[i]:
                rest[i] = _rest(slope, step, offset, i)
                change = max(change, abs(rest[i] - before[i]))
                before[i] = rest[i]
                sizes[count] = abs(rest[i])
                count += 1
        scatter = max(1.4826 * np.median(sizes[:count]), least)
        if change < CONVERGED_PX:
            break
        for i in range(n):
            weight[i] = 1.0 / (1.0 + (rest[i] / scatter) ** 2)
    count = 0
    for i in range(n):
        used[i] = usable[i] and abs(rest[i]) < cut * scatter
        weight[i] = 1.0
        count += used[i]
    if count < 2 * m + 2 or not _solve(slope, offset, used, weight, size, factor, step):
        return -1.0
    total = 0.0
    for i in range(n):
        if used[i]:
            total += _rest(slope, step, offset, i) ** 2
    residual = math.sqrt(total / count)
    _inverse(factor, square[m + 1], covariance)
    variance = max(residual, least) ** 2
    for j in range(m):
        for k in range(m):
            covariance[j, k] *= variance / (size[j] * size[k])
    return residual
