"""Proposed next pushes of a part, by what they tell about the ends of others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class NextPushes(Result):
    """Proposed next pushes of a part; made by `PartModel.next_pushes`.

    Attributes
    ----------
    order : tuple of int
        Indices of the candidates, the best first.
    names : tuple of str
        Names of these candidates.
    variance : (k + 1,) float64
        Mean variance of the predicted ends of the intended pushes before the first and after each
        [m^2]; angles at 35 mm/rad.
    misfit : float
        Typical error that no push of the part removes [m].
    position, angle : float
        Mean typical bound of the intended pushes now [m], [rad]; inf without a bound.
    candidates : int
        Number of candidates.
    pushes : int
        Number of pushes of the part that were made.
    start, end : (k, 2) float64
        Start and end of the pusher's centre in each proposed push [m].
    """

    _drawings: ClassVar[Mapping[str, str]] = {"pushes": "fixel.drawing.parts:draw_next"}

    order: tuple[int, ...]
    names: tuple[str, ...]
    variance: FloatArray
    misfit: float
    position: float
    angle: float
    candidates: int
    pushes: int
    start: FloatArray
    end: FloatArray

    @property
    def shrinking(self) -> FloatArray:
        """Expected ratios (k,) of the bound after each push to the bound now."""
        total = self.misfit**2 + self.variance
        return np.asarray(np.sqrt(total[1:] / total[0]))

    def _name(self, k: int) -> str:
        name = self.names[k]
        return f"candidate {self.order[k] + 1}" if name == "scene" else name

    def _summary(self) -> Summary:
        rows = []
        for k, ratio in enumerate(self.shrinking.tolist()):
            way = self.end[k] - self.start[k]
            rows.append(
                (k + 1, self._name(k),
                 1e3 * self.start[k, 0], 1e3 * self.start[k, 1],
                 math.degrees(math.atan2(way[1], way[0])), 1e3 * float(np.hypot(*way)),
                 1e3 * self.position * ratio, math.degrees(self.angle) * ratio)
            )  # fmt: skip
        number = (Column(name, format=".1f") for name in
                  ("x [mm]", "y [mm]", "direction [deg]", "travel [mm]"))  # fmt: skip
        bounds = (Column("bound [mm]", format=".2f"), Column("[deg]", format=".2f"))
        now = f"{1e3 * self.position:.2f} mm, {math.degrees(self.angle):.2f} deg"
        return Summary(
            f"NextPushes: {len(rows)} of {self.candidates} candidates, after {self.pushes} pushes",
            [Table(("", "push", *number, *bounds), rows)],
            [f"mean typical bound of the intended pushes: {now} now; expected after each above"],
        )
