"""Placing parts by eye and camera: how far everything is from where a scene wants it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.exchange.atomic import written_whole
from fixel.model import Body, Fixel, Pusher, Scene
from fixel.model.fields import FloatArray, positive
from fixel.model.trajectory import wrapped
from fixel.vision.frame import Frame, Picture
from fixel.vision.locate import Located, TagLocator
from fixel.vision.marks import Rig
from fixel.workflows.overlay_drawing import draw_look

ACTUATOR_HEIGHT: Final = 0.03  # [m] of one that the rig does not know
LOOKS_BETWEEN_FLIPS: Final = 10  # a mirrored picture is looked for in every so many without a mark


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tolerance:
    """How far from its place a part may be.

    Parameters
    ----------
    distance : float
        Of the origin of its frame [m].
    angle : float
        [rad].
    """

    distance: float
    angle: float

    def __post_init__(self) -> None:
        positive(self.distance, "--tolerance-mm", "mm")
        positive(self.angle, "--tolerance-deg", "deg")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartLook:
    """One part of the scene, as it should lie and as it does.

    Attributes
    ----------
    thing : Body or Pusher or Fixel
    height : float
        Of its upper face [m].
    marked : bool
        Whether the rig has marks for it.
    measured : (3,) float64 or None
        Its pose [m, m, rad], if it is seen.
    within : bool
        Whether it is within tolerance.
    """

    thing: Body | Pusher | Fixel
    height: float
    marked: bool
    measured: FloatArray | None
    within: bool

    @property
    def name(self) -> str:
        """Of the part, in the scene."""
        return self.thing.name

    @property
    def error(self) -> FloatArray | None:
        """(3,) measured less wanted [m, m, rad], the angle the short way round."""
        if self.measured is None:
            return None
        off = self.measured - self.thing.pose
        return np.array([off[0], off[1], float(wrapped(off[2]))])


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """What one picture says about the places of all parts.

    Attributes
    ----------
    rig : Rig
    tolerance : Tolerance
    parts : tuple of PartLook
        Bodies first, then pushers, then fixels.
    problems : tuple of str
        Why nothing that is measured can be believed.
    remarks : tuple of str
        What else one should know.
    """

    rig: Rig
    tolerance: Tolerance
    parts: tuple[PartLook, ...]
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def checked(self) -> tuple[PartLook, ...]:
        """The parts that can be measured."""
        return tuple(part for part in self.parts if part.marked)

    @property
    def placed(self) -> bool:
        """Whether everything that has marks is where it should be."""
        return self.state == "placed"

    @property
    def state(self) -> str:
        """`trouble`, `not-seen` (the part to place), `off` or `placed`."""
        if self.problems:
            return "trouble"
        if all(part.within for part in self.checked):
            return "placed"
        return "not-seen" if self.to_place.measured is None else "off"

    @property
    def to_place(self) -> PartLook:
        """The part that needs a hand next: the first that is not in place, else the first."""
        return next((part for part in self.checked if not part.within), self.checked[0])

    @property
    def sentence(self) -> str:
        """What to do, in a few words."""
        part = self.to_place
        error = part.error
        if self.problems:
            return "Cannot measure"
        if self.placed:
            return "In place"
        if error is None:
            return f"{part.name} is not seen"
        push = 1e3 * float(np.hypot(*error[:2])), 1e3 * self.tolerance.distance
        turn = math.degrees(error[2]), math.degrees(self.tolerance.angle)
        way = "clockwise" if error[2] > 0.0 else "counter-clockwise"
        words = [
            *([f"push {push[0]:.1f} mm"] if push[0] > push[1] else []),
            *([f"turn {abs(turn[0]):.1f} deg {way}"] if abs(turn[0]) > turn[1] else []),
        ]
        return f"{part.name}: {', '.join(words)}"

    def summary(self) -> dict[str, Any]:
        """Plain values, for JSON and for the page."""
        return {
            "state": self.state,
            "placed": self.placed,
            "sentence": self.sentence,
            "to_place": self.to_place.name,
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
            "angle_deg": _rounded(math.degrees(error[2])),
            "distance_mm": _rounded(1e3 * np.hypot(*error[:2])),
        }

    def _push_on_screen(self, part: PartLook) -> float | None:
        """Which way to push, in the picture: 0 to the right, 90 down [deg]."""
        if part.measured is None:
            return None
        ends = np.array([part.measured[:2], part.thing.pose[:2]])
        right, down = np.diff(self.rig.camera.project_at(ends, part.height), axis=0)[0]
        return _rounded(math.degrees(math.atan2(down, right)))


class Locator(Protocol):
    """Finds the marked parts of a rig in one picture."""

    def __call__(self, picture: Picture) -> Located: ...


@final
class Overlay:
    """Compares pictures with a scene.

    Parameters
    ----------
    rig : Rig
        With marks for at least one part of the scene.
    scene : Scene
        Its poses are those that are wanted.
    tolerance : Tolerance, optional
        The rig's own where left out.
    locate : Locator, optional
        Finds the parts; by default from tags.

    Raises
    ------
    InvalidInput
        A rig that has no marks for any part of the scene.
    """

    def __init__(
        self,
        rig: Rig,
        scene: Scene,
        tolerance: Tolerance | None = None,
        locate: Locator | None = None,
    ) -> None:
        self.rig = rig
        self.scene = scene
        self.tolerance = tolerance or Tolerance(
            distance=rig.position_tolerance, angle=rig.angle_tolerance
        )
        self._locate = locate or TagLocator(rig)
        self._things: tuple[Body | Pusher | Fixel, ...] = (
            *scene.bodies,
            *scene.pushers,
            *scene.fixels,
        )
        self._looks_without_marks = 0
        self._mirrored = False
        _refuse_strangers(rig, scene)

    def look(self, picture: Picture) -> Look:
        """Where everything is in this picture.

        Parameters
        ----------
        picture : (h, w, 3) uint8
        """
        wrong_size = _wrong_size(self.rig, picture)
        if wrong_size:
            return self._judged(Located({}, {}), [wrong_size], [])
        located = self._locate(picture)
        problems = [
            *_moved(self.rig, located, self.tolerance),
            *self._mirror_complaint(picture, located),
        ]
        return self._judged(located, problems, _plate_remarks(self.rig, located))

    def drawn(self, picture: Picture, look: Look, *, words: bool = False) -> Picture:
        """A copy of the picture with outlines; `words` writes the errors into it too."""
        return draw_look(picture, look, words=words)

    def _judged(self, located: Located, problems: list[str], remarks: list[str]) -> Look:
        return Look(
            rig=self.rig,
            tolerance=self.tolerance,
            parts=tuple(self._part(thing, located) for thing in self._things),
            problems=tuple(problems),
            remarks=tuple(remarks),
        )

    def _part(self, thing: Body | Pusher | Fixel, located: Located) -> PartLook:
        known = self.rig.parts.get(thing.name)
        measured = located.parts.get(thing.name)
        part = PartLook(
            thing=thing,
            height=known.height if known else self._height(thing),
            marked=known is not None and bool(known.marks),
            measured=measured,
            within=False,
        )
        error = part.error
        if error is None:
            return part
        near = float(np.hypot(*error[:2])) <= self.tolerance.distance
        within = near and abs(float(error[2])) <= self.tolerance.angle
        return PartLook(
            thing=thing, height=part.height, marked=part.marked, measured=measured, within=within
        )

    def _height(self, thing: Body | Pusher | Fixel) -> float:
        if isinstance(thing, Fixel):
            return self.rig.fixel_height
        if isinstance(thing, Pusher):
            return ACTUATOR_HEIGHT
        return max((part.height for part in self.rig.parts.values()), default=ACTUATOR_HEIGHT)

    def _mirror_complaint(self, picture: Picture, located: Located) -> list[str]:
        """Tags do not read in a mirror: if there are some there, say so."""
        if located.parts or located.plate:
            self._looks_without_marks, self._mirrored = 0, False
        else:
            if self._looks_without_marks % LOOKS_BETWEEN_FLIPS == 0:
                turned = self._locate(np.ascontiguousarray(picture[:, ::-1]))
                self._mirrored = bool(turned.parts or turned.plate)
            self._looks_without_marks += 1
        if not self._mirrored:
            return []
        return ["The picture is mirrored: turn mirroring off in the settings of the camera"]


def watch(
    overlay: Overlay,
    frames: Iterable[Frame],
    show: Callable[[Callable[[], Picture], dict[str, Any]], None],
) -> Look | None:
    """Look at frames until they end, and show each with its outlines.

    Parameters
    ----------
    overlay : Overlay
    frames : iterable of Frame
    show : callable
        Told a function that draws the picture, to be called only if somebody looks, and the status:
        `LiveView.show`.

    Returns
    -------
    Look or None
        The last; None without any frame.
    """
    look = None
    for frame in frames:
        look = overlay.look(frame.picture)
        show(partial(overlay.drawn, frame.picture, look), look.summary())
    return look


def write_picture(path: Path, picture: Picture) -> None:
    """A picture as a PNG file, whole or absent."""
    from PIL import Image

    with written_whole(path) as unfinished:
        Image.fromarray(np.ascontiguousarray(picture[:, :, ::-1])).save(unfinished, format="PNG")


def _rounded(value: float) -> float:
    """To a ten thousandth of a mm or a degree; zero without a sign."""
    return round(float(value), 4) + 0.0


def _refuse_strangers(rig: Rig, scene: Scene) -> None:
    marked = [name for name, part in rig.parts.items() if part.marks]
    if not set(marked) & set(scene.names):
        raise InvalidInput(
            f"rig {rig.name!r}",
            found="marks on " + (", ".join(marked) or "no part"),
            expected="marks on a part of the scene: " + ", ".join(scene.names),
            hint="parts of a rig have the names they have in the scene",
        )


def _wrong_size(rig: Rig, picture: Picture) -> str:
    height, width = picture.shape[:2]
    wide, high = rig.camera.lens.image_size
    if (width, height) == (wide, high):
        return ""
    turned = " and turned on its side" if (height, width) == (wide, high) else ""
    return (
        f"The camera gives {width} x {height} px{turned}, but rig {rig.name} was calibrated at "
        f"{wide} x {high} px: set the camera to that, or calibrate it anew"
    )


def _moved(rig: Rig, located: Located, tolerance: Tolerance) -> list[str]:
    """Plate tags stay where they are: if they seem not to, it is the camera that has moved."""
    if not located.plate:
        return []
    far = {number: float(np.hypot(*off)) for number, off in located.plate.items()}
    worst = max(far, key=lambda number: far[number])
    if far[worst] <= tolerance.distance:
        return []
    return [
        f"The camera or the plate has moved: plate tag {worst} appears {1e3 * far[worst]:.1f} mm "
        "from where the rig has it; place the camera anew"
    ]


def _plate_remarks(rig: Rig, located: Located) -> list[str]:
    if rig.plate and not located.plate:
        return ["No plate tag is seen, so nothing tells whether the camera has moved"]
    return []
