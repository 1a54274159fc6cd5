"""Draw measured outlines on the frames of a film, to check a track by eye."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from fixel.drawing import palette
from fixel.errors import InvalidInput
from fixel.formats.video_file import VideoWriter
from fixel.io.atomic import written_whole
from fixel.model import Scene
from fixel.vision.frame import Frame, Picture
from fixel.vision.outlines import bgr, draw_outline, draw_words, outline_pixels
from fixel.vision.tracking import FilmTracks
from fixel.vision.tracking.follow import things_of

SHOWN: Final = 6  # frames on a sheet
ACROSS: Final = 2  # frames side by side
WIDTH: Final = 960  # [px] largest width of a frame on a sheet


def write_overlay(
    frames: Iterator[Frame], scene: Scene, tracked: FilmTracks, path: Path, note: str = ""
) -> None:
    """Write the film with outlines of object, pusher and fixels at their heights."""
    step = float(np.median(np.diff(tracked.time))) if len(tracked.time) > 1 else 1.0 / 30.0
    zero = float(tracked.time[0])
    size = tuple(2 * (side // 2) for side in tracked.rig.camera.lens.image_size)
    with VideoWriter(path, (size[0], size[1]), rate=1.0 / step, note=note) as writer:
        for index, frame in enumerate(frames):
            picture = drawn(frame, index, scene, tracked)
            writer.write(Frame(frame.time - zero, picture[: size[1], : size[0]]))


def write_sheet(frames: Iterator[Frame], scene: Scene, tracked: FilmTracks, path: Path) -> None:
    """Write a few frames of the overlay as one picture."""
    from fixel.vision.opencv import opencv

    cv2 = opencv()
    n = len(tracked.time)
    wanted = set(np.linspace(0, n - 1, min(SHOWN, n)).round().astype(int).tolist())
    shown = []
    for index, frame in enumerate(frames):
        if index in wanted:
            picture = drawn(frame, index, scene, tracked)
            scale = min(1.0, WIDTH / picture.shape[1])
            shown.append(
                cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            )
    while len(shown) % ACROSS:
        shown.append(np.full_like(shown[0], 255))
    rows = [np.hstack(shown[k : k + ACROSS]) for k in range(0, len(shown), ACROSS)]
    with written_whole(path) as unfinished:
        if not cv2.imwrite(str(unfinished), np.vstack(rows)):
            raise InvalidInput(str(path), found="no room for it", expected="a file to write")


def drawn(frame: Frame, index: int, scene: Scene, tracked: FilmTracks) -> Picture:
    """Return a frame with the measured outlines drawn on it."""
    picture = np.array(frame.picture)
    rig, camera = tracked.rig, tracked.rig.camera
    places = {fixel.name: fixel.place for fixel in tracked.fixels}
    for fixel in scene.fixels:
        pose = np.append(places.get(fixel.name, fixel.pose[:2]), fixel.pose[2])
        line = outline_pixels(camera, fixel.shape, pose, rig.fixel_height)
        # Fixels that are only planned are dashed.
        dash = None if fixel.name in places else 4.0
        draw_outline(picture, line, bgr(palette.TOUCHED), dash=dash)
    things = things_of(scene)
    pushers = {pusher.name for pusher in scene.pushers}
    missing = []
    for name, part in tracked.parts.items():
        if not part.good[index]:
            missing.append(f"{name}: {part.reason[index]}")
            continue
        if name in things:
            line = outline_pixels(
                camera, things[name].shape, part.pose[index], rig.parts[name].height
            )
            colour = palette.PUSHER if name in pushers else palette.TRAIL
            draw_outline(picture, line, bgr(colour))
    draw_words(picture, f"{frame.time:.3f} s", (8, 24), (255, 255, 255))
    for row, words in enumerate(missing):
        draw_words(picture, words, (8, 50 + 24 * row), bgr(palette.FORCE))
    return picture
