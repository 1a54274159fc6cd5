"""Compare camera pictures with a scene, to place parts by eye."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.target import scene_of as stored_scene
from fixel.database.project import Project
from fixel.drawing.palette import PUSHER, TRAIL
from fixel.errors import InvalidInput, unknown_name
from fixel.formats.scene_file import load_scene
from fixel.io.atomic import written_whole
from fixel.model import Body, Disk, Fixel, Polygon, Pusher, Scene, placed
from fixel.model.fields import positive
from fixel.model.trajectory import pose_difference
from fixel.sampling.rows import moved_onto
from fixel.testbed.frame_source import STALLED, FrameQueue, FrameSource
from fixel.typing import FloatArray
from fixel.vision.frame import Frame, Picture
from fixel.vision.marks import Rig
from fixel.vision.outlines import (
    Bgr,
    bgr,
    draw_arrow,
    draw_outline,
    draw_words,
    outline_pixels,
    place_pixels,
)
from fixel.vision.tracking.follow import MIN_FRAMES, FramePoses, Locator, things_of

ACTUATOR_HEIGHT: Final = 0.03  # [m] of an actuator that the rig does not list
TRIES: Final = 10  # largest number of pictures for one look
HELD: Final = 2  # pictures in the queue; of a live camera the older of them are late
BETWEEN_SIGNS: Final = 0.2  # [s] of waiting for a picture before checking whether any will come
SILENT: Final = STALLED + 1.0  # [s] without pictures; most sources report the cause before

Show = Callable[[Callable[[], Picture], dict[str, Any]], None]


class Overlay:
    """Comparison of pictures with the wanted poses of a scene, of which the rig has a part.

    The tolerance is by default that of the rig. All wanted poses are moved rigidly with an
    `anchor`, usually the actuator, to where the camera sees it; without one they are those of the
    scene. The rig must have a part of the scene, and be able to measure the anchor.
    """

    def __init__(
        self, rig: Rig, scene: Scene, tolerance: Tolerance | None = None, *, anchor: str = ""
    ) -> None:
        self.rig = rig
        usual = Tolerance(distance=rig.position_tolerance, angle=rig.angle_tolerance)
        self.tolerance = tolerance or usual
        self._locator = Locator(rig, scene)
        if anchor and anchor not in self._locator.names:
            raise unknown_name("anchor", anchor, self._locator.names)
        self.anchor, self._planned, self.scene = anchor, scene, scene
        self._home, self._n_seen = things_of(scene)[anchor].pose if anchor else np.zeros(3), 0

    def look(self, frame: Frame) -> Look:
        """Locate all parts in a frame and compute their errors."""
        located = self._locator.see(frame)
        sight = located.parts.get(self.anchor)
        if sight is not None and sight.pose is not None:
            self._follow(sight.pose)
        things: list[Body | Pusher | Fixel] = [*self.scene.bodies, *self.scene.pushers]
        return Look(
            rig=self.rig,
            tolerance=self.tolerance,
            parts=tuple(self._part(thing, located) for thing in (*things, *self.scene.fixels)),
            problems=located.problems,
            remarks=(*located.remarks, *([self._about_anchor()] if self.anchor else [])),
        )

    def _follow(self, pose: FloatArray) -> None:
        """Move the wanted poses to the mean pose of the anchor since it was last displaced."""
        now = things_of(self.scene)[self.anchor].pose
        off = pose_difference(pose, now)
        far = np.hypot(*off[:2]) > self.tolerance.distance or abs(off[2]) > self.tolerance.angle
        self._n_seen = 1 if far else self._n_seen + 1
        self.scene = moved_onto(self._planned, self._home, now + off / self._n_seen)
        self._locator.expect(self.scene.fixels)

    def _about_anchor(self) -> str:
        if not self._n_seen:
            return f"{self.anchor} has not been seen yet: the poses are those of the scene"
        x, y, turn = things_of(self.scene)[self.anchor].pose - self._home
        off = f"{1e3 * math.hypot(x, y):.1f} mm and {math.degrees(turn):.1f} deg"
        return f"all poses are moved with {self.anchor}, which is {off} from its place in the scene"

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
    """Load the scene of a file or of a stored experiment; raise `InvalidInput` without either."""
    if (path is None) == (key is None):
        raise InvalidInput(
            "fixel overlay",
            found="both a scene and an experiment" if path else "neither scene nor experiment",
            expected="a scene file, or --experiment with the name of a stored experiment",
        )
    if path is not None:
        return load_scene(path).scene
    with Project(project).store() as store:
        return stored_scene(store.experiment(store.find(str(key))))


def frames_of(
    source: FrameSource,
    live: bool,
    notify: Callable[[str], None] | None = None,
    patience: float | None = None,
) -> Iterator[Frame]:
    """Yield the pictures of an open source; of a live one, which does not wait, only the newest.

    `notify` is called with the reason when the pictures have ended, for a live source also after
    `patience` [s] without one, by default `SILENT`.
    """
    queue = FrameQueue(source, live=live, held=HELD)
    queue.start()
    missing, reason, patience = 0.0, "", patience or SILENT
    try:
        while not reason:
            arrived = queue.get(BETWEEN_SIGNS)
            while live and (newer := queue.get(0.0)) is not None:
                arrived = newer
            if arrived is not None:
                with suppress(InvalidInput):  # a damaged one: the next arrives soon
                    yield arrived.rendered or Frame(arrived.time, arrived.picture())
                missing = 0.0
            elif queue.over:
                reason = queue.reason
            elif live and (missing := missing + BETWEEN_SIGNS) >= patience:
                reason = f"the camera has sent nothing for {patience:g} s"
        if notify is not None:
            notify(reason)
    finally:
        queue.close()


def watch(overlay: Overlay, frames: Iterable[Frame], show: Show) -> Iterator[Look]:
    """Compare frames with the scene until they end; yield each result after it was shown.

    `show` is called with a function that draws the picture, to be used only if there is a viewer,
    and with the status: `LiveView.show`.
    """
    for frame in frames:
        look = overlay.look(frame)
        show(partial(draw_look, frame.picture, look), look.summary())
        yield look


def look_once(overlay: Overlay, frames: Iterable[Frame]) -> tuple[Picture, Look]:
    """Return the first picture that shows all measurable parts, else the last of a few.

    Raise `InvalidInput` without a picture, or if nothing can be measured in it.
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


