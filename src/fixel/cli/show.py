"""`fixel show KEY` and `fixel compare KEY`: one stored experiment, and a simulation of it."""

import json
import shlex
import sys
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, project_words
from fixel.cli.simulation import NOT_SOLVED, MotionChoice
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.model import Experiment, Parameters
    from fixel.workflows.project.compare import Comparison

HERE = Path()
MAX_ROWS = 20

Key = Annotated[
    str,
    typer.Argument(help="Experiment: its id, its name, or DATASET/NAME.", show_default=False),
]


def show(
    key: Key,
    project: ProjectFolder = HERE,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the experiment: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show an experiment: its facts, what was measured, and how far to believe it."""
    from fixel.database.project import Project
    from fixel.io.atomic import written_whole
    from fixel.workflows.project.compare import summary

    _refuse_picture(plot)
    with Project.open(project).store() as store:
        number = store.find(key)
        experiment = store.experiment(number)
    if plot is not None:
        from fixel.drawing.experiment import draw_experiment

        with written_whole(plot) as unfinished:
            draw_experiment(experiment, unfinished)
    if as_json:
        typer.echo(_json({"id": number, **summary(experiment), "files": _files(plot)}))
    else:
        typer.echo(_written_show(number, experiment, project, plot))


def compare(
    key: Key,
    project: ProjectFolder = HERE,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A parameter of the simulation, e.g. mu_support=0.3; may be repeated.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    calibration: Annotated[
        int | None,
        typer.Option(
            help="Id of a stored calibration: its parameters and its motion model; --set and"
            " --motion change them.",
            metavar="ID",
        ),
    ] = None,
    motion: Annotated[
        MotionChoice | None, typer.Option(help="Motion model; dynamic where left out.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw both motions: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
    save: Annotated[bool, typer.Option("--save", help="Keep the simulation.")] = False,
) -> None:
    """Simulate an experiment, and report how far the simulation is from what was measured."""
    from fixel.database.project import Project
    from fixel.simulation.motion import MOTION_MODELS
    from fixel.workflows.calibration.stored import parameters_of
    from fixel.workflows.project.compare import comparison

    _refuse_picture(plot)
    parameters = _parameters(set_ or [])
    models = {model.name: model for model in MOTION_MODELS}
    with Project.open(project).store() as store:
        number = store.find(key)
        experiment = store.experiment(number)
        model = models[motion]() if motion else None
        if calibration is not None:
            parameters, model = parameters_of(store, calibration, experiment, parameters, model)
        _announce(experiment, as_json)
        answer = comparison(experiment, parameters, model)
        command = _command("compare", experiment, project, set_ or [], motion, calibration)
        saved = store.add_simulation(answer.record(number, command)) if save else None
    if plot is not None:
        _draw(answer, plot)
    if as_json:
        extra = {"experiment_id": number, "simulation_id": saved, "files": _files(plot)}
        typer.echo(_json(answer.summary() | extra))
    else:
        typer.echo(_written_compare(answer, project, plot, saved, command))
    if not answer.complete:
        raise typer.Exit(NOT_SOLVED)


# --- what both share --------------------------------------------------------------------------


def _refuse_picture(plot: Path | None) -> None:
    """Reject an invalid file for the chart before any work."""
    if plot is not None:
        from fixel.drawing.chart import PICTURE_ENDINGS, refuse_ending
        from fixel.io.atomic import refuse_unwritable

        refuse_ending(plot, PICTURE_ENDINGS, "picture")
        refuse_unwritable(plot)


def _json(answer: dict[str, object]) -> str:
    from fixel.formats.trajectory_file import plain_numbers

    return json.dumps(plain_numbers(answer), allow_nan=False)


def _files(plot: Path | None) -> dict[str, str]:
    return {} if plot is None else {"plot": str(plot)}


def _joined(blocks: list[list[str]]) -> str:
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _command(
    name: str,
    experiment: "Experiment",
    project: Path,
    set_: list[str] | None = None,
    motion: MotionChoice | None = None,
    calibration: int | None = None,
) -> str:
    """Return the command, to be run in the current folder."""
    words = ["fixel", name, experiment.key, *project_words(project)]
    if calibration is not None:
        words += ["--calibration", str(calibration)]
    for value in set_ or []:
        words += ["--set", value]
    if motion is not None:
        words += ["--motion", motion.value]
    return shlex.join(words)


def _origin(experiment: "Experiment") -> str:
    what = "real" if experiment.real else f"SIMULATED by {experiment.simulated_by}"
    return f"{experiment.key}: {what}"


# --- show -------------------------------------------------------------------------------------


def _written_show(number: int, experiment: "Experiment", project: Path, plot: Path | None) -> str:
    """Return about a screen of text."""
    blocks = [
        [_origin(experiment), f"experiment {number} of dataset {experiment.dataset}"],
        _frames(experiment),
        _poses(experiment),
        _mode(experiment),
        _listed("conditions", [(k, _value(v)) for k, v in experiment.conditions.items()]),
        _listed("flags", [(f.name, f.detail) for f in experiment.flags if f.fault]),
        _listed("remarks", [(f.name, f.detail) for f in experiment.flags if not f.fault]),
        _channels(experiment),
        _provenance(experiment),
        [] if plot is None else [f"wrote {plot}"],
        [f"Next: {_next_show(experiment, project, plot)}"],
    ]
    return _joined(blocks)


def _frames(experiment: "Experiment") -> list[str]:
    from fixel.workflows.project.compare import frame_rate

    rate = frame_rate(experiment.trajectory)
    count = len(experiment.trajectory.time)
    lines = [
        f"{count} frames" + ("" if rate is None else f" at {rate:.4g} Hz")
        + f", {experiment.duration:.4g} s"
    ]  # fmt: skip
    if experiment.effective is not None:
        first, last = experiment.effective
        lines.append(f"useful from {first:.4g} to {last:.4g} s")
    return lines


def _poses(experiment: "Experiment") -> list[str]:
    from fixel.cli.screen import table
    from fixel.workflows.project.compare import length_unit, travelled

    unit, metre = length_unit(experiment)
    rows = []
    for name, row in (("start", 0), ("end", -1)):
        x, y, angle = experiment.trajectory.pose[row].tolist()
        rows.append((name, f"{x / metre:.2f}", f"{y / metre:.2f}", f"{degrees(angle):.2f}"))
    head = (experiment.object_name, f"x [{unit}]", f"y [{unit}]", "angle [deg]")
    way = travelled(experiment.trajectory, 1e-3 if unit == "mm" else 1e-6)
    return [*table(head, rows), f"travelled {way / metre:.2f} {unit}"]


def _mode(experiment: "Experiment") -> list[str]:
    return [f"contact mode at the end: {experiment.contact_mode or 'not known'}"]


def _listed(title: str, rows: list[tuple[str, str]]) -> list[str]:
    if not rows:
        return []
    width = max(len(name) for name, _ in rows[:MAX_ROWS])
    shown = [f"  {name.ljust(width)}  {value}".rstrip() for name, value in rows[:MAX_ROWS]]
    left_out = len(rows) - len(shown)
    more = [f"  ... and {left_out} more; --json has them all"] if left_out else []
    return [title, *shown, *more]


def _value(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _channels(experiment: "Experiment") -> list[str]:
    rows = [
        (channel.name, f"{len(channel.time)} readings of {', '.join(channel.columns)}")
        for channel in experiment.channels
    ]
    return _listed("channels", rows)


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


def _next_show(experiment: "Experiment", project: Path, plot: Path | None) -> str:
    """Return the command that most users need next."""
    if plot is None:
        return _command("show", experiment, project) + f" --plot {_picture(experiment)}"
    if experiment.scene is not None:
        return _command("compare", experiment, project)
    return shlex.join(["fixel", "list", *project_words(project)])


def _picture(experiment: "Experiment") -> str:
    """Return a valid file name, whatever the name of the experiment."""
    return shlex.quote(experiment.name.replace("/", "-") + ".png")


# --- compare ----------------------------------------------------------------------------------


def _parameters(settings: list[str]) -> "Parameters":
    """Parse `--set NAME=VALUE`."""
    from fixel.model import KNOWN_PARAMETERS, Parameters

    values: dict[str, float] = {}
    for setting in settings:
        name, _, text = setting.partition("=")
        try:
            values[name.strip()] = float(text)
        except ValueError:
            raise InvalidInput(
                "--set",
                found=repr(setting),
                expected="NAME=NUMBER with a name out of " + ", ".join(KNOWN_PARAMETERS),
            ) from None
    return Parameters(values)


def _announce(experiment: "Experiment", as_json: bool) -> None:
    """Compile before the clock runs; print a notice on a terminal, or without `--json`."""
    if experiment.scene is not None:
        from fixel.cli.screen import notify
        from fixel.workflows.compilation import get_ready

        get_ready(experiment.scene, notify if sys.stderr.isatty() or not as_json else None)


def _draw(answer: "Comparison", plot: Path) -> None:
    from fixel.drawing.experiment import draw_comparison
    from fixel.io.atomic import written_whole

    with written_whole(plot) as unfinished:
        draw_comparison(answer.experiment, answer.simulated, unfinished, answer.contacts)


def _written_compare(
    answer: "Comparison", project: Path, plot: Path | None, saved: int | None, command: str
) -> str:
    """Return about a screen of text."""
    wrote = [] if plot is None else [f"wrote {plot}"]
    kept = [] if saved is None else [f"kept as simulation {saved}"]
    blocks = [
        [_origin(answer.experiment)],
        _listed("parameters", [(k, _value(v)) for k, v in answer.parameters.items()]),
        _status(answer),
        _errors(answer),
        _modes(answer),
        wrote + kept,
        [f"Next: {_next_compare(answer, project, plot, saved, command)}"],
    ]
    return _joined(blocks)


def _status(answer: "Comparison") -> list[str]:
    first, last = answer.time[0], answer.time[-1]
    if answer.complete:
        return [f"{answer.status}; {len(answer.time)} frames from {first:.4g} to {last:.4g} s"]
    stopped = answer.simulation.stopped_at
    return [f"{answer.status}, stopped at {stopped:.6g} s: no errors", answer.simulation.advice]


def _errors(answer: "Comparison") -> list[str]:
    rms, final, angle = answer.position_rms, answer.final_position, answer.final_angle
    if rms is None or final is None or angle is None:
        return []
    from fixel.workflows.project.compare import length_unit

    unit, metre = length_unit(answer.experiment)
    lines = [
        f"position, rms      {rms / metre:.3f} {unit}",
        f"position, at end   {final / metre:.3f} {unit}",
        f"angle, at end      {degrees(angle):.3f} deg",
    ]
    # The thesis's E weighs angles for objects of its own size.
    return lines + ([f"E, 35 mm/rad       {answer.error_mm2:.3f} mm^2"] if unit == "mm" else [])


def _modes(answer: "Comparison") -> list[str]:
    if answer.contacts is None:
        return []
    measured = answer.experiment.contact_mode or "not known"
    verdict = {True: ", the same", False: ", another", None: ""}[answer.same_contact_mode]
    what = "measured" if answer.experiment.real else "recorded"
    return [f"contact mode, {what} {measured}, simulated {answer.contact_mode}{verdict}"]


def _next_compare(
    answer: "Comparison", project: Path, plot: Path | None, saved: int | None, command: str
) -> str:
    """Return the command that most users need next."""
    if plot is None:
        return f"{command} --plot {_picture(answer.experiment)}"
    if saved is None:
        return f"{command} --save"
    return _command("compare", answer.experiment, project) + " --set mu_pusher=0.2"
