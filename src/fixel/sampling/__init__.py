"""Plans of experiments: which configurations to try."""

from fixel.sampling.checks import Problem
from fixel.sampling.eight_push import eight_push_plan
from fixel.sampling.offsets import Axis, Grid, Listed, Nominal, Offset, OffsetScheme, Sampled
from fixel.sampling.plan import Plan
from fixel.sampling.rehearsal import rehearse
from fixel.sampling.rig import Layout, PlannedShape, RegularPolygon, Rig
from fixel.sampling.thesis import thesis_plan

__all__ = [
    "Axis",
    "Grid",
    "Layout",
    "Listed",
    "Nominal",
    "Offset",
    "OffsetScheme",
    "Plan",
    "PlannedShape",
    "Problem",
    "RegularPolygon",
    "Rig",
    "Sampled",
    "eight_push_plan",
    "rehearse",
    "thesis_plan",
]
