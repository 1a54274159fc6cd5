"""Plan files: a sampling plan as a small YAML or JSON file.

The file contains the scheme, not the experiments generated from it. Lengths are in metres, angles
in radians, as in scene files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats.records import (
    FileRecord,
    NoneRecord,
    NonNegative,
    Number,
    Point,
    Positive,
    Triple,
    built,
    only_form,
    validated,
    within,
)
from fixel.formats.scene_model import plain_content, support_of
from fixel.formats.scene_schema import PointsRecord, TripodRecord, UniformRecord
from fixel.io.document import parse_yaml, read_document, yaml_text
from fixel.model import Disk, Ellipsoid, Polygon, Tripod
from fixel.sampling import (
    FixelLayout,
    Grid,
    Nominal,
    OffsetAxis,
    OffsetList,
    OffsetSample,
    OffsetScheme,
    Plan,
    PlannedShape,
    RegularPolygon,
    SamplingRig,
)
from fixel.sampling.rig import Outline

Values = Annotated[list[Number], Field(min_length=1)]
Rows = Annotated[list[Triple], Field(min_length=1)]
Bounds = Annotated[list[Number], Field(min_length=2, max_length=2)]


class RegularRecord(FileRecord):
    sides: int = Field(description="number of sides")
    side: Positive = Field(description="length of a side [m]")


class OutlineRecord(FileRecord):
    """Outline of a head or an object, in exactly one form."""

    polygon: list[Point] | None = Field(None, description="corners x, y of a polygon [m]")
    disk: Positive | None = Field(None, description="radius of a disk [m]")
    regular: RegularRecord | None = Field(
        None, description="regular polygon with one side facing -x"
    )


class RestRecord(FileRecord):
    """Support of an object, in exactly one form."""

    tripod: TripodRecord | None = Field(None, description="three points about the centre of mass")
    points: PointsRecord | None = Field(None, description="support at given points")
    uniform: UniformRecord | None = Field(None, description="uniform pressure over the footprint")
    none: NoneRecord | None = Field(None, description="no friction with the plane")


class HeadRecord(FileRecord):
    shape: OutlineRecord
    speed: Positive = Field(description="speed of the head [m/s]")
    travel: Positive = Field(description="distance after which the head stops [m]")
    force_limit: Positive | None = Field(None, description="force at which the drive stalls [N]")
    friction: NonNegative = Field(description="friction coefficient against the object")


class FixelsRecord(FileRecord):
    radius: Positive = Field(description="radius of each fixel [m]")
    friction: NonNegative = Field(description="friction coefficient against the object")
    zone_side: Positive = Field(description="side of the square zone of the fixels [m]")


class NominalPoseRecord(FileRecord):
    gap: Number = Field(description="gap between head and object along the motion [m]")
    angle: Number = Field(0.0, description="angle of the object [rad]")


class PlanShapeRecord(FileRecord):
    name: str
    shape: OutlineRecord
    mass: Positive = Field(description="mass of the object [kg]")
    support: RestRecord | None = Field(None, description="support of the object on the plane")
    zone_start: Number = Field(
        description="distance from the start of the head to the fixel zone [m]"
    )


class LayoutRecord(FileRecord):
    name: str
    pegs: list[Point] = Field(
        description="positions u, v of the fixels in the unit square of the zone"
    )
    number: int | None = Field(None, description="number of the layout in a publication")


class AxisRecord(FileRecord):
    name: Literal["x", "y", "theta"]
    step: Positive = Field(description="length of a step [m], or [rad] for theta")
    first: int = Field(description="number of the first step, may be negative")
    last: int = Field(description="number of the last step")


class GridRecord(FileRecord):
    x: Values = Field([0.0], description="offsets along x [m]")
    y: Values = Field([0.0], description="offsets along y [m]")
    theta: Values = Field([0.0], description="offsets of the angle [rad]")


class SampleRecord(FileRecord):
    method: Literal["sobol", "halton", "uniform"] = "sobol"
    count: int = Field(description="number of points")
    seed: int = Field(0, description="seed of the random number generator")
    x: Bounds = Field([0.0, 0.0], description="smallest and largest offset along x [m]")
    y: Bounds = Field([0.0, 0.0], description="smallest and largest offset along y [m]")
    theta: Bounds = Field([0.0, 0.0], description="smallest and largest offset of the angle [rad]")


class OffsetsRecord(FileRecord):
    """Scheme of offsets from the nominal pose, in exactly one form."""

    nominal: NoneRecord | None = Field(None, description="nominal pose: {}")
    axis: AxisRecord | None = Field(None, description="steps along one axis, without step 0")
    grid: GridRecord | None = Field(None, description="all combinations of values")
    list: Rows | None = Field(None, description="offsets x [m], y [m], theta [rad]")
    sample: SampleRecord | None = Field(None, description="points that fill a box")


class PlanRecord(FileRecord):
    """Content of a plan file."""

    fixel_plan: Literal[1] = Field(description="version of the format")
    name: str
    head: HeadRecord = Field(
        description="head of the pusher, which starts at the origin and moves along +x"
    )
    fixels: FixelsRecord
    nominal: NominalPoseRecord = Field(description="pose to which offsets are added")
    shapes: list[PlanShapeRecord] = Field(description="objects")
    layouts: list[LayoutRecord] = Field(description="layouts of the fixels")
    offsets: list[OffsetsRecord] = Field(
        description="schemes of offsets of the object, performed in this order"
    )
    repetitions: int = Field(1, description="number of runs of each configuration")


def load_plan(path: str | Path) -> Plan:
    """Load a plan file: YAML, or JSON if the name ends in `.json`.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    return _plan(read_document(Path(path), "plan file"))


