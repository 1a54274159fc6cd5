"""Options that several capabilities share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from fixel.capability.options import Door, Option

if TYPE_CHECKING:
    from fixel.calibration.noise import Noise
    from fixel.simulation.motion import AbstractMotionModel

Seed = Annotated[int, Door(least=0, meaning="Seed of the random numbers.")]
Level = Annotated[float, Door(above=0.0, below=1.0)]
Threads = Annotated[int | None, Door(least=1, effort=True)]
Save = Annotated[bool, Door(effort=True)]
MotionName = Annotated["AbstractMotionModel | str | None", Door(plain=str | None, metavar="MODEL")]

# Parameters to calibrate, and a stored calibration.
Fit = Annotated[tuple[str, ...], Door(metavar="NAME[=LOW:HIGH[:START]]")]
CalibrationId = Annotated[int | None, Door(metavar="ID", least=1)]

# Options that select experiments.
Dataset = Annotated[str, Door(metavar="NAME", meaning="Select only experiments of this dataset.")]
Where = Annotated[
    tuple[str, ...],
    Door(
        metavar="FILTER",
        meaning='Select experiments that match, such as "surface=abs error>5 real"; '
        "may be repeated.",
    ),
]
Flagged = Annotated[bool, Door(flag="--all", meaning="Include experiments whose data have faults.")]
Names = Annotated[Sequence[str], Door(plain=tuple[str, ...], metavar="NAME[,NAME]", commas=True)]
# Engine of a stored calibration, or of its simulations; empty for none.
EngineName = Annotated[str, Door(metavar="NAME", program=True)]
# A model of fixel, another engine, or the path of a program, under either flag.
Motion = Annotated[
    "AbstractMotionModel | str | None",
    Door(plain=str | None, metavar="NAME", also=("--engine",), program=True),
]


@dataclass(frozen=True, slots=True)
class StatedNoise:
    """Noise of measured poses, as a request states it.

    Attributes
    ----------
    position_m : float
        Standard deviation of measured positions.
    angle_rad : float
        Standard deviation of measured angles.
    """

    position_m: Annotated[float, Door(unit="mm")]
    angle_rad: Annotated[float, Door(unit="mrad")]

    def build(self) -> Noise:
        """Return the noise for Python."""
        from fixel.calibration.noise import Noise

        return Noise(position_m=self.position_m, angle_rad=self.angle_rad)


NoiseOption = Annotated["Noise | None", Door(plain=StatedNoise | None, usual="estimated")]

# Option of a capability whose experiments may stand on a mapped table.
TABLE: Final = Option(
    name="table",
    plain=Path | None,
    default=None,
    meaning="Map of an uneven table, saved by fixel table map, for the experiments on it.",
)
