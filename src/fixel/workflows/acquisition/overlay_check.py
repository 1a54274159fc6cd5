"""Errors of all parts in one picture, with a verdict and the next thing to do."""

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
    """Largest allowed deviation of a part from its place.

    Parameters
    ----------
    distance : float
        Deviation of the origin of its frame [m].
    angle : float
        Deviation of its angle [rad].
    """

    distance: float
    angle: float

    def __post_init__(self) -> None:
        positive(self.distance, "--tolerance-mm", "mm")
        positive(self.angle, "--tolerance-deg", "deg")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartLook:
    """Wanted and measured pose of one part of the scene.

    Attributes
    ----------
    thing : Body or Pusher or Fixel
    height : float
        Height of its upper face [m].
    looked_for : bool
        Whether the part can be measured.
    measured : (3,) float64 or None
        Measured pose [m, m, rad], if the part is seen.
    reason : str
        Why the part is not seen.
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


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """Errors of all parts in one picture, with a verdict.

    Attributes
    ----------
    rig : Rig
    tolerance : Tolerance
    parts : tuple of PartLook
        Bodies first, then pushers, then fixels.
    problems : tuple of str
        Reasons why no measurement is valid.
    remarks : tuple of str
        Further remarks for the user.
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
