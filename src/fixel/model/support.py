"""Supports of bodies on the plane: points, tripod, pressure, ellipsoid; points of a footprint.

The plane has its anisotropic and uneven friction, and its unevenness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import pi
from typing import Annotated, Final, final

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    finite,
    floats,
    frozen,
    inner_share,
    instance,
    non_negative,
    numbers,
    positive,
    settle,
    table,
    vector,
)
from fixel.model.shape import Disk, Polygon, Shape
from fixel.typing import ArrayField, FloatArray

# Outlines with more corners than this count as smooth curves.
MAX_CORNERS: Final = 12
# Polygons with more corners are divided by a grid, since every corner is that of a triangle else.
MAX_FAN_CORNERS: Final = 128
COARSER: Final = 1.02  # factor of the pitch of the grid, until it has few enough cells
# Shapes whose cells are kept, and triangles whose division is.
MAX_KEPT: Final = 64
# Points of the outer and of the inner ring under a smooth outline.
SMOOTH_RINGS: Final = (10, 6)
# Sizes of the two rings relative to the outline, about its centroid. The exact value is irrelevant:
# on real pushes 0.85 to 0.98 gave the same errors (docs/how-to/benchmark-on-real-pushes.md).
OUTER: Final = 0.93
INNER: Final = 0.48


@lru_cache(MAX_KEPT)
def cells(shape: Shape, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Compute centroids (n, 2) of about `n_points` cells that tile a shape, and shares of the area.

    Centroids are in the frame of the shape [m]; shares (n,) are positive with sum 1 [-]. The
    weighted mean of the points is the centroid of the shape, to rounding. The arrays are read-only,
    since the cells of the latest shapes are kept: bodies are often built again.
    """
    if isinstance(shape, Disk):
        points, share = _disk_cells(shape, n_points)
    elif len(shape.vertices) > MAX_FAN_CORNERS:
        points, share = _grid_cells(shape, n_points)
    else:
        points, share = _polygon_cells(shape, n_points)
    points.flags.writeable = share.flags.writeable = False
    return points, share


