"""Options that several capabilities share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, final

from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.calibration.noise import Noise
    from fixel.simulation.motion import AbstractMotionModel

Seed = Annotated[int, Door(least=0)]
Threads = Annotated[int | None, Door(least=1, effort=True)]
Names = tuple[str, ...]
MotionName = Annotated[
    "AbstractMotionModel | str | None",
    Door(plain=str | None, alias="--engine", metavar="NAME", program=True),
]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseSizes:
    """Standard deviations of measured poses.

    Attributes
    ----------
    position_m : float
        Standard deviation of measured positions; estimated by default.
    angle_rad : float
        Standard deviation of measured angles; estimated by default.
    """

    position_m: Annotated[float, Door(above=0.0, unit="mm")]
    angle_rad: Annotated[float, Door(above=0.0, unit="mrad")]

    def build(self) -> Noise:
        """Return the noise for a calibration."""
        from fixel.calibration.noise import Noise

        return Noise(position_m=self.position_m, angle_rad=self.angle_rad)


NoiseOption = Annotated["Noise | None", Door(plain=NoiseSizes | None)]
