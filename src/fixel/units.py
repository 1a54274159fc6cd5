"""Units as plain floats in SI: `20 * mm` is 0.02, and `x / mm` is a length in millimetres.

Examples
--------
>>> from fixel.units import deg, mm
>>> radius = 38 * mm
>>> print(f"{radius} m, {0.5 / deg:.1f} degrees")
0.038 m, 28.6 degrees
"""

from collections.abc import Mapping
from math import pi
from typing import Final, NamedTuple

__all__ = ["cm", "deg", "g", "mm", "mrad", "ms", "um"]

cm: Final = 1e-2  # [m]
mm: Final = 1e-3  # [m]
um: Final = 1e-6  # [m]
deg: Final = pi / 180.0  # [rad]
mrad: Final = 1e-3  # [rad]
ms: Final = 1e-3  # [s]
g: Final = 1e-3  # [kg]

MICRO: Final = 3e-3  # [m], radius of parts below which lengths are shown in micrometres

# Units for display instead of SI units, and the factor from SI.
_DISPLAYED: Final[Mapping[str, tuple[str, float]]] = {
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
    "rad": ("deg", 180.0 / pi),
    "rad/s": ("deg/s", 180.0 / pi),
    "N m": ("N mm", 1e3),
    "kg": ("g", 1e3),
    "-": ("", 1.0),
}
# Units in the suffixes of names of conditions; longer suffixes first.
_SUFFIXES: Final[Mapping[str, str]] = {
    "_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad", "_m": "m", "_s": "s", "_n": "N", "_kg": "kg",
}  # fmt: skip


class DisplayUnit(NamedTuple):
    """Display unit and its factor from SI."""

    name: str  # empty for no unit
    factor: float  # from SI to this unit

    def on(self, label: str) -> str:
        """Append the unit to a label."""
        return f"{label} [{self.name}]" if self.name else label

    def text(self, value: float) -> str:
        """Format a value in this unit, without the unit's name."""
        return f"{self.factor * value:.3g}"


def displayed(unit: str) -> DisplayUnit:
    """Return the unit in which people read values of an SI unit, such as mm and deg."""
    name, factor = _DISPLAYED.get(unit, (unit, 1.0))
    return DisplayUnit(unit_text(name), factor)


def length_unit(reach: float) -> tuple[str, float]:
    """Return the unit for displaying lengths of a part of some radius [m], and its size [m]."""
    return ("um", um) if 0.0 < reach < MICRO else ("mm", mm)


def unit_text(unit: str) -> str:
    """Format a unit with a superscript square."""
    return unit.replace("^2", "²")


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a condition into the name without its suffix and the SI unit."""
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(suffix) and name != suffix:
            return name.removesuffix(suffix), unit
    return name, ""
