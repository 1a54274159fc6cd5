"""`fixel show`, `calibrations` and `report`: an experiment; calibrations; a page about one."""

import sys
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fixel.capability.options import CalibrationId, Door, EngineName
from fixel.cli import screen
from fixel.cli.capability import command
from fixel.errors import NotStored, counted
from fixel.table import Column, Table, shortened
from fixel.workflows.sentences import origin_of

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import Experiment
    from fixel.workflows.report.write import Report

MAX_ROWS = 20


@command
def show(
    project: "Project",
    experiment: Annotated[str, Door(metavar="EXPERIMENT")],
    *,
    plot: Annotated[Path | None, Door(writes=True)] = None,
) -> screen.CommandAnswer:
    """Show an experiment: scene, data, faults and provenance.

    Parameters
    ----------
    experiment : str
        Experiment: its id, its name, or DATASET/NAME.
    plot : Path, optional
        Draw the experiment: .png, .svg or .pdf.
    """
    from fixel.workflows.project.compare import summary

    screen.require_picture(plot)
    with project.store() as store:
        number = store.find(experiment)
        found, replaced_by = store.experiment(number), store.replacement(number)
    if plot is not None:
        from fixel.drawing.chart import save_figure
        from fixel.drawing.experiment import experiment_figure

        save_figure(lambda: experiment_figure(found), plot)
    files = {} if plot is None else {"plot": str(plot)}
    content = {"id": number, "replaced_by": replaced_by, **summary(found), "files": files}
    about = [origin_of(found), f"experiment {number} of dataset {found.dataset}"]
    if replaced_by is not None:
        about.append(f"replaced by experiment {replaced_by} of the same name")
    key = found.key if replaced_by is None else f"id:{number}"
    following = f"Next: {_next_show(found, key, project.folder, plot)}"
    return screen.CommandAnswer(
        content, screen.paragraphs(about, *_blocks(found), screen.wrote([plot]), [following])
    )


def _blocks(experiment: "Experiment") -> list[list[str]]:
    """Return what is known of an experiment, about a screen of text in blocks of lines."""
    conditions = {
        name: value if isinstance(value, str) else f"{value:.6g}"
        for name, value in experiment.conditions.items()
    }
    channels = [
        (channel.name, f"{counted(len(channel.time), 'reading')} of {', '.join(channel.columns)}")
        for channel in experiment.channels
    ]
    return [
        _frames(experiment),
        _poses(experiment),
        [f"contact mode at the end: {experiment.contact_mode or 'unknown'}"],
        _listed("conditions", [*conditions.items()]),
        _listed("flags", [(f.name, f.detail) for f in experiment.flags if f.fault]),
        _listed("remarks", [(f.name, f.detail) for f in experiment.flags if not f.fault]),
        _listed("channels", channels),
        _provenance(experiment),
    ]


def _frames(experiment: "Experiment") -> list[str]:
    from fixel.workflows.project.compare import frame_rate

    rate = frame_rate(experiment.trajectory)
    count = len(experiment.trajectory.time)
    lines = [
        counted(count, "frame") + ("" if rate is None else f" at {rate:.4g} Hz")
        + f", {experiment.duration:.4g} s"
    ]  # fmt: skip
    if experiment.effective is not None:
        first, last = experiment.effective
        lines.append(f"usable from {first:.4g} to {last:.4g} s")
    return lines


def _poses(experiment: "Experiment") -> list[str]:
    from fixel.workflows.project.compare import travelled

    unit, metre = experiment.length_unit
    rows = []
    for name, row in (("start", 0), ("end", -1)):
        x, y, angle = experiment.trajectory.pose[row].tolist()
        rows.append((name, x / metre, y / metre, degrees(angle)))
    x_and_y = (Column("x", unit, ".2f"), Column("y", unit, ".2f"))
    columns = (experiment.object_name, *x_and_y, Column("angle", "deg", ".2f"))
    way = travelled(experiment.trajectory, 1e-3 if unit == "mm" else 1e-6)
    return [*Table(columns, rows).lines(), f"path length {way / metre:.2f} {unit}"]


