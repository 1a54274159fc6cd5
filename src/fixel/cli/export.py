"""`fixel export PROJECT TARGET`: a project's experiments for others."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, project_at

if TYPE_CHECKING:
    from fixel.workflows.project.export import ExportAnswer


def export(
    paths: Annotated[
        list[Path],
        typer.Argument(
            help="TARGET: a .zip that another project imports; with --parquet or --lerobot, a new"
            " folder. PROJECT: the same as --project.",
            metavar="[PROJECT] TARGET",
            show_default=False,
        ),
    ],
    folder: ProjectFolder = Path(),
    dataset: Annotated[
        str | None, typer.Option(help="Only the experiments of this dataset.", metavar="NAME")
    ] = None,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Write two tables: experiments and frames.")
    ] = False,
    lerobot: Annotated[
        bool, typer.Option("--lerobot", help="Write a LeRobot dataset, version 3.0.")
    ] = False,
    fps: Annotated[
        int | None,
        typer.Option(
            help="Frames a second of the LeRobot dataset; else the experiments' own, mostly.",
            metavar="HZ",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the experiments of a project for others, flagged ones too."""
    from fixel.cli.screen import progress_bar
    from fixel.errors import InvalidInput
    from fixel.workflows.project.export import export as export_project
    from fixel.workflows.project.export import json_text

    *places, target = paths
    if len(places) > 1:
        raise InvalidInput("TARGET", found=f"{len(paths)} paths", expected="[PROJECT] TARGET")
    if parquet and lerobot:
        raise InvalidInput("--parquet", found="--lerobot too", expected="one of them")
    answer = export_project(
        project_at(places[0] if places else None, folder),
        target,
        format="parquet" if parquet else "lerobot" if lerobot else "bundle",
        dataset=dataset,
        fps=fps,
        progress=progress_bar("Exporting"),
    )
    typer.echo(json_text(answer) if as_json else written(answer))


def written(answer: "ExportAnswer") -> str:
    """Return a few lines of text: what was written, and remarks on it."""
    from fixel.cli.screen import seconds

    counts = dict(answer.counts)
    total = counts.pop("experiments")
    about = [f"{counts.pop(what, 0)} {what}" for what in ("flagged", "simulated", "replaced")]
    about = [text for text in about if not text.startswith("0 ")]
    more = [f"{n} {what.replace('_', ' ')}" for what, n in counts.items() if n]
    lines = [
        f"{total} experiments" + (f", of them {', '.join(about)}" if about else ""),
        *([f"with {', '.join(more)}"] if more else []),
        *(f"left out: {n} {_why(what)}" for what, n in answer.left_out.items()),
        f"wrote {answer.target}, {answer.bytes / 1e6:.3g} MB in {seconds(answer.seconds)}",
    ]
    return "\n".join(lines)


def _why(what: str) -> str:
    return {
        "deleted": "deleted experiments",
        "calibrations": "calibrations that used experiments which are not exported",
    }[what]
