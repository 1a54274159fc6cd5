"""`fixel record` and `fixel track`: record an experiment, check recordings, and track films."""

import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.capability.options import Door
from fixel.cli.capability import command, subcommand
from fixel.cli.screen import CommandAnswer, FilmPath, command_line, command_of, notify, wrote
from fixel.errors import InvalidInput, counted
from fixel.progress import show_progress
from fixel.table import Column, Table
from fixel.workflows.acquisition import RecordPlan

if TYPE_CHECKING:
    from fixel.formats.recording import Recording
    from fixel.testbed.frame_source import CameraPicture
    from fixel.testbed.recorder import RecordingStatus, RecordingSummary
    from fixel.web.live_pages import RecordPreview
    from fixel.workflows.acquisition.track import TrackAnswer

UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}

app = typer.Typer(
    help="Record frames, each with a reading of the contact sensors.",
    invoke_without_command=True,
    no_args_is_help=True,
    rich_markup_mode=None,
)

Folder = Annotated[Path, Door(metavar="FOLDER", meaning="Folder of the recording.")]


@app.callback()
@partial(command, of=RecordPlan)
def record(
    *, preview: Annotated[bool, Door(flag="--preview")] = False, **options: Any
) -> CommandAnswer:
    """Record frames, each with a reading of the contact sensors.

    Parameters
    ----------
    preview : bool
        Show the recording live in the browser.
    """
    from fixel.vision.frame import size_of
    from fixel.workflows.acquisition.record import record as record_experiment

    options["size"], options["limit"] = size_of(options["size"]), duration(options["limit"])
    plan = RecordPlan(**options)
    with stop_on_request() as reasons, _shown(plan, preview, reasons) as watch:
        done = record_experiment(plan, stop=lambda: next(iter(reasons), ""), watch=watch)
    content = done._asdict()
    content["duration_s"], content["rate_per_s"] = content.pop("seconds"), done.rate
    return CommandAnswer(content, _lines(done), code=1 if done.early else 0)


@subcommand(app, "check")
def check(folder: Folder) -> CommandAnswer:
    """Check every frame of a recording, and report missing ones."""
    from fixel.formats.recording import open_recording

    return _checked(open_recording(folder))


@subcommand(app, "repair")
def repair(folder: Folder) -> CommandAnswer:
    """Remove incomplete last frames of an interrupted recording.

    The recording is then marked as ended.
    """
    from fixel.formats.recording import repair_recording

    return _checked(repair_recording(folder))


def duration(text: str | None) -> float | None:
    """Parse a duration such as `15s`, `10min`, `1.5 h` or `15` to seconds."""
    if text is None:
        return None
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(s|min|h|)\s*", text)
    if match is None:
        raise InvalidInput("limit", found=repr(text), expected="a duration: 15s, 10min, 1h")
    return float(match[1]) * UNITS[match[2]]


@contextmanager
def _shown(plan: "RecordPlan", preview: bool, reasons: list[str]) -> Iterator[Any]:
    """Yield a callback that shows a running recording: on the terminal, and in the browser."""
    terminal, length = sys.stderr.isatty(), 0
    with ExitStack() as stack:
        page: RecordPreview | None = None
        if preview:
            from fixel.web.live_pages import RecordPreview as Preview
            from fixel.web.serve import WebServer

            page = Preview(str(plan.folder))
            notify(f"preview: {stack.enter_context(WebServer([page.page()])).link}")

        def watch(arrived: "CameraPicture", status: "RecordingStatus") -> None:
            nonlocal length
            if terminal:  # a line that is overwritten again and again
                text = status_line(status)
                print("\r" + text.ljust(length), end="", file=sys.stderr, flush=True)
                length = len(text)
            if page is not None:
                if page.stop_wanted:
                    reasons.append("stopped in the browser")
                page.show(arrived.picture, status, plan.limit)

        try:
            yield watch
        finally:
            if length:
                print(file=sys.stderr, flush=True)


def status_line(status: "RecordingStatus") -> str:
    """Format the state of a running recording as one line."""
    fixels = "" if status.bits is None else f"  fixels {status.bits:03b}"
    return (
        f"{status.seconds:7.1f} s  {status.frames} frames  {status.lost} lost "
        f" {status.rate:.1f} frames/s{fixels}  {status.free / 1e9:.1f} GB free"
    )


def _lines(done: "RecordingSummary") -> list[str]:
    lines = [
        f"recorded {done.folder}: {counted(done.frames, 'frame')} in {done.seconds:.3f} s, "
        f"{done.rate:.2f} frames/s, {done.lost} lost, {done.bytes / 1e6:.1f} MB",
        f"ended{' early' if done.early else ''}: {done.reason}",
    ]
    if done.without_reading:
        lines.append(f"frames without a sensor reading: {done.without_reading}")
    lines += [f"problem: {problem}" for problem in done.problems]
    return [*lines, _after(done.folder)]


