"""`fixel calibrate`: estimate parameters from experiments, with verdicts on each."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import (
    AsJson,
    DatasetName,
    Flagged,
    NoiseMm,
    NoiseMrad,
    PictureFolder,
    ProjectFolder,
    Seed,
    Where,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.calibration.run import Calibration


def calibrate(
    experiments: Annotated[
        list[str] | None,
        typer.Argument(
            help="Ids or names; without any, all that the options below leave.",
            metavar="[EXPERIMENT]...",
        ),
    ] = None,
    folder: ProjectFolder = Path(),
    dataset: DatasetName = None,
    where: Where = None,
    flagged: Flagged = False,
    mode: Annotated[
        str | None,
        typer.Option(
            help="each: every experiment by itself; joint: one set for all; campaign: both, and"
            " the ways of the thesis between them; stored: the best of the sets found before.",
            metavar="MODE",
            show_default="each for one experiment, else joint",
        ),
    ] = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter to find, in SI units or with _mm, _deg, _mrad after the name; may be"
            " repeated.",
            metavar="NAME[=LOW:HIGH[:START]]",
        ),
    ] = None,
    hold: Annotated[
        list[str] | None,
        typer.Option("--set", help="Parameter that stays; may be repeated.", metavar="NAME=VALUE"),
    ] = None,
    space: Annotated[
        Path | None,
        typer.Option(help="File with the parameters, in place of --fit.", metavar="FILE"),
    ] = None,
    dakota: Annotated[
        Path | None,
        typer.Option(
            help="Input file of Dakota's pattern search, for search and parameters.", metavar="FILE"
        ),
    ] = None,
    error: Annotated[
        str,
        typer.Option(
            help="mean-square (the thesis's E), root-mean-square (the ASME paper's), end-pose or"
            " robust.",
            metavar="NAME",
        ),
    ] = "mean-square",
    angle_scale_mm: Annotated[
        float, typer.Option(help="What a radian counts as [mm].", metavar="MM")
    ] = 35.0,
    combine: Annotated[
        str, typer.Option(help="Of several experiments: sum, mean or largest.", metavar="HOW")
    ] = "sum",
    motion: Annotated[
        str, typer.Option(help="dynamic, quasistatic or first-order.", metavar="MODEL")
    ] = "dynamic",
    optimiser: Annotated[
        str | None,
        typer.Option(
            help="pattern-search, fixed-step, nelder-mead, cma-es, mads or least-squares.",
            metavar="NAME",
            show_default="least-squares for one set of parameters and an error that is a sum of"
            " squares, else pattern-search",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            help="Computing time for the search and the verdicts [s], half of it for each.",
            metavar="SECONDS",
            min=0.0,
        ),
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(
            help="Calibrate a random sample of N experiments, spread over their conditions.",
            metavar="N",
            min=1,
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(help="Of the optimiser; may be repeated.", metavar="NAME=VALUE"),
    ] = None,
    starts: Annotated[
        int, typer.Option(help="Searches, all but the first from random places.", min=1)
    ] = 1,
    seed: Seed = 0,
    noise_mm: NoiseMm = None,
    noise_mrad: NoiseMrad = None,
    level: Annotated[float, typer.Option(help="Of the intervals.")] = 0.95,
    verdicts: Annotated[
        bool, typer.Option("--verdicts/--no-verdicts", help="Find out what the data determine.")
    ] = True,
    name: Annotated[str, typer.Option(help="Of the calibration.", metavar="NAME")] = "calibration",
    workers: Annotated[
        int | None,
        typer.Option(help="Processes; 0 for this one alone.", min=0, show_default="0"),
    ] = None,
    site: Annotated[
        Path | None,
        typer.Option(help="Cluster the workers run on: see fixel jobs site.", metavar="FILE"),
    ] = None,
    prepare_only: Annotated[
        bool, typer.Option("--prepare", help="Make the job only, for fixel jobs submit.")
    ] = False,
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Find the parameters with which simulations meet experiments.

    Interrupted or repeated, the same command goes on from what is finished.
    """
    from fixel.calibration.objective import EndPose
    from fixel.database.project import Project
    from fixel.workflows.calibration import run
    from fixel.workflows.calibration.parameter_options import (
        default_unknowns,
        fitted,
        held,
        read_space,
    )
    from fixel.workflows.calibration.request import (
        CalibrationRequest,
        NamedOptions,
        usual_optimiser,
    )
    from fixel.workflows.project.filters import query_of

    if experiments and (dataset or where):
        given = "--dataset" if dataset else "--where"
        raise InvalidInput(given, found="experiments by name too", expected="one of them")
    project = Project.open(folder)
    query = query_of(dataset=dataset, where=where or (), flagged=flagged)
    with project.store() as store:
        chosen = run.choose(store, experiments or (), query)
    if sample is not None:
        chosen = run.sampled(chosen, sample, seed)
    scenes = [target.case.scene for target in chosen.targets]
    search = NamedOptions(name=optimiser or "", options=_options(option or []))
    if dakota is not None:
        from fixel.workflows.calibration.parameter_options import from_dakota

        search, unknowns = from_dakota(dakota)
    elif space is not None:
        unknowns = list(read_space(space).unknowns)
    else:
        unknowns = fitted(fit, scenes) if fit else default_unknowns(scenes)
    kept = held(hold or [])
    names = {unknown.name for unknown in kept}
    unknowns = [unknown for unknown in unknowns if unknown.name not in names] + kept
    how = _mode(mode, len(scenes))
    if not search.name:
        frames = sum(1 if error == EndPose.name else len(t.pose) for t in chosen.targets)
        free = sum(not unknown.frozen for unknown in unknowns)
        usual = usual_optimiser(how, combine, error, 3 * frames, free)
        search = search.model_copy(update={"name": usual})
    request = CalibrationRequest(
        name=name,
        mode=how,
        unknowns=unknowns,
        error=NamedOptions(name=error, options={"angle_scale": 1e-3 * angle_scale_mm}),
        motion=motion,
        optimiser=search,
        starts=starts,
        combine=_one_of("--combine", combine, ("sum", "mean", "largest")),
        seed=seed,
        noise_position=None if noise_mm is None else 1e-3 * noise_mm,
        noise_angle=None if noise_mrad is None else 1e-3 * noise_mrad,
        level=level,
        verdicts=verdicts,
        budget=budget,
        sample_of=chosen.sample_of,
    )
    if request.mode == "stored":
        with project.store() as store:
            points = run.stored_points(store, request)
        request = request.model_copy(update={"stored": points, "verdicts": False})
    _announce(scenes[0], as_json)
    if plot is not None:
        from fixel.workflows.figures import make_folder

        make_folder(plot)
    job = run.prepare(project, chosen, request)
    if prepare_only:
        _prepared(job, as_json)
        return
    from fixel.cli.jobs import job_bar
    from fixel.jobs.site import load_site

    try:
        run.run(
            job,
            workers=workers,
            site=None if site is None else load_site(site),
            progress=job_bar(),
        )
    except KeyboardInterrupt:
        from fixel.cli.screen import notify

        notify(f"what is finished is kept in {job}; the same command goes on from there")
        raise
    command = "fixel " + shlex.join(sys.argv[1:])
    done = run.collect(project, job, command, chosen.left_out)
    pictures = _draw(done, plot) if plot is not None else []
    if as_json:
        typer.echo(json.dumps(done.summary() | {"pictures": [str(path) for path in pictures]}))
        return
    from fixel.cli.calibration_text import lines_of

    for line in lines_of(done, folder, pictures):
        typer.echo(line)


