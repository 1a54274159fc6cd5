"""`fixel track FILM`: track a film and store an experiment."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder

if TYPE_CHECKING:
    from fixel.workflows.acquisition.track import TrackAnswer

MAX_FLAGS = 8


def track(
    source: Annotated[
        Path, typer.Argument(help="Video file, or folder of a recording.", metavar="FILM")
    ],
    rig: Annotated[
        str,
        typer.Option(
            help="Rig file, or thesis-tags, thesis-stickers, microscope.",
            metavar="RIG",
            show_default="rig.yaml beside the film",
        ),
    ] = "",
    scene: Annotated[
        Path | None,
        typer.Option(
            help="Scene file, as it was planned.",
            metavar="FILE",
            show_default="scene.yaml beside the film",
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(help="auto, tags, stickers or silhouette.", metavar="METHOD")
    ] = "auto",
    folder: ProjectFolder = Path(),
    dataset: Annotated[str, typer.Option(help="Of the experiment.", metavar="NAME")] = "bench",
    name: Annotated[
        str,
        typer.Option(help="Of the experiment.", metavar="NAME", show_default="the film's"),
    ] = "",
    register: Annotated[
        bool,
        typer.Option("--register", help="Find the camera's place anew, from tags on the plate."),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Track, and store nothing.")] = False,
    overlay: Annotated[
        Path | None,
        typer.Option(help="Film with the measured outlines: .mp4, .mkv.", metavar="FILE"),
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="A few frames of that: .png.", metavar="FILE")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Poses, residuals and gaps: .png, .svg, .pdf.", metavar="FILE"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Track a film, and store it as an experiment."""
    from fixel.cli.screen import progress_bar
    from fixel.workflows.acquisition.track import track_film

    answer = track_film(
        source,
        rig=rig,
        scene=scene,
        method=method,
        register=register,
        project=None if dry_run else folder,
        dataset=dataset,
        name=name,
        overlay=overlay,
        sheet=sheet,
        plot=plot,
        progress=progress_bar("Tracking"),
    )
    if as_json:
        typer.echo(json.dumps(answer.summary(), allow_nan=False))
        return
    options = {
        "--rig": rig,
        "--scene": scene or "",
        "--method": method if method != "auto" else "",
        "--project": folder if folder != Path() else "",
        "--dataset": dataset if dataset != "bench" else "",
        "--name": name,
    }
    again = ["fixel", "track", str(source), *(["--register"] if register else [])]
    again += [word for key, value in options.items() if value for word in (key, str(value))]
    typer.echo("\n".join(_lines(answer, folder, shlex.join(again))))


def _lines(answer: "TrackAnswer", folder: Path, again: str) -> list[str]:
    from fixel.cli.screen import table

    experiment, tracked, motion = answer.experiment, answer.tracked, answer.motion
    seconds = tracked.time[-1] - tracked.time[0]
    lines = [
        f"{answer.film.path}: {len(tracked.time)} frames, {seconds:.2f} s, rig {answer.rig.name}"
    ]
    rows = []
    for name, part in answer.summary()["parts"].items():
        rows.append(
            (
                name,
                str(part["frames"]),
                str(len(tracked.time) - part["frames"]),
                str(part["outliers"]),
                f"{part['residual_px']:.3f}",
                f"{part['residual_m'] * 1e6:.2f}",
            )
        )
    head = ("part", "poses", "missing", "outliers", "residual [px]", "[um]")
    lines += table(head, rows)
    if motion is not None and motion.moved:
        assert experiment.effective is not None
        first, last = experiment.effective
        lines.append(
            f"actuator: {motion.cruise * 1e3:.4g} mm/s over {motion.travel * 1e3:.4g} mm; "
            f"useful from {first:.2f} to {last:.2f} s"
        )
    if tracked.fixels:
        lines.append(f"fixels measured: {', '.join(f.name for f in tracked.fixels)}")
    if experiment.contact_mode:
        lines.append(f"contact mode at the end: {experiment.contact_mode}")
    lines += [f"  {flag.name}: {flag.detail}" for flag in experiment.flags[:MAX_FLAGS]]
    if experiment.simulated_by:
        lines.append("SIMULATED: no camera has seen this")
    lines += [f"wrote {path}" for path in answer.files.values()]
    where = "" if folder == Path() else f" --project {shlex.quote(str(folder))}"
    if answer.number is None:
        lines.append("stored nothing; leave out --dry-run to store it")
        lines.append(f"Next: {again}")
    else:
        verb = "stored as" if answer.new else "there already as"
        lines.append(f"{verb} experiment {answer.number}, {experiment.key}")
        lines.append(f"Next: fixel show {shlex.quote(experiment.key)}{where}")
    return lines
