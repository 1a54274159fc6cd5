"""`fixel record`: record an experiment; check and repair recordings; serve one as a camera."""

import json
import re
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import AsJson
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.formats.recording import Recording
    from fixel.testbed.frame_source import CameraPicture
    from fixel.testbed.recorder import RecordingStatus, RecordingSummary

UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}

app = typer.Typer(
    help="Record an experiment: frames, and for each what the fixels feel.",
    invoke_without_command=True,
    no_args_is_help=True,
    rich_markup_mode=None,
)

Folder = Annotated[
    Path, typer.Argument(help="Folder of the recording.", metavar="FOLDER", exists=True)
]


@app.callback()
def record(
    context: typer.Context,
    camera: Annotated[
        str | None,
        typer.Option(
            help="0 or /dev/video0, http://... of a network camera, a video or a recording.",
            metavar="SOURCE",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to make for the recording.", metavar="FOLDER")
    ] = None,
    tactile: Annotated[
        str | None,
        typer.Option(
            help="Serial port of the tactile board; 'film' for the readings of a played recording.",
            metavar="PORT",
            show_default="none",
        ),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(help="Rig, by name or file; its camera's size is required.", metavar="RIG"),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(
            help="Scene file of what lies on the plate, kept with the recording.",
            metavar="FILE",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(help="Asked of the camera, without --rig.", metavar="WIDTHxHEIGHT"),
    ] = None,
    rate: Annotated[float, typer.Option(help="Asked of the camera [frames/s].", min=1.0)] = 30.0,
    codec: Annotated[
        str,
        typer.Option(
            help="as-it-comes: JPEG of the camera, bit by bit; near: JPEG of high quality; exact:"
            " no loss, 7 times the space; auto: as it comes, or near.",
            metavar="NAME",
        ),
    ] = "auto",
    until: Annotated[
        str,
        typer.Option(
            help="key: until Enter or Ctrl-C; limit; seated: as --mode says, or at rest.",
            metavar="WHEN",
        ),
    ] = "key",
    mode: Annotated[
        str | None,
        typer.Option(help="Fixels 1, 2, 3 that mean seated, such as 010.", metavar="DIGITS"),
    ] = None,
    limit: Annotated[
        str | None, typer.Option(help="The longest it may take: 15s, 10min.", metavar="DURATION")
    ] = None,
    preview: Annotated[bool, typer.Option("--preview", help="Show it in the browser.")] = False,
    fast: Annotated[
        bool, typer.Option("--fast", help="Play a file as fast as it is read, at its own times.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Record an experiment: frames, and for each what the fixels feel."""
    if context.invoked_subcommand is not None:
        return
    from fixel.cli.stopping import stop_on_request
    from fixel.workflows.acquisition.record import RecordPlan, summary
    from fixel.workflows.acquisition.record import record as record_experiment

    if camera is None or out is None:
        missing = "--camera" if camera is None else "--out"
        raise InvalidInput(
            missing, found=None, expected="fixel record --camera SOURCE --out FOLDER"
        )
    plan = RecordPlan(
        camera=camera,
        folder=out,
        tactile=tactile,
        rig=rig,
        scene=scene,
        size=None if size is None else _size(size),
        rate=rate,
        codec=codec,
        until=until,
        mode=mode,
        limit=None if limit is None else duration(limit),
        fast=fast,
    )
    with stop_on_request() as wish, _shown(plan.limit, out, preview, wish) as watch:
        done = record_experiment(plan, stop=wish, watch=watch)
    typer.echo(json.dumps(summary(done), allow_nan=False) if as_json else _written(done))
    if done.early:
        raise typer.Exit(1)


@app.command()
def check(folder: Folder, as_json: AsJson = False) -> None:
    """Check every frame of a recording against its row, and report what is missing."""
    _checked(folder, as_json, repair=False)


@app.command()
def repair(folder: Folder, as_json: AsJson = False) -> None:
    """Cut off what is torn at the end of a recording that broke off, and mark it as ended."""
    _checked(folder, as_json, repair=True)


def serve(
    film: Annotated[
        Path,
        typer.Argument(help="A video, or the folder of a recording.", metavar="FILM", exists=True),
    ],
    port: Annotated[int, typer.Option(help="0 for any that is free.", min=0, max=65535)] = 0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin anew at its end.")] = False,
    as_json: AsJson = False,
) -> None:
    """Serve a film on this machine as a network camera would, until Ctrl-C."""
    from fixel.testbed.loopback import LoopbackCamera

    with LoopbackCamera(film, port=port, loop=loop) as camera:
        if as_json:
            typer.echo(json.dumps({"url": camera.url, "size_px": list(camera.stream.size)}))
        else:
            width, height = camera.stream.size
            typer.echo(f"serving {film}, {width} x {height} pixels, at {camera.url}")
            words = ["fixel", "record", "--camera", camera.url, "--out", "recording"]
            typer.echo(f"Next: {shlex.join(words)}")
        camera.wait()


def duration(text: str) -> float:
    """Parse a duration such as `15s`, `10min`, `1.5 h` or `15` to seconds."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(s|min|h|)\s*", text)
    if match is None:
        raise InvalidInput("--limit", found=repr(text), expected="a duration: 15s, 10min, 1h")
    return float(match[1]) * UNITS[match[2]]


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9][0-9]*)[xX×]([1-9][0-9]*)", text.strip())
    if match is None:
        raise InvalidInput("--size", found=repr(text), expected="WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])


@contextmanager
def _shown(limit: float | None, out: Path, preview: bool, wish: Any) -> Iterator[Any]:
    """Yield a callback that shows a running recording: on the terminal, and in the browser."""
    line = _StatusLine() if sys.stderr.isatty() else None
    with _browser(limit, out, preview, wish) as page:

        def watch(arrived: "CameraPicture", status: "RecordingStatus") -> None:
            if line is not None:
                line.show(status)
            if page is not None:
                page(arrived, status)

        try:
            yield watch
        finally:
            if line is not None:
                line.end()


@contextmanager
def _browser(limit: float | None, out: Path, preview: bool, wish: Any) -> Iterator[Any]:
    if not preview:
        yield None
        return
    from fixel.cli.screen import notify
    from fixel.web.record_page import RecordPreview
    from fixel.web.serve import WebServer

    shown = RecordPreview(str(out))

    def page(arrived: "CameraPicture", status: "RecordingStatus") -> None:
        if shown.stop_wanted:
            wish.reason = wish.reason or "stopped in the browser"
        shown.show(
            arrived.picture,
            shown.status(
                elapsed_s=status.seconds,
                frames=status.frames,
                lost=status.lost,
                reading=-1 if status.bits is None else status.bits,
                disk_free_bytes=float(status.free),
                limit_s=limit,
                problems=status.problems,
            ),
        )

    with WebServer([shown.page()]) as server:
        notify(f"preview: {server.link}")
        yield page


class _StatusLine:
    """Line on standard error that is overwritten again and again."""

    def __init__(self) -> None:
        self._length = 0

    def show(self, status: "RecordingStatus") -> None:
        fixels = "" if status.bits is None else f"  fixels {status.bits:03b}"
        text = (
            f"{status.seconds:7.1f} s  {status.frames} frames  {status.lost} lost "
            f" {status.rate:.1f} frames/s{fixels}  {status.free / 1e9:.1f} GB free"
        )
        print("\r" + text.ljust(self._length), end="", file=sys.stderr, flush=True)
        self._length = len(text)

    def end(self) -> None:
        if self._length:
            print(file=sys.stderr, flush=True)


def _written(done: "RecordingSummary") -> str:
    """Return a text about the recording."""
    frames = "frame" if done.frames == 1 else "frames"
    lines = [
        f"recorded {done.folder}: {done.frames} {frames} in {done.seconds:.3f} s, "
        f"{done.rate:.2f} frames/s, {done.lost} lost, {done.bytes / 1e6:.1f} MB",
        f"ended{' early' if done.early else ''}: {done.reason}",
    ]
    if done.without_reading:
        lines.append(f"without a reading of the fixels: {done.without_reading}")
    lines += [f"problem: {problem}" for problem in done.problems]
    return "\n".join([*lines, f"Next: fixel track {shlex.quote(str(done.folder))}"])


def _checked(folder: Path, as_json: bool, *, repair: bool) -> None:
    from fixel.workflows.acquisition.record import check, check_summary

    recording = check(folder, repair=repair)
    if as_json:
        typer.echo(json.dumps(check_summary(recording), allow_nan=False))
    else:
        typer.echo(_found(recording))


def _found(recording: "Recording") -> str:
    width, height = recording.header.size
    readings = int((recording.readings >= 0).sum())
    lines = [
        f"{recording.folder}: {recording.n_frames} frames in "
        f"{recording.time[-1] - recording.time[0]:.3f} s, {readings} readings, "
        f"{width} x {height} pixels, {recording.header.codec}",
        "every frame belongs to its row",
    ]
    if recording.end is not None:
        lines.append(f"ended: {recording.end.reason}")
    lines += [f"problem: {problem}" for problem in recording.problems]
    folder = shlex.quote(str(recording.folder))
    verb = "track" if recording.complete else "record repair"
    return "\n".join([*lines, f"Next: fixel {verb} {folder}"])
