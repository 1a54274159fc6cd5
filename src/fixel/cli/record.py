"""`fixel record` and `fixel track`: record an experiment, check recordings, and track films."""

import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import CAMERA, AsJson, ProjectFolder, option, required, with_options
from fixel.cli.screen import command_line, command_of, notify, print_answer, wrote
from fixel.errors import InvalidInput, counted
from fixel.progress import show_progress
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.formats.recording import Recording
    from fixel.testbed.frame_source import CameraPicture
    from fixel.testbed.recorder import RecordingStatus, RecordingSummary
    from fixel.web.live_pages import RecordPreview
    from fixel.workflows.acquisition.record import RecordPlan
    from fixel.workflows.acquisition.track import TrackAnswer

UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}

app = typer.Typer(
    help="Record frames, each with a reading of the contact sensors.",
    invoke_without_command=True,
    no_args_is_help=True,
    rich_markup_mode=None,
)

Folder = Annotated[
    Path, typer.Argument(help="Folder of the recording.", metavar="FOLDER", exists=True)
]


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """Options of `fixel record`."""

    camera: Annotated[str | None, CAMERA] = None
    out: Path | None = option(None, "New folder for the recording.", metavar="FOLDER")
    tactile: str | None = option(
        None,
        "Serial port of the tactile board; 'film' for the readings of a played recording.",
        metavar="PORT",
        show_default="none",
    )
    rig: str | None = option(
        None, "Rig, by name or file; the pictures must have the size of its camera.", metavar="RIG"
    )
    scene: Path | None = option(
        None,
        "Scene file of the experiment, stored with the recording.",
        metavar="FILE",
        exists=True,
        dir_okay=False,
    )
    size: str | None = option(
        None, "Picture size to request from the camera; without --rig only.", metavar="WIDTHxHEIGHT"
    )
    rate: float = option(30.0, "Frame rate to request from the camera [frames/s].", min=1.0)
    codec: str = option(
        "auto",
        "Codec. as-it-comes: JPEG of the camera, bit for bit; near: JPEG of high quality; exact: "
        "lossless, 5 times the size of near; auto: as-it-comes if the camera sends JPEG, "
        "else near.",
        metavar="NAME",
    )
    until: str = option(
        "key",
        "End of the recording. key: Enter or Ctrl-C; limit: after --limit; seated: contact mode "
        "of --mode, or at rest.",
        metavar="WHEN",
    )
    mode: str | None = option(
        None,
        "Contact mode that counts as seated, one digit per fixel 1, 2, 3, such as 010.",
        metavar="DIGITS",
    )
    limit: str | None = option(None, "Longest duration, such as 15s or 10min.", metavar="DURATION")
    preview: bool = option(False, "Show the recording live in the browser.", "--preview")
    fast: bool = option(
        False,
        "Play a file as fast as it can be read; time stamps stay those of the file.",
        "--fast",
    )

    @property
    def plan(self) -> "RecordPlan":
        """Plan of the recording."""
        from fixel.vision.frame import size_of
        from fixel.workflows.acquisition.record import RecordPlan

        if self.camera is None or self.out is None:
            missing = "--camera" if self.camera is None else "--out"
            raise InvalidInput(
                missing, found=None, expected="both: fixel record --camera SOURCE --out FOLDER"
            )
        same = ("camera", "tactile", "rig", "scene", "rate", "codec", "until", "mode", "fast")
        return RecordPlan(
            folder=self.out,
            size=size_of(self.size),
            limit=None if self.limit is None else duration(self.limit),
            **{name: getattr(self, name) for name in same},
        )


@app.callback()
@with_options
def record(*, context: typer.Context, options: RecordOptions, as_json: AsJson = False) -> None:
    """Record frames, each with a reading of the contact sensors."""
    if context.invoked_subcommand is not None:
        return
    from fixel.workflows.acquisition.record import record as record_experiment
    from fixel.workflows.acquisition.record import summary

    plan = options.plan
    with stop_on_request() as wish, _shown(plan, options.preview, wish) as watch:
        done = record_experiment(plan, stop=wish, watch=watch)
    print_answer(as_json, lambda: summary(done), lambda: _lines(done))
    if done.early:
        raise typer.Exit(1)


@app.command()
def check(folder: Folder, as_json: AsJson = False) -> None:
    """Check every frame of a recording, and report missing ones."""
    _check(folder, as_json, repair=False)


@app.command()
def repair(folder: Folder, as_json: AsJson = False) -> None:
    """Remove incomplete last frames of an interrupted recording.

    The recording is then marked as ended.
    """
    _check(folder, as_json, repair=True)


def duration(text: str) -> float:
    """Parse a duration such as `15s`, `10min`, `1.5 h` or `15` to seconds."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(s|min|h|)\s*", text)
    if match is None:
        raise InvalidInput("--limit", found=repr(text), expected="a duration: 15s, 10min, 1h")
    return float(match[1]) * UNITS[match[2]]


@contextmanager
def _shown(plan: "RecordPlan", preview: bool, wish: "StopWish") -> Iterator[Any]:
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
                    wish.reason = wish.reason or "stopped in the browser"
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
    """Return what to do with a whole recording, which cannot be tracked without a rig."""
    from fixel.formats.recording import RIG_FILE

    track = f"Next: {command_of('track', folder)}"
    return track if (folder / RIG_FILE).is_file() else f"{track} --rig RIG, with your rig for RIG"


def _check(folder: Path, as_json: bool, *, repair: bool) -> None:
    from fixel.formats.recording import open_recording, repair_recording
    from fixel.workflows.acquisition.record import check_summary

    recording = (repair_recording if repair else open_recording)(folder)
    print_answer(as_json, lambda: check_summary(recording), lambda: _check_lines(recording))


def _check_lines(recording: "Recording") -> list[str]:
    width, height = recording.header.size
    readings = int((recording.readings >= 0).sum())
    lines = [
        f"{recording.folder}: {recording.n_frames} frames in "
        f"{recording.time[-1] - recording.time[0]:.3f} s, {readings} readings, "
        f"{width} x {height} pixels, {recording.header.codec}",
        "every frame matches its row",
    ]
    if recording.end is not None:
        lines.append(f"ended: {recording.end.reason}")
    lines += [f"problem: {problem}" for problem in recording.problems]
    if recording.complete:
        return [*lines, _after(recording.folder)]
    return [*lines, f"Next: {command_of('record', 'repair', recording.folder)}"]


class StopWish:
    """Request to stop, with its reason."""

    reason = ""

    def __call__(self) -> str:
        """Return the reason to stop; empty while there is none."""
        return self.reason


@contextmanager
def stop_on_request() -> Iterator[StopWish]:
    """Collect requests to stop: Enter, Ctrl-C, SIGTERM; a second Ctrl-C interrupts at once."""
    wish = StopWish()

    def request(number: int, frame: FrameType | None) -> None:
        wish.reason = "stopped with Ctrl-C" if number == signal.SIGINT else "stopped by a signal"
        signal.signal(number, signal.default_int_handler)

    kept: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        kept = {n: signal.signal(n, request) for n in (signal.SIGINT, signal.SIGTERM)}
    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=_wait_for_enter, args=(wish,), daemon=True).start()
    try:
        yield wish
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _wait_for_enter(wish: StopWish) -> None:
    if sys.stdin.readline():
        wish.reason = wish.reason or "stopped with Enter"


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

    with show_progress(stage="tracking") as report:
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
            progress=report,
        )
    print_answer(as_json, answer.summary, lambda: _track_lines(answer, folder))


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
