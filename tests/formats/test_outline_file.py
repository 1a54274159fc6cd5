"""Outlines of parts from SVG, DXF and STL files, which libraries of these kinds write."""

import struct
from math import pi

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import InvalidInput, MissingExtra, Polygon
from fixel.units import mm

ezdxf = pytest.importorskip("ezdxf")
pytest.importorskip("svgelements")
trimesh = pytest.importorskip("trimesh")


def svg(path, inside, size='width="100mm" viewBox="0 0 100 80"'):
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{inside}</svg>')
    return path


def dxf(path, draw, units=4):
    drawing = ezdxf.new(units=units)
    draw(drawing.modelspace(), drawing)
    drawing.saveas(path)
    return path


def slot(space, drawing, layer="0"):
    """A slot of 40 by 20 mm, from four entities that share no points in order."""
    layer = {"layer": layer}
    space.add_line((0, 0), (20, 0), layer)
    space.add_line((0, 20), (20, 20), layer)
    space.add_arc((20, 10), 10, -90, 90, dxfattribs=layer)
    space.add_arc((0, 10), 10, 90, 270, dxfattribs=layer)


SLOT = 20 * 20 + pi * 10**2  # [mm^2]


@pytest.mark.parametrize("tolerance", [0.3 * mm, 0.01 * mm])
def test_slot_in_dxf_has_its_area(tmp_path, tolerance):
    part = Polygon.from_file(dxf(tmp_path / "slot.dxf", slot), tolerance=tolerance)
    length = 2 * 20 + 2 * pi * 10
    assert abs(part.area - SLOT * mm**2) <= length * mm * tolerance
    assert part.centroid == pytest.approx([10 * mm, 10 * mm], abs=tolerance)
    # Every corner is on the drawn curve.
    x, y = (part.vertices / mm).T
    out = np.hypot(x - np.clip(x, 0, 20), y - 10)
    assert np.abs(out - 10).max() <= tolerance / mm


@pytest.mark.parametrize("size", [0.12, 0.4, 3.0, 24.0, 200.0])  # [mm]
def test_disks_of_any_size_are_round_by_default(tmp_path, size):
    """At least 24 corners, and at most 0.1 mm off: also of the circles of other libraries."""

    def draw(space, drawing):
        space.add_circle((5, 5), size / 2)

    circle = f'<circle cx="50" cy="40" r="{size / 2}"/>'
    solid = trimesh.creation.cylinder(radius=size / 2, height=1, sections=96)
    solid.export(tmp_path / "disk.stl")
    drawn = svg(tmp_path / "disk.svg", circle, 'width="300mm" viewBox="0 0 300 240"')
    for path, unit in (
        (dxf(tmp_path / "disk.dxf", draw), None), (drawn, None), (tmp_path / "disk.stl", "mm"),
    ):  # fmt: skip
        corners = Polygon.from_file(path, unit=unit).vertices / mm
        radius = np.hypot(*(corners - corners.mean(axis=0)).T)
        gaps = np.hypot(*(np.roll(corners, 1, axis=0) - corners).T)
        assert len(corners) >= 24, path.suffix
        assert radius == pytest.approx(size / 2, abs=0.1)
        assert (size / 2 - np.sqrt(size**2 / 4 - gaps**2 / 4)).max() <= 0.1


def test_finer_tolerance_has_more_corners(tmp_path):
    path = dxf(tmp_path / "slot.dxf", slot)
    counts = [len(Polygon.from_file(path, tolerance=t).vertices) for t in (1e-3, 1e-4, 1e-5)]
    assert counts == sorted(counts)
    assert counts[0] < 20 < 100 < counts[-1] < 500


@pytest.mark.parametrize(("units", "metres"), [(1, 0.0254), (4, 1e-3), (5, 1e-2)])
def test_unit_that_dxf_states_counts(tmp_path, units, metres):
    part = Polygon.from_file(dxf(tmp_path / "slot.dxf", slot, units))
    assert part.area == pytest.approx(SLOT * metres**2, rel=1e-2)


def test_unit_of_dxf_is_needed_and_must_agree(tmp_path):
    none = dxf(tmp_path / "none.dxf", slot, units=0)
    refused(Polygon.from_file, none, match="no unit of length")
    assert Polygon.from_file(none, unit="mm").area == pytest.approx(SLOT * 1e-6, rel=1e-2)
    with pytest.raises(InvalidInput, match=r"a unit in mm.dxf is 1 mm"):
        Polygon.from_file(dxf(tmp_path / "mm.dxf", slot), unit="in")
    refused(Polygon.from_file, none, unit="m", match=r"a part of 4e[+]04 by")
    refused(Polygon.from_file, none, unit="mmm", match="did you mean 'mm'")