def _mode(mode: str | None, n: int) -> Any:
    if mode is None:
        return "each" if n == 1 else "joint"
    return _one_of("--mode", mode, ("each", "joint", "campaign", "stored"))


def _one_of(where: str, value: str, known: tuple[str, ...]) -> Any:
    if value not in known:
        raise InvalidInput(where, found=repr(value), expected="one of " + ", ".join(known))
    return value


def _options(settings: list[str]) -> dict[str, Any]:
    """Parse `--option NAME=VALUE`; values are JSON, or else text."""
    found: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InvalidInput("--option", found=repr(setting), expected="NAME=VALUE")
        try:
            found[name.strip()] = json.loads(text)
        except json.JSONDecodeError:
            found[name.strip()] = text
    return found


def _announce(scene: Any, as_json: bool) -> None:
    """Compile before the clock runs; print a notice on a terminal, or without `--json`."""
    from fixel.cli.screen import notify
    from fixel.workflows.compilation import get_ready

    get_ready(scene, notify if sys.stderr.isatty() or not as_json else None)


def _prepared(job: Path, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps({"job": str(job)}))
        return
    typer.echo(f"prepared {job}; once it is done, this command without --prepare stores its result")
    typer.echo(f"Next: fixel jobs submit {shlex.quote(str(job))} --workers 2")


def _draw(done: "Calibration", folder: Path) -> list[Path]:
    from fixel.workflows.calibration.charts import draw_all

    return draw_all(done, folder)