def _after(folder: Path) -> str:
    """Return what to do with a whole recording, which cannot be tracked without rig and scene."""
    from fixel.formats.recording import RIG_FILE, SCENE_FILE

    files = {"RIG": RIG_FILE, "SCENE": SCENE_FILE}
    missing = [name for name, file in files.items() if not (folder / file).is_file()]
    options = "".join(f" --{name.lower()} {name}" for name in missing)
    yours = f", with your own files for {' and '.join(missing)}" if missing else ""
    return f"Next: {command_of('track', folder)}{options}{yours}"


def _checked(recording: "Recording") -> CommandAnswer:
    header, end = recording.header, recording.end
    content = {
        "folder": str(recording.folder),
        "complete": recording.complete,
        "frames": recording.n_frames,
        "duration_s": float(recording.time[-1] - recording.time[0]),
        "readings": int((recording.readings >= 0).sum()),
        "size_px": list(header.size),
        "codec": header.codec,
        "rig": header.rig,
        "source": header.source,
        "started": header.started,
        "reason": "" if end is None else end.reason,
        "problems": list(recording.problems),
    }
    width, height = header.size
    lines = [
        f"{recording.folder}: {recording.n_frames} frames in {content['duration_s']:.3f} s, "
        f"{content['readings']} readings, {width} x {height} pixels, {header.codec}",
        "every frame matches its row",
    ]
    if end is not None:
        lines.append(f"ended: {end.reason}")
    lines += [f"problem: {problem}" for problem in recording.problems]
    repair = f"Next: {command_of('record', 'repair', recording.folder)}"
    lines.append(_after(recording.folder) if recording.complete else repair)
    return CommandAnswer(content, lines)


@contextmanager
def stop_on_request() -> Iterator[list[str]]:
    """Collect reasons to stop: Enter, Ctrl-C, SIGTERM; a second Ctrl-C interrupts at once."""
    reasons: list[str] = []

    def request(number: int, frame: FrameType | None) -> None:
        by = "with Ctrl-C" if number == signal.SIGINT else "by a signal"
        reasons.append(f"stopped {by}")
        signal.signal(number, signal.default_int_handler)

    kept: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        kept = {n: signal.signal(n, request) for n in (signal.SIGINT, signal.SIGTERM)}
    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=_wait_for_enter, args=(reasons,), daemon=True).start()
    try:
        yield reasons
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _wait_for_enter(reasons: list[str]) -> None:
    if sys.stdin.readline():
        reasons.append("stopped with Enter")


MAX_FLAGS = 8


@command
def track(
    project: Path,
    source: FilmPath,
    *,
    rig: Annotated[str, Door(metavar="RIG", usual="rig.yaml next to the film")] = "",
    scene: Annotated[Path | None, Door(usual="scene.yaml next to the film")] = None,
    method: Annotated[str, Door(metavar="METHOD")] = "auto",
    dataset: Annotated[str, Door(metavar="NAME")] = "bench",
    name: Annotated[str, Door(metavar="NAME", usual="the film's")] = "",
    place_camera: Annotated[bool, Door(flag="--register")] = False,  # pydantic has a `register`
    dry_run: Annotated[bool, Door(flag="--dry-run")] = False,
    overlay: Path | None = None,
    sheet: Path | None = None,
    plot: Path | None = None,
) -> CommandAnswer:
    """Track a film or recording and store it as an experiment.

    Parameters
    ----------
    rig : str
        Rig file or name of an example rig: thesis-tags, thesis-stickers, microscope.
    scene : Path, optional
        Scene file of the planned experiment.
    method : str
        Tracking method: auto, tags, stickers or silhouette.
    dataset : str
        Dataset of the experiment.
    name : str
        Name of the experiment.
    place_camera : bool
        Estimate the camera pose again from the tags on the plate.
    dry_run : bool
        Track only; store nothing.
    overlay : Path, optional
        Write the film with the measured outlines: .mp4 or .mkv.
    sheet : Path, optional
        Write a picture of a few frames with the measured outlines: .png.
    plot : Path, optional
        Draw poses, residuals and gaps: .png, .svg or .pdf.
    """
    from fixel.workflows.acquisition.track import track_film

    options: Any = {"dataset": dataset, "name": name, "overlay": overlay, "sheet": sheet}
    options |= {"rig": rig, "scene": scene, "method": method, "plot": plot}
    place = None if dry_run else project
    with show_progress(stage="tracking") as report:
        answer = track_film(
            source, **options, register=place_camera, project=place, progress=report
        )
    return CommandAnswer(answer.summary(), _track_lines(answer, project))


def _track_lines(answer: "TrackAnswer", folder: Path) -> list[str]:
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