def write_png(path: Path, picture: Picture) -> None:
    """Write a picture as a PNG file, completely or not at all."""
    from PIL import Image

    with written_whole(path) as unfinished:
        Image.fromarray(np.ascontiguousarray(picture[:, :, ::-1])).save(unfinished, format="PNG")


WANTED: Final = bgr(TRAIL)
ACTUATOR: Final = bgr(PUSHER)
STANDING: Final = bgr("#E8E8E8")
MEASURED: Final = bgr("#F0E442")  # yellow of the same palette
BRIGHT: Final = bgr("#7CFFB2")  # the same green, to be read on a dark rim
WARNING: Final = bgr("#FF8A66")
AXIS: Final = 55.0  # [px] length of the world's axes as drawn
FAINT: Final = 0.45
ARROW: Final = (45.0, 130.0)  # [px] shortest and longest arrow of a push
EXAGGERATED: Final = 8.0  # drawn length of a push over its true length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tolerance:
    """Largest allowed deviation of a part from its place."""

    distance: float  # deviation of the origin of its frame [m]
    angle: float  # deviation of its angle [rad]

    def __post_init__(self) -> None:
        positive(self.distance, "--tolerance-mm", "mm")
        positive(self.angle, "--tolerance-deg", "deg")


class PartLook(NamedTuple):
    """Wanted and measured pose of one part of the scene."""

    thing: Body | Pusher | Fixel
    height: float  # height of its upper face [m]
    looked_for: bool  # whether the part can be measured
    measured: FloatArray | None  # (3,) measured pose [m, m, rad], if the part is seen
    reason: str  # why the part is not seen
    tolerance: Tolerance

    @property
    def name(self) -> str:
        """Name of the part in the scene."""
        return self.thing.name

    @property
    def round(self) -> bool:
        """Whether the part shows no angle; that of a round fixel always counts as correct."""
        return isinstance(self.thing, Fixel) and isinstance(self.thing.shape, Disk)

    @property
    def error(self) -> FloatArray | None:
        """(3,) measured minus wanted pose [m, m, rad], with the angle wrapped."""
        return None if self.measured is None else pose_difference(self.measured, self.thing.pose)

    @property
    def within(self) -> bool:
        """Whether the part is at its wanted pose, within tolerance."""
        error = self.error
        if error is None:
            return False
        near = float(np.hypot(*error[:2])) <= self.tolerance.distance
        return near and abs(float(error[2])) <= self.tolerance.angle


