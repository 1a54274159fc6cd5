"""`fixel calibrate`: estimate parameters from experiments, with verdicts on each."""

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import (
    AsJson,
    Engine,
    MeasurementNoise,
    PictureFolder,
    ProjectFolder,
    Seed,
    Selection,
    SiteFile,
    Workers,
    argument,
    option,
    require_folder,
    require_one_of,
    with_options,
)
from fixel.cli.screen import (
    command_line,
    command_of,
    compare_command,
    notify,
    print_answer,
    seconds,
    wrote,
)
from fixel.errors import Interrupted, InvalidInput, NotStored

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model.space import ParameterSpace
    from fixel.workflows.calibration.calibration import Calibrations
    from fixel.workflows.calibration.project import ExperimentSelection
    from fixel.workflows.calibration.request import NamedOptions


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of `fixel calibrate` for parameters, error and search."""

    mode: str | None = option(
        None,
        "Kind of calibration. each: one set per experiment; joint: one set for all; campaign: "
        "each, then joint, with the intermediate steps of the thesis; stored: the best of the "
        "stored sets.",
        metavar="MODE",
        show_default="each for one experiment, else joint",
    )
    fit: list[str] | None = option(
        None,
        "Parameter to calibrate, in SI units or with the suffix _mm, _deg or _mrad; may be "
        "repeated.",
        metavar="NAME[=LOW:HIGH[:START]]",
    )
    hold: list[str] | None = option(
        None, "Parameter with a fixed value; may be repeated.", "--set", metavar="NAME=VALUE"
    )
    space: Path | None = option(None, "File with the parameters, instead of --fit.")
    dakota: Path | None = option(
        None, "Input file of Dakota's pattern search, for search and parameters.", metavar="FILE"
    )
    error: str = option(
        "mean-square",
        "Error to minimise: mean-square (E of the thesis), root-mean-square (of the ASME paper), "
        "end-pose or robust.",
        metavar="NAME",
    )
    angle_scale_mm: float = option(35.0, "Weight of angles in the error [mm/rad].", metavar="MM")
    combine: str = option(
        "sum", "Combination of the errors of experiments: sum, mean or largest.", metavar="HOW"
    )
    motion: str = option(
        "dynamic", "Motion model: dynamic, quasistatic or first-order.", metavar="MODEL"
    )
    engine: Engine = None
    optimiser: str | None = option(
        None,
        "Optimiser: pattern-search, fixed-step, nelder-mead, cma-es, mads or least-squares.",
        metavar="NAME",
        show_default="least-squares for mode joint and a sum of squares, else pattern-search",
    )
    budget: float | None = option(
        None,
        "Computing time [s], half of it for the search and half for the verdicts.",
        metavar="SECONDS",
        min=0.0,
    )
    sample: int | None = option(
        None,
        "Calibrate a random sample of N experiments, spread over their conditions.",
        metavar="N",
        min=1,
    )
    settings: list[str] | None = option(
        None, "Option of the optimiser; may be repeated.", "--option", metavar="NAME=VALUE"
    )
    starts: int = option(1, "Number of searches; all but the first start at random points.", min=1)
    seed: Seed = 0
    noise: MeasurementNoise
    level: float = option(0.95, "Confidence level of the intervals.")
    verdicts: bool = option(
        True, "Compute intervals, profiles and verdicts.", "--verdicts/--no-verdicts"
    )
    name: str = option("calibration", "Name of the calibration.", metavar="NAME")

    def chosen_mode(self, chosen: "ExperimentSelection") -> Any:
        """Return the mode: by default one set of parameters for several experiments."""
        usual = "each" if len(chosen.targets) == 1 else "joint"
        return require_one_of("--mode", self.mode or usual, ("each", "joint", "campaign", "stored"))

    def arguments(self, chosen: "ExperimentSelection") -> dict[str, Any]:
        """Return the arguments of `fixel.calibrate` for the selected experiments."""
        from fixel.calibration.noise import Noise

        optimiser, parameters = self._search_and_parameters(chosen)
        noise = self.noise
        if (noise.noise_mm is None) != (noise.noise_mrad is None):
            raise InvalidInput(
                "--noise-mm and --noise-mrad", found="one of them", expected="both, or neither"
            )
        return {
            "parameters": parameters,
            "error": {"name": self.error, "angle_scale": 1e-3 * self.angle_scale_mm},
            "combine": require_one_of("--combine", self.combine, ("sum", "mean", "largest")),
            "optimiser": optimiser,
            "starts": self.starts,
            "noise": None
            if noise.noise_mm is None or noise.noise_mrad is None
            else Noise(position_m=1e-3 * noise.noise_mm, angle_rad=1e-3 * noise.noise_mrad),
            "level": self.level,
            "verdicts": self.verdicts,
            "motion": self.engine or self.motion,
            "seed": self.seed,
            "budget": self.budget,
            "name": self.name,
        }

    def _search_and_parameters(
        self, chosen: "ExperimentSelection"
    ) -> "tuple[NamedOptions, ParameterSpace]":
        from fixel.calibration.usual_parameters import default_unknowns
        from fixel.model.space import ParameterSpace
        from fixel.workflows.calibration.parameter_options import (
            fixed_unknowns,
            from_dakota,
            read_space,
            searched_unknowns,
        )
        from fixel.workflows.calibration.request import NamedOptions

        scenes = [target.case.scene for target in chosen.targets]
        options = dict(map(_setting, self.settings or []))
        search = NamedOptions(name=self.optimiser or "auto", options=options)
        if self.dakota is not None:
            search, unknowns = from_dakota(self.dakota)
        elif self.space is not None:
            unknowns = list(read_space(self.space).unknowns)
        elif self.fit:
            unknowns = searched_unknowns(self.fit, scenes)
        else:
            unknowns = default_unknowns(scenes)
        fixed = fixed_unknowns(self.hold or [])
        names = {unknown.name for unknown in fixed}
        unknowns = [unknown for unknown in unknowns if unknown.name not in names] + fixed
        return search, ParameterSpace(unknowns=tuple(unknowns))


@with_options
def calibrate(
    *,
    experiments: list[str] | None = argument(
        None,
        "Ids or names of experiments; by default all that match the options.",
        metavar="[EXPERIMENT]...",
    ),
    folder: ProjectFolder = Path(),
    selection: Selection,
    search: SearchOptions,
    workers: Workers = None,
    site: SiteFile = None,
    prepare_only: bool = option(False, "Only prepare the job, for fixel jobs submit.", "--prepare"),
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Estimate parameters from experiments, with verdicts.

    Finished evaluations are stored: repeat the command after an interruption to continue.
    """
    if experiments and (selection.dataset or selection.where):
        given = "--dataset" if selection.dataset else "--where"
        raise InvalidInput(given, found="names of experiments too", expected="one of them")
    from dataclasses import replace

    from fixel.database.project import Project
    from fixel.workflows.calibration.project import draw_sample, select_experiments
    from fixel.workflows.compilation import get_ready

    project = Project(folder)
    with project.store() as store:
        chosen = select_experiments(store, experiments or (), selection.query)
    if search.sample is not None:
        chosen = draw_sample(chosen, search.sample, search.seed)
    chosen = replace(chosen, command=command_line())
    mode, arguments = search.chosen_mode(chosen), search.arguments(chosen)
    if prepare_only:
        job = _prepare(project, mode, chosen, arguments)
        print_answer(as_json, lambda: {"job": str(job)}, lambda: _prepared(job))
        return
    get_ready(chosen.targets[0].case.scene)  # before the clock runs
    require_folder(plot)
    where = {"store": project, "workers": workers or 0, "site": site}
    done = _calibrations(mode, chosen, arguments | where)
    pictures = [] if plot is None else done.draw(plot)

    print_answer(
        as_json,
        lambda: done.summary() | {"pictures": [str(path) for path in pictures]},
        lambda: [
            *done.analysis.lines(),
            "",
            f"Took {seconds(done.analysis.seconds)}.",
            *wrote(pictures),
            f"stored as calibration {', '.join(map(str, done.ids[:3]))}"
            f"{', ...' * (len(done.ids) > 3)}; job {done.folder}",
            f"Next: {_next(done, folder)}",
        ],
    )