def test_other_entities_of_dxf(tmp_path):
    def draw(space, drawing):
        block = drawing.blocks.new("BLOCK")
        # A polyline with a bulge: a half disk on a square of 10 mm.
        block.add_lwpolyline([(0, 0, 0), (10, 0, 1), (10, 10, 0), (0, 10, 0)], "xyb", close=True)
        space.add_blockref("BLOCK", (5, 5), {"xscale": 2, "yscale": 2})
        space.add_text("a note")

    part = Polygon.from_file(dxf(tmp_path / "block.dxf", draw), tolerance=0.01 * mm)
    assert part.area == pytest.approx(4 * (100 + pi * 25 / 2) * mm**2, rel=1e-3)
    assert part.vertices.min(axis=0) == pytest.approx([5 * mm, 5 * mm], abs=1e-9)
    assert not part.is_convex or len(part.pieces) == 1
    ellipse = dxf(
        tmp_path / "e.dxf", lambda s, d: s.add_ellipse((0, 0), major_axis=(30, 0), ratio=0.5)
    )
    area = Polygon.from_file(ellipse, tolerance=0.01 * mm).area
    assert area == pytest.approx(pi * 30 * 15 * mm**2, rel=2e-3)


def test_layer_selects_outline(tmp_path):
    def draw(space, drawing):
        slot(space, drawing, "PART")
        space.add_line((-50, 3), (50, 3), {"layer": "axes"})

    path = dxf(tmp_path / "layers.dxf", draw)
    refused(Polygon.from_file, path, match="an open line from")
    assert Polygon.from_file(path, part="PART").area == pytest.approx(SLOT * 1e-6, rel=1e-2)
    refused(Polygon.from_file, path, part="PARTS", match="'PART'")


def test_holes_and_several_outlines(tmp_path):
    plate = '<rect width="50" height="40"/>'
    hole = '<circle cx="20" cy="20" r="5"/>'
    path = svg(tmp_path / "hole.svg", plate + hole + plate)  # one drawn twice
    refused(Polygon.from_file, path, match="1 hole, the largest of 10 by 10 mm")
    assert Polygon.from_file(path, fill_holes=True).area == pytest.approx(50 * 40 * 1e-6)
    two = svg(tmp_path / "two.svg", plate + '<rect id="b" x="60" width="7" height="8"/>')
    raised = refused(Polygon.from_file, two, match=r"2 separate outlines: 50 by 40 mm; 7 by 8 mm")
    assert "part=" in str(raised)
    assert Polygon.from_file(two, part="b").area == pytest.approx(56e-6)


def test_curves_transforms_and_groups_of_svg(tmp_path):
    # A Bezier parabola y = x (20 - x) / 10 over 20 mm has area 20**3 / 60.
    curve = '<g id="g" transform="translate(10 5)"><path d="M0 0 Q10 20 20 0 Z"/></g>'
    path = svg(tmp_path / "curve.svg", curve + "<text>note</text>")
    part = Polygon.from_file(path, part="g", unit="mm", tolerance=0.01 * mm)
    assert part.area == pytest.approx(20**3 / 60 * mm**2, rel=1e-3)
    # y is up: the parabola, below its base in a browser, is at negative y.
    assert part.vertices.max(axis=0) == pytest.approx([30 * mm, -5 * mm], abs=1e-6)
    assert part.vertices.min() == pytest.approx(-15 * mm, abs=0.02 * mm)


TURN = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
SKEW = np.array([[1.0, np.tan(np.radians(20))], [0.0, 1.0]])


