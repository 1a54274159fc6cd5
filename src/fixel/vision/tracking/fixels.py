"""Where the fixels stand, from the rims of their tops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from fixel.kernels.arrays import FloatArray
from fixel.model import Disk, Fixel
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.tracking.outline import Edges, Fit, circle_edges, fit_pose
from fixel.vision.tracking.tracked import FoundFixel

REACH_FIRST: Final = 12.0  # [px] from where the scene has it
REACH: Final = 4.0
LEAST_SHARE: Final = 0.45  # of a rim
MOST_RESIDUAL: Final = 0.6  # [px]
LEAST: Final = 3  # frames that a place is worth something from


@final
class FixelFinder:
    """Measures fixels in some frames of a film.

    Tops may be darker or brighter than the plate: what fits better counts. Where the side of the
    cylinder shows, its edge is another one, and is left out as such.
    """

    def __init__(self, rig: Rig, fixels: Sequence[Fixel]) -> None:
        self._camera = rig.camera
        self._height = rig.fixel_height
        self._fixels = [fixel for fixel in fixels if isinstance(fixel.shape, Disk)]
        self._found: dict[str, list[FloatArray]] = {f.name: [] for f in self._fixels}

    def see(self, frame: Frame) -> None:
        """Measure what shows in a frame."""
        for fixel in self._fixels:
            assert isinstance(fixel.shape, Disk)
            before = self._found[fixel.name]
            start = np.append(before[-1] if before else fixel.pose[:2], 0.0)
            fits = [
                self._fit(
                    frame,
                    circle_edges(fixel.shape.radius, self._height, dark_inside=dark),
                    start,
                    REACH if before else REACH_FIRST,
                )
                for dark in (True, False)
            ]
            good = [fit for fit in fits if fit is not None]
            if good:
                best = max(good, key=lambda fit: fit.share - fit.residual)
                before.append(best.pose[:2])

    def _fit(self, frame: Frame, edges: Edges, start: FloatArray, reach: float) -> Fit | None:
        fit = fit_pose(frame.luma, self._camera, edges, start, reach=reach, turns=False)
        if fit is None or fit.share < LEAST_SHARE or fit.residual > MOST_RESIDUAL:
            return None
        return fit

    def found(self) -> tuple[FoundFixel, ...]:
        """Fixels that were measured often enough."""
        result = []
        for name, places in self._found.items():
            if len(places) < LEAST:
                continue
            place = np.median(places, axis=0)
            scatter = float(np.sqrt(np.mean(np.sum((np.array(places) - place) ** 2, axis=1))))
            result.append(FoundFixel(name=name, place=place, scatter=scatter, n=len(places)))
        return tuple(result)
