"""`fixel filter KEY`: pose and friction of a stored experiment, estimated frame by frame."""

import shlex
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fixel.cli.options import (
    AnySeed,
    AsJson,
    ProjectFolder,
    option,
    require_picture,
    required,
    with_options,
)
from fixel.cli.screen import (
    command_of,
    origin_of,
    paragraphs,
    print_answer,
    project_words,
    wrote,
)
from fixel.errors import InvalidInput
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.workflows.filtering import FilterAnswer

Range = tuple[float, float]

BELIEF_FAR = 3.0  # times the camera's noise: a belief beyond it is worth a line
NOISE_FAR = 1.5  # times the belief: ellipsoids are too small beyond it
N_PARTICLES = 125


@dataclass(frozen=True, kw_only=True)
class FilterOptions:
    """Options of `fixel filter`."""

    occlude: str | None = option(
        None, "Hide the object from the filter during this interval [s].", metavar="FROM:TO"
    )
    tactile: bool = option(True, "Whether to use the tactile readings.", "--tactile/--no-tactile")
    particles: int = option(N_PARTICLES, "Number of particles.")
    prior: list[str] | None = option(
        None,
        "Uniform prior of a parameter, such as mu_pusher=0.1:1; may be repeated.",
        metavar="NAME=LOW:HIGH",
    )
    seed: AnySeed = 0
    threads: int = option(1, "Number of threads.", min=1)
    plot: Path | None = option(None, "Draw the run: .png, .svg or .pdf.")
    save: bool = option(True, "Store the run.", "--save/--no-save")

    def command(self, key: str, project: Path) -> str:
        """Return the command to be typed in the current folder, without --plot."""
        words: list[object] = []
        if self.occlude is not None:
            words += ["--occlude", self.occlude]
        if not self.tactile:
            words += ["--no-tactile"]
        for belief in self.prior or []:
            words += ["--prior", belief]
        words += [] if self.particles == N_PARTICLES else ["--particles", self.particles]
        words += [] if self.seed == 0 else ["--seed", self.seed]
        return command_of("filter", key, *project_words(project), *words)


@with_options
def filter_(
    *,
    key: str = required(
        "Experiment: its id, its name, or DATASET/NAME.", metavar="EXPERIMENT", show_default=False
    ),
    project: ProjectFolder = Path(),
    options: FilterOptions,
    as_json: AsJson = False,
) -> None:
    """Estimate pose and friction with a particle filter."""
    from fixel.database.project import Project
    from fixel.filtering.particle_filter import ParticleFilter
    from fixel.workflows.filtering import filter_experiment

    plot = options.plot
    require_picture(plot)
    command = options.command(key, project)
    machine = ParticleFilter(
        n_particles=options.particles,
        threads=options.threads,
        priors=dict(map(_prior, options.prior or [])),
    )
    answer = filter_experiment(
        Project(project),
        key,
        machine,
        occlusion=None if options.occlude is None else _interval("--occlude", options.occlude),
        use_tactile=options.tactile,
        seed=options.seed,
        save=options.save,
        command=command,
    )
    if plot is not None:
        _draw(answer, plot)
    files = {} if plot is None else {"plot": str(plot)}
    print_answer(
        as_json,
        lambda: answer.summary() | {"files": files},
        lambda: _lines(answer, plot, project, command),
    )


def _interval(option: str, text: str) -> Range:
    """Parse FROM:TO."""
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


def _draw(answer: "FilterAnswer", plot: Path) -> None:
    from fixel.drawing.filtering import draw_filter
    from fixel.io.atomic import written_whole

    with written_whole(plot) as unfinished:
        draw_filter(answer.estimates.experiment, answer.estimates, unfinished)


def _lines(answer: "FilterAnswer", plot: Path | None, project: Path, command: str) -> list[str]:
    kept = [] if answer.run_id is None else [f"stored as filter run {answer.run_id}"]
    return paragraphs(
        [origin_of(answer.estimates.experiment)],
        _misfit(answer),
        _noise(answer),
        _input(answer),
        _errors(answer),
        _parameters(answer),
        _calibrated(answer),
        _modes(answer),
        _effort(answer),
        kept + wrote([plot]),
        [f"Next: {_next(answer, plot, project, command)}"],
    )


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
        "The model is wrong by more than the noise explains, so the values below are effective "
        "values.",
    ]
    believed = found.options.position_deviation / max(misfit.noise_m, 1e-12)
    if believed > BELIEF_FAR:
        lines.append(
            f"The filter assumes {believed:.2g} times the estimated camera noise; its intervals "
            "include the misfit only in this way."
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
        f"The camera noise is {ratio:.2g} times the value that the filter assumes, so its "
        "intervals are too narrow. Set position_deviation and angle_deviation of ParticleFilter "
        "in Python."
    ]


