"""Options of a sensitivity analysis, and its result for one push."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

from fixel.model import Scene
from fixel.simulation import AbstractMotionModel
from fixel.simulation.stepper import AbstractStepper
from fixel.uncertainty.outcomes import Sensitivity
from fixel.uncertainty.starts import StartError


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityRequest:
    """Options of a sensitivity analysis.

    Parameters
    ----------
    error : StartError
    samples : int
        Number of perturbed starts per push.
    values : mapping of str to float
        Parameters that override those of a calibration.
    ranges : mapping of str to (float, float)
        Further uncertain inputs of the indices; they override a calibration's intervals.
    calibration : int, optional
        Id; for stored experiments by default the newest; without any, the scene's own values.
    engine : str
        Engine whose newest calibration is used, and that simulates scene files.
    indices : bool
    base : int
        Base samples of the indices, a power of two.
    seed : int
    threads : int, optional
    """

    error: StartError
    samples: int = 1000
    values: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    calibration: int | None = None
    engine: str = ""
    indices: bool = False
    base: int = 128
    seed: int = 0
    threads: int | None = None

    def question(self, keys: Sequence[str]) -> dict[str, Any]:
        """Return the request as plain content."""
        return {
            "of": list(keys),
            "error": [*self.error.size.tolist(), self.error.kind],
            "samples": self.samples,
            "values": dict(self.values),
            "ranges": {name: list(interval) for name, interval in self.ranges.items()},
            "calibration": self.calibration,
            "engine": self.engine,
            "indices": self.base if self.indices else None,
            "seed": self.seed,
        }


class Subject(NamedTuple):
    """Push to analyse."""

    key: str
    id: int | None  # id of a stored experiment
    scene: Scene
    values: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    motion: AbstractMotionModel
    stepper: AbstractStepper | None
    banner: str


class Finding(NamedTuple):
    """Sensitivity of one push."""

    subject: Subject
    sensitivity: Sensitivity
