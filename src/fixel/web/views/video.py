"""Videos of experiments for browsers: a format that they play, and outlines of the part."""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
from pydantic import Field

from fixel.database.project import Project
from fixel.drawing.view import evenly
from fixel.errors import FixelError
from fixel.formats.rig_file import EXAMPLES, load_rig, rig_of
from fixel.formats.video_file import VideoWriter, open_video
from fixel.model import Experiment
from fixel.vision.frame import Frame, opencv
from fixel.vision.marks import Rig
from fixel.vision.outlines import outline_pixels
from fixel.web.values import Answer, Array, ShortArray
from fixel.workflows.acquisition.tracked_experiment import CAMERA

CACHE: Final = "cache"  # folder of a project for files that can be made again
WIDEST: Final = 1280  # [px] largest width of a converted video
PLAYED: Final = ("h264", "vp8", "vp9", "av1")  # codecs
_one_at_a_time: Final = Lock()
RIGS: Final = "rigs"  # folder of a project for the rig files of its benches
MAX_OUTLINES: Final = 600  # outlines; in between the part is drawn at the nearest


def browser_video(project: Project, video: Path) -> tuple[Path, str]:
    """Return a file that a browser plays, and its media type: the video, or a smaller copy.

    The copy is in the project's cache, and has the times of the video. Writing it takes about as
    long as the video lasts. A file that is no video raises `InvalidInput`.
    """
    with video.open("rb") as stream:
        container = _container(stream.read(16))
    if container is not None and open_video(video).codec in PLAYED:
        return video, container
    copy = project.folder / CACHE / f"video-{video.stem[:32]}.mp4"
    if not copy.is_file():  # checked first: a finished copy need not wait for others being written
        with _one_at_a_time:
            if not copy.is_file():
                _write(video, copy)
    return copy, "video/mp4"


def _container(start: bytes) -> str | None:
    """Media type of a file that begins like this; None if a browser would not play it.

    Examples
    --------
    >>> _container(b"\\x00\\x00\\x00\\x20ftypisom")
    'video/mp4'
    """
    if start[4:8] == b"ftyp":
        return "video/mp4"
    return "video/webm" if start[:4] == b"\x1aE\xdf\xa3" else None  # Matroska, as it calls itself


def _write(video: Path, copy: Path) -> None:
    cv2 = opencv()
    source = open_video(video)
    width, height = source.size
    scale = min(1.0, WIDEST / width)
    size = (int(scale * width) // 2 * 2, int(scale * height) // 2 * 2)
    copy.parent.mkdir(exist_ok=True)
    with VideoWriter(copy, size) as writer:
        for frame in source.frames():
            smaller = cv2.resize(frame.picture, size, interpolation=cv2.INTER_AREA)
            writer.write(Frame(frame.time, smaller))


class VideoOutlines(Answer):
    """Outlines of the object in pictures of this size."""

    size: tuple[int, int] = Field(
        serialization_alias="size_px", description="width and height of the video"
    )
    time: Array = Field(
        serialization_alias="time_s", description="(n,) time on the clock of the video"
    )
    outline: ShortArray = Field(
        serialization_alias="outline_px",
        description="(n, m, 2) closed outlines; the centre of the first pixel is 0",
    )


def rig_named(project: Project, name: str) -> Rig | None:
    """Load the rig of a name from the project's `rigs` folder or the examples; None if unknown."""
    for path in sorted((project.folder / RIGS).glob("*.yaml")):
        try:
            rig = load_rig(path)
        except FixelError:
            continue  # another bench's file may be broken; this one may still be found
        if rig.name == name:
            return rig
    return next((rig for rig in map(rig_of, EXAMPLES) if rig.name == name), None)


def outlines_in_video(project: Project, experiment: Experiment) -> VideoOutlines | None:
    """Return outlines of the measured object in its video; None without rig, scene or height, or
    if the camera was not where the rig places it."""
    rig = rig_named(project, str(experiment.conditions.get("rig", "")))
    scene, part = experiment.scene, None if rig is None else rig.parts.get(experiment.object_name)
    height = experiment.height or (None if part is None else part.height)
    if rig is None or scene is None or height is None or CAMERA in experiment.conditions:
        return None
    shape = next(b.shape for b in scene.bodies if b.name == experiment.object_name)
    track = experiment.trajectory
    chosen = evenly(len(track.time), MAX_OUTLINES)
    lines = [outline_pixels(rig.camera, shape, pose, height) for pose in track.pose[chosen]]
    return VideoOutlines(
        size=rig.camera.lens.image_size, time=track.time[chosen], outline=np.stack(lines)
    )
