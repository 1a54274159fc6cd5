"""Outlines of parts from drawings and meshes: SVG, DXF and STL."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fixel.errors import InvalidInput, check_name, counted, require
from fixel.io.atomic import parsed, refuse_ending
from fixel.model.fields import path_of, positive
from fixel.typing import FloatArray

UNITS: Final = {
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "in": 0.0254,
    "pt": 0.0254 / 72.0,
    "px": 0.0254 / 96.0,
}
DXF_UNITS: Final = {1: "in", 4: "mm", 5: "cm", 6: "m", 13: "um"}
# [m] A part of another size is probably in another unit. Curves beyond FAR have too many points.
SMALLEST, LARGEST, FAR = 1e-4, 5.0, 100.0
FINEST: Final = 1e-6  # [m] smallest tolerance
COARSEST: Final = 1e-4  # [m] tolerance by default
SHARE: Final = 0.004  # and of a small part, as a share of its size: 24 corners of a disk
MAX_BYTES: Final = {".svg": 4_000_000, ".dxf": 20_000_000, ".stl": 100_000_000}  # some 10 s
MAX_CURVES, MAX_RINGS, MAX_TRIANGLES = 20_000, 500, 500_000
MAX_ELEMENTS: Final = 100_000  # of a drawing in SVG; half as many characters of style
MAX_STEPS: Final = 4096  # of one curve
MAX_PAIRS: Final = 2_000_000  # of ends that meet

# They would print what they skip in a damaged file, with tracebacks and text of that file.
for _parser in ("ezdxf", "trimesh"):
    logging.getLogger(_parser).addHandler(logging.NullHandler())


def read_outline(
    path: str | Path,
    *,
    unit: str | None = None,
    tolerance: float | None = None,
    part: str | None = None,
    fill_holes: bool = False,
) -> FloatArray:
    """Read the outline (n, 2) of a part from a file [m]; see `fixel.Polygon.from_file`."""
    path = path_of(path, "path")
    refuse_ending(path, [*_READERS], "drawing or shape")
    if unit is not None:
        check_name("unit", unit, UNITS)
    if tolerance is not None and positive(tolerance, "tolerance", "m") < FINEST:
        raise InvalidInput("tolerance", found=tolerance, expected=f"at least {FINEST:g} m")
    with parsed(path):
        kind = path.suffix.lower()
        _refuse_more(path.name, path.stat().st_size, MAX_BYTES[kind], "bytes", "leave out the rest")
        read, region = _READERS[kind]
        source = _OutlineSource(path, unit, tolerance or COARSEST, part)
        lines = read(source)
        if tolerance is None and len(lines):
            size = float(np.ptp(np.vstack(lines), axis=0).max())
            source = source._replace(tolerance=min(COARSEST, SHARE * size or COARSEST))
            lines = lines if source.tolerance == COARSEST else read(source)
        return _outline(region(lines, source), source, fill_holes)


class _OutlineSource(NamedTuple):
    """Arguments of the readers."""

    path: Path
    unit: str | None
    tolerance: float  # [m]
    part: str | None

    def scale(self, stated: float | None) -> float:
        """Return the unit of a drawing [m], which its file may state; raise if unit= differs."""
        given = None if self.unit is None else UNITS[self.unit]
        if stated is None and given is None:
            found, expected = "no unit of length", f"unit=, one of {', '.join(UNITS)}"
            raise InvalidInput(self.path.name, found=found, expected=expected)
        if stated and given and abs(stated / given - 1.0) > 1e-3:
            found = f"{self.unit!r}, while a unit in {self.path.name} is {1e3 * stated:g} mm"
            expected, hint = "the same unit in both", "leave out unit=, or correct the file"
            raise InvalidInput("unit", found=found, expected=expected, hint=hint)
        return float(stated or given or 0.0)

    def points(self, points: ArrayLike, scale: float) -> FloatArray:
        """Return points (n, 2) in metres; raise unless they are finite and near the origin."""
        found = np.asarray(points, dtype=np.float64)[:, :2] * scale
        if not (np.abs(found) <= FAR).all():
            where, far = self.path.name, f"coordinates beyond {FAR:g} m"
            expected = "a part near the origin"
            raise InvalidInput(where, found=far, expected=expected, hint="check unit=")
        return found


def _refuse_more(where: str, n: int, most: int, what: str, hint: str | None = None) -> None:
    if n > most:
        raise InvalidInput(where, found=f"{n} {what}", expected=f"at most {most}", hint=hint)


def _outline(region: Any, source: _OutlineSource, fill_holes: bool) -> FloatArray:
    """Return the outline of a region that is one part; raise for others."""
    where, tolerance = source.path.name, source.tolerance
    parts = [one for one in shapely.get_parts(region) if one.area > tolerance**2]
    if len(parts) != 1:
        sizes = "; ".join(map(_size, parts[:5]))
        found = f"{len(parts)} separate outlines: {sizes}" if parts else "no closed outline"
        hint = "part= selects a layer of a DXF file, or an id of an SVG file" if parts else None
        raise InvalidInput(where, found=found, expected="one outline", hint=hint)
    extent = float(np.ptp(shapely.get_coordinates(parts[0]), axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        found = f"a part of {_size(parts[0])}"
        expected = f"a size from {1e3 * SMALLEST:g} mm to {LARGEST:g} m"
        hint = "check unit=; Polygon takes corners of any size"
        raise InvalidInput(where, found=found, expected=expected, hint=hint)
    holes = [shapely.Polygon(ring) for ring in parts[0].interiors]
    holes = [hole for hole in holes if hole.area > tolerance**2]
    if holes and not fill_holes:
        found = (
            f"{counted(len(holes), 'hole')}, the largest of {_size(max(holes, key=shapely.area))}"
        )
        hint = "fill_holes=True fills them; then give inertia= and centre_of_mass= of the body"
        raise InvalidInput(where, found=found, expected="an outline without holes", hint=hint)
    ring = shapely.Polygon(parts[0].exterior).simplify(0.5 * tolerance)
    return np.asarray(shapely.get_coordinates(ring)[:-1])


def _size(shape: Any) -> str:
    width, height = 1e3 * np.ptp(shapely.get_coordinates(shape), axis=0)
    return f"{width:.4g} by {height:.4g} mm"


def _region(lines: Iterable[FloatArray], source: _OutlineSource) -> Any:
    """Return the region inside lines, which are joined to rings; rings inside others are holes."""
    where, tolerance = source.path.name, source.tolerance
    rings: list[FloatArray] = []
    pieces: list[FloatArray] = []
    for line in lines:
        closed = len(line) > 3 and np.hypot(*(line[0] - line[-1])) <= tolerance
        (rings if closed else pieces).append(line)
    rings += _joined(pieces, where, tolerance)
    _refuse_more(where, len(rings), MAX_RINGS, "closed lines")
    alone: list[Any] = []
    for area in map(shapely.Polygon, rings):
        if not area.is_valid:
            found = f"{shapely.is_valid_reason(area)} [m]"
            raise InvalidInput(where, found=found, expected="lines that do not cross")
        # A line that was drawn twice counts once.
        if not any(area.symmetric_difference(a).area <= tolerance * a.length for a in alone):
            alone.append(area)
    areas = np.array(alone, dtype=object)
    outer = shapely.contains(areas[:, None], areas[None, :]).sum(axis=0) % 2 == 1
    return shapely.union_all(areas[outer]).difference(shapely.union_all(areas[~outer]))


def _joined(pieces: list[FloatArray], where: str, tolerance: float) -> list[FloatArray]:
    """Return rings of lines whose ends are within the tolerance of one another."""
    if not pieces:
        return []
    ends = np.array([end for piece in pieces for end in (piece[0], piece[-1])])
    tree = cKDTree(ends)
    met_ends = int(tree.count_neighbors(tree, tolerance) - len(ends)) // 2
    _refuse_more(where, met_ends, MAX_PAIRS, "pairs of ends that meet")
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ends), len(ends)))
    place = connected_components(links, directed=False)[1]
    met = ends[np.unique(place, return_index=True)[1]][place].reshape(-1, 2, 2)
    lines = [np.vstack((a, piece[1:-1], b)) for (a, b), piece in zip(met, pieces, strict=True)]
    merged = shapely.line_merge(shapely.MultiLineString(lines))
    for line in shapely.get_parts(merged):
        if not line.is_ring:
            (x, y), (u, v) = 1e3 * shapely.get_coordinates(line)[[0, -1]]
            found = f"an open line from ({x:.4g}, {y:.4g}) mm to ({u:.4g}, {v:.4g}) mm"
            expected = f"closed lines, with gaps of at most {1e3 * tolerance:g} mm"
            hint = "close it, or select the outline with part="
            raise InvalidInput(where, found=found, expected=expected, hint=hint)
    return [*map(shapely.get_coordinates, shapely.get_parts(merged))]


_NUMBER: Final = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def _from_svg(source: _OutlineSource) -> list[FloatArray]:
    require("svgelements", "an outline in SVG", extra="files")
    import svgelements

    text, where = source.path.read_text(encoding="utf-8"), source.path.name
    # Entities and clones can unpack to more than fits in memory.
    if banned := re.search(r"<!ENTITY\b|<(?:\w+:)?use\b", text):
        expected, hint = "a drawing without entities and clones", "unlink clones; save as plain SVG"
        raise InvalidInput(where, found=banned[0], expected=expected, hint=hint)
    _check_drawn(text, where)
    svg = svgelements.SVG.parse(io.StringIO(text), reify=False, ppi=96.0)
    if (box := svg.viewbox) and svg.values.get("height") is None:  # as browsers do
        height = svg.width * box.height / box.width
        svg = svgelements.SVG.parse(io.StringIO(text), reify=False, ppi=96.0, height=height)
    width = re.fullmatch(r"([\d.]+)\s*(mm|cm|in|pt)", str(svg.values.get("width")).strip())
    stated = float(width[1]) * UNITS[width[2]] / svg.width if width else None  # [m] of a pixel
    drawn = svg.width / box.width if box else 1.0  # [pixel] of a unit of the drawing
    scale = source.scale(stated and stated * drawn) / drawn
    scale = stated or scale
    found = [*svg.elements()]
    if source.part is not None:
        named = {one.id: one for one in found if getattr(one, "id", None)}
        check_name("part", source.part, named)
        group = isinstance(named[source.part], svgelements.Group)
        found = [*named[source.part].select()] if group else [named[source.part]]
    lines = []
    for shape in (one for one in found if isinstance(one, svgelements.Shape)):
        written = str(shape.values.get("points") or "")
        if len(_NUMBER.findall(written)) != 2 * len(getattr(shape, "points", ())):
            unclear = f"an odd or unclear list of points: {written[:60]}"  # some would be lost
            raise InvalidInput(where, found=unclear, expected="x,y x,y ...")
        path = svgelements.Path(shape)
        for own in path.as_subpaths():
            points = [_sampled(step, path.transform, source, scale) for step in own if step.end]
            if len(points) > 1:
                lines.append(np.vstack(points) * (1.0, -1.0))  # y points down in SVG
    return lines


def _check_drawn(text: str, where: str) -> None:
    """Raise for a drawing that takes minutes, or more than fits in memory."""
    left = MAX_ELEMENTS
    for _, one in ElementTree.iterparse(io.StringIO(text)):
        # svgelements reads styles in quadratic time.
        left -= 1 + 2 * len(one.text or "") * one.tag.endswith("style")
        if left < 0:
            expected = f"at most {MAX_ELEMENTS} elements, and 50 kB of style"
            raise InvalidInput(where, found="more", expected=expected, hint="save as plain SVG")


def _sampled(segment: Any, transform: Any, source: _OutlineSource, scale: float) -> FloatArray:
    """Return points (n, 2) of a segment of an SVG path within half the tolerance [m]."""
    at = transform.point_in_matrix_space  # of points: svgelements skews no arcs
    if type(segment).__name__ in ("Move", "Line", "Close"):
        return source.points([at(segment.end)], scale)
    steps = 8
    while True:
        along = map(segment.point, np.linspace(0.0, 1.0, steps + 1))
        points = source.points([*map(at, along)], scale)
        off = np.abs(points[1::2] - 0.5 * (points[:-1:2] + points[2::2])).max()
        if off <= 0.25 * source.tolerance or steps >= MAX_STEPS:
            return points
        steps *= 2


def _from_dxf(source: _OutlineSource) -> list[FloatArray]:
    require("ezdxf", "an outline in DXF", extra="files")
    import ezdxf

    document = ezdxf.readfile(source.path)
    stated = DXF_UNITS.get(document.units)
    scale = source.scale(None if stated is None else UNITS[stated])
    found = [*document.modelspace()]
    if source.part is not None:
        layers = sorted({one.dxf.layer for one in found})
        check_name("part", source.part, layers)
        found = [one for one in found if one.dxf.layer == source.part]
    lines = []
    for curve in _curves(found, iter(range(MAX_CURVES)), source.path.name):
        points: Iterable[Any] = _reach(curve)
        source.points([*points], scale)
        if curve.dxftype() != "LINE":
            points = curve.flattening(0.5 * source.tolerance / scale)
        lines.append(source.points([*points], scale))
    return lines


def _curves(found: Iterable[Any], left: Iterator[int], where: str) -> Iterator[Any]:
    """Yield the curves of entities, and of blocks and polylines in them, one by one."""
    for one in found:
        if next(left, None) is None:
            _refuse_more(where, MAX_CURVES + 1, MAX_CURVES, "curves or more")
        kind = one.dxftype()
        if kind == "INSERT" and one.mcount > 1:
            yield from _curves(one.multi_insert(), left, where)
        elif kind in ("INSERT", "LWPOLYLINE", "POLYLINE"):
            yield from _curves(one.virtual_entities(), left, where)
        elif kind in ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"):
            yield one


def _reach(curve: Any) -> Iterable[Any]:
    """Return points of a curve that show its size."""
    if curve.dxftype() == "LINE":
        return curve.dxf.start, curve.dxf.end
    if curve.dxftype() == "SPLINE":
        return (*curve.control_points, *curve.fit_points)
    return (curve.dxf.major_axis,) if curve.dxftype() == "ELLIPSE" else ((curve.dxf.radius, 0.0),)


def _from_stl(source: _OutlineSource) -> FloatArray:
    """Return the triangles (n, 3, 2) of a mesh, seen along z."""
    require("trimesh", "an outline in STL", extra="files")
    from trimesh.exchange import stl

    scale = source.scale(None)
    with source.path.open("rb") as stream:
        mesh = stl.load_stl(stream)
    _refuse_more(source.path.name, len(mesh["faces"]), MAX_TRIANGLES, "triangles")
    corners = source.points(mesh["vertices"], scale)[mesh["faces"]]
    seen = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) > FINEST**2  # not those on edge
    return np.asarray(corners[seen])


# By the ending, the functions that return the lines of a file, and the region of lines.
_READERS: Final[dict[str, tuple[Callable[[_OutlineSource], Any], Callable[..., Any]]]] = {
    ".svg": (_from_svg, _region),
    ".dxf": (_from_dxf, _region),
    ".stl": (_from_stl, lambda triangles, _: shapely.union_all(shapely.polygons(triangles))),
}
