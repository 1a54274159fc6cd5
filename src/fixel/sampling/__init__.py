"""Plans of experiments: configurations to measure."""

from fixel.sampling.offsets import (
    Grid as Grid,
    Nominal as Nominal,
    Offset as Offset,
    OffsetAxis as OffsetAxis,
    OffsetList as OffsetList,
    OffsetSample as OffsetSample,
    OffsetScheme as OffsetScheme,
)
from fixel.sampling.plan import Plan as Plan, PlanProblem as PlanProblem, rehearse as rehearse
from fixel.sampling.published import (
    eight_push_plan as eight_push_plan,
    table_plan as table_plan,
    thesis_plan as thesis_plan,
)
from fixel.sampling.rig import (
    FixelLayout as FixelLayout,
    PlannedShape as PlannedShape,
    RegularPolygon as RegularPolygon,
    SamplingRig as SamplingRig,
)
from fixel.sampling.rows import about_part as about_part
