"""Errors of all parts in one picture, with a verdict, the next thing to do, and a drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.drawing.palette import PUSHER, TRAIL
from fixel.model import Body, Disk, Fixel, Polygon, Pusher, placed
from fixel.model.fields import positive
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.vision.frame import Picture
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


@final
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
        if self.measured is None:
            return None
        off = self.measured - self.thing.pose
        return np.array([off[0], off[1], float(wrapped(off[2]))])

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
        error = part.error
        seen: dict[str, Any] = {
            "name": part.name,
            "seen": error is not None,
            "reason": part.reason,
            "within": part.within,
            "dx_mm": None,
            "dy_mm": None,
            "angle_deg": None,
            "distance_mm": None,
            "push_screen_deg": self._push_on_screen(part),
        }
        if error is None:
            return seen
        return seen | {
            "dx_mm": _rounded(1e3 * error[0]),
            "dy_mm": _rounded(1e3 * error[1]),
            "angle_deg": None if part.round else _rounded(math.degrees(error[2])),
            "distance_mm": _rounded(1e3 * np.hypot(*error[:2])),
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


def draw_look(picture: Picture, look: Look, *, words: bool) -> Picture:
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
