"""Perform a plan of experiments at a bench: open its devices and its campaign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Fit, Seed
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import PlannedExperiment
    from fixel.workflows.analysis import AnalysisReport
    from fixel.workflows.bench.devices import BenchDevices
    from fixel.workflows.bench.loop import BenchLoop

YOURS: Final = "that of fixel.yaml"
# As `fixel overlay` names it; the other name is that of version 0.2.
ANGLE: Final = Door(
    flag="--tolerance-deg", also=("--tolerance-angle-deg",), unit="deg", above=0.0,
    usual="the rig's",
)  # fmt: skip


def open_bench(
    project: Project,
    plan: Annotated[
        Path | None, Door(metavar="PLAN", usual="the 420 experiments of the thesis")
    ] = None,
    *,
    limit: Annotated[int | None, Door(least=1, metavar="COUNT")] = None,
    emulated: bool = False,
    auto: bool = False,
    choose: bool = False,
    until: Annotated[str, Door(metavar="NAME=WIDTH")] = "",
    fit: Fit = (),
    motion: Annotated[str, Door(metavar="NAME")] = "quasistatic",
    scene: Path | None = None,
    about_part: bool = False,
    name: Annotated[str, Door(metavar="NAME", usual="that of the plan")] = "",
    rig: Annotated[str | None, Door(metavar="RIG", usual=YOURS)] = None,
    camera: Annotated[str | None, Door(metavar="SOURCE", usual=YOURS)] = None,
    tactile: Annotated[str | None, Door(metavar="PORT", usual=YOURS)] = None,
    driver: Annotated[str | None, Door(metavar="DRIVER", usual=YOURS)] = None,
    port: Annotated[str | None, Door(metavar="PORT", usual=YOURS)] = None,
    axes: Annotated[str | None, Door(metavar="AXES", usual=YOURS)] = None,
    drive_pose: Annotated[str | None, Door(metavar="X,Y,ANGLE", usual=YOURS)] = None,
    tolerance: Annotated[float | None, Door(unit="mm", above=0.0, usual="the rig's")] = None,
    tolerance_angle: Annotated[float | None, ANGLE] = None,
    seed: Seed = 1,
    dry_run: bool = False,
    check: bool = False,
) -> AbstractContextManager[BenchLoop]:
    """Perform a plan of experiments at a bench, row by row.

    The same command continues after an interruption. Nothing is ever deleted. A plan, a device or
    a row that the drive cannot perform is refused before anything moves.

    Parameters
    ----------
    project : Project
        Project that stores the experiments.
    plan : Path, optional
        Plan file, or a table (.csv) with one row per experiment.
    limit : int, optional
        Number of experiments of the campaign at which to stop.
    emulated : bool
        Whether to use an emulated laboratory instead of devices.
    auto : bool
        Whether to push as soon as the part is in place, and to repeat what has a fault.
    choose : bool
        Whether the next row is the one that narrows the widest interval most.
    until : str
        Half-widths of 95 % intervals at which to stop: mu_pusher=0.02,tripod_radius=1mm.
    fit : tuple of str
        Parameter to calibrate meanwhile, as for fixel calibrate; may be repeated.
    motion : str
        Motion model of these calibrations.
    scene : Path, optional
        Scene file from which the rows of a table differ; by default scene.yaml in its folder.
    about_part : bool
        Whether to move each row so that the part always lies at the place of the first one, for a
        drive with several axes that pushes it from all sides.
    name : str
        Name of the campaign, which is the dataset of its experiments.
    rig : str, optional
        Rig with camera and markers, by name or file.
    camera : str, optional
        Camera: 0, /dev/video0 or http://...
    tactile : str, optional
        Serial port of the tactile board.
    driver : str, optional
        Kind of drive: grbl, manual or simulated.
    port : str, optional
        Serial port of the drive's controller.
    axes : str, optional
        Axes of the controller, such as X or XY.
    drive_pose : str, optional
        Pose of the coordinates of a drive with several axes in the world [mm, mm, deg].
    tolerance : float, optional
        Largest allowed position error of a part [m].
    tolerance_angle : float, optional
        Largest allowed angle error of a part [rad].
    seed : int
        Seed of the emulated laboratory.
    dry_run : bool
        Whether to check every row against the limits of the drive, and to move nothing.
    check : bool
        Whether to measure the bench with the part of the first row, and to push nothing.

    Returns
    -------
    context manager
        It opens the devices and gives a `BenchLoop`, whose `run` performs the plan.

    Raises
    ------
    InvalidInput, DeviceFailed, JobRefused
        A plan, device or row is refused, a device does not answer as it should, or another process
        performs this campaign.
    """
    call = locals()
    from fixel.sampling import about_part as pushes_about_part, thesis_plan
    from fixel.sampling.rig import plain_name
    from fixel.workflows.bench.devices import SETTINGS, emulated_devices, open_devices, settings_of
    from fixel.workflows.bench.estimates import check_wishes
    from fixel.workflows.sampling import planned_rows

    read = planned_rows(plan, project, scene=scene) if plan else thesis_plan().experiments
    rows = pushes_about_part(read) if about_part else read
    check_wishes(rows, fit, motion, until)
    given = {key: call[key] for key in SETTINGS if key in call}
    settings = settings_of(project.settings.bench, given)
    for key in given.keys() - {"rig"} if emulated else ():
        if given[key] is not None:
            raise InvalidInput(key, found=repr(given[key]), expected="none for an emulated bench")
    devices = emulated_devices(rows, seed, rig or "") if emulated else open_devices(settings)
    usual = "thesis" if plan is None else plan.stem
    options = BENCH.asked({**call, "name": plain_name(name, "name") if name else usual})
    return _opened(project, rows, devices, dict(options))


@contextmanager
def _opened(
    project: Project,
    rows: Sequence[PlannedExperiment],
    devices: AbstractContextManager[BenchDevices],
    options: Mapping[str, Any],
) -> Iterator[BenchLoop]:
    from fixel.vision.tracking.follow import Locator
    from fixel.workflows.bench.campaign import BENCH as FOLDER, Campaign
    from fixel.workflows.bench.loop import BenchLoop

    with devices as opened:
        for row in rows:
            opened.check(row)
            things = row.scene.bodies[0], row.scene.pushers[0]
            Locator(opened.rig, row.scene, tuple(own.name for own in things))
        campaign = Campaign(project.folder / FOLDER / options["name"], rows, options["emulated"])
        with closing(campaign):
            own = {one.name: options[one.name] for one in fields(BenchLoop) if one.kw_only}
            yield BenchLoop(project, campaign, opened, **own)


def report_of(loop: BenchLoop) -> AnalysisReport:
    """Return the rows, attempts and estimates of a campaign."""
    from fixel.table import Table
    from fixel.workflows.analysis import Analysis, AnalysisReport
    from fixel.workflows.bench.acceptance import figure_table

    campaign, live = loop.campaign, loop.live
    n, rows = len(campaign.accepted), len(campaign.rows)
    attempts = [
        (own.row, own.number, own.state, "; ".join(own.reasons) or "-")
        for own in campaign.attempts.values()
        if own.state != "accepted"
    ]
    tables = [] if live is None else [live.table]
    if loop.figures:
        tables.insert(0, figure_table(loop.figures))
    if attempts:
        head = ("row", "attempt", "state", "reasons")
        tables.append(Table(head, attempts, title="Attempts without an experiment"))
    numbers = {
        "campaign": campaign.folder.name,
        "folder": str(campaign.folder),
        "rows": rows,
        "accepted": n,
        "skipped": sorted(campaign.skipped),
        "attempts": [own._asdict() for own in campaign.attempts.values()],
        "finish": loop.finish,
        "half_widths": {} if live is None else dict(live.estimates.half_widths),
        "values": {} if live is None else dict(live.estimates.calibration),
        "check": [own._asdict() | {"verdict": own.verdict} for own in loop.figures],
        "held_out_error_m": None if live is None else live.estimates.held_out_error,
    }
    return AnalysisReport(
        Analysis(
            kind="bench",
            title=f"Campaign {campaign.folder.name}",
            question={},
            headline=(f"Rows with experiments: {n} of {rows}; {loop.finish or 'not finished'}.",),
            tables=tuple(tables),
            notes=() if live is None else live.words,
            numbers=numbers,
        )
    )


BENCH: Final = Capability(name="bench", function=open_bench, plot="")
