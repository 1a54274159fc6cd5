"""Convert videos that browsers cannot play, once, and to a smaller size."""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Final, NamedTuple

from fixel.database.project import Project
from fixel.formats.video_file import VideoWriter, open_video
from fixel.vision.frame import Frame
from fixel.vision.opencv import opencv

CACHE: Final = "cache"  # folder of a project for files that can be made again
WIDEST: Final = 1280  # [px] largest width of a converted video
PLAYED: Final = ("h264", "vp8", "vp9", "av1")  # codecs
_one_at_a_time: Final = Lock()


class BrowserVideo(NamedTuple):
    """Video file that a browser can play."""

    path: Path
    media_type: str


def browser_video(project: Project, video: Path) -> BrowserVideo:
    """Return the video itself if a browser plays it, else a smaller copy in the project's cache.

    The copy has the times of the video. Writing it takes about as long as the video lasts.

    Raises
    ------
    InvalidInput
        The file is no video.
    """
    with video.open("rb") as stream:
        container = _container(stream.read(16))
    if container is not None and open_video(video).codec in PLAYED:
        return BrowserVideo(video, container)
    copy = project.folder / CACHE / f"video-{video.stem[:32]}.mp4"
    if not copy.is_file():  # checked first: a finished copy need not wait for others being written
        with _one_at_a_time:
            if not copy.is_file():
                _write(video, copy)
    return BrowserVideo(copy, "video/mp4")


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
