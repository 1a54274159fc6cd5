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
from typing import Final

__all__ = ["cm", "deg", "g", "mm", "mrad", "ms", "um"]

cm: Final = 1e-2  # [m]
mm: Final = 1e-3  # [m]
um: Final = 1e-6  # [m]
deg: Final = pi / 180.0  # [rad]
mrad: Final = 1e-3  # [rad]
ms: Final = 1e-3  # [s]
g: Final = 1e-3  # [kg]

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


def displayed(unit: str) -> tuple[str, float]:
    """Return the unit in which people read values of an SI unit, and the factor to it."""
    return _DISPLAYED.get(unit, (unit, 1.0))


def unit_text(unit: str) -> str:
    """Format a unit with a superscript square."""
    return unit.replace("^2", "²")


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a condition into the name without its suffix and the SI unit."""
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(suffix) and name != suffix:
            return name.removesuffix(suffix), unit
    return name, ""
