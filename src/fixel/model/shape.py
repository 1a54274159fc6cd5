"""Shapes: geometry of bodies in their own frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import hypot, pi
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar, final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, Value, frozen, positive, settle, table, whole
from fixel.registry import offered
from fixel.typing import BoolArray, FloatArray

Item = TypeVar("Item", bound=np.generic)
Piece = tuple[FloatArray, BoolArray]

# Share of the size of a polygon below which two points are one, and a vertex lies on a straight
# edge. Larger values remove detail of finely digitised outlines.
COINCIDENT = 1e-12

# [m] Limits of the size of shapes; far beyond, squares and products leave the range of float64.
SMALLEST, LARGEST = 1e-12, 1e12

# [m] Distances of the outline from the centroid: lengths that suit parts of usual size also suit
# those from `USUAL` on; for parts below 3 mm they are scaled as from a part of `TYPICAL`.
USUAL, TYPICAL = 8e-3, 50e-3

# Corners of the polygon that represents a disk in drawings.
DRAWN_CORNERS = 64


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Polygon(Comparable):
    """Simple polygon, convex or not.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, in the frame of the shape [m], in either orientation. Clockwise ones are
        reversed; repeated vertices and vertices on a straight edge are removed.

    Attributes
    ----------
    area : float
        Area [m^2].
    centroid : (2,) float64
        Centroid in the frame of the shape [m].
    unit_inertia : float
        Polar second moment of area about the centroid, divided by the area [m^2]; times the mass it
        is the moment of inertia of a uniform body.
    is_convex : bool
        Whether it turns left at every vertex.
    pieces : tuple of ((k, 2) float64, (k,) bool)
        Convex counter-clockwise pieces [m] with a flag per edge, from vertex k to k + 1: whether it
        lies on the outline. One piece if convex.
    radius : float
        Largest distance of a vertex from the origin of the frame [m].

    Raises
    ------
    InvalidInput
        The polygon has fewer than three corners, a number that is not finite, or no area, or its
        outline crosses or touches itself.

    Examples
    --------
    >>> Polygon([(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)]).area
    0.005000000000000001
    """

    vertices: Annotated[FloatArray, Value(table, "x [m], y [m]")]
    area: float = field(init=False, repr=False, compare=False)
    centroid: FloatArray = field(init=False, repr=False, compare=False)
    unit_inertia: float = field(init=False, repr=False, compare=False)
    is_convex: bool = field(init=False, repr=False, compare=False)
    pieces: tuple[Piece, ...] = field(init=False, repr=False, compare=False)
    radius: float = field(init=False, repr=False, compare=False)

    if TYPE_CHECKING:  # what may be given; the fields are what is kept

        def __init__(self, vertices: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        vertices = _simple_outline(table(self.vertices, "polygon", "x [m], y [m]"))
        area, centroid, unit_inertia = _area_moments(vertices)
        pieces = convex_pieces(vertices)
        settle(
            self,
            vertices=vertices,
            area=area,
            centroid=frozen(centroid),
            unit_inertia=unit_inertia,
            is_convex=len(pieces) == 1,
            pieces=pieces,
            radius=float(np.hypot(*vertices.T).max()),
        )

    @classmethod
    def rectangle(cls, width: float, height: float) -> Polygon:
        """Create a rectangle about the origin of its frame.

        Parameters
        ----------
        width, height : float
            Sides along x and y [m].

        Examples
        --------
        >>> Polygon.rectangle(0.04, 0.02).centroid
        array([0., 0.])
        """
        x = 0.5 * positive(width, "rectangle.width", "m")
        y = 0.5 * positive(height, "rectangle.height", "m")
        return cls(np.array([(-x, -y), (x, -y), (x, y), (-x, y)]))

    @classmethod
    def regular(cls, n: int, radius: float) -> Polygon:
        """Create a regular polygon about the origin of its frame.

        Parameters
        ----------
        n : int
            Number of corners, at least 3.
        radius : float
            Distance of the corners from the origin [m]; the first one lies on the x axis.

        Examples
        --------
        >>> len(Polygon.regular(6, 0.05).vertices)
        6
        """
        angle = np.arange(whole(n, "regular.n", 3)) * (2.0 * pi / n)
        corners = np.column_stack((np.cos(angle), np.sin(angle)))
        return cls(positive(radius, "regular.radius", "m") * corners)

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        unit: str | None = None,
        tolerance: float | None = None,
        part: str | None = None,
        fill_holes: bool = False,
    ) -> Polygon:
        """Read the outline of a part from an SVG or DXF drawing, or from an STL mesh.

        Coordinates are those of the file, with y up; a mesh is seen along z. Lines whose ends meet
        within the tolerance are joined. The extra `files` installs the packages.

        Parameters
        ----------
        path : str or path
            File that ends in `.svg`, `.dxf` or `.stl`.
        unit : str, optional
            Unit of the coordinates: `"m"`, `"cm"`, `"mm"`, `"um"`, `"in"` or, in SVG, `"px"`. By
            default the unit that the file states; STL files state none.
        tolerance : float, optional
            Largest distance of the polygon from the drawn curves [m]; by default 0.1 mm, or 0.4 %
            of the size of a part below 25 mm, which gives a disk 24 corners or more.
        part : str, optional
            Layer of a DXF file, or id of a shape or group of an SVG file; by default everything.
        fill_holes : bool
            Whether holes are filled, instead of an error.

        Raises
        ------
        InvalidInput
            A damaged file; no closed outline, or several; holes; no unit, or a doubtful one.
        MissingExtra
            The package that reads the file is not installed.

        Examples
        --------
        >>> drawing = '<svg width="80mm" viewBox="0 0 80 40"><path d="M0 0H80V40H0Z"/></svg>'
        >>> _ = Path("part.svg").write_text(drawing)
        >>> round(Polygon.from_file("part.svg").area, 9)
        0.0032
        """
        read = offered("methods", "read_outline")
        return cls(read(path, unit=unit, tolerance=tolerance, part=part, fill_holes=fill_holes))

    @property
    def outline(self) -> FloatArray:
        """Corners (n, 2), counter-clockwise, in the frame of the shape [m]."""
        return self.vertices


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Disk(Comparable):
    """Disk about the origin of its frame.

    Contacts treat it as exactly round; `outline` and `pieces` are a 64-gon, for drawing only.

    Parameters
    ----------
    radius : float
        Radius of the disk [m].

    Attributes
    ----------
    area, centroid, unit_inertia, is_convex, pieces
        Attributes as for `Polygon`.

    Examples
    --------
    >>> from fixel.units import mm
    >>> Disk(5 * mm).radius
    0.005
    """

    radius: Annotated[float, Value(positive, "m")]

    def __post_init__(self) -> None:
        settle(self, radius=positive(self.radius, "disk", "m"))
        _check_size(self.radius, "disk")

    @property
    def area(self) -> float:
        """Area [m^2]."""
        return pi * self.radius**2

    @property
    def centroid(self) -> FloatArray:
        """Centroid (2,), the origin [m]."""
        return frozen(np.zeros(2))

    @property
    def unit_inertia(self) -> float:
        """Polar second moment of area about the centre, divided by the area [m^2]."""
        return 0.5 * self.radius**2

    @property
    def is_convex(self) -> bool:
        """Whether the shape is convex: always True."""
        return True

    @property
    def outline(self) -> FloatArray:
        """Corners (64, 2) on the circle, counter-clockwise [m]."""
        angle = np.arange(DRAWN_CORNERS) * (2.0 * pi / DRAWN_CORNERS)
        return frozen(self.radius * np.column_stack((np.cos(angle), np.sin(angle))))

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Convex pieces: the outline as one piece."""
        return convex_pieces(self.outline)