class Look(NamedTuple):
    """Errors of all parts in one picture, with a verdict."""

    rig: Rig
    tolerance: Tolerance
    parts: tuple[PartLook, ...]  # bodies first, then pushers, then fixels
    problems: tuple[str, ...] = ()  # reasons why no measurement is valid
    remarks: tuple[str, ...] = ()  # further remarks for the user

    @property
    def checked(self) -> tuple[PartLook, ...]:
        """The parts that can be measured."""
        return tuple(part for part in self.parts if part.looked_for)

    @property
    def placed(self) -> bool:
        """Whether everything that has marks is where it should be."""
        return self.state == "placed"

    @property
    def state(self) -> str:
        """One of `trouble`, `not-seen` (the part to place), `off` or `placed`."""
        if self.problems:
            return "trouble"
        if all(part.within for part in self.checked):
            return "placed"
        return "not-seen" if self.to_place.measured is None else "off"

    @property
    def to_place(self) -> PartLook:
        """Part to place next: the first that is not in place, else the first."""
        return next((part for part in self.checked if not part.within), self.checked[0])

    @property
    def headline(self) -> str:
        """Verdict in a few words that change only with it."""
        if self.problems:
            return "Cannot measure"
        if self.placed:
            return "In place"
        return f"{self.to_place.name} is {'not seen' if self.to_place.error is None else 'off'}"

    @property
    def sentence(self) -> str:
        """Instruction for the part to place, in a few words."""
        part = self.to_place
        error = part.error
        if self.problems or self.placed or error is None:
            return self.headline
        push = 1e3 * float(np.hypot(*error[:2])), 1e3 * self.tolerance.distance
        turn = math.degrees(error[2]), math.degrees(self.tolerance.angle)
        way = "clockwise" if error[2] > 0.0 else "counter-clockwise"
        words = [
            *([f"push {push[0]:.{self.decimals - 1}f} mm"] if push[0] > push[1] else []),
            *([f"turn {abs(turn[0]):.1f} deg {way}"] if abs(turn[0]) > turn[1] else []),
        ]
        return f"{part.name}: {', '.join(words)}"

    @property
    def decimals(self) -> int:
        """Decimals of a millimetre that resolve a twentieth of the tolerance."""
        return max(2, math.ceil(-math.log10(1e3 * self.tolerance.distance / 20.0)))

    def words(self, part: PartLook) -> tuple[str, str, str]:
        """Return the error of a visible part as text: x [mm], y [mm], angle [deg]."""
        assert part.error is not None
        x, y, turn = part.error.tolist()
        return (
            _signed(1e3 * x, self.decimals),
            _signed(1e3 * y, self.decimals),
            "-" if part.round else _signed(math.degrees(turn), 2),
        )

    def summary(self) -> dict[str, Any]:
        """Return plain values, for JSON and for the page."""
        return {
            "state": self.state,
            "placed": self.placed,
            "headline": self.headline,
            "sentence": self.sentence,
            "to_place": self.to_place.name,
            "decimals": self.decimals,
            "tolerance_mm": _rounded(1e3 * self.tolerance.distance),
            "tolerance_deg": _rounded(math.degrees(self.tolerance.angle)),
            "parts": [self._part_summary(part) for part in self.checked],
            "problems": list(self.problems),
            "remarks": list(self.remarks),
        }

    def _part_summary(self, part: PartLook) -> dict[str, Any]:
        seen = part.error is not None
        x, y, turn = [math.nan] * 3 if part.error is None else part.error.tolist()
        return {
            "name": part.name,
            "seen": seen,
            "reason": part.reason,
            "within": part.within,
            "dx_mm": _rounded(1e3 * x) if seen else None,
            "dy_mm": _rounded(1e3 * y) if seen else None,
            "angle_deg": _rounded(math.degrees(turn)) if seen and not part.round else None,
            "distance_mm": _rounded(1e3 * math.hypot(x, y)) if seen else None,
            "push_screen_deg": self._push_on_screen(part),
        }

    def _push_on_screen(self, part: PartLook) -> float | None:
        """Direction of the push in the picture: 0 to the right, 90 down [deg]."""
        if part.measured is None:
            return None
        ends = np.array([part.measured[:2], part.thing.pose[:2]])
        right, down = np.diff(self.rig.camera.project_at(ends, part.height), axis=0)[0]
        return _rounded(math.degrees(math.atan2(down, right)))


