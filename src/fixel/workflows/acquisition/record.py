"""Record an experiment from a camera and the fixels into one folder."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from fixel.errors import InvalidInput, unknown_name
from fixel.formats.recording import CODECS, RIG_FILE, SCENE_FILE, Recording, is_recording
from fixel.formats.recording_video import warm_up
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import load_scene
from fixel.testbed.file_source import FILM, PlayedTactile
from fixel.testbed.frame_source import Stream
from fixel.testbed.open_source import check_size, source_of
from fixel.testbed.recorder import Recorder, RecordingSummary, Seating, Stop, TouchReader, Watch
from fixel.vision.marks import Rig

ENDS: Final = ("key", "limit", "seated")
CHOICES: Final = ("auto", *CODECS)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RecordPlan:
    """Source, destination and end of a recording."""

    camera: str  # see `source_of`
    folder: Path  # folder to create
    # Port of the tactile board; `film`, or `film:FOLDER`, for the readings of a recording.
    tactile: str | None = None
    rig: str | None = None  # name or file of a rig; pictures must have the size of its camera
    scene: Path | None = None  # scene file of what lies on the plate; copied into the recording
    # Picture size requested from the camera if there is no rig [px].
    size: tuple[int, int] | None = None
    rate: float = 30.0  # frame rate requested from the camera [frames/s]
    codec: str = "auto"  # one of `CHOICES`; `auto` stores JPEG unchanged and pixels as `near`
    until: str = "key"  # one of `ENDS`; a key ends the recording in any case
    mode: str | None = None  # digits of fixels 1, 2, 3 that count as seated: `"010"`
    limit: float | None = None  # maximum duration [s]
    fast: bool = False  # whether a file is played as fast as it can be read

    def __post_init__(self) -> None:
        for option, value, known in ("--codec", self.codec, CHOICES), ("--until", self.until, ENDS):
            if value not in known:
                raise unknown_name(option, value, known)
        if self.until == "limit" and self.limit is None:
            raise InvalidInput("--limit", found=None, expected="a duration such as 15s")
        if self.limit is not None and not (math.isfinite(self.limit) and self.limit > 0.0):
            raise InvalidInput("--limit", found=f"{self.limit} s", expected="more than 0 s")
        if self.mode is not None and (self.until != "seated" or self.tactile is None):
            expected = "used with --until seated and --tactile"
            raise InvalidInput("--mode", found=repr(self.mode), expected=expected)
        if self.folder.exists():
            what = "a recording" if is_recording(self.folder) else "an existing file or folder"
            raise InvalidInput(str(self.folder), found=what, expected="a new folder")


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
        raise InvalidInput(
            "--codec",
            found=repr(choice),
            expected="near or exact, since this source does not send JPEG",
        )
    if choice != "auto":
        return choice
    return "as-it-comes" if stream.jpeg else "near"


def summary(done: RecordingSummary) -> dict[str, Any]:
    """Return the summary of a recording as plain values."""
    known = done._asdict() | {"folder": str(done.folder), "problems": list(done.problems)}
    known["duration_s"], known["rate_per_s"] = known.pop("seconds"), done.rate
    return known


def check_summary(recording: Recording) -> dict[str, Any]:
    """Return the findings about a recording as plain values."""
    header, end = recording.header, recording.end
    return {
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


def _seating(plan: RecordPlan, rig: Rig | None) -> Seating:
    """Return the seating condition; digits in order of the fixels' names become a tactile byte."""
    if plan.mode is None:
        return Seating()
    n = 3 if rig is None else len(rig.tactile)
    if len(plan.mode) != n or set(plan.mode) - {"0", "1"}:
        raise InvalidInput(
            "--mode", found=plan.mode, expected=f"a digit 0 or 1 for each of {n} fixels"
        )
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
    from fixel.testbed.tactile import TactileReader

    return TactileReader(plan.tactile)
