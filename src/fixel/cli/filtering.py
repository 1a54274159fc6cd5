"""`fixel filter KEY`: pose and friction of a stored experiment, estimated frame by frame."""

import json
import shlex
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.filtering.run import FilterAnswer

HERE = Path()

Range = tuple[float, float]

BELIEF_FAR = 3.0  # times the camera's noise: a belief beyond it is worth a line
NOISE_FAR = 1.5  # times the belief: ellipsoids are too small beyond it


def filter_(
    key: Annotated[
        str,
        typer.Argument(
            help="Experiment: its id, its name, or DATASET/NAME.",
            metavar="EXPERIMENT",
            show_default=False,
        ),
    ],
    project: ProjectFolder = HERE,
    occlude: Annotated[
        str | None,
        typer.Option(help="Hide the object from the filter meanwhile [s].", metavar="FROM:TO"),
    ] = None,
    tactile: Annotated[
        bool, typer.Option("--tactile/--no-tactile", help="Whether the fixels are listened to.")
    ] = True,
    particles: Annotated[int, typer.Option(help="How many particles.")] = 125,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            help="Uniform belief about a parameter, e.g. mu_pusher=0.1:1; may be repeated.",
            metavar="NAME=LOW:HIGH",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random number generator.")] = 0,
    threads: Annotated[int, typer.Option(help="Of the simulation.", min=1)] = 1,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the run: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    save: Annotated[bool, typer.Option("--save/--no-save", help="Keep the run.")] = True,
    as_json: AsJson = False,
) -> None:
    """Estimate pose and friction while an experiment goes on, with a particle filter."""
    from fixel.cli.screen import progress_bar
    from fixel.database.project import Project
    from fixel.filtering.particle_filter import ParticleFilter
    from fixel.workflows.filtering.run import filter_experiment

    _refuse_picture(plot)
    command = _command(key, project, occlude, tactile, particles, prior, seed)
    options = ParticleFilter(
        n_particles=particles, threads=threads, priors=dict(map(_prior, prior or []))
    )
    answer = filter_experiment(
        Project.open(project),
        key,
        options,
        occlusion=None if occlude is None else _interval("--occlude", occlude),
        use_tactile=tactile,
        seed=seed,
        save=save,
        command=command,
        progress=progress_bar("Filtering"),
    )
    if plot is not None:
        _draw(answer, plot)
    if as_json:
        files = {} if plot is None else {"plot": str(plot)}
        typer.echo(_json(answer.summary() | {"files": files}))
        return
    typer.echo(_written(answer, plot, project, command))


def _refuse_picture(plot: Path | None) -> None:
    """Before any work."""
    if plot is not None:
        from fixel.drawing.chart import PICTURE_ENDINGS, refuse_ending
        from fixel.io.atomic import refuse_unwritable

        refuse_ending(plot, PICTURE_ENDINGS, "picture")
        refuse_unwritable(plot)


def _interval(option: str, text: str) -> Range:
    """Of FROM:TO, or a refusal."""
    first, _, last = text.partition(":")
    try:
        return float(first), float(last)
    except ValueError:
        raise InvalidInput(
            option, found=repr(text), expected="two numbers with a colon, such as 2:4"
        ) from None


def _prior(text: str) -> tuple[str, Range]:
    name, _, interval = text.partition("=")
    return name.strip(), _interval(f"--prior {name.strip()}", interval)


def _command(
    key: str,
    project: Path,
    occlude: str | None,
    tactile: bool,
    particles: int,
    prior: list[str] | None,
    seed: int,
) -> str:
    """What to type, from the current folder."""
    words = ["fixel", "filter", key]
    if project != HERE:
        words += ["--project", str(project)]
    if occlude is not None:
        words += ["--occlude", occlude]
    if not tactile:
        words += ["--no-tactile"]
    for belief in prior or []:
        words += ["--prior", belief]
    words += [] if particles == 125 else ["--particles", str(particles)]
    words += [] if seed == 0 else ["--seed", str(seed)]
    return shlex.join(words)


def _json(answer: dict[str, object]) -> str:
    from fixel.formats.trajectory_file import plain_numbers

    return json.dumps(plain_numbers(answer), allow_nan=False)


def _draw(answer: "FilterAnswer", plot: Path) -> None:
    from fixel.drawing.filtering import draw_filter
    from fixel.io.atomic import written_whole

    with written_whole(plot) as unfinished:
        draw_filter(answer.experiment, answer.estimates, unfinished)


# --- the answer for people --------------------------------------------------------------------


