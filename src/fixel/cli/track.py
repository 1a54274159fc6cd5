"""`fixel track FILM`: track a film and store an experiment."""

from pathlib import Path
from typing import TYPE_CHECKING

from fixel.cli.options import AsJson, ProjectFolder, option, required, with_options
from fixel.cli.screen import command_line, command_of, print_answer, progress_bar, wrote
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.workflows.acquisition.track import TrackAnswer

MAX_FLAGS = 8


@with_options
def track(
    *,
    source: Path = required("Video file or folder of a recording.", metavar="FILM"),
    rig: str = option(
        "",
        "Rig file or name of an example rig: thesis-tags, thesis-stickers, microscope.",
        metavar="RIG",
        show_default="rig.yaml next to the film",
    ),
    scene: Path | None = option(
        None,
        "Scene file of the planned experiment.",
        metavar="FILE",
        show_default="scene.yaml next to the film",
    ),
    method: str = option(
        "auto", "Tracking method: auto, tags, stickers or silhouette.", metavar="METHOD"
    ),
    folder: ProjectFolder = Path(),
    dataset: str = option("bench", "Dataset of the experiment.", metavar="NAME"),
    name: str = option("", "Name of the experiment.", metavar="NAME", show_default="the film's"),
    register: bool = option(
        False, "Estimate the camera pose again from the tags on the plate.", "--register"
    ),
    dry_run: bool = option(False, "Track only; store nothing.", "--dry-run"),
    overlay: Path | None = option(None, "Write the film with the measured outlines: .mp4 or .mkv."),
    sheet: Path | None = option(
        None, "Write a picture of a few frames with the measured outlines: .png."
    ),
    plot: Path | None = option(None, "Draw poses, residuals and gaps: .png, .svg or .pdf."),
    as_json: AsJson = False,
) -> None:
    """Track a film or recording and store it as an experiment."""
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
    print_answer(as_json, answer.summary, lambda: _lines(answer, folder))


def _lines(answer: "TrackAnswer", folder: Path) -> list[str]:
    experiment, tracked, motion = answer.experiment, answer.tracked, answer.motion
    seconds = tracked.time[-1] - tracked.time[0]
    lines = [
        f"{answer.film.path}: {len(tracked.time)} frames, {seconds:.2f} s, rig {answer.rig.name}",
        *_parts(answer),
    ]
    if motion is not None and motion.moved:
        assert experiment.effective is not None
        first, last = experiment.effective
        lines.append(
            f"actuator: {motion.cruise * 1e3:.4g} mm/s over {motion.travel * 1e3:.4g} mm; usable "
            f"from {first:.2f} to {last:.2f} s"
        )
    if tracked.fixels:
        lines.append(f"fixels measured: {', '.join(f.name for f in tracked.fixels)}")
    if experiment.contact_mode:
        lines.append(f"contact mode at the end: {experiment.contact_mode}")
    lines += [f"  {flag.name}: {flag.detail}" for flag in experiment.flags[:MAX_FLAGS]]
    if experiment.simulated_by:
        lines.append("SIMULATED: these are not pictures of a real camera")
    lines += wrote(answer.files.values())
    if answer.number is None:
        lines.append("Nothing was stored; without --dry-run, the experiment is stored.")
        return [*lines, f"Next: {command_line(without='--dry-run')}"]
    verb = "stored as" if answer.new else "already stored as"
    lines.append(f"{verb} experiment {answer.number}, {experiment.key}")
    return [*lines, f"Next: {command_of('show', experiment.key, project=folder)}"]


def _parts(answer: "TrackAnswer") -> list[str]:
    n = len(answer.tracked.time)
    rows = [
        (
            *(name, part["frames"], n - part["frames"], part["outliers"]),
            *(part["residual_px"], part["residual_m"] * 1e6),
        )
        for name, part in answer.summary()["parts"].items()
    ]
    head = ("part", "poses", "missing", "outliers")
    residuals = (Column("residual", "px", ".3f"), Column("[um]", format=".2f"))
    return Table((*head, *residuals), rows).lines()
