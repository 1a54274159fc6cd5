"""`fixel testbed run`, `film` and `serve`: experiments on a simulated testbed, and their films."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.capability.options import Door, Seed, Threads
from fixel.cli.capability import subcommand, typer_command
from fixel.cli.project import imported
from fixel.cli.screen import CommandAnswer, FilmPath, command_of, print_answer, wrote
from fixel.progress import show_progress
from fixel.table import Column, Table, shortened
from fixel.workflows.acquisition import FILM, Count

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fixel.database.project import Project
    from fixel.workflows.acquisition.film import FilmResult

MAX_ROWS = 20

app = typer.Typer(
    help="Perform and film experiments on the simulated testbed.", no_args_is_help=True
)


@subcommand(app, "run")
def run_plan(
    project: "Project",
    plan: Annotated[Path | None, Door(metavar="PLAN")] = None,
    *,
    seed: Seed = 1,
    uneven_table: Annotated[float, Door(least=0.0)] = 0.0,
    limit: Count = None,
    threads: Threads = None,
) -> CommandAnswer:
    """Perform a plan on the simulated testbed, with noise.

    The drive has ripple, and the plate is uneven.

    Parameters
    ----------
    plan : Path, optional
        Plan file; by default the 420 experiments of the thesis.
    uneven_table : float
        Standard deviation of the logarithm of loads by place; 0 for a flat table.
    limit : int, optional
        Maximum number of experiments.
    threads : int, optional
        Number of threads; all cores by default.
    """
    from fixel.workflows.project.importing import run_testbed

    options: Any = {"seed": seed, "uneven_table": uneven_table, "limit": limit, "threads": threads}
    with show_progress(stage="performing") as report:
        done = run_testbed(project, plan, **options, progress=report)
    return imported(done, {"seed": seed}, project.folder)


def _film(request: "BaseModel", folder: Path, as_json: bool) -> None:
    with show_progress(stage="filming") as report:
        made = FILM.function(**FILM.arguments(request), project=folder, progress=report)
    print_answer(as_json, lambda: {"films": [one._asdict() for one in made]}, lambda: _lines(made))


app.command("film")(typer_command(FILM, _film))


def _lines(films: "list[FilmResult]") -> list[str]:
    rows = [
        (one.name, one.frames, one.seconds, one.status, str(one.folder)) for one in films[:MAX_ROWS]
    ]
    columns = ("film", "frames", Column("time", "s", ".2f"), "simulation", "recording")
    lines = shortened(Table(columns, rows).lines(), len(films) + 1)
    lines += wrote(one.video for one in films)
    unmarked = sorted({name for one in films for name in one.unmarked})
    if unmarked:
        lines.append(
            f"rendered without markers, since the rig has none for them: {', '.join(unmarked)}"
        )
    if films:
        lines += ["", f"Next: {command_of('track', films[0].folder)}"]
    return lines


@subcommand(app, "serve")
def serve(
    film: FilmPath,
    *,
    port: Annotated[int, Door(least=0, most=65535)] = 0,
    loop: Annotated[bool, Door(flag="--loop")] = False,
    as_json: bool,
) -> None:
    """Serve a film on this machine like a network camera, until Ctrl-C.

    Parameters
    ----------
    port : int
        Port to listen on; 0 for any free one.
    loop : bool
        Repeat the film endlessly.
    """
    from fixel.testbed.file_source import LoopbackCamera

    with LoopbackCamera(film, port=port, loop=loop) as camera:
        width, height = camera.stream.size
        record = command_of("record", "--camera", camera.url, "--out", "recording")
        print_answer(
            as_json,
            lambda: {"url": camera.url, "size_px": [width, height]},
            lambda: [
                f"serving {film}, {width} x {height} pixels, at {camera.url}",
                f"Next: {record}",
            ],
        )
        camera.wait()