def _input(answer: "FilterAnswer") -> list[str]:
    found = answer.estimates
    hidden = "never hidden"
    if found.occlusion is not None:
        hidden = "hidden from {:g} to {:g} s".format(*found.occlusion)
    felt = "with tactile readings" if found.uses_tactile else "without tactile readings"
    return [
        f"{len(found.time)} frames from {found.time[0]:.4g} to {found.time[-1]:.4g} s, {hidden},"
        f" {felt}"
    ]


def _errors(answer: "FilterAnswer") -> list[str]:
    found = {
        "while seen": answer.estimates.rms(hidden=False),
        "while hidden": answer.estimates.rms(hidden=True),
    }
    rows = [(k, 1e3 * pair[0], degrees(pair[1])) for k, pair in found.items() if pair is not None]
    columns = ("error, rms", Column("position", "mm", ".3f"), Column("angle", "deg", ".3f"))
    return Table(columns, rows).lines() if rows else []


def _parameters(answer: "FilterAnswer") -> list[str]:
    found = answer.estimates
    rows: list[tuple[Any, ...]] = []
    for name, mean, (low, _, high) in zip(
        found.prior.names, found.mean[-1], found.quantiles[-1], strict=True
    ):
        remark = "" if found.excited[name] else "not excited: about the same as the prior"
        if found.at_bound[name]:
            remark = "at the bound of its prior: use a wider one with --prior"
        label, factor = _label_and_factor(name)
        rows.append((label, *(float(factor * value) for value in (mean, low, high)), remark))
    numbers = (Column(name, format=".3g") for name in ("mean", "5 %", "95 %"))
    return Table(("at the end", *numbers, ""), rows).lines() if rows else []


def _calibrated(answer: "FilterAnswer") -> list[str]:
    """Return estimates of the same parameters by calibrations with this experiment."""
    rows: list[tuple[Any, ...]] = []
    for number, parameters in answer.compared().items():
        for name, one in parameters.items():
            label, factor = _label_and_factor(name)
            ends = ("open" if x is None else f"{factor * x:.3g}" for x in (one["low"], one["high"]))
            verdict = one["verdict"] or "not assessed"
            rows.append((f"calibration {number}", label, factor * one["value"], *ends, verdict))
    columns = ("of this experiment", "", Column("value", format=".3g"), "low", "high", "verdict")
    return Table(columns, rows).lines() if rows else []


def _label_and_factor(name: str) -> tuple[str, float]:
    """Name of a parameter with its unit for display, and the factor to that unit."""
    return (f"{name} [mm]", 1e3) if name == "tripod_radius" else (name, 1.0)


def _modes(answer: "FilterAnswer") -> list[str]:
    if answer.estimates.touch.shape[1] == 0:
        return []
    measured, estimated = answer.estimates.experiment.contact_mode, answer.estimates.contact_mode
    verdict = "" if not measured else ", the same" if measured == estimated else ", different"
    what = "measured" if answer.estimates.experiment.real else "recorded"
    return [f"contact mode, {what} {measured or 'unknown'}, estimated {estimated}{verdict}"]


def _effort(answer: "FilterAnswer") -> list[str]:
    found = answer.estimates
    times = 1e3 * found.busy[1:]
    lines = [
        f"{found.options.n_particles} particles, {sorted(times)[len(times) // 2]:.3g} ms per "
        f"frame (at most {times.max():.3g} ms): {found.real_time_factor:.3g} times real time"
    ]
    lost = int(found.recovered.sum())
    if lost:
        lines.append(f"lost the object in {lost} frames and was restarted there")
    return lines


def _next(answer: "FilterAnswer", plot: Path | None, project: Path, command: str) -> str:
    """Return the command that most users need next."""
    experiment, found = answer.estimates.experiment, answer.estimates
    if plot is None:
        return f"{command} --plot {shlex.quote(experiment.name.replace('/', '-') + '-filter.png')}"
    if found.occlusion is None:
        start, end = found.time[0], found.time[-1]
        third = (end - start) / 3.0
        return f"{command} --occlude {start + third:.3g}:{end - third:.3g}"
    values = dict(zip(found.prior.names, found.mean[-1], strict=True))
    excited = [name for name, known in found.excited.items() if known]
    settings = [word for name in excited for word in ("--set", f"{name}={values[name]:.3g}")]
    return command_of("compare", experiment.key, *project_words(project), *settings)