@pytest.mark.parametrize(
    "round_part",
    ['<circle cx="5" cy="6" r="4" {}/>', '<ellipse cx="5" cy="6" rx="4" ry="4" {}/>',
     '<path d="M9 6 A4 4 0 1 1 1 6 A4 4 0 1 1 9 6 Z" {}/>',
     '<g {}><circle cx="5" cy="6" r="4"/></g>'],
)  # fmt: skip
@pytest.mark.parametrize(
    ("how", "matrix"), [(f"rotate({np.degrees(0.5)})", TURN), ("skewX(20)", SKEW),
                        (f"rotate({np.degrees(0.5)}) skewX(20)", TURN @ SKEW)],
)  # fmt: skip
def test_turned_and_skewed_shapes_of_svg(tmp_path, round_part, how, matrix):
    path = svg(tmp_path / "round.svg", round_part.format(f'transform="{how}"'))
    part = Polygon.from_file(path, tolerance=0.01 * mm)
    # Undone by hand, every corner is on the circle that was drawn.
    back = np.linalg.solve(matrix, (part.vertices / mm * (1.0, -1.0)).T).T - (5.0, 6.0)
    assert np.hypot(*back.T) == pytest.approx(4.0, abs=0.03)
    assert part.area == pytest.approx(16 * pi * mm**2, rel=5e-3)
    square = f'<rect x="2" y="3" width="8" height="5" transform="{how}"/>'
    corners = Polygon.from_file(svg(tmp_path / "square.svg", square)).vertices / mm
    drawn = np.array([(2, 3), (10, 3), (10, 8), (2, 8)]) @ matrix.T * (1.0, -1.0)
    off = np.hypot(*(corners[:, None] - drawn).transpose(2, 0, 1))
    assert off.min(axis=0) == pytest.approx(0.0, abs=1e-6)


def test_points_of_svg_that_would_be_lost_are_refused(tmp_path):
    def drawn(points):
        return svg(tmp_path / "odd.svg", f'<polygon points="{points}"/>')

    for points in ("0,0 40,0 40,30 0,30", "0 0 40 0 40 30 0 30", "0 0 4e1-0 40 30-0 30"):
        assert Polygon.from_file(drawn(points)).area == pytest.approx(1200 * mm**2, rel=1e-6)
    for points in ("0,0 40,0 40,30 0", "0,0 40,0 40,30 .5.3"):
        refused(Polygon.from_file, drawn(points), match="unclear list of points: 0,0 4")


def test_unit_of_svg(tmp_path):
    square = '<path d="M0 0H10V10H0Z"/>'
    plain = svg(tmp_path / "plain.svg", square, "")
    refused(Polygon.from_file, plain, match="no unit of length")
    assert Polygon.from_file(plain, unit="mm").area == pytest.approx(1e-4)
    assert Polygon.from_file(plain, unit="px").area == pytest.approx((10 * 0.0254 / 96) ** 2)
    large = svg(tmp_path / "large.svg", square, 'width="200" height="160" viewBox="0 0 100 80"')
    assert Polygon.from_file(large, unit="mm").area == pytest.approx(1e-4)
    inches = svg(tmp_path / "inches.svg", square, 'width="5in" viewBox="0 0 50 50"')
    assert Polygon.from_file(inches).area == pytest.approx(0.0254**2)
    refused(Polygon.from_file, inches, unit="mm", match=r"a unit in inches.svg is 2.54 mm")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_is_seen_from_above(tmp_path, kind):
    # An L of two boxes of different heights: not convex, 6 corners.
    a = trimesh.creation.box(bounds=[[0, 0, 0], [30, 10, 5]])
    b = trimesh.creation.box(bounds=[[0, 0, 0], [10, 40, 8]])
    path = tmp_path / "l.stl"
    path.write_bytes(
        data.encode() if isinstance(data := (a + b).export(file_type=kind), str) else data
    )
    part = Polygon.from_file(path, unit="mm")
    assert part.area == pytest.approx((300 + 400 - 100) * mm**2)
    assert (len(part.vertices), part.is_convex, len(part.pieces)) == (6, False, 2)
    refused(Polygon.from_file, path, match="no unit")


def test_round_mesh(tmp_path):
    trimesh.creation.icosphere(4, 20.0).export(tmp_path / "ball.stl")
    part = Polygon.from_file(tmp_path / "ball.stl", unit="mm")
    assert part.area == pytest.approx(pi * 400 * mm**2, rel=0.01)


# --- hostile and damaged files


def test_svg_reads_no_entities_and_no_clones(tmp_path):
    (tmp_path / "secret").write_text("M0 0H10V10H0Z")
    entity = '<!DOCTYPE svg [<!ENTITY p SYSTEM "secret">]>'
    for text in (
        f'{entity}<svg><path d="&p;"/></svg>',
        '<svg xmlns:x="a"><x:use href="#a"/></svg>',
    ):
        (tmp_path / "a.svg").write_text(text)
        with pytest.raises(InvalidInput, match="without entities and clones"):
            Polygon.from_file(tmp_path / "a.svg", unit="mm")
    # Encodings that hide an entity from a search of the text are not read at all.
    for encoding in ("utf-16", "cp037"):
        head = f'<?xml version="1.0" encoding="{encoding}"?>'
        text = f'{head}{entity}<svg><path d="&p;"/></svg>'
        (tmp_path / "a.svg").write_bytes(text.encode(encoding))
        with pytest.raises(InvalidInput, match=r"a readable SVG file|no closed outline"):
            Polygon.from_file(tmp_path / "a.svg", unit="mm")
    image = '<image width="9" height="9" href="/dev/zero"/>'
    path = svg(tmp_path / "b.svg", image + '<path d="M0 0H10V10H0Z"/>')
    assert Polygon.from_file(path).area == pytest.approx(1e-4)


