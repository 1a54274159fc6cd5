"""`fixel new`, `import`, `list` and `testbed run`: a laboratory's project folder."""

import json
import shlex
import sys
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import AsJson, DatasetName, Flagged, ProjectFolder, Where, project_words

if TYPE_CHECKING:
    from fixel.database.browsing import ExperimentPage, ExperimentRow
    from fixel.workflows.project.importing import ImportSummary

MAX_ROWS = 30


testbed = typer.Typer(help="Perform experiments.", no_args_is_help=True, rich_markup_mode=None)


def new(
    folder: Annotated[Path, typer.Argument(help="Folder to make.", metavar="FOLDER")],
    database: Annotated[
        str | None,
        typer.Option(
            help="Database of a server, in place of a file: postgresql+psycopg://USER@HOST/NAME.",
            metavar="URL",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a project: a folder with settings, a database and media."""
    from fixel.workflows.project.importing import new_project

    project = new_project(folder, database)
    if as_json:
        typer.echo(json.dumps({"folder": str(folder), "name": project.settings.name}))
        return
    typer.echo(f"made the project {project.settings.name} in {folder}")
    typer.echo("fixel import SOURCE stores what was recorded; or try simulated experiments:")
    typer.echo(f"Next: fixel testbed run --limit 30 --project {shlex.quote(str(folder))}")


def import_(
    source: Annotated[Path, typer.Argument(help="File or folder.", metavar="SOURCE")],
    folder: ProjectFolder = Path(),
    importer: Annotated[
        str | None,
        typer.Option("--as", help="Name of the importer, else it is recognised.", metavar="NAME"),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", help="For the importer; may be repeated.", metavar="NAME=VALUE"),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(
            help="Scene file for a CSV table: outline of the object, pusher, pegs. Without one,"
            " a template is written beside the table.",
            metavar="FILE",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how the source is read, and import nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Import recorded experiments; those stored already are skipped."""
    from fixel.cli.screen import progress_bar
    from fixel.database.project import Project
    from fixel.workflows.project.importing import import_experiments, import_plan, write_template

    if source.suffix.lower() == ".zip" and importer is None:
        _import_bundle(source, folder, dry_run, as_json)
        return
    if not dry_run:
        project = Project.open(folder)
    plan = import_plan(source, importer, option or (), scene)
    answer: dict[str, Any] = {
        "importer": plan.importer,
        "source": str(source),
        "experiments": plan.n_experiments,
        "understood": list(plan.understood),
    }
    if not as_json:
        typer.echo(f"{source}: {plan.n_experiments} experiments, read as {plan.importer}")
        for sentence in plan.understood:
            typer.echo(f"  {sentence}")
    if dry_run:
        if as_json:
            typer.echo(json.dumps(answer))
        else:
            typer.echo(f"Next: {shlex.join(_without_dry_run())}")
        return
    done = import_experiments(project, plan, progress_bar("Importing"))
    template = write_template(plan, project.folder)
    if template is not None:
        answer["template"] = str(template)
        if not as_json:
            typer.echo(
                f"There is no scene, so these poses cannot be simulated or calibrated. Fill in"
                f" {template}, then import the table again with --scene."
            )
            words = [*sys.argv[1:], "--scene", str(template)]
            answer["next"] = shlex.join(["fixel", *words])
    _say_imported(done, answer, as_json, folder)


def _without_dry_run() -> list[str]:
    return ["fixel", *(word for word in sys.argv[1:] if word != "--dry-run")]


def _import_bundle(source: Path, folder: Path, dry_run: bool, as_json: bool) -> None:
    """Import the bundle that another project exported."""
    from fixel.cli.screen import progress_bar
    from fixel.database.project import Project
    from fixel.workflows.project.export import import_zip

    counts = import_zip(Project.open(folder), source, progress_bar("Importing"), dry_run=dry_run)
    if as_json:
        typer.echo(json.dumps({"source": str(source), "dry_run": dry_run, **counts}))
        return
    verb = "would add" if dry_run else "added"
    found = ", ".join(f"{n} {kind}" for kind, n in counts.items() if n) or "nothing"
    typer.echo(f"{source}: {verb} {found}")
    after = _without_dry_run() if dry_run else ["fixel", "list", *project_words(folder)]
    typer.echo(f"Next: {shlex.join(after)}")


def list_(
    folder: ProjectFolder = Path(),
    dataset: DatasetName = None,
    name: Annotated[
        str | None, typer.Option(help="Only names like this; * for anything.", metavar="PATTERN")
    ] = None,
    real: Annotated[
        bool | None, typer.Option("--real/--simulated", help="Only real, or only simulated ones.")
    ] = None,
    where: Where = None,
    flag: Annotated[
        str | None, typer.Option(help="Only those with this flag.", metavar="NAME")
    ] = None,
    flagged: Flagged = False,
    deleted: Annotated[bool, typer.Option("--deleted", help="Only those deleted.")] = False,
    limit: Annotated[int, typer.Option(help="Maximum number of rows.", min=1)] = MAX_ROWS,
    as_json: AsJson = False,
) -> None:
    """List experiments."""
    from fixel.database.project import Project
    from fixel.workflows.project.filters import query_of
    from fixel.workflows.project.importing import list_experiments, overview

    project = Project.open(folder)
    query = query_of(
        dataset=dataset,
        name=name,
        real=real,
        where=where or (),
        flag=flag,
        flagged=flagged,
        deleted=deleted,
        limit=limit,
    )
    listing = list_experiments(project, query)
    if as_json:
        typer.echo(json.dumps(_listed(listing)))
        return
    for line in _lines(listing):
        typer.echo(line)
    datasets, flags = overview(project)
    if datasets and not any((dataset, name, where, flag)):
        typer.echo("datasets: " + ", ".join(f"{k} {n}" for k, n in datasets.items()))
    if flags and not flag:
        typer.echo("flags:    " + ", ".join(f"{k} {n}" for k, n in flags.items()))
    if listing.rows:
        words = ["fixel", "show", listing.rows[0].key, *project_words(folder)]
        typer.echo(f"Next: {shlex.join([*words, '--plot', 'run.png'])}")
    else:
        words = ["fixel", "testbed", "run", "--limit", "30", *project_words(folder)]
        typer.echo(f"Next: {shlex.join(words)}")


@testbed.command("run")
def run_plan(
    plan: Annotated[
        Path | None,
        typer.Argument(help="Plan file; without one, the thesis's 420.", metavar="[PLAN]"),
    ] = None,
    folder: ProjectFolder = Path(),
    seed: Annotated[int, typer.Option(help="Seed of the random number generator.")] = 1,
    limit: Annotated[
        int | None, typer.Option(help="Only the first so many.", min=1, metavar="COUNT")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(help="As many as there are cores, else.", min=1)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Perform a plan on the simulated testbed: with noise, ripple and a rough plate."""
    from fixel.cli.screen import progress_bar
    from fixel.database.project import Project
    from fixel.workflows.project.importing import run_testbed

    done = run_testbed(
        Project.open(folder),
        plan,
        seed=seed,
        limit=limit,
        threads=threads,
        progress=progress_bar("Performing"),
    )
    _say_imported(done, {"seed": seed}, as_json, folder)


def _say_imported(
    done: "ImportSummary", answer: dict[str, Any], as_json: bool, folder: Path
) -> None:
    if as_json:
        typer.echo(json.dumps(answer | done._asdict()))
        return
    from fixel.cli.screen import seconds

    known = f", {done.known} were there already" if done.known else ""
    typer.echo(f"stored {done.new} experiments in {seconds(done.wall_time_s)}{known}")
    if done.faulty:
        typer.echo(f"{done.faulty} of them have faults in their data: fixel list --all shows them")
    following = shlex.join(["fixel", "list", *project_words(folder)])
    typer.echo(f"Next: {answer.get('next', following)}")


def _lines(listing: "ExperimentPage") -> list[str]:
    from fixel.cli.screen import table

    head = ("id", "experiment", "", "frames", "time [s]", "moved [mm]", "turned [deg]", "contacts")
    rows = [_row(summary) for summary in listing.rows]
    lines = table(head, rows, left=3) if rows else []
    more = listing.total - len(rows)
    lines.append(f"{listing.total} experiments" + (f", {more} not shown" if more else ""))
    if listing.left_out:
        lines[-1] += f"; {listing.left_out} left out for faults in their data (--all shows them)"
    return lines


def _row(summary: "ExperimentRow") -> tuple[str, ...]:
    return (
        str(summary.id),
        summary.key,
        "" if summary.is_real else "SIMULATED",
        str(summary.n_frame),
        f"{summary.duration_s:.2f}",
        f"{1e3 * summary.moved_m:.1f}",
        f"{degrees(summary.turned_rad):.1f}",
        summary.contact_mode,
    )


def _listed(listing: "ExperimentPage") -> dict[str, Any]:
    experiments = []
    for summary in listing.rows:
        row = summary._asdict()
        del row["conditions_json"]
        experiments.append(row | {"conditions": summary.conditions})
    return {
        "experiments": experiments,
        "total": listing.total,
        "left_out": listing.left_out,
    }
