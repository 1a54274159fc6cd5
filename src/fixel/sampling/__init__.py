"""Plans of experiments: configurations to measure."""

from fixel.sampling.offsets import (
    Grid,
    Nominal,
    Offset,
    OffsetAxis,
    OffsetList,
    OffsetSample,
    OffsetScheme,
)
from fixel.sampling.plan import Plan, PlanProblem, rehearse
from fixel.sampling.published import eight_push_plan, table_plan, thesis_plan
from fixel.sampling.rig import FixelLayout, PlannedShape, RegularPolygon, SamplingRig
from fixel.sampling.rows import about_part

__all__ = [
    "FixelLayout",
    "Grid",
    "Nominal",
    "Offset",
    "OffsetAxis",
    "OffsetList",
    "OffsetSample",
    "OffsetScheme",
    "Plan",
    "PlanProblem",
    "PlannedShape",
    "RegularPolygon",
    "SamplingRig",
    "about_part",
    "eight_push_plan",
    "rehearse",
    "table_plan",
    "thesis_plan",
]
