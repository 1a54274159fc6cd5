"""What one picture says about the places of all parts: errors, a verdict, what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from fixel.model import Body, Disk, Fixel, Pusher
from fixel.model.fields import positive
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.vision.marks import Rig


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
    looked_for : bool
        Whether it can be measured.
    measured : (3,) float64 or None
        Its pose [m, m, rad], if it is seen.
    reason : str
        Why it is not.
    tolerance : Tolerance
    """

    thing: Body | Pusher | Fixel
    height: float
    looked_for: bool
    measured: FloatArray | None
    reason: str
    tolerance: Tolerance

    @property
    def name(self) -> str:
        """Of the part, in the scene."""
        return self.thing.name

    @property
    def round(self) -> bool:
        """Whether it shows no angle: a round fixel is turned as it should be, always."""
        return isinstance(self.thing, Fixel) and isinstance(self.thing.shape, Disk)

    @property
    def error(self) -> FloatArray | None:
        """(3,) measured less wanted [m, m, rad], the angle the short way round."""
        if self.measured is None:
            return None
        off = self.measured - self.thing.pose
        return np.array([off[0], off[1], float(wrapped(off[2]))])

    @property
    def within(self) -> bool:
        """Whether it is where it should be, within tolerance."""
        error = self.error
        if error is None:
            return False
        near = float(np.hypot(*error[:2])) <= self.tolerance.distance
        return near and abs(float(error[2])) <= self.tolerance.angle


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
        return tuple(part for part in self.parts if part.looked_for)

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
    def headline(self) -> str:
        """The verdict, in words that change only with it."""
        if self.problems:
            return "Cannot measure"
        if self.placed:
            return "In place"
        return f"{self.to_place.name} is {'not seen' if self.to_place.error is None else 'off'}"

    @property
    def sentence(self) -> str:
        """What to do, in a few words."""
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
        """Digits of a millimetre that are worth showing: to a twentieth of the tolerance."""
        return max(2, math.ceil(-math.log10(1e3 * self.tolerance.distance / 20.0)))

    def words(self, part: PartLook) -> tuple[str, str, str]:
        """Error of a part that is seen, in words: x [mm], y [mm], angle [deg]."""
        assert part.error is not None
        x, y, turn = part.error.tolist()
        return (
            _signed(1e3 * x, self.decimals),
            _signed(1e3 * y, self.decimals),
            "-" if part.round else _signed(math.degrees(turn), 2),
        )

    def summary(self) -> dict[str, Any]:
        """Plain values, for JSON and for the page."""
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
        """Which way to push, in the picture: 0 to the right, 90 down [deg]."""
        if part.measured is None:
            return None
        ends = np.array([part.measured[:2], part.thing.pose[:2]])
        right, down = np.diff(self.rig.camera.project_at(ends, part.height), axis=0)[0]
        return _rounded(math.degrees(math.atan2(down, right)))


def _rounded(value: float) -> float:
    """To a ten thousandth of a mm or a degree; zero without a sign."""
    return round(float(value), 4) + 0.0


def _signed(value: float, decimals: int) -> str:
    """With its sign, unless it is nothing."""
    text = f"{value:+.{decimals}f}"
    return text.lstrip("+-") if float(text) == 0.0 else text