def plan_from_text(text: str, where: str = "plan") -> Plan:
    """Parse a plan from YAML text; `where` names it in errors."""
    return _plan(parse_yaml(text, where))


def plan_text(plan: Plan) -> str:
    """Return a plan as YAML text, from which `plan_from_text` builds an equal plan."""
    return yaml_text(_content(plan))


def _plan(raw: Any) -> Plan:
    record = validated(PlanRecord, raw, "plan")
    head, fixels, nominal = record.head, record.fixels, record.nominal
    rig = SamplingRig(
        head=_outline(head.shape, "head.shape"),
        speed=head.speed,
        travel=head.travel,
        force_limit=head.force_limit,
        head_friction=head.friction,
        fixel_friction=fixels.friction,
        fixel_radius=fixels.radius,
        zone_side=fixels.zone_side,
        gap=nominal.gap,
        angle=nominal.angle,
    )
    return Plan(
        name=record.name,
        rig=rig,
        shapes=tuple(_shape(shape, f"shapes[{k}]") for k, shape in enumerate(record.shapes)),
        layouts=tuple(_layout(layout, f"layouts[{k}]") for k, layout in enumerate(record.layouts)),
        schemes=tuple(_scheme(form, f"offsets[{k}]") for k, form in enumerate(record.offsets)),
        repetitions=record.repetitions,
    )


def _shape(record: PlanShapeRecord, path: str) -> PlannedShape:
    outline = _outline(record.shape, f"{path}.shape")
    support = support_of(record.support, f"{path}.support")
    with within(path, f"shape {record.name!r}.", "shape."):
        return PlannedShape(
            name=record.name,
            outline=outline,
            mass=record.mass,
            support=support,
            zone_start=record.zone_start,
        )


def _outline(record: OutlineRecord, path: str) -> Outline:
    form = only_form(record, path)
    if record.regular:
        return built(RegularPolygon, record.regular, path)
    with within(path):
        return (Disk if form == "disk" else Polygon)(getattr(record, form))


def _layout(record: LayoutRecord, path: str) -> FixelLayout:
    pegs = tuple((u, v) for u, v in record.pegs)
    return built(FixelLayout, record, path, f"layout {record.name!r}.", "layout.", pegs=pegs)


def _scheme(record: OffsetsRecord, path: str) -> OffsetScheme:
    only_form(record, path)
    if record.axis:
        return built(OffsetAxis, record.axis, path)
    if record.grid:
        return built(Grid, record.grid, path, **{name: tuple(v) for name, v in record.grid})
    if record.sample:
        return built(OffsetSample, record.sample, path)
    if record.list:
        with within(path):
            return OffsetList(tuple((x, y, theta) for x, y, theta in record.list))
    return Nominal()


def _content(plan: Plan) -> dict[str, Any]:
    rig = plan.rig
    limit = {} if rig.force_limit is None else {"force_limit": rig.force_limit}
    return {
        "fixel_plan": 1,
        "name": plan.name,
        "head": {
            "shape": _outline_content(rig.head),
            "speed": rig.speed,
            "travel": rig.travel,
            **limit,
            "friction": rig.head_friction,
        },
        "fixels": {
            "radius": rig.fixel_radius,
            "friction": rig.fixel_friction,
            "zone_side": rig.zone_side,
        },
        "nominal": {"gap": rig.gap, "angle": rig.angle},
        "shapes": [
            {
                "name": shape.name,
                "shape": _outline_content(shape.outline),
                "mass": shape.mass,
                "support": _support_content(shape),
                "zone_start": shape.zone_start,
            }
            for shape in plan.shapes
        ],
        "layouts": [
            {
                "name": layout.name,
                **({} if layout.number is None else {"number": layout.number}),
                "pegs": [list(peg) for peg in layout.pegs],
            }
            for layout in plan.layouts
        ],
        "offsets": [_scheme_content(scheme) for scheme in plan.schemes],
        "repetitions": plan.repetitions,
    }


def _outline_content(outline: Outline) -> Any:
    if isinstance(outline, RegularPolygon):
        return {"regular": {"sides": outline.sides, "side": outline.side}}
    return plain_content(outline)


def _support_content(shape: PlannedShape) -> Any:
    support = shape.support
    if isinstance(support, Ellipsoid):
        raise InvalidInput(
            f"shape {shape.name!r}.support",
            found="a Ellipsoid",
            expected="a Tripod, SupportPoints, UniformPressure or NoSupport, the supports of "
            "plan files",
        )
    content = plain_content(support)
    if isinstance(support, Tripod) and not support.angle:
        del content["tripod"]["angle"]
    return content


def _scheme_content(scheme: OffsetScheme) -> dict[str, Any]:
    match scheme:
        case Nominal():
            return {"nominal": {}}
        case OffsetAxis(name=name, step=step, first=first, last=last):
            return {"axis": {"name": name, "step": step, "first": first, "last": last}}
        case Grid(x=x, y=y, theta=theta):
            return {"grid": {"x": list(x), "y": list(y), "theta": list(theta)}}
        case OffsetList(rows=rows):
            return {"list": [list(row) for row in rows]}
        case OffsetSample(method=method, count=count, seed=seed):
            bounds = {name: list(getattr(scheme, name)) for name in ("x", "y", "theta")}
            return {"sample": {"method": method, "count": count, "seed": seed, **bounds}}
