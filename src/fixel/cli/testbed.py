"""`fixel testbed run`, `film` and `serve`: experiments on a simulated testbed, and their films."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from fixel.cli.options import AsJson, ProjectFolder, Seed, argument, option, required, with_options
from fixel.cli.project import print_imported
from fixel.cli.screen import command_of, print_answer, shortened, wrote
from fixel.progress import show_progress
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.workflows.acquisition.film import FilmResult

MAX_ROWS = 20

app = typer.Typer(
    help="Perform and film experiments on the simulated testbed.", no_args_is_help=True
)


@app.command("run")
@with_options
def run_plan(
    *,
    plan: Path | None = argument(
        None, "Plan file; by default the 420 experiments of the thesis.", metavar="[PLAN]"
    ),
    folder: ProjectFolder = Path(),
    seed: Seed = 1,
    uneven_table: float = option(
        0.0, "Standard deviation of the logarithm of loads by place; 0 for a flat table.", min=0.0
    ),
    limit: int | None = option(None, "Maximum number of experiments.", min=1, metavar="COUNT"),
    threads: int | None = option(None, "Number of threads; all cores by default.", min=1),
    as_json: AsJson = False,
) -> None:
    """Perform a plan on the simulated testbed, with noise.

    The drive has ripple, and the plate is uneven.
    """
    from fixel.database.project import Project
    from fixel.workflows.project.importing import run_testbed

    with show_progress(stage="performing") as report:
        done = run_testbed(
            Project(folder),
            plan,
            seed=seed,
            uneven_table=uneven_table,
            limit=limit,
            threads=threads,
            progress=report,
        )
    print_imported(done, {"seed": seed}, as_json, folder)


@app.command("film")
@with_options
def film(
    *,
    sources: list[str] | None = argument(
        None,
        "Scene files, plan files, or experiments of the project by id or name.",
        metavar="[EXPERIMENT|SCENE.yaml|PLAN.yaml]...",
    ),
    out: Path = option(Path("film"), "New folder for the films.", "--out", "-o", metavar="FOLDER"),
    rig: str = option(
        "thesis-tags",
        "Rig file or name of an example rig: thesis-tags, thesis-stickers, microscope.",
        metavar="RIG",
    ),
    looks: str | None = option(
        None,
        "Camera effects: clean, thesis, hard, microscope-clean or microscope.",
        metavar="NAME",
        show_default="thesis, or microscope",
    ),
    set_: list[str] | None = option(
        None,
        "One value of the camera effects, such as occlusion=1.5; may be repeated.",
        "--set",
        metavar="NAME=VALUE",
    ),
    seed: Seed = 1,
    exact: bool = option(False, "Store pictures without loss, in larger files.", "--exact"),
    video: Path | None = option(None, "Also write the film as one video file: .mp4 or .mkv."),
    rate: float = option(30.0, "Frame rate [Hz].", min=0.1, max=1000.0),
    lead: float = option(0.5, "Time at rest before the motion [s].", min=0.0),
    rest: float = option(0.5, "Time at rest after the motion [s].", min=0.0),
    frames: int | None = option(None, "Maximum number of frames.", min=1, metavar="COUNT"),
    limit: int | None = option(
        None, "Maximum number of experiments to film from a plan.", min=1, metavar="COUNT"
    ),
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Render simulated experiments as recordings, to test tracking.

    Their true poses are known.
    """
    from fixel.workflows.acquisition import film as films

    settings = films.FilmSettings(
        rig=rig,
        looks=looks or "",
        changes=tuple(set_ or ()),
        seed=seed,
        codec="exact" if exact else "near",
        rate=rate,
        lead=lead,
        rest=rest,
        frames=frames,
    )
    with show_progress(stage="filming") as report:
        made = films.film(
            sources or [], out, settings, project=folder, limit=limit, video=video, progress=report
        )
    print_answer(as_json, lambda: {"films": list(map(_content, made))}, lambda: _lines(made))


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


def _content(one: "FilmResult") -> dict[str, object]:
    video = None if one.video is None else str(one.video)
    return one._asdict() | {"folder": str(one.folder), "video": video}


@app.command("serve")
@with_options
def serve(
    *,
    film: Path = required("Video file or folder of a recording.", metavar="FILM", exists=True),
    port: int = option(0, "Port to listen on; 0 for any free one.", min=0, max=65535),
    loop: bool = option(False, "Repeat the film endlessly.", "--loop"),
    as_json: AsJson = False,
) -> None:
    """Serve a film on this machine like a network camera, until Ctrl-C."""
    from fixel.testbed.loopback import LoopbackCamera

    with LoopbackCamera(film, port=port, loop=loop) as camera:
        width, height = camera.stream.size
        print_answer(
            as_json,
            lambda: {"url": camera.url, "size_px": [width, height]},
            lambda: [
                f"serving {film}, {width} x {height} pixels, at {camera.url}",
                f"Next: {command_of('record', '--camera', camera.url, '--out', 'recording')}",
            ],
        )
        camera.wait()
