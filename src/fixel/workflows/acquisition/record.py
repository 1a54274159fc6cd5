"""Record an experiment from a camera and the fixels into one folder."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from fixel.errors import InvalidInput
from fixel.formats.recording import RIG_FILE, SCENE_FILE
from fixel.formats.recording_video import warm_up
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import load_scene
from fixel.testbed.file_source import FILM, PlayedTactile
from fixel.testbed.frame_source import Stream
from fixel.testbed.open_source import check_size, source_of
from fixel.testbed.recorder import Recorder, RecordingSummary, Seating, Stop, TouchReader, Watch
from fixel.testbed.tactile import TactileReader
from fixel.vision.marks import Rig
from fixel.workflows.acquisition import RecordPlan


def record(
    plan: RecordPlan, *, stop: Stop | None = None, watch: Watch | None = None
) -> RecordingSummary:
    """Record an experiment.

    `stop` is called often, and returns a reason in words if the recording shall end. `watch` is
    called with pictures and status. Before the recording starts, `InvalidInput` is raised for no
    camera, fixels or space, a wrong picture size, and an existing folder.
    """
    rig = None if plan.rig is None else rig_of(plan.rig)
    scene = None
    if plan.scene is not None:
        load_scene(plan.scene)  # raises if it cannot be loaded
        scene = plan.scene.read_bytes()
    seating = _seating(plan, rig) if plan.until == "seated" else None
    size = plan.size if rig is None else rig.camera.lens.image_size

    def prepare(folder: Path) -> None:
        if rig is not None:
            save_rig(rig, folder / RIG_FILE)
        if scene is not None:
            (folder / SCENE_FILE).write_bytes(scene)

    warm_up()
    source = source_of(plan.camera, size=size, rate=plan.rate, as_fast_as_possible=plan.fast)
    # Open the camera last: pictures that wait in a buffer get the time at which they are taken out.
    with _tactile(plan) as tactile, source:
        stream = source.open()
        if size is not None:
            check_size(stream, size, source.name)
        return Recorder(
            source=source,
            stream=stream,
            folder=plan.folder,
            codec=codec_for(plan.codec, stream),
            tactile=tactile,
            rig="" if rig is None else rig.name,
            limit=plan.limit,
            seating=seating,
            stop=stop,
            watch=watch,
            prepare=prepare,
        ).run()


def codec_for(choice: str, stream: Stream) -> str:
    """Return the chosen codec; for `auto`, the one that suits the camera.

    Raise `InvalidInput` for `as-it-comes` with a camera that sends no JPEG.
    """
    if choice == "as-it-comes" and not stream.jpeg:
        expected = "near or exact, since this source does not send JPEG"
        raise InvalidInput("codec", found=repr(choice), expected=expected)
    if choice != "auto":
        return choice
    return "as-it-comes" if stream.jpeg else "near"


def _seating(plan: RecordPlan, rig: Rig | None) -> Seating:
    """Return the seating condition; digits in order of the fixels' names become a tactile byte."""
    if plan.mode is None:
        return Seating()
    n = 3 if rig is None else len(rig.tactile)
    if len(plan.mode) != n or set(plan.mode) - {"0", "1"}:
        expected = f"a digit 0 or 1 for each of {n} fixels"
        raise InvalidInput("mode", found=plan.mode, expected=expected)
    if rig is None:
        return Seating(int(plan.mode, 2))  # the thesis: the byte is the mode
    digits = dict(zip(sorted(rig.tactile), plan.mode, strict=True))
    return Seating(sum(int(digits[name]) << bit for bit, name in enumerate(rig.tactile)))


def _tactile(plan: RecordPlan) -> AbstractContextManager[TouchReader | None]:
    """Return what opens the reader of the fixels; None without a tactile port."""
    if plan.tactile is None:
        return nullcontext()
    kind, _, film = plan.tactile.partition(":")
    if kind == FILM:
        return nullcontext(PlayedTactile(film or plan.camera, in_turn=plan.fast))
    return connected_tactile(TactileReader(plan.tactile))


def connected_tactile(board: TactileReader) -> TactileReader:
    """Connect a tactile board; its port is not the option `--port` that an error would name."""
    try:
        return board.connect()
    except InvalidInput as problem:
        raise problem.at(f"tactile {board.port}") from None
