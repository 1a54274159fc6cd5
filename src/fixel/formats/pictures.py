"""Pictures from files: photographs, folders of them, and frames of videos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.video_file import ENDINGS, open_video
from fixel.io.atomic import usable
from fixel.vision.frame import Picture, opencv

PHOTO_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEO_ENDINGS: Final = (*ENDINGS, ".nut")  # of a recording too
FROM_VIDEO: Final = 40  # frames used of a video
MAX_BYTES: Final = 200_000_000


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those of folders sorted by name; raise unless pictures or videos."""
    known = (*PHOTO_ENDINGS, *VIDEO_ENDINGS)
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InvalidInput(str(path), found="no such file", expected="pictures or a video")
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in known)
            if not inside:
                raise InvalidInput(
                    str(path), found="a folder without pictures", expected="files such as .png"
                )
            files += inside
        elif path.suffix.lower() not in known:
            raise InvalidInput(
                str(path), found=f"the ending {path.suffix!r}", expected=", ".join(known)
            )
        else:
            files.append(path)
    return files


def pictures_of(files: Sequence[Path]) -> Iterator[tuple[str, Picture]]:
    """Yield every picture with its name; of a video, frames spread over its length."""
    for file in files:
        if file.suffix.lower() in VIDEO_ENDINGS:
            yield from _frames_of(file)
        else:
            yield file.name, read_picture(file)


def first_picture(path: Path) -> Picture:
    """Load a picture, or the first frame of a video."""
    (file,) = files_of([path])[:1]
    if file.suffix.lower() in VIDEO_ENDINGS:
        for frame in open_video(file).frames():
            return frame.picture
        raise InvalidInput(str(path), found="no frames", expected="a video with pictures")
    return read_picture(file)


def read_picture(path: Path) -> Picture:
    """Load a picture as the sensor recorded it, without the rotation noted in its file."""
    cv2 = opencv()
    with usable(path, "a picture"):
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput(str(path), found="more than 200 MB", expected="a picture")
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture: Picture | None = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise InvalidInput(
            str(path), found="a file that is not a picture", expected="a file such as .png or .jpg"
        )
    return picture


def _frames_of(file: Path) -> Iterator[tuple[str, Picture]]:
    video = open_video(file)
    every = max(1, (video.n_frames or sum(1 for _ in video.frames())) // FROM_VIDEO)
    for number, frame in enumerate(video.frames()):
        if number % every == 0:
            yield f"{file.name} at {frame.time:.2f} s", frame.picture
