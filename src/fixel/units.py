"""Units as plain floats in SI: `20 * mm` is 0.02, and `x / mm` is a length in millimetres.

Examples
--------
>>> from fixel.units import deg, mm
>>> radius = 38 * mm
>>> print(f"{radius} m, {0.5 / deg:.1f} degrees")
0.038 m, 28.6 degrees
"""

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
