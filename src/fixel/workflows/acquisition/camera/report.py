"""Accuracy of places on the plate, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from fixel.typing import FloatArray
from fixel.vision.measured_camera import MeasuredCamera
from fixel.vision.plane_errors import PlaneErrors, plane_errors

CORNERS: Final = ("upper left", "upper right", "lower left", "lower right")
FINE: Final = 3e-4  # [m] a bench with larger errors should be calibrated again


@final
@dataclass(frozen=True, slots=True)
class PlaceAccuracy:
    """Expected accuracy of places at one height.

    Attributes
    ----------
    errors : PlaneErrors
    typical, worst : float
        Radius that contains 95 % of the errors: median over the picture, and maximum [m].
    worst_at : str
        Part of the picture with the largest error: `upper left corner`.
    empty_corners : tuple of str
        Corners of the picture without a board nearby; all four if this is unknown.
    seen_known : bool
        Whether the places of the boards are known.
    """

    errors: PlaneErrors
    typical: float
    worst: float
    worst_at: str
    empty_corners: tuple[str, ...]
    seen_known: bool

    @property
    def sentence(self) -> str:
        """Accuracy in one sentence, for the user."""
        height = f"{1e3 * self.errors.height:g} mm above the plate"
        if not self.errors.known:
            return (
                f"How right a place {height} is cannot be said: nothing is known of the camera's "
                "errors"
            )
        parts = [
            f"A place {height} is right to {mm(self.typical)} (95 %), "
            f"worst {mm(self.worst)} in the {self.worst_at}"
        ]
        if self.seen_known:
            n = len(self.empty_corners)
            parts.append(
                "every corner of the picture had a board near"
                if not n
                else f"{n} of 4 corners had no board near ({', '.join(self.empty_corners)})"
            )
        return "; ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "height_m": self.errors.height,
            "known": self.errors.known,
            "typical_95_m": self.typical if self.errors.known else None,
            "worst_95_m": self.worst if self.errors.known else None,
            "worst_at": self.worst_at if self.errors.known else None,
            "corners_without_board": list(self.empty_corners) if self.seen_known else None,
            "sentence": self.sentence,
        }


def verdict(measured: MeasuredCamera, height: float) -> PlaceAccuracy:
    """Compute the expected accuracy of places at a height above the plate [m]."""
    errors = plane_errors(measured, height)
    worst = np.unravel_index(int(np.argmax(errors.whole)), errors.whole.shape)
    return PlaceAccuracy(
        errors=errors,
        typical=float(np.median(errors.whole)),
        worst=float(errors.whole.max()),
        worst_at=_part_of_picture(errors.pixels[worst], measured.lens.image_size),
        empty_corners=empty_corners(measured.seen),
        seen_known=bool(measured.seen.size),
    )


def empty_corners(seen: FloatArray) -> tuple[str, ...]:
    """Return the corners of the picture, a quarter of its sides wide, that no board reached."""
    if not seen.size:
        return CORNERS
    rows, columns = max(1, seen.shape[0] // 4), max(1, seen.shape[1] // 4)
    upper, lower = seen[:rows], seen[-rows:]
    parts = (upper[:, :columns], upper[:, -columns:], lower[:, :columns], lower[:, -columns:])
    return tuple(name for name, part in zip(CORNERS, parts, strict=True) if not part.any())


def mm(metres: float) -> str:
    """Format a length for reading: microns below a tenth of a millimetre."""
    return f"{1e3 * metres:.2g} mm" if metres >= 1e-4 else f"{1e6 * metres:.2g} um"


def _part_of_picture(pixel: FloatArray, size: tuple[int, int]) -> str:
    u, v = pixel / (np.array(size) - 1.0)
    down = "upper" if v < 0.25 else "lower" if v > 0.75 else ""
    across = "left" if u < 0.25 else "right" if u > 0.75 else ""
    if down and across:
        return f"{down} {across} corner"
    return f"{down or across} part of the picture" if down or across else "middle of the picture"
