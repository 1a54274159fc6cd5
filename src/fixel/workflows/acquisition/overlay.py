"""Compare camera pictures with a scene, to place parts by eye."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.scene_file import load_scene
from fixel.io.atomic import written_whole
from fixel.model import Body, Fixel, Pusher, Scene
from fixel.testbed.frame_queue import FrameQueue
from fixel.testbed.frame_source import STALLED, CameraPicture, FrameSource
from fixel.vision.frame import Frame, Picture
from fixel.vision.locate import FramePoses, Locator
from fixel.vision.marks import Rig
from fixel.vision.tracking.fixels import MIN_FRAMES
from fixel.workflows.acquisition.overlay_check import Look, PartLook, Tolerance, draw_look

ACTUATOR_HEIGHT: Final = 0.03  # [m] of an actuator that the rig does not list
TRIES: Final = 10  # largest number of pictures for one look
HELD: Final = 2  # pictures in the queue; of a live camera the older of them are late
BETWEEN_SIGNS: Final = 0.2  # [s] of waiting for a picture before checking whether any will come
SILENT: Final = STALLED + 1.0  # [s] without pictures; most sources report the cause before

Show = Callable[[Callable[[], Picture], dict[str, Any]], None]


@final
class Overlay:
    """Comparison of pictures with a scene.

    Parameters
    ----------
    rig : Rig
        Rig with at least one part of the scene.
    scene : Scene
        Scene with the wanted poses.
    tolerance : Tolerance, optional
        Defaults to the tolerances of the rig.

    Raises
    ------
    InvalidInput
        The rig has no part of the scene.
    """

    def __init__(self, rig: Rig, scene: Scene, tolerance: Tolerance | None = None) -> None:
        self.rig = rig
        self.tolerance = tolerance or Tolerance(
            distance=rig.position_tolerance, angle=rig.angle_tolerance
        )
        self._locator = Locator(rig, scene)
        self._things: tuple[Body | Pusher | Fixel, ...] = (
            *scene.bodies,
            *scene.pushers,
            *scene.fixels,
        )

    def look(self, frame: Frame) -> Look:
        """Locate all parts in a frame and compute their errors."""
        located = self._locator.see(frame)
        return Look(
            rig=self.rig,
            tolerance=self.tolerance,
            parts=tuple(self._part(thing, located) for thing in self._things),
            problems=located.problems,
            remarks=located.remarks,
        )

    def drawn(self, picture: Picture, look: Look, *, words: bool = False) -> Picture:
        """Return a copy of the picture with outlines; `words` writes the errors on it too."""
        return draw_look(picture, look, words=words)

    def _part(self, thing: Body | Pusher | Fixel, located: FramePoses) -> PartLook:
        sight = located.parts.get(thing.name)
        measured = None if sight is None else sight.pose
        if thing.name in located.fixels:  # round: its angle counts as correct
            measured = np.append(located.fixels[thing.name], thing.pose[2])
        known = self.rig.parts.get(thing.name)
        return PartLook(
            thing=thing,
            height=known.height if known else self._height(thing),
            looked_for=measured is not None or thing.name in self._locator.names,
            measured=measured,
            reason="" if sight is None else sight.reason,
            tolerance=self.tolerance,
        )

    def _height(self, thing: Body | Pusher | Fixel) -> float:
        if isinstance(thing, Fixel):
            return self.rig.fixel_height
        if isinstance(thing, Pusher):
            return ACTUATOR_HEIGHT
        return max((part.height for part in self.rig.parts.values()), default=ACTUATOR_HEIGHT)


def scene_of(path: Path | None, key: str | None, project: Path) -> Scene:
    """Load the scene of a file or of a stored experiment.

    Raises
    ------
    InvalidInput
        Neither or both are given, or the experiment has no scene.
    """
    if (path is None) == (key is None):
        raise InvalidInput(
            "fixel overlay",
            found="both a scene and an experiment" if path else "neither scene nor experiment",
            expected="a scene file, or --experiment with the name of a stored experiment",
        )
    if path is not None:
        return load_scene(path).scene
    with Project(project).store() as store:
        experiment = store.experiment(store.find(str(key)))
    if experiment.scene is None:
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="no scene",
            expected="an experiment with a scene",
        )
    return experiment.scene


def frames_of(
    source: FrameSource, live: bool, notify: Callable[[str], None] | None = None
) -> Iterator[Frame]:
    """Yield the pictures of an open source; of a live source only the newest.

    Parameters
    ----------
    source : FrameSource
    live : bool
        Whether the source continues without waiting for its reader.
    notify : callable, optional
        Called with the reason when the pictures have ended.
    """
    queue = FrameQueue(source, live=live, held=HELD)
    queue.start()
    came, reason = time.monotonic(), ""
    try:
        while not reason:
            arrived = queue.get(BETWEEN_SIGNS)
            while live and (newer := queue.get(0.0)) is not None:
                arrived = newer
            if arrived is not None:
                if (frame := _decoded(arrived)) is not None:
                    yield frame
                came = time.monotonic()
            elif queue.over:
                reason = queue.reason
            elif live and time.monotonic() - came > SILENT:
                reason = f"the camera has sent nothing for {SILENT:g} s"
        if notify is not None:
            notify(reason)
    finally:
        queue.close()


def _decoded(arrived: CameraPicture) -> Frame | None:
    """Return the frame, or None for a damaged one: the next arrives soon."""
    try:
        return Frame(arrived.time, arrived.picture())
    except InvalidInput:
        return None


def watch(overlay: Overlay, frames: Iterable[Frame], show: Show) -> Iterator[Look]:
    """Compare frames with the scene until they end, and show each with its outlines.

    Parameters
    ----------
    overlay : Overlay
    frames : iterable of Frame
    show : callable
        Called with a function that draws the picture, to be used only if there is a viewer, and
        with the status: `LiveView.show`.

    Yields
    ------
    Look
        Result for one frame, after it was shown.
    """
    for frame in frames:
        look = overlay.look(frame)
        show(partial(overlay.drawn, frame.picture, look), look.summary())
        yield look


def look_once(overlay: Overlay, frames: Iterable[Frame]) -> tuple[Picture, Look]:
    """Return the first picture that shows all measurable parts, else the last of a few.

    Raises
    ------
    InvalidInput
        No picture, or one in which nothing can be measured.
    """
    answer = None
    for number, frame in enumerate(islice(frames, TRIES), 1):
        look = overlay.look(frame)
        answer = frame.picture, look
        if number >= MIN_FRAMES and all(part.measured is not None for part in look.checked):
            break
    if answer is None:
        raise InvalidInput("--camera", found="no picture", expected="a camera that sends pictures")
    if answer[1].problems:
        raise InvalidInput(answer[1].problems[0])
    return answer


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture as a PNG file, completely or not at all."""
    from PIL import Image

    with written_whole(path) as unfinished:
        Image.fromarray(np.ascontiguousarray(picture[:, :, ::-1])).save(unfinished, format="PNG")