def _listed(title: str, rows: list[tuple[str, str]]) -> list[str]:
    if not rows:
        return []
    width = max(len(name) for name, _ in rows[:MAX_ROWS])
    shown = [f"  {name.ljust(width)}  {value}".rstrip() for name, value in rows[:MAX_ROWS]]
    return [title, *shortened(shown, len(rows), "  ")]


def _provenance(experiment: "Experiment") -> list[str]:
    origin = experiment.provenance
    values = {
        "source": origin.source,
        "sha256": origin.sha256,
        "command": origin.command,
        "seed": "" if origin.seed is None else str(origin.seed),
        "fixel": origin.version,
        "stored": origin.created,
    }
    return _listed("provenance", [(name, value) for name, value in values.items() if value])


def _next_show(experiment: "Experiment", key: str, project: Path, plot: Path | None) -> str:
    """Return the command that most users need next for an experiment, named by its key or id."""
    if plot is None:
        picture = experiment.name.replace("/", "-") + ".png"
        return screen.command_of("show", key, "--plot", picture, project=project)
    if experiment.scene is not None:
        return screen.command_of("compare", key, project=project)
    return screen.command_of("list", project=project)


@command
def report(
    project: "Project",
    *,
    out: Annotated[Path, Door(metavar="FOLDER")] = Path("report"),
    calibration: CalibrationId = None,
    engine: EngineName = "",
    title: str = "",
) -> screen.CommandAnswer:
    """Write a report on a calibration, with errors and verdicts.

    The page needs no network. Next to it: every figure as PDF, and a bibliography.

    Parameters
    ----------
    out : Path
        Folder of the report; created if missing.
    calibration : int, optional
        Id of the calibration; by default the newest for several experiments.
    engine : str
        Use the newest calibration by this engine, such as mujoco.
    title : str
        Title of the report.
    """
    options: Any = {"calibration": calibration, "engine": engine, "title": title}
    tell = screen.notify if sys.stderr.isatty() else None
    done = project.report(out, **options, command=screen.command_line(), notify=tell)
    return screen.CommandAnswer(done.summary(), _lines(done))


def _lines(done: "Report") -> list[str]:
    from fixel.workflows.report.write import next_command

    content = done.content
    n = len(content.warnings)
    return [
        *content.findings,
        "",
        f"{counted(n, 'warning')}, at the top of the report:" if n else "no warnings",
        *(f"  - {sentence}" for sentence in content.warnings),
        "",
        f"wrote {done.page} ({done.size / 1e6:.1f} MB), {len(done.figures)} figures as PDF in"
        f" {done.page.parent / 'figures'}, {done.bibliography}",
        f"Next: {next_command(done)}",
    ]


@command
def calibrations(project: "Project", calibration: CalibrationId = None) -> screen.CommandAnswer:
    """List stored calibrations, or show the estimates of one.

    Parameters
    ----------
    calibration : int, optional
        Id of a calibration to show; all are listed without it.
    """
    from fixel.workflows.calibration.stored import list_calibrations, stored_calibration

    if calibration is None:
        listed = list_calibrations(project)
        if not listed.rows:
            raise NotStored("calibration", hint="make one with: fixel calibrate")
        following = screen.command_of("calibrations", listed.rows[0][0], project=project.folder)
        lines = [*listed.lines(), f"Next: {following}"]
        return screen.CommandAnswer({"calibrations": listed.records()}, lines)
    fit = stored_calibration(project, calibration)
    content = {
        "calibration": calibration,
        "estimates": [own.stored() for own in fit.estimates.values()],
        "parameters": dict(fit),
        "rms_error_mm": 1e3 * fit.rms_error,
        "experiments": list(fit.keys_of_experiments),
        **fit.analysis.texts(),
        **{own: getattr(fit, own) for own in ("status", "evaluations", "command", "call")},
    }
    return screen.CommandAnswer(
        content, [repr(fit), *([f"Repeat it: {fit.command}"] if fit.command else [])]
    )
