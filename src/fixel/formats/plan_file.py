"""Plan files: a sampling plan as a small YAML or JSON file.

The file contains the scheme, not the experiments generated from it. Lengths are in metres, angles
in radians, as in scene files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field

from fixel import sampling
from fixel.errors import InvalidInput
from fixel.formats import scene_file as _shapes_and_supports  # noqa: F401
from fixel.formats.records import arguments, choice_of, content, keys_of, made, record_of, validated
from fixel.io.document import document, yaml_text
from fixel.model import Disk, Ellipsoid, NoSupport, Polygon, SupportPoints, Tripod, UniformPressure
from fixel.sampling.rig import Outline

record_of(sampling.RegularPolygon, "regular")
choice_of("OutlineRecord", Outline, polygon=Polygon, disk=Disk, regular=sampling.RegularPolygon)
RestRecord: Any = choice_of(
    "RestRecord", tripod=Tripod, points=SupportPoints, uniform=UniformPressure, none=NoSupport
)
record_of(sampling.PlannedShape, "shape", names={"outline": "shape"}, support=RestRecord)
record_of(sampling.FixelLayout, "layout")
record_of(sampling.Nominal, "nominal")
record_of(sampling.OffsetAxis, "axis")
record_of(sampling.Grid, "grid")
record_of(sampling.OffsetSample, "sample")
choice_of(
    "OffsetsRecord",
    sampling.OffsetScheme,
    nominal=sampling.Nominal,
    axis=sampling.OffsetAxis,
    grid=sampling.Grid,
    list=sampling.OffsetList,
    sample=sampling.OffsetSample,
)
# Sections of a file that together are its rig: their keys by the names of fields.
_RIG: Final = {
    "head": {"head": "shape", "head_friction": "friction"}
    | {name: name for name in ("speed", "travel", "force_limit")},
    "fixels": {"fixel_radius": "radius", "fixel_friction": "friction", "zone_side": "zone_side"},
    "nominal": {"gap": "gap", "angle": "angle"},
}
SECTIONS: Final = {
    section: record_of(
        sampling.SamplingRig,
        "rig",
        title=f"{section.capitalize()}Record",
        names=names,
        leave_out=[name for name in sampling.SamplingRig.__dataclass_fields__ if name not in names],
    )
    for section, names in _RIG.items()
}
PlanRecord: Any = record_of(
    sampling.Plan,
    "",
    names={"schemes": "offsets"},
    leave_out=["rig"],
    more={
        "fixel_plan": (Literal[1], Field(description="version of the format")),
        **{section: (record, ...) for section, record in SECTIONS.items()},
    },
)


def load_plan(path: str | Path) -> sampling.Plan:
    """Load a plan file: YAML, or JSON if the name ends in `.json`."""
    rig: dict[str, Any] = {}
    with document(path, "plan file") as raw:
        record = validated(PlanRecord, raw, "plan")
        for section in SECTIONS:
            rig |= arguments(getattr(record, section), section)
        plan: sampling.Plan = made(record, rig=sampling.SamplingRig(**rig))
    return plan


def plan_text(plan: sampling.Plan) -> str:
    """Return a plan as the text of a YAML file, from which `load_plan` loads an equal plan."""
    return yaml_text(_content(plan))


def _content(plan: sampling.Plan) -> dict[str, Any]:
    for shape in plan.shapes:
        if isinstance(shape.support, Ellipsoid):
            raise InvalidInput(
                f"shape {shape.name!r}.support",
                found="a Ellipsoid",
                expected="a Tripod, SupportPoints, UniformPressure or NoSupport, the supports of "
                "plan files",
            )
    found = content(plan)
    for shape in found["shapes"]:
        if not shape["support"].get("tripod", {}).get("angle", 1.0):
            del shape["support"]["tripod"]["angle"]
    sections = {section: keys_of(plan.rig, record) for section, record in SECTIONS.items()}
    return {"fixel_plan": 1, "name": found.pop("name"), **sections, **found}