@pytest.mark.parametrize("drawn", [
    "<style>" + 3000 * "a{" + "</style>", 10_001 * "<g/>",
])  # fmt: skip
def test_drawings_that_take_minutes_are_rejected(tmp_path, monkeypatch, drawn):
    monkeypatch.setattr("fixel.formats.outline_file.MAX_ELEMENTS", 10_000)
    refused(Polygon.from_file, svg(tmp_path / "a.svg", drawn), match="found more, but")


def test_blocks_that_unpack_to_millions_are_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.formats.outline_file.MAX_CURVES", 1000)

    def draw(space, drawing):
        for k in range(30):
            block = drawing.blocks.new(f"B{k}")
            if k:
                block.add_blockref(f"B{k - 1}", (0, 0))
                block.add_blockref(f"B{k - 1}", (1, 0))
        space.add_blockref("B29", (0, 0))

    refused(Polygon.from_file, dxf(tmp_path / "bomb.dxf", draw), match="at most 1000")


def test_a_star_of_many_lines_takes_no_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.formats.outline_file.MAX_PAIRS", 1000)
    star = "".join(f"M50 40L{10 + 0.5 * k} 10" for k in range(60))
    path = svg(tmp_path / "star.svg", f'<path d="{star}"/>')

    refused(Polygon.from_file, path, match="1770 pairs of ends that meet")


@pytest.mark.parametrize(("ending", "size"), [("svg", 4_000_000), ("dxf", 20_000_000)])
def test_giant_files_are_rejected_unread(tmp_path, ending, size):
    path = tmp_path / f"giant.{ending}"
    with path.open("wb") as stream:
        stream.truncate(size + 1)

    refused(Polygon.from_file, path, match=f"at most {size}; leave out the rest")


@pytest.mark.parametrize("radius", [1e9, 1e300, float("nan")])
def test_giant_curves_are_rejected(tmp_path, radius):
    path = dxf(tmp_path / "giant.dxf", lambda s, d: s.add_circle((0, 0), radius))
    refused(Polygon.from_file, path, match="beyond 100 m")
    refused(Polygon.from_file, svg(tmp_path / "a.svg", f'<circle r="{radius}"/>'))


def test_count_that_stl_declares_is_not_believed(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50))
    refused(Polygon.from_file, path, unit="mm", match="a readable STL file")


@pytest.mark.parametrize("ending", ["svg", "dxf", "stl"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.97])
def test_truncated_and_foreign_files(tmp_path, ending, share):
    whole = tmp_path / f"whole.{ending}"
    if ending == "svg":
        svg(whole, '<path d="M0 0H10V10H0Z"/>')
    elif ending == "dxf":
        dxf(whole, slot)
    else:
        trimesh.creation.box(extents=[9, 9, 9]).export(whole)
    data = whole.read_bytes()
    cut = tmp_path / f"cut.{ending}"
    # A cut at 97 % of DXF is in its last section, after the entities; a closed outline is found.
    if not (ending == "dxf" and share > 0.9):
        cut.write_bytes(data[: int(share * len(data))])
        refused(Polygon.from_file, cut, unit="mm")
    cut.write_bytes(b"\x89PNG\r\n" + data[::-1])
    refused(Polygon.from_file, cut, unit="mm")


def test_crossing_lines_missing_files_and_other_endings(tmp_path):
    path = svg(tmp_path / "a.svg", '<path d="M0 0L10 10V0L0 10Z"/>')
    refused(Polygon.from_file, path, match="Self-intersection")
    refused(Polygon.from_file, tmp_path / "none.svg", match="no such file")
    refused(Polygon.from_file, tmp_path / "a.step", match=r".svg, .dxf, .stl")
    refused(Polygon.from_file, path, tolerance=0.0, match="tolerance")
    refused(Polygon.from_file, svg(tmp_path / "b.svg", ""), match="no closed outline")


def test_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "svgelements", None)
    with pytest.raises(MissingExtra, match=r"needs the package svgelements; run: pip install 'fix"):
        Polygon.from_file(svg(tmp_path / "a.svg", ""))
