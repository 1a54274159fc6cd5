"""`fixel testbed film`: recordings of simulated experiments, as a camera would make them."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, Seed

if TYPE_CHECKING:
    from fixel.workflows.acquisition.film import FilmResult

MAX_ROWS = 20


def film(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="Scene files, plan files, or experiments of the project by id or name.",
            metavar="[EXPERIMENT|SCENE.yaml|PLAN.yaml]...",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder to make.", metavar="FOLDER")
    ] = Path("film"),
    rig: Annotated[
        str,
        typer.Option(help="Rig file, or thesis-tags, thesis-stickers, microscope.", metavar="RIG"),
    ] = "thesis-tags",
    looks: Annotated[
        str | None,
        typer.Option(
            help="clean, thesis, hard; microscope-clean, microscope.",
            metavar="NAME",
            show_default="thesis, or microscope",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A number of the looks, e.g. occlusion=1.5; may be repeated.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    seed: Seed = 1,
    exact: Annotated[
        bool, typer.Option("--exact", help="Keep every bit of every picture; larger files.")
    ] = False,
    video: Annotated[
        Path | None,
        typer.Option(help="Write it as one video file too: .mp4, .mkv.", metavar="FILE"),
    ] = None,
    rate: Annotated[float, typer.Option(help="Frames a second [Hz].", min=0.1, max=1000.0)] = 30.0,
    lead: Annotated[float, typer.Option(help="At rest before the motion [s].", min=0.0)] = 0.5,
    rest: Annotated[float, typer.Option(help="At rest after the motion [s].", min=0.0)] = 0.5,
    frames: Annotated[
        int | None, typer.Option(help="No more than so many.", min=1, metavar="COUNT")
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(help="Only the first so many of a plan.", min=1, metavar="COUNT"),
    ] = None,
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Film simulated experiments: recordings with known truth, to test tracking against."""
    from fixel.cli.screen import notify, progress_bar
    from fixel.workflows.acquisition.film import Shooting, film

    filmed = film(
        sources or [],
        out,
        Shooting(
            rig=rig,
            looks=looks or "",
            changes=tuple(set_ or ()),
            seed=seed,
            codec="exact" if exact else "near",
            rate=rate,
            lead=lead,
            rest=rest,
            frames=frames,
        ),
        project=folder,
        limit=limit,
        video=video,
        notify=notify if sys.stderr.isatty() or not as_json else None,
        progress=None if as_json else progress_bar("Filming"),
    )
    if as_json:
        typer.echo(json.dumps({"films": [_plain(one) for one in filmed]}, allow_nan=False))
    else:
        typer.echo(written(filmed))


def written(filmed: "list[FilmResult]") -> str:
    """Return the films that were made, and the next command."""
    from fixel.cli.screen import table

    rows = [
        (one.name, str(one.frames), f"{one.seconds:.2f}", one.status, str(one.folder))
        for one in filmed[:MAX_ROWS]
    ]
    lines = table(("film", "frames", "time [s]", "simulation", "recording"), rows)
    if len(filmed) > MAX_ROWS:
        lines.append(f"... and {len(filmed) - MAX_ROWS} more; --json has them all")
    lines += [f"wrote {one.video}" for one in filmed if one.video is not None]
    unmarked = sorted({name for one in filmed for name in one.unmarked})
    if unmarked:
        lines.append(f"without a mark, since the rig knows none: {', '.join(unmarked)}")
    if filmed:
        lines += ["", f"Next: fixel track {shlex.quote(str(filmed[0].folder))}"]
    return "\n".join(lines)


def _plain(one: "FilmResult") -> dict[str, object]:
    return {
        "name": one.name,
        "folder": str(one.folder),
        "frames": one.frames,
        "seconds": one.seconds,
        "status": one.status,
        "unmarked": list(one.unmarked),
        "video": None if one.video is None else str(one.video),
    }