def _rounded(value: float) -> float:
    """Round to a ten thousandth of a mm or a degree; zero has no sign."""
    return round(float(value), 4) + 0.0


def _signed(value: float, decimals: int) -> str:
    """Format a number with its sign, or zero without one."""
    text = f"{value:+.{decimals}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text


def draw_look(picture: Picture, look: Look, *, words: bool = False) -> Picture:
    """Return a copy of a picture with outlines; `words` writes the errors on it too."""
    canvas = picture.copy()
    if (canvas.shape[1], canvas.shape[0]) == look.rig.camera.lens.image_size:
        _axes(canvas, look)
        for part in reversed(look.parts):
            _wanted(canvas, look, part)
        for part in look.checked:
            _measured(canvas, look, part)
    if words:
        _words(canvas, look)
    return canvas


def _wanted(canvas: Picture, look: Look, part: PartLook) -> None:
    """Draw the upper outline solid, the footprint and the edges between them faint."""
    camera, thing = look.rig.camera, part.thing
    foot = outline_pixels(camera, thing.shape, thing.pose, 0.0)
    upper = outline_pixels(camera, thing.shape, thing.pose, part.height)
    colour = _colour(part)
    draw_outline(canvas, foot, colour, width=1, strength=FAINT, halo=False)
    if isinstance(thing.shape, Polygon):
        corners = placed(thing.shape.outline, thing.pose)
        ends = place_pixels(camera, corners, 0.0), place_pixels(camera, corners, part.height)
        for edge in np.stack(ends, axis=1):
            draw_outline(canvas, edge, colour, width=1, strength=FAINT, closed=False, halo=False)
    draw_outline(canvas, upper, colour, width=4 if part.within else 2)


def _measured(canvas: Picture, look: Look, part: PartLook) -> None:
    """Draw the measured outline dashed, and an arrow towards the wanted place."""
    if part.measured is None or look.problems:
        return
    camera = look.rig.camera
    line = outline_pixels(camera, part.thing.shape, part.measured, part.height)
    draw_outline(canvas, line, MEASURED, width=2, dash=9.0)
    if part.within:
        return
    start, end = place_pixels(camera, [part.measured[:2], part.thing.pose[:2]], part.height)
    way = end - start
    length = float(np.linalg.norm(way))
    if length > 0.0:
        drawn = float(np.clip(EXAGGERATED * length, *ARROW))
        draw_arrow(canvas, start, start + way * drawn / length, MEASURED, width=4)


def _axes(canvas: Picture, look: Look) -> None:
    length = AXIS * look.rig.camera.metres_per_pixel()
    ends = place_pixels(look.rig.camera, [[0.0, 0.0], [length, 0.0], [0.0, length]], 0.0)
    for name, end in zip("xy", ends[1:], strict=True):
        draw_arrow(canvas, ends[0], end, STANDING, width=1)
        draw_words(canvas, name, [end[0] + 4.0, end[1] + 4.0], STANDING, size=0.5)


def _colour(part: PartLook) -> Bgr:
    if part.within:
        return BRIGHT
    if isinstance(part.thing, Fixel):
        return STANDING
    return ACTUATOR if isinstance(part.thing, Pusher) else WANTED


def _words(canvas: Picture, look: Look) -> None:
    """Write the verdict large, then one line for each part, from the upper left."""
    size = max(0.4, canvas.shape[1] / 1600.0)
    step = 42.0 * size
    lines = [*look.problems, *(_line(look, part) for part in look.checked), *look.remarks]
    band = canvas[: round(step * (1.6 + len(lines)))]
    band[:] = band // 3
    colour = BRIGHT if look.placed else WARNING
    draw_words(canvas, look.sentence, (16.0, step), colour, size=1.5 * size)
    for number, line in enumerate(lines):
        draw_words(canvas, line, (16.0, step * (2.1 + number)), STANDING, size=0.8 * size)


def _line(look: Look, part: PartLook) -> str:
    if part.error is None:
        return f"{part.name}: not seen, {part.reason}"
    x, y, turn = look.words(part)
    angle = "" if part.round else f"angle {turn} deg, "
    return f"{part.name}: x {x} mm, y {y} mm, {angle}{'in place' if part.within else 'off'}"