def _disk_cells(disk: Disk, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Place rings at the Gauss-Legendre nodes of r^2, each turned by half a point."""
    n_rings = max(1, round((n_points / 2.0) ** 0.5))
    per_ring = max(3, round(n_points / n_rings))
    node, weight = np.polynomial.legendre.leggauss(n_rings)
    radius = disk.radius * np.sqrt(0.5 * (node + 1.0))
    angle = (np.arange(per_ring) + 0.5 * np.arange(n_rings)[:, None]) * (2.0 * pi / per_ring)
    points = radius[:, None, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return points.reshape(-1, 2), np.repeat(0.5 * weight / per_ring, per_ring)


def _polygon_cells(polygon: Polygon, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Cut convex pieces into fans about their centroids, and these triangles into equal ones."""
    points, areas = [], []
    for triangle in _fans(polygon):
        (ax, ay), (bx, by) = (triangle[1:] - triangle[0]).tolist()
        area = 0.5 * abs(ax * by - ay * bx)
        per_side = max(1, round((n_points * area / polygon.area) ** 0.5))
        points.append(_similar_cells(per_side) @ triangle)
        areas.append(np.full(per_side**2, area / per_side**2))
    share = np.concatenate(areas)
    share /= share.sum()
    found = np.concatenate(points)
    return found + (polygon.centroid - share @ found), share


def _grid_cells(polygon: Polygon, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Cut a polygon by a square grid about its centroid, with at most `n_points` cells."""
    outline = shapely.Polygon(polygon.vertices - polygon.centroid)
    shapely.prepare(outline)
    far = float(np.hypot(*(polygon.vertices - polygon.centroid).T).max())
    pitch = (polygon.area / n_points) ** 0.5
    while True:
        reach = int(np.ceil(far / pitch))
        left = pitch * np.arange(-reach, reach)
        x, y = (axis.reshape(-1) for axis in np.meshgrid(left, left))
        boxes = shapely.box(x, y, x + pitch, y + pitch)
        boxes = boxes[shapely.intersects(outline, boxes)]
        if len(boxes) <= max(n_points, 4):
            break
        pitch *= COARSER
    parts = shapely.intersection(outline, boxes)
    area = shapely.area(parts)
    parts, area = parts[area > 0.0], area[area > 0.0]
    share = area / area.sum()
    found = shapely.get_coordinates(shapely.centroid(parts))
    return found + (polygon.centroid - share @ found), share


def _fans(polygon: Polygon) -> list[FloatArray]:
    """Return triangles (3, 2) that tile a polygon."""
    triangles = []
    for vertices, _ in polygon.pieces:
        centre = polygon.centroid if polygon.is_convex else Polygon(vertices).centroid
        following = np.roll(vertices, -1, axis=0)
        triangles += [np.array([centre, a, b]) for a, b in zip(vertices, following, strict=True)]
    return triangles


@lru_cache(MAX_KEPT)
def _similar_cells(per_side: int) -> FloatArray:
    """Barycentric centroids (per_side^2, 3) of the equal triangles that tile one."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(per_side) for j in range(per_side - i)]
    inverted = [(i + 2 / 3, j + 2 / 3) for i in range(per_side) for j in range(per_side - i - 1)]
    first, second = np.array(upright + inverted).T / per_side
    return np.column_stack((1.0 - first - second, first, second))


def support_grid(
    shape: Shape, *, outer: float = OUTER, inner: float = INNER
) -> tuple[FloatArray, NDArray[np.str_]]:
    """Create support points (n, 2) on two scaled outlines and at the centroid [m].

    Return also the part (n,) of the outline that each represents: `corner`, `edge`, `ring` of a
    smooth one, or `inside`.

    For outlines with corners these are all corners and the middles of the edges of the outer copy,
    and the corners of the inner one. For smooth ones they are evenly spaced, with those of the
    inner copy half a step on. Points outside an outline that is not convex are left out.
    """
    for name, size in (("outer", outer), ("inner", inner)):
        inner_share(size, f"net.{name}")
    centre = shape.centroid
    smooth = isinstance(shape, Disk) or len(shape.outline) > MAX_CORNERS
    if smooth:
        rings = {
            "ring": _evenly(shape, outer, SMOOTH_RINGS[0], 0.0),
            "inside": _evenly(shape, inner, SMOOTH_RINGS[1], 0.5),
        }
    else:
        corners = centre + outer * (shape.outline - centre)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        rings = {
            "corner": corners,
            "edge": middles,
            "inside": centre + inner * (shape.outline - centre),
        }
    rings["inside"] = np.concatenate((rings["inside"], centre[None]))
    points = np.concatenate(list(rings.values()))
    part = np.concatenate([np.full(len(ring), name) for name, ring in rings.items()])
    inside = shapely.intersects_xy(shapely.Polygon(shape.outline), points[:, 0], points[:, 1])
    return points[inside], part[inside]


def _evenly(shape: Shape, size: float, n: int, lead: float) -> FloatArray:
    """Points (n, 2) evenly spaced along a scaled copy of an outline, offset by `lead` steps."""
    outline = shapely.Polygon(shape.outline)
    copy = shapely.affinity.scale(outline, size, size, origin=tuple(shape.centroid.tolist()))
    along = (np.arange(n) + lead) / n
    points = shapely.line_interpolate_point(copy.exterior, along, normalized=True)
    return np.asarray(shapely.get_coordinates(points))


# Share of the weight below which a negative load is a rounding error and becomes zero.
LOAD_ROUNDING = 1e-12


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Tripod(Comparable):
    """Three equal support points, equilateral about the centre of mass.

    Parameters
    ----------
    radius : float
        Distance of the points from the centre of mass [m].
    friction : float
        Coefficient of friction against the plane [-].
    angle : float
        Angle of the first point from the body's x axis [rad].

    Examples
    --------
    >>> from fixel.units import mm
    >>> Tripod(radius=38 * mm, friction=0.25).radius
    0.038
    """

    radius: Annotated[float, Value(positive, "m")]
    friction: Annotated[float, Value(non_negative)]
    angle: Annotated[float, Value(finite, "rad")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "tripod")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SupportPoints(Comparable):
    """Support at given points.

    Loads on three points follow from the balance out of the plane; others are given or equal.

    Parameters
    ----------
    points : (n, 2) array_like
        Points in the frame of the shape [m].
    friction : float or (n,) array_like
        Coefficients of friction against the plane [-].
    loads : (n,) array_like, optional
        Normal force at each point [N]; not for three points.

    Examples
    --------
    >>> feet = [(-0.03, -0.02), (0.03, -0.02), (0.0, 0.04)]
    >>> SupportPoints(points=feet, friction=0.25).points.shape
    (3, 2)
    """

    points: Annotated[FloatArray, Value(table, "x [m], y [m]")]
    friction: float | FloatArray
    loads: FloatArray | None = None

    def __post_init__(self) -> None:
        points = table(self.points, "points.at", "x [m], y [m]")
        friction = self.friction
        if np.ndim(friction) == 0:
            friction = non_negative(friction, "points.friction")
        else:
            friction = _one_per_point(friction, len(points), "points.friction", "coefficient")
        loads = self.loads
        if loads is not None:
            loads = _one_per_point(loads, len(points), "points.loads", "load [N]")
            _check_loads(loads)
        settle(self, points=points, friction=friction, loads=loads)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class UniformPressure(Comparable):
    """Even pressure over the footprint, as quadrature points.

    For a centre of mass away from the centroid, the pressure is tilted linearly to balance it.

    Parameters
    ----------
    friction : float
        Coefficient of friction against the plane [-].
    n_points : int
        Approximate number of points of the footprint; the exact one depends on the shape.

    Examples
    --------
    >>> UniformPressure(friction=0.25).n_points
    64
    """

    friction: Annotated[float, Value(non_negative)]
    n_points: int = 64

    def __post_init__(self) -> None:
        n_points = finite(self.n_points, "uniform.n_points")
        if n_points != int(n_points) or not 3 <= n_points <= 100_000:
            found, expected = self.n_points, "a whole number from 3 to 100000"
            raise InvalidInput("uniform.n_points", found=found, expected=expected)
        check_fields(self, "uniform")
        settle(self, n_points=int(n_points))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Ellipsoid(Comparable):
    """Ellipsoidal limit surface. Prefer points where the pressure is known.

    Parameters
    ----------
    force : float
        Largest friction force, sliding without rotation [N].
    torque : float
        Largest friction torque, rotating about the centre [N m].
    centre : (2,) array_like
        Centre of friction in the frame of the shape [m].

    References
    ----------
    :cite:t:`howe1996`; :cite:t:`goyal1991`.

    Examples
    --------
    >>> Ellipsoid(force=0.37, torque=0.014).centre
    array([0., 0.])
    """

    force: Annotated[float, Value(positive, "N")]
    torque: Annotated[float, Value(positive, "N m")]
    centre: Annotated[ArrayField, Value(vector, "x [m], y [m]")] = (0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        check_fields(self, "ellipsoid")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class NoSupport(Comparable):
    """Support without friction.

    Examples
    --------
    >>> from fixel.model import Body, Disk
    >>> Body("puck", Disk(0.03), mass=0.1).support == NoSupport()
    True
    """


Support = Tripod | SupportPoints | UniformPressure | Ellipsoid | NoSupport


def support_points(
    support: Support, shape: Shape, centre_of_mass: ArrayLike, mass: float, gravity: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the support points (n, 2) [m] of a body, and their loads [N] and friction [-].

    Points are relative to the centre of mass, in body axes; `NoSupport` has none. The centre of
    mass (2,) is in the frame of the shape [m]. An `Ellipsoid`, or a support that cannot carry the
    centre of mass, raises `InvalidInput`.
    """
    com = np.asarray(centre_of_mass, dtype=np.float64)
    weight = mass * gravity
    friction: float | FloatArray
    if isinstance(support, Tripod):
        angle = support.angle + np.arange(3) * (2.0 * pi / 3.0)
        points = support.radius * np.column_stack((np.cos(angle), np.sin(angle)))
        loads = np.full(3, weight / 3.0)
        friction = support.friction
    elif isinstance(support, SupportPoints):
        points = support.points - com
        loads = _point_loads(support, points, com, weight)
        friction = support.friction
    elif isinstance(support, UniformPressure):
        points, share = cells(shape, support.n_points)
        points = points - com
        loads = weight * _tilted(share, points, com)
        friction = support.friction
    elif isinstance(support, NoSupport):
        points, loads, friction = np.zeros((0, 2)), np.zeros(0), 0.0
    else:
        expected = "Tripod, SupportPoints, UniformPressure or NoSupport"
        hint = "an ellipsoidal limit surface has no points"
        raise InvalidInput("support", found=type(support).__name__, expected=expected, hint=hint)
    return frozen(points), frozen(loads), frozen(np.broadcast_to(friction, loads.shape))


def _point_loads(
    support: SupportPoints, points: FloatArray, com: FloatArray, weight: float
) -> FloatArray:
    if support.loads is not None:
        return support.loads
    n = len(points)
    if n != 3:
        return np.full(n, weight / n)
    return weight * _barycentric(points, com)


def _barycentric(points: FloatArray, com: FloatArray) -> FloatArray:
    """Shares of three points in a weight at the origin; raise if one would pull."""
    share = triangle_shares(points)
    if np.isnan(share).any():
        found, hint = "three points on one line", "give more points, or move one"
        raise InvalidInput("support.points.at", found=found, expected="a triangle", hint=hint)
    if share.min() < -LOAD_ROUNDING:
        weights = ", ".join(f"{s:.4g}" for s in share)
        raise InvalidInput(
            "support.points.at",
            found=f"the centre of mass ({com[0]:g}, {com[1]:g}) outside the support triangle"
            f" (barycentric weights {weights})",
            expected="weights of at least 0",
            hint="the body would tip over: move a point, or the centre of mass",
        )
    return np.maximum(share, 0.0)


def triangle_shares(points: FloatArray) -> FloatArray:
    """Shares (..., 3) of three points (..., 3, 2) in a weight at the origin.

    These are the barycentric coordinates of the origin: negative where a point would have to pull,
    NaN where the three lie on one line.

    Source: ASME 2006 paper, balance out of the plane.
    """
    a, b, c = (points[..., k, :] for k in range(3))
    with np.errstate(over="ignore", invalid="ignore"):  # points too far away for their area
        area = np.stack((_cross(b, c), _cross(c, a), _cross(a, b)), axis=-1)
        total = area.sum(axis=-1, keepdims=True)
        size = np.ptp(points, axis=-2).max(axis=-1)[..., None]
        flat = ~(np.abs(total) >= 1e-9 * size**2) | ~np.isfinite(total)
    share = np.divide(area, total, out=np.full_like(area, np.nan), where=~flat & (size > 0.0))
    return np.asarray(share)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _tilted(share: FloatArray, points: FloatArray, com: FloatArray) -> FloatArray:
    """Tilt shares of the weight to balance it; raise if one would be negative."""
    tilted = tilted_shares(share, points)
    if tilted.min() < -LOAD_ROUNDING:
        x, y = -(share @ points)
        raise InvalidInput(
            "support.uniform",
            found=f"a centre of mass at ({com[0]:g}, {com[1]:g}),"
            f" ({x:g}, {y:g}) m from the centroid: the pressure would be negative at one end",
            expected="a centre of mass closer to the centroid",
            hint="give support points instead",
        )
    return np.maximum(tilted, 0.0)


def tilted_shares(share: FloatArray, points: FloatArray) -> FloatArray:
    """Tilt shares (..., n) of the weight under p0 to p0 (1 + a . r), such that their centre is the
    origin; they may come out negative. Points (n, 2) are relative to the centre of mass [m].
    """
    centroid = times_each(share, points)
    r = points - centroid[..., None, :]
    moment = np.swapaxes(share[..., None] * r, -1, -2) @ r
    tilt = np.linalg.solve(moment, -centroid[..., None])
    return np.asarray(share * (1.0 + (r @ tilt)[..., 0]))


def times_each(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Multiply rows (..., k) by a matrix (k, m), each by itself: in a product of all, the last bits
    of a row depend on the number of rows."""
    return np.asarray((rows[..., None, :] @ matrix)[..., 0, :])


def _one_per_point(value: ArrayLike, n: int, where: str, what: str) -> FloatArray:
    expected = f"one {what} for each of the {n} points"
    row = floats(value, where, expected)
    if row.shape != (n,):
        raise InvalidInput(where, found=f"{row.size} values", expected=expected)
    return frozen([non_negative(x, f"{where}[{k}]") for k, x in enumerate(row.tolist())])


def _check_loads(loads: FloatArray) -> None:
    if len(loads) == 3:
        found = "loads for three points"
        expected = "no loads, since equilibrium determines them"
        hint = "remove the loads, or split one point into two"
        raise InvalidInput("points.loads", found=found, expected=expected, hint=hint)
    if loads.sum() <= 0.0:
        raise InvalidInput("points.loads", found="only zeros", expected="at least one load above 0")


# --- friction and unevenness of the plane ---------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class FrictionMap(Comparable):
    """Multiplier of support friction that depends on the place.

    It is bilinear between the nodes of a grid, and constant beyond the border.

    Parameters
    ----------
    origin : (2,) array_like
        World position of node [0, 0] [m].
    cell : (2,) array_like
        Distance of neighbouring nodes along x and y [m].
    factor : (n_y, n_x) array_like
        Multiplier at each node, row by row from low y to high [-].
    """

    origin: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    cell: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    factor: FloatArray

    def __post_init__(self) -> None:
        _check_grid(self, "friction_map", "factor")
        for row, column in np.argwhere(self.factor <= 0.0).tolist():
            raise InvalidInput(
                f"friction_map.factor[{row}][{column}]",
                found=float(self.factor[row, column]),
                expected="a factor greater than 0",
            )

    def at(self, position: ArrayLike) -> FloatArray:
        """Interpolate the multipliers (...) at world positions (..., 2) [m]."""
        return _bilinear(self.origin, self.cell, self.factor, position)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LoadMap(Comparable):
    """Unevenness of a table, as the logarithm of a factor of the loads on support points by place.

    A rigid part on an uneven table presses more where the table is high. The loads are those at the
    start of the motion, balanced so that their centre and sum do not change; hence a constant or an
    inclined map has no effect, nor has any map on parts on three points. It is bilinear between the
    nodes of a grid, and constant beyond the border.

    Parameters
    ----------
    origin : (2,) array_like
        World position of node [0, 0] [m].
    cell : (2,) array_like
        Distance of neighbouring nodes along x and y [m].
    log_load : (n_y, n_x) array_like
        Logarithm of the factor at each node, row by row from low y to high [-].

    Examples
    --------
    >>> hill = LoadMap(origin=(0, 0), cell=(0.1, 0.1), log_load=[[0.0, 0.0], [0.0, 1.0]])
    >>> float(hill.at((0.05, 0.05)))
    0.25
    """

    origin: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    cell: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    log_load: FloatArray

    def __post_init__(self) -> None:
        _check_grid(self, "load_map", "log_load")

    def at(self, position: ArrayLike) -> FloatArray:
        """Interpolate the logarithms (...) at world positions (..., 2) [m]."""
        return _bilinear(self.origin, self.cell, self.log_load, position)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Plane(Comparable):
    """Multipliers of the friction of all supports.

    Parameters
    ----------
    anisotropy : (2,) array_like
        Factors along the principal axes of the plane [-].
    axis : float
        Angle of the first principal axis from world x [rad].
    friction_map : FrictionMap, optional
        Multiplier by place.
    load_map : LoadMap, optional
        Unevenness of the table, which changes how parts press on it.

    Examples
    --------
    >>> Plane(anisotropy=(1.1, 0.9)).anisotropy
    array([1.1, 0.9])
    """

    anisotropy: Annotated[ArrayField, Value(vector, "along the axis, across it")] = (1.0, 1.0)  # type: ignore[assignment]
    axis: Annotated[float, Value(finite, "rad")] = 0.0
    friction_map: FrictionMap | None = None
    load_map: LoadMap | None = None

    def __post_init__(self) -> None:
        check_fields(self, "plane")
        if (self.anisotropy <= 0.0).any():
            found = self.anisotropy.tolist()
            raise InvalidInput("plane.anisotropy", found=found, expected="factors greater than 0")
        for name, kind in (("friction_map", FrictionMap), ("load_map", LoadMap)):
            expected = f"a {kind.__name__}, or None"
            instance(getattr(self, name), kind | None, f"plane.{name}", expected)


def _check_grid(own: FrictionMap | LoadMap, where: str, name: str) -> None:
    """Check the fields of a map and store them; its values (n_y, n_x) are rows of equal length."""
    check_fields(own, where)
    if (own.cell <= 0.0).any():
        found = own.cell.tolist()
        raise InvalidInput(f"{where}.cell", found=found, expected="numbers greater than 0 [m]")
    values = getattr(own, name)
    try:
        width = len(values[0])
    except (TypeError, IndexError, KeyError):
        found = f"the type {type(values).__name__}"
        raise InvalidInput(f"{where}.{name}", found=found, expected=f"rows of {name}s") from None
    settle(own, **{name: table(values, f"{where}.{name}", ", ".join([name] * width))})


def _bilinear(
    origin: FloatArray, cell: FloatArray, grid: FloatArray, position: ArrayLike
) -> FloatArray:
    """Interpolate a grid (n_y, n_x) at positions (..., 2)."""
    n_y, n_x = grid.shape
    node = (numbers(position, "position") - origin) / cell
    column = np.clip(node[..., 0], 0.0, n_x - 1.0)
    row = np.clip(node[..., 1], 0.0, n_y - 1.0)
    left = np.minimum(column.astype(np.intp), max(n_x - 2, 0))
    low = np.minimum(row.astype(np.intp), max(n_y - 2, 0))
    right, high = np.minimum(left + 1, n_x - 1), np.minimum(low + 1, n_y - 1)
    u, v = column - left, row - low
    below = (1.0 - u) * grid[low, left] + u * grid[low, right]
    above = (1.0 - u) * grid[high, left] + u * grid[high, right]
    return np.asarray((1.0 - v) * below + v * above)