Shape = Polygon | Disk


def placed(points: ArrayLike, pose: ArrayLike) -> FloatArray:
    """Transform points from an inner frame to the outer frame of its pose.

    Parameters
    ----------
    points : (..., 2) array_like
        Points in the inner frame [m].
    pose : (3,) array_like
        Pose of the inner frame in the outer one [m, m, rad].

    Returns
    -------
    (..., 2) float64
        Points in the outer frame [m].
    """
    x, y, angle = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(angle), np.sin(angle)
    turned = np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]])
    return np.asarray(turned + np.array([x, y]))


def rotated(points: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate points (..., 2 or more) about the origin by angles (...) [rad]."""
    c, s, x, y = np.cos(angle), np.sin(angle), points[..., 0], points[..., 1]
    return np.stack((c * x - s * y, s * x + c * y), axis=-1)


def length_scale(shape: Shape) -> float:
    """Return the factor by which usual lengths, such as noise of cameras, suit a small part.

    It is 1 for parts of usual size, and proportional to the size of parts below 3 mm.
    """
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    return min(1.0, max(reach / TYPICAL, (reach / USUAL) ** 3))


def _simple_outline(given: FloatArray) -> FloatArray:
    vertices = _without_repeats(given)
    if len(vertices) < 3:
        found, expected = f"{len(vertices)} distinct vertices", "at least 3 vertices"
        raise InvalidInput("polygon", found=found, expected=expected)
    size = float(np.ptp(vertices, axis=0).max())
    _check_size(size, "polygon")
    scaled = (vertices - vertices.mean(axis=0)) / size
    if not _turns_once(scaled):
        if shapely.MultiPoint(scaled).convex_hull.area <= COINCIDENT:
            found = "no area, since all vertices are on one line"
            raise InvalidInput("polygon", found=found, expected="a polygon with an area")
        _check_pairs(scaled, vertices)
    vertices = _without_straight_corners(vertices, size)
    x, y = (vertices - vertices[0]).T
    doubled = float(np.sum(x * following(y) - following(x) * y))
    if abs(doubled) <= COINCIDENT * size**2:
        found, expected = f"an area of {abs(doubled) / 2:g} m^2", "a polygon with an area"
        raise InvalidInput("polygon", found=found, expected=expected)
    return frozen(vertices if doubled > 0.0 else vertices[::-1])


def _turns_once(scaled: FloatArray) -> bool:
    """Whether an outline turns to the same side at every corner and once around; it is simple then,
    which takes a tenth of the time to find out."""
    edge = following(scaled) - scaled
    after = following(edge)
    turn = edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0]
    angle = np.arctan2(turn, (edge * after).sum(axis=1))
    sharp = abs(float(np.sign(turn).sum())) == len(turn) and np.abs(turn).min() > 2.0 * COINCIDENT
    return bool(sharp and abs(float(angle.sum())) < 3.0 * pi)


def _check_size(size: float, where: str) -> None:
    if not SMALLEST <= size <= LARGEST:
        found, expected = f"a size of {size:g} m", f"a size from {SMALLEST:g} to {LARGEST:g} m"
        raise InvalidInput(where, found=found, expected=expected, hint="lengths are in metres")


def _without_repeats(vertices: FloatArray) -> FloatArray:
    size = float(np.ptp(vertices, axis=0).max())
    if (np.abs(following(vertices) - vertices).max(axis=1) > COINCIDENT * size).all():
        return vertices
    kept: list[FloatArray] = []
    for vertex in vertices:
        if not kept or np.abs(vertex - kept[-1]).max() > COINCIDENT * size:
            kept.append(vertex)
    while len(kept) > 1 and np.abs(kept[0] - kept[-1]).max() <= COINCIDENT * size:
        kept.pop()
    return np.array(kept)


def _without_straight_corners(vertices: FloatArray, size: float) -> FloatArray:
    while True:
        before = np.concatenate((vertices[-1:], vertices[:-1]))
        chord = following(vertices) - before
        offset = vertices - before
        height = np.abs(chord[:, 0] * offset[:, 1] - chord[:, 1] * offset[:, 0])
        straight = height <= COINCIDENT * size * np.hypot(*chord.T)
        straight &= ~np.concatenate((straight[-1:], straight[:-1]))  # neighbours one at a time
        if not straight.any() or len(vertices) == 3:
            return vertices
        vertices = vertices[~straight]


def _check_pairs(scaled: FloatArray, vertices: FloatArray) -> None:
    outline = shapely.Polygon(scaled)
    if outline.is_valid:
        return
    crossing = _crossing_edges(scaled)
    found = "an outline that crosses or touches itself"
    if crossing is not None:
        first, second = crossing
        n = len(vertices)
        found += (
            f": the edge from vertex {first} to {(first + 1) % n}"
            f" meets the edge from vertex {second} to {(second + 1) % n}"
        )
    expected, hint = "a simple polygon", "list the corners in order along the outline"
    raise InvalidInput("polygon", found=found, expected=expected, hint=hint)


def _crossing_edges(vertices: FloatArray) -> tuple[int, int] | None:
    """Indices of the first two edges that meet; neighbours must meet along a length."""
    n = len(vertices)
    edges = shapely.linestrings(np.stack((vertices, np.roll(vertices, -1, axis=0)), axis=1))
    tree = shapely.STRtree(edges)
    pairs = np.sort(tree.query(edges, predicate="intersects").T, axis=1)
    for first, second in np.unique(pairs, axis=0).tolist():
        neighbours = (second - first) in (1, n - 1)
        if first == second:
            continue
        if not neighbours or shapely.intersection(edges[first], edges[second]).length > 0.0:
            return first, second
    return None


def _area_moments(vertices: FloatArray) -> tuple[float, FloatArray, float]:
    """Area [m^2], centroid [m] and polar second moment about it over the area [m^2]."""
    origin = vertices.mean(axis=0)
    p = vertices - origin
    q = following(p)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = 0.5 * float(cross.sum())
    centre = ((p + q) * cross[:, None]).sum(axis=0) / (6.0 * area)
    squares = (p * p + p * q + q * q).sum(axis=1)
    about_origin = float((squares * cross).sum()) / (12.0 * area)
    return area, origin + centre, about_origin - hypot(*centre) ** 2


# --- decomposition into convex pieces -------------------------------------------------------------

# Share of the squared size below which a turn counts as straight. Smaller values cut polygons with
# almost collinear vertices into more pieces, larger ones let pieces be slightly non-convex.
STRAIGHT = 1e-12


def convex_pieces(vertices: FloatArray) -> tuple[Piece, ...]:
    """Decompose a simple polygon, a counter-clockwise outline (n, 2) [m], into convex pieces.

    Each has its vertices (k, 2), counter-clockwise, and a flag (k,) for each edge from vertex k to
    k + 1: whether it lies on the outline. Constrained Delaunay triangles are merged as long as the
    union is convex.

    Source
    ------
    S. Hertel, K. Mehlhorn (1983), Fast triangulation of simple polygons: at most four times as many
    pieces as the optimal decomposition.
    """
    if is_convex(vertices):
        return (_piece(vertices, list(range(len(vertices)))),)
    size = float(np.ptp(vertices, axis=0).max())
    triangles = _triangles(vertices, size)
    attempts = [
        _merged(vertices, list(triangles), order, size) for order in _orders(vertices, triangles)
    ]
    return tuple(_piece(vertices, loop) for loop in min(attempts, key=len))


def following(rows: NDArray[Item]) -> NDArray[Item]:
    """Return the row after each, the first after the last, faster than `numpy.roll`."""
    return np.concatenate((rows[1:], rows[:1]))


def is_convex(vertices: FloatArray, size: float | None = None) -> bool:
    """Whether a counter-clockwise simple polygon turns left, or goes straight, at every vertex.

    `size` [m] scales the tolerance for straight; by default the larger side of the bounding box.
    """
    size = size or float(np.ptp(vertices, axis=0).max())
    after = following(vertices) - vertices
    before = np.concatenate((after[-1:], after[:-1]))
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return bool((turn >= -STRAIGHT * size**2).all())


def _piece(vertices: FloatArray, loop: list[int]) -> Piece:
    corners = np.array(vertices[loop])
    order = np.array(loop)
    on_outline = following(order) == (order + 1) % len(vertices)
    corners.flags.writeable = False
    on_outline.flags.writeable = False
    return corners, on_outline


def _triangles(vertices: FloatArray, size: float) -> list[list[int]]:
    """Vertex indices of constrained Delaunay triangles, each counter-clockwise."""
    scaled = (vertices - vertices.mean(axis=0)) / size
    number_of = {tuple(point): index for index, point in enumerate(scaled.tolist())}
    cells = shapely.constrained_delaunay_triangles(shapely.Polygon(scaled)).geoms
    triangles = []
    for cell in cells:
        a, b, c = (number_of[x, y] for x, y in cell.exterior.coords[:3])
        triangles.append([a, b, c] if _turn(scaled, a, b, c) > 0.0 else [a, c, b])
    return triangles


def _orders(vertices: FloatArray, triangles: list[list[int]]) -> Iterator[list[tuple[int, int]]]:
    """Yield the diagonals of a triangulation in a few orders; the best depends on the polygon."""
    edges = {edge for triangle in triangles for edge in _edges(triangle)}
    diagonals = sorted((i, j) for i, j in edges if i < j and (j, i) in edges)
    length = {(i, j): float(np.hypot(*(vertices[i] - vertices[j]))) for i, j in diagonals}
    for tied in (diagonals, diagonals[::-1]):
        yield tied
        yield sorted(tied, key=lambda edge: -length[edge])
        yield sorted(tied, key=lambda edge: length[edge])


def _merged(
    vertices: FloatArray, loops: list[list[int]], diagonals: list[tuple[int, int]], size: float
) -> list[list[int]]:
    """Merge loops by removing each diagonal between them if the union is convex."""
    owner = {edge: index for index, loop in enumerate(loops) for edge in _edges(loop)}
    for start, end in diagonals:
        left, right = owner[start, end], owner[end, start]
        union = _union(loops[left], loops[right], start, end)
        if is_convex(vertices[union], size):
            for edge in _edges(loops[right]):
                owner[edge] = left
            loops[left], loops[right] = union, []
    return [loop for loop in loops if loop]


def _union(left: list[int], right: list[int], start: int, end: int) -> list[int]:
    """Return the union of two loops that share an edge, `start` to `end` in the left one."""
    at = left.index(end)
    around_left = left[at:] + left[:at]  # from end to start
    at = right.index(start)
    around_right = right[at:] + right[:at]  # from start to end
    return around_left + around_right[1:-1]


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _turn(vertices: FloatArray, a: int, b: int, c: int) -> float:
    (x0, y0), (x1, y1), (x2, y2) = vertices[[a, b, c]].tolist()
    return float((x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1))