def _next(done: "Calibrations", folder: Path) -> str:
    """Return the command that compares the worst experiment with its simulation."""
    fits = [done.joint] if done.joint else done.each
    fit = max(fits, key=lambda one: float(one.found.errors.max()))
    target = fit.targets[int(fit.found.errors.argmax())]
    space, found = fit.space, fit.found
    columns = space.columns(found.values(space.labels)[None], target.conditions)
    values = {name: float(column[0]) for name, column in columns.items()}
    return compare_command(target.key, values, done.request.motion, folder)


def calibrations(
    number: Annotated[
        int | None,
        typer.Argument(
            help="Id of a calibration to show; all are listed without it.", metavar="ID"
        ),
    ] = None,
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """List stored calibrations, or show the estimates of one."""
    from fixel.database.project import Project
    from fixel.workflows.calibration.project import list_calibrations, stored_calibration

    project = Project(folder)
    if number is None:
        listed = list_calibrations(project)
        if not listed.rows:
            raise NotStored("calibration", hint="make one with: fixel calibrate")
        last = listed.rows[0][0]
        print_answer(
            as_json,
            lambda: {"calibrations": listed.records()},
            lambda: [*listed.lines(), f"Next: {command_of('calibrations', last, project=folder)}"],
        )
        return
    fit = stored_calibration(project, number)
    print_answer(
        as_json,
        lambda: {
            "calibration": number,
            "estimates": [own.stored() for own in fit.estimates.values()],
            "parameters": dict(fit),
            "rms_error_mm": 1e3 * fit.rms_error,
            "status": fit.status,
            "command": fit.command,
            "call": fit.call,
        },
        lambda: [repr(fit), *([f"Repeat it: {fit.command}"] if fit.command else [])],
    )


def _calibrations(
    mode: str, chosen: "ExperimentSelection", arguments: dict[str, Any]
) -> "Calibrations":
    """Call the function of a mode."""
    from fixel.workflows.calibration import run

    try:
        if mode == "joint":
            return run.calibrate(chosen, **arguments).run
        functions = {
            "each": run.calibrate_each,
            "campaign": run.calibrate_campaign,
            "stored": run.calibrate_stored,
        }
        return functions[mode](chosen, **arguments)
    except Interrupted as interrupted:
        notify(str(interrupted))
        raise


def _prepare(
    project: "Project", mode: Any, chosen: "ExperimentSelection", arguments: dict[str, Any]
) -> Path:
    from fixel.workflows.calibration.plan import CalibrationPlan
    from fixel.workflows.calibration.stored_run import job_folder, prepare_folder

    plan = CalibrationPlan.of(mode, chosen, **arguments).rehearse()
    job = job_folder(project.folder, plan)
    prepare_folder(plan, job)
    return job


def _prepared(job: Path) -> list[str]:
    return [
        f"Prepared {job}. When it has finished, run this command without --prepare to store the"
        " result.",
        f"Next: fixel jobs submit {shlex.quote(str(job))} --workers 2",
    ]


def _setting(text: str) -> tuple[str, Any]:
    """Parse `--option NAME=VALUE`; a value is JSON, or else text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidInput("--option", found=repr(text), expected="NAME=VALUE")
    try:
        return name.strip(), json.loads(value)
    except json.JSONDecodeError:
        return name.strip(), value
