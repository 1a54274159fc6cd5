"""`fixel calibrate`: estimate parameters from experiments, with verdicts on each."""

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fixel.cli.options import (
    AsJson,
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
from fixel.cli.screen import command_line, job_bar, notice, notify, print_answer
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions
    from fixel.workflows.calibration.run import ExperimentSelection


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of `fixel calibrate` for parameters, error and search."""

    mode: str | None = option(
        None,
        "each: every experiment alone; joint: one set for all; campaign: each, then joint, with"
        " the intermediate steps of the thesis; stored: the best of the sets found before.",
        metavar="MODE",
        show_default="each for one experiment, else joint",
    )
    fit: list[str] | None = option(
        None,
        "Parameter to find, in SI units or with _mm, _deg, _mrad after the name; may be repeated.",
        metavar="NAME[=LOW:HIGH[:START]]",
    )
    hold: list[str] | None = option(
        None, "Parameter that stays; may be repeated.", "--set", metavar="NAME=VALUE"
    )
    space: Path | None = option(None, "File with the parameters, instead of --fit.")
    dakota: Path | None = option(
        None, "Input file of Dakota's pattern search, for search and parameters.", metavar="FILE"
    )
    error: str = option(
        "mean-square",
        "mean-square (the thesis's E), root-mean-square (the ASME paper's), end-pose or robust.",
        metavar="NAME",
    )
    angle_scale_mm: float = option(35.0, "Length that one radian counts as [mm].", metavar="MM")
    combine: str = option(
        "sum", "How errors of experiments are combined: sum, mean or largest.", metavar="HOW"
    )
    motion: str = option("dynamic", "dynamic, quasistatic or first-order.", metavar="MODEL")
    optimiser: str | None = option(
        None,
        "pattern-search, fixed-step, nelder-mead, cma-es, mads or least-squares.",
        metavar="NAME",
        show_default="least-squares for one set of parameters and an error that is a sum of"
        " squares, else pattern-search",
    )
    budget: float | None = option(
        None,
        "Computing time for the search and the verdicts [s], half of it for each.",
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
        None, "Setting of the optimiser; may be repeated.", "--option", metavar="NAME=VALUE"
    )
    starts: int = option(1, "Searches, all but the first from random places.", min=1)
    seed: Seed = 0
    noise: MeasurementNoise
    level: float = option(0.95, "Confidence level of the intervals.")
    verdicts: bool = option(
        True, "Compute intervals, profiles and verdicts.", "--verdicts/--no-verdicts"
    )
    name: str = option("calibration", "Name of the calibration.", metavar="NAME")

    def request(self, chosen: "ExperimentSelection") -> "CalibrationRequest":
        """Return the request for the selected experiments, without stored sets of parameters."""
        from fixel.workflows.calibration.parameter_options import fixed_unknowns
        from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions

        n = len(chosen.targets)
        mode: Any = "each" if n == 1 else "joint"
        if self.mode is not None:
            mode = require_one_of("--mode", self.mode, ("each", "joint", "campaign", "stored"))
        search, unknowns = self._search_and_unknowns(chosen)
        fixed = fixed_unknowns(self.hold or [])
        names = {unknown.name for unknown in fixed}
        unknowns = [unknown for unknown in unknowns if unknown.name not in names] + fixed
        if not search.name:
            n_free = sum(not unknown.frozen for unknown in unknowns)
            usual = self._usual_optimiser(mode, chosen, n_free)
            search = search.model_copy(update={"name": usual})
        noise = self.noise
        return CalibrationRequest(
            name=self.name,
            mode=mode,
            unknowns=unknowns,
            error=NamedOptions(
                name=self.error, options={"angle_scale": 1e-3 * self.angle_scale_mm}
            ),
            motion=self.motion,
            optimiser=search,
            starts=self.starts,
            combine=require_one_of("--combine", self.combine, ("sum", "mean", "largest")),
            seed=self.seed,
            noise_position=None if noise.noise_mm is None else 1e-3 * noise.noise_mm,
            noise_angle=None if noise.noise_mrad is None else 1e-3 * noise.noise_mrad,
            level=self.level,
            verdicts=self.verdicts,
            budget=self.budget,
            sample_of=chosen.sample_of,
        )

    def _search_and_unknowns(
        self, chosen: "ExperimentSelection"
    ) -> "tuple[NamedOptions, list[Any]]":
        from fixel.calibration.usual_parameters import default_unknowns
        from fixel.workflows.calibration.parameter_options import (
            from_dakota,
            read_space,
            searched_unknowns,
        )
        from fixel.workflows.calibration.request import NamedOptions

        scenes = [target.case.scene for target in chosen.targets]
        options = dict(map(_setting, self.settings or []))
        search = NamedOptions(name=self.optimiser or "", options=options)
        if self.dakota is not None:
            return from_dakota(self.dakota)
        if self.space is not None:
            return search, list(read_space(self.space).unknowns)
        return search, searched_unknowns(self.fit, scenes) if self.fit else default_unknowns(scenes)

    def _usual_optimiser(self, mode: str, chosen: "ExperimentSelection", n_free: int) -> str:
        from fixel.calibration.objective import EndPose
        from fixel.workflows.calibration.request import usual_optimiser

        only_ends = self.error == EndPose.name
        frames = sum(1 if only_ends else len(target.pose) for target in chosen.targets)
        return usual_optimiser(mode, self.combine, self.error, 3 * frames, n_free)


@with_options
def calibrate(
    *,
    experiments: list[str] | None = argument(
        None,
        "Ids or names; without any, all that the options below leave.",
        metavar="[EXPERIMENT]...",
    ),
    folder: ProjectFolder = Path(),
    selection: Selection,
    search: SearchOptions,
    workers: Workers = None,
    site: SiteFile = None,
    prepare_only: bool = option(False, "Make the job only, for fixel jobs submit.", "--prepare"),
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Find the parameters with which simulations meet experiments.

    Interrupted or repeated, the same command goes on from what is finished.
    """
    if experiments and (selection.dataset or selection.where):
        given = "--dataset" if selection.dataset else "--where"
        raise InvalidInput(given, found="experiments by name too", expected="one of them")
    from fixel.database.project import Project
    from fixel.workflows.calibration import run
    from fixel.workflows.compilation import get_ready

    project = Project.open(folder)
    with project.store() as store:
        chosen = run.select_experiments(store, experiments or (), selection.query)
    if search.sample is not None:
        chosen = run.draw_sample(chosen, search.sample, search.seed)
    request = search.request(chosen)
    if request.mode == "stored":
        with project.store() as store:
            points = run.stored_points(store, request)
        request = request.model_copy(update={"stored": points, "verdicts": False})
    get_ready(chosen.targets[0].case.scene, notice(as_json))  # before the clock runs
    require_folder(plot)
    job = run.prepare(project, chosen, request)
    if prepare_only:
        print_answer(as_json, lambda: {"job": str(job)}, lambda: _prepared(job))
        return
    _run(job, workers, site)
    done = run.collect(project, job, command_line(), chosen.left_out)
    pictures = []
    if plot is not None:
        from fixel.workflows.calibration.charts import draw_all

        pictures = draw_all(done, plot)

    def lines() -> list[str]:
        from fixel.cli.calibration_text import lines_of

        return lines_of(done, folder, pictures)

    print_answer(
        as_json, lambda: done.summary() | {"pictures": [str(path) for path in pictures]}, lines
    )


def _run(job: Path, workers: int | None, site: Path | None) -> None:
    from fixel.jobs.site import load_site
    from fixel.workflows.calibration import run

    place = None if site is None else load_site(site)
    try:
        run.run(job, workers=workers, site=place, progress=job_bar())
    except KeyboardInterrupt:
        notify(f"what is finished is kept in {job}; the same command goes on from there")
        raise


def _prepared(job: Path) -> list[str]:
    return [
        f"prepared {job}; once it is done, this command without --prepare stores its result",
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
