"""`fixel show KEY` and `fixel compare KEY`: one stored experiment, and a simulation of it."""

import shlex
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import (
    AsJson,
    Engine,
    ProjectFolder,
    engine_or_motion,
    option,
    require_picture,
    with_options,
)
from fixel.cli.screen import (
    command_of,
    paragraphs,
    print_answer,
    project_words,
    shortened,
    wrote,
)
from fixel.cli.simulation import NOT_SOLVED, MotionChoice
from fixel.errors import InvalidInput
from fixel.table import Column, Table
from fixel.workflows.sentences import origin_of

if TYPE_CHECKING:
    from fixel.database.store import Store
    from fixel.model import Experiment, Parameters
    from fixel.workflows.project.compare import PathComparison, RunComparison

MAX_ROWS = 20

Key = Annotated[
    str,
    typer.Argument(
        help="Experiment: its id, its name, or DATASET/NAME.",
        metavar="EXPERIMENT",
        show_default=False,
    ),
]


def show(
    key: Key,
    project: ProjectFolder = Path(),
    plot: Annotated[
        Path | None, typer.Option(help="Draw the experiment: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show an experiment: scene, data, faults and provenance."""
    from fixel.database.project import Project
    from fixel.io.atomic import written_whole
    from fixel.workflows.project.compare import summary

    require_picture(plot)
    with Project(project).store() as store:
        number = store.find(key)
        experiment = store.experiment(number)
    if plot is not None:
        from fixel.drawing.experiment import draw_experiment

        with written_whole(plot) as unfinished:
            draw_experiment(experiment, unfinished)
    print_answer(
        as_json,
        lambda: {"id": number, **summary(experiment), "files": _files(plot)},
        lambda: _show_lines(number, experiment, project, plot),
    )


@with_options
def compare(
    *,
    key: Key,
    project: ProjectFolder = Path(),
    set_: list[str] | None = option(
        None,
        "Parameter of the simulation, such as mu_support=0.3; may be repeated.",
        "--set",
        metavar="NAME=VALUE",
    ),
    calibration: int | None = option(
        None,
        "Id of a stored calibration, whose parameters and motion model are used; --set and "
        "--motion override them.",
        metavar="ID",
    ),
    motion: MotionChoice | None = option(None, "Motion model; dynamic by default."),
    engine: Engine = None,
    plot: Path | None = option(None, "Draw measured and simulated motion: .png, .svg or .pdf."),
    as_json: AsJson = False,
    save: bool = option(False, "Store the simulation.", "--save"),
) -> None:
    """Simulate an experiment and compare it with its measurement."""
    from fixel.database.project import Project
    from fixel.simulation.motion import motion_model
    from fixel.workflows.calibration.stored import parameters_of, unseen_by
    from fixel.workflows.project.compare import RunComparison
    from fixel.workflows.project.comparison import compare as compare_experiments

    require_picture(plot)
    parameters = _parameters(set_ or [])
    with Project(project).store() as store:
        number = store.find(key)
        experiment = store.experiment(number)
        published = _published(store, number, experiment)
        if experiment.scene is None and published is not None and not save:
            _print_published(published, number, plot, as_json)
            return
        chosen = engine_or_motion(engine, motion)
        model = motion_model(chosen) if chosen else None
        if calibration is not None:
            parameters, model = parameters_of(store, calibration, experiment, parameters, model)
        unseen = [] if calibration is None else unseen_by(store, calibration, experiment)
        _compile(experiment)
        found = compare_experiments(experiment, {"given": parameters}, motion=model, progress=False)
        answer = found.rows[0].run
        assert isinstance(answer, RunComparison)
        command = _command("compare", experiment, project, set_ or [], chosen, calibration)
        saved = store.add_simulation(answer.record(number, command)) if save else None
    if plot is not None:
        _draw(answer, plot)
    more = {"experiment_id": number, "simulation_id": saved, "files": _files(plot)}
    more |= {} if published is None else {"by_publisher": published.errors()}
    print_answer(
        as_json,
        lambda: {"unseen": unseen} | answer.summary() | more,
        lambda: _compare_lines(answer, published, project, plot, saved, command, unseen),
    )
    if not answer.complete:
        raise typer.Exit(NOT_SOLVED)


def _published(
    store: "Store", experiment_id: int, experiment: "Experiment"
) -> "PathComparison | None":
    """Compare the simulation by the publisher of an experiment, if one is stored."""
    from fixel.workflows.project.compare import compare_path

    simulation_id = store.published_simulations().get(experiment_id)
    return (
        None if simulation_id is None else compare_path(experiment, store.simulation(simulation_id))
    )


def _print_published(
    published: "PathComparison", experiment_id: int, plot: Path | None, as_json: bool
) -> None:
    """Print the errors of a simulation by the publisher, of an experiment without a scene."""
    if plot is not None:
        _draw(published, plot)
    experiment = published.experiment
    print_answer(
        as_json,
        lambda: {
            "experiment": experiment.key,
            "experiment_id": experiment_id,
            "by_publisher": published.errors(),
            "files": _files(plot),
        },
        lambda: paragraphs(
            [origin_of(experiment), "no scene, so fixel cannot simulate it"],
            _published_lines(published),
            wrote([plot]),
        ),
    )


def _published_lines(published: "PathComparison | None") -> list[str]:
    if published is None:
        return []
    return ["simulation by the publisher of the data:", *_errors(published), *_modes(published)]


def _files(plot: Path | None) -> dict[str, str]:
    return {} if plot is None else {"plot": str(plot)}


def _command(
    name: str,
    experiment: "Experiment",
    project: Path,
    set_: list[str] | None = None,
    motion: str | None = None,
    calibration: int | None = None,
) -> str:
    """Return the command, to be run in the current folder."""
    from fixel.simulation.engine_names import motion_words

    words: list[object] = [] if calibration is None else ["--calibration", calibration]
    words += [word for value in set_ or [] for word in ("--set", value)]
    words += [] if motion is None else motion_words(motion)
    return command_of(name, experiment.key, *project_words(project), *words)


def _show_lines(
    number: int, experiment: "Experiment", project: Path, plot: Path | None
) -> list[str]:
    """About a screen of text."""
    return paragraphs(
        [origin_of(experiment), f"experiment {number} of dataset {experiment.dataset}"],
        _frames(experiment),
        _poses(experiment),
        [f"contact mode at the end: {experiment.contact_mode or 'unknown'}"],
        _listed("conditions", [(k, _value(v)) for k, v in experiment.conditions.items()]),
        _listed("flags", [(f.name, f.detail) for f in experiment.flags if f.fault]),
        _listed("remarks", [(f.name, f.detail) for f in experiment.flags if not f.fault]),
        _channels(experiment),
        _provenance(experiment),
        wrote([plot]),
        [f"Next: {_next_show(experiment, project, plot)}"],
    )


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
        lines.append(f"usable from {first:.4g} to {last:.4g} s")
    return lines


def _poses(experiment: "Experiment") -> list[str]:
    from fixel.workflows.project.compare import length_unit, travelled

    unit, metre = length_unit(experiment)
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
    return command_of("list", project=project)


def _picture(experiment: "Experiment") -> str:
    """Return a valid file name, whatever the name of the experiment."""
    return shlex.quote(experiment.name.replace("/", "-") + ".png")


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
                expected="NAME=NUMBER, where NAME is one of " + ", ".join(KNOWN_PARAMETERS),
            ) from None
    return Parameters(values)


def _compile(experiment: "Experiment") -> None:
    """Compile before the clock runs."""
    if experiment.scene is not None:
        from fixel.workflows.compilation import get_ready

        get_ready(experiment.scene)


def _draw(answer: "PathComparison", plot: Path) -> None:
    from fixel.drawing.experiment import draw_comparison
    from fixel.io.atomic import written_whole

    with written_whole(plot) as unfinished:
        draw_comparison(answer.experiment, answer.simulated, unfinished, answer.contacts)


def _compare_lines(
    answer: "RunComparison",
    published: "PathComparison | None",
    project: Path,
    plot: Path | None,
    saved: int | None,
    command: str,
    unseen: list[str],
) -> list[str]:
    """About a screen of text."""
    kept = [] if saved is None else [f"stored as simulation {saved}"]
    return paragraphs(
        [f"Unseen: {text}" for text in unseen],
        [origin_of(answer.experiment)],
        _listed("parameters", [(k, _value(v)) for k, v in answer.parameters.items()]),
        _status(answer),
        _errors(answer),
        _modes(answer),
        _published_lines(published),
        wrote([plot]) + kept,
        [f"Next: {_next_compare(answer, project, plot, saved, command)}"],
    )


def _status(answer: "RunComparison") -> list[str]:
    first, last = answer.time[0], answer.time[-1]
    if answer.complete:
        return [f"{answer.status}; {len(answer.time)} frames from {first:.4g} to {last:.4g} s"]
    stopped = answer.simulation.stopped_at
    return [
        f"{answer.status}, stopped at {stopped:.6g} s: no error can be computed",
        answer.simulation.advice,
    ]


def _errors(answer: "PathComparison") -> list[str]:
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


def _modes(answer: "PathComparison") -> list[str]:
    if not answer.contact_mode:
        return []
    measured = answer.experiment.contact_mode or "not known"
    verdict = {True: ", the same", False: ", different", None: ""}[answer.same_contact_mode]
    what = "measured" if answer.experiment.real else "recorded"
    return [f"contact mode, {what} {measured}, simulated {answer.contact_mode}{verdict}"]


def _next_compare(
    answer: "RunComparison", project: Path, plot: Path | None, saved: int | None, command: str
) -> str:
    """Return the command that most users need next."""
    if plot is None:
        return f"{command} --plot {_picture(answer.experiment)}"
    if saved is None:
        return f"{command} --save"
    return _command("compare", answer.experiment, project) + " --set mu_pusher=0.2"
