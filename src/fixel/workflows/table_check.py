"""Check from repeated pushes whether a table is good enough: in memory, or of a project."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import ConditionName, Door, Flagged, Level, Seed, Where

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import Experiment
    from fixel.parts.table_check import TableCheck
    from fixel.progress import ProgressOption
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer

JSON: Final = ("folder", "pictures")  # what `--json` has besides numbers


def table_check(
    experiments: Iterable[Experiment],
    *,
    part: ConditionName = None,
    surface: ConditionName = None,
    session: ConditionName = None,
    position: Annotated[float, Door(unit="mm", above=0.0)] = 2e-3,
    angle: Annotated[float, Door(unit="deg", above=0.0)] = math.radians(3.0),
    level: Level = 0.95,
    seed: Seed = 0,
) -> TableCheck:
    """Check from repeated pushes whether a table is good enough for plans.

    Pushes with the same contact, direction and travel in the frame of the part should move it
    equally. They differ by noise from run to run, and by where and how the part lies on an uneven
    table. `fixel sample --table` plans such pushes.

    Parameters
    ----------
    experiments : sequence of Experiment
        Pushes on one table. Those without a scene of one part and one pusher are left out.
    part : str, optional
        Condition that names the part; by default the first of `shape`, `part`, `object` and
        `object_id` that experiments have.
    surface : str, optional
        Condition that names the table; by default `surface` or `table`.
    session : str, optional
        Condition that names the session; by default the first of `session`, `date`, `day`, `batch`,
        `speed` and `speed_m_s` that experiments have.
    position : float
        Tolerance of a plan for the position of the part [m].
    angle : float
        Tolerance of a plan for the angle of the part [rad].
    level : float
        Confidence level of the intervals.
    seed : int
        Seed of the bootstrap over different pushes, or over spots of the table if there are few.

    Returns
    -------
    TableCheck
        `.verdict` is `good enough`, `not good enough` or `undecided`; `.effects` has the causes.

    Raises
    ------
    InvalidInput
        No push was repeated at one place and elsewhere, or there are several tables.

    Examples
    --------
    >>> import fixel
    >>> from fixel.sampling import table_plan
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> uneven = SimulatedTestbed(plate_roughness=0.0, uneven_table=2.0)
    >>> check = fixel.table_check(uneven.run(table_plan().experiments))
    >>> check["place"].is_found, check["orientation"].is_found
    (True, False)
    """
    TABLE_CHECK.asked(locals())
    from fixel.calibration.known_pushes import check_conditions
    from fixel.calibration.target import targets_of
    from fixel.datasets import Experiments
    from fixel.parts.table_check import check_table

    used = [own for own in Experiments.of(experiments) if own.scene is not None
            and len(own.scene.bodies) == len(own.scene.pushers) == 1]  # fmt: skip
    check_conditions(used, part=part, surface=surface, session=session)
    targets, real = targets_of(used), all(own.real for own in used)
    return check_table(targets, part, surface, session, (position, angle), level, seed, real)


def check_stored(
    project: Project,
    *,
    where: Where = (),
    flagged: Flagged = False,
    progress: ProgressOption = None,
    **options: Any,
) -> TableCheck:
    """Check from repeated pushes whether a table is good enough for plans.

    `fixel sample --table` plans such pushes.

    Parameters
    ----------
    **options
        Options of `fixel.table_check`.
    """
    return table_check(project.experiments(*where, flagged=flagged), **options)


def report_of(check: TableCheck) -> AnalysisReport:
    """Return verdict, tables, notes, figure and numbers of a checked table."""
    from fixel.drawing.parts import table_chart
    from fixel.workflows.analysis import AnalysisReport, Picture, analysis_of

    names = ("name", "position_m", "angle_rad", "within", "pairs")
    effects = [dict(zip(names, own, strict=True)) for own in check.effects]
    numbers = {"verdict": check.verdict, "loss": check.loss, "session": check.session}
    numbers |= {"effects": effects}
    analysis = analysis_of("table-check", check, title="Check of a table", numbers=numbers)
    caption = "Differences of equal pushes by the distance and turn between them, with means."
    banner = "" if check.real else "SIMULATED"
    return AnalysisReport(analysis, [Picture("pairs", table_chart(check), banner, caption)])


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that draws the pairs."""
    return [] if done.drawn else [*done.again, "--plot", "table"]


TABLE_CHECK: Final = Capability(
    name="table-check",
    title="Table check",
    function=check_stored,
    of=table_check,
    leave_out=("experiments",),
    group="table",
    verb="check",
)