def _written(answer: "FilterAnswer", plot: Path | None, project: Path, command: str) -> str:
    blocks = [
        [_origin(answer)],
        _misfit(answer),
        _noise(answer),
        _input(answer),
        _errors(answer),
        _parameters(answer),
        _calibrated(answer),
        _modes(answer),
        _effort(answer),
        _kept(answer, plot),
        [f"Next: {_next(answer, plot, project, command)}"],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _origin(answer: "FilterAnswer") -> str:
    experiment = answer.experiment
    what = "real" if experiment.real else f"SIMULATED by {experiment.simulated_by}"
    return f"{experiment.key}: {what}"


def _misfit(answer: "FilterAnswer") -> list[str]:
    """Return the first lines: how far the intervals below can be trusted."""
    misfit, found = answer.estimates.misfit, answer.estimates
    if misfit.ratio is None or not misfit.warns:
        return []
    lines = [
        f"model misfit: residuals of {1e3 * misfit.residual_m:.2g} mm and"
        f" {degrees(misfit.residual_rad):.2g} deg are {misfit.ratio:.2g} times the noise of"
        f" {1e3 * misfit.noise_m:.2g} mm and {degrees(misfit.noise_rad):.2g} deg"
        " (second differences of the measured poses).",
        "The model is wrong by more than the noise explains: values below are effective ones.",
    ]
    believed = found.options.position_deviation / max(misfit.noise_m, 1e-12)
    if believed > BELIEF_FAR:
        lines.append(
            f"The filter believes {believed:.2g} times as much camera noise as there is;"
            " its intervals allow for the misfit as far as that goes."
        )
    return lines


def _noise(answer: "FilterAnswer") -> list[str]:
    misfit, options = answer.estimates.misfit, answer.estimates.options
    ratio = max(
        misfit.noise_m / options.position_deviation, misfit.noise_rad / options.angle_deviation
    )
    if ratio < NOISE_FAR:
        return []
    return [
        f"The camera's noise is {ratio:.2g} times what the filter believes: its intervals are too"
        " small. Set position_deviation and angle_deviation of ParticleFilter in Python."
    ]


def _input(answer: "FilterAnswer") -> list[str]:
    found = answer.estimates
    hidden = "never hidden"
    if found.occlusion is not None:
        start, end = found.occlusion
        hidden = f"hidden from {start:g} to {end:g} s"
    felt = "with the fixels' readings" if found.uses_tactile else "without tactile readings"
    return [
        f"{len(found.time)} frames from {found.time[0]:.4g} to {found.time[-1]:.4g} s, {hidden},"
        f" {felt}"
    ]


def _errors(answer: "FilterAnswer") -> list[str]:
    from fixel.cli.screen import table

    rows = [
        (name, f"{1e3 * errors[0]:.3f}", f"{degrees(errors[1]):.3f}")
        for name, errors in (
            ("while seen", answer.rms(hidden=False)),
            ("while hidden", answer.rms(hidden=True)),
        )
        if errors is not None
    ]
    return table(("error, rms", "position [mm]", "angle [deg]"), rows) if rows else []


def _parameters(answer: "FilterAnswer") -> list[str]:
    from fixel.cli.screen import table

    found = answer.estimates
    rows = []
    for name, mean, (low, _, high) in zip(
        found.prior.names, found.mean[-1], found.quantiles[-1], strict=True
    ):
        told = "" if found.excited[name] else "not excited: about as believed before"
        if found.at_bound[name]:
            told = "at the bound of its prior: choose a wider one with --prior"
        shown = f"{name} [mm]" if name == "tripod_radius" else name
        factor = 1e3 if name == "tripod_radius" else 1.0
        numbers = [f"{factor * value:.3g}" for value in (mean, low, high)]
        rows.append((shown, *numbers, told))
    return table(("at the end", "mean", "5 %", "95 %", ""), rows) if rows else []


def _calibrated(answer: "FilterAnswer") -> list[str]:
    """Return estimates of the same parameters by calibrations with this experiment."""
    from fixel.cli.screen import table

    rows = []
    for number, parameters in answer.compared().items():
        for name, one in parameters.items():
            factor = 1e3 if name == "tripod_radius" else 1.0
            ends = [one["low"], one["high"]]
            shown = ["open" if end is None else f"{factor * end:.3g}" for end in ends]
            label = f"{name} [mm]" if name == "tripod_radius" else name
            verdict = one["verdict"] or "not assessed"
            rows.append(
                (f"calibration {number}", label, f"{factor * one['value']:.3g}", *shown, verdict)
            )
    return (
        table(("of this experiment", "", "value", "low", "high", "verdict"), rows) if rows else []
    )


def _modes(answer: "FilterAnswer") -> list[str]:
    if answer.estimates.touch.shape[1] == 0:
        return []
    measured, estimated = answer.experiment.contact_mode, answer.estimates.contact_mode
    verdict = "" if not measured else ", the same" if measured == estimated else ", another"
    what = "measured" if answer.experiment.real else "recorded"
    return [f"contact mode, {what} {measured or 'not known'}, estimated {estimated}{verdict}"]


def _effort(answer: "FilterAnswer") -> list[str]:
    found = answer.estimates
    times = 1e3 * found.busy[1:]
    lines = [
        f"{found.options.n_particles} particles, {sorted(times)[len(times) // 2]:.3g} ms a frame"
        f" (at most {times.max():.3g} ms): {found.real_time_factor:.3g} times real time"
    ]
    lost = int(found.recovered.sum())
    if lost:
        lines.append(f"lost the object in {lost} frames, and started again there")
    return lines


def _kept(answer: "FilterAnswer", plot: Path | None) -> list[str]:
    kept = [] if answer.run_id is None else [f"kept as filter run {answer.run_id}"]
    return kept + ([] if plot is None else [f"wrote {plot}"])


def _next(answer: "FilterAnswer", plot: Path | None, project: Path, command: str) -> str:
    """The command most people want after this one."""
    experiment, found = answer.experiment, answer.estimates
    if plot is None:
        return f"{command} --plot {shlex.quote(experiment.name.replace('/', '-') + '-filter.png')}"
    if found.occlusion is None:
        start, end = found.time[0], found.time[-1]
        third = (end - start) / 3.0
        return f"{command} --occlude {start + third:.3g}:{end - third:.3g}"
    words = ["fixel", "compare", experiment.key]
    words += [] if project == HERE else ["--project", str(project)]
    for name, told in found.excited.items():
        if told:
            value = found.mean[-1][found.prior.names.index(name)]
            words += ["--set", f"{name}={value:.3g}"]
    return shlex.join(words)
