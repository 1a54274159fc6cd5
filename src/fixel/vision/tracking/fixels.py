"""Measurement of the places of fixels from the rims of their tops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from fixel.model import Disk, Fixel
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.tracking.outline import OutlineEdges, PoseFit, circle_edges, fit_pose, window_of
from fixel.vision.tracking.tracked import FoundFixel

REACH_FIRST: Final = 10.0  # [px] from its place in the scene
FIXEL_REACH: Final = 4.0
# Radii of visible rings as shares of the fixel's radius: a turned end has concentric rings. The
# radius of the clearest one is fitted with its place, since a wrong radius would bias the place
# where the side of the cylinder hides part of the ring.
RINGS: Final = (1.0, 0.92, 0.85, 0.78, 0.7, 0.62)
WIDEST, NARROWEST = 1.1, 0.5
LOOKS: Final = 4  # fits of a ring, each with the radius of the one before
SAME_RADIUS: Final = 0.02  # [px] change of radius at which the fits have converged
MIN_SHARE: Final = 0.45  # of a ring
MAX_RESIDUAL: Final = 0.5  # [px]
MIN_FRAMES: Final = 3  # least number of frames for a place

Ring = tuple[float, bool]  # share of the radius, and whether it is dark inside


@final
class FixelFinder:
    """Measurement of fixels in some frames of a film.

    The clearest ring of the top, dark or bright inside, is chosen where a fixel is first seen. The
    edge of the cylinder's side differs from it, and is left out.
    """

    def __init__(self, rig: Rig, fixels: Sequence[Fixel]) -> None:
        self._camera = rig.camera
        self._height = rig.fixel_height
        self._scale = rig.camera.metres_per_pixel(rig.fixel_height)
        self._fixels = [fixel for fixel in fixels if isinstance(fixel.shape, Disk)]
        self._found: dict[str, list[FloatArray]] = {f.name: [] for f in self._fixels}
        self._rings: dict[str, Ring] = {}

    def see(self, frame: Frame) -> None:
        """Measure the visible fixels in a frame."""
        for fixel in self._fixels:
            places = self._found[fixel.name]
            if places:
                rings, start, reach = [self._rings[fixel.name]], places[-1], FIXEL_REACH
            else:
                rings = [(share, dark) for share in RINGS for dark in (True, False)]
                start, reach = fixel.pose[:2], REACH_FIRST
            fits = [self._fit(frame, fixel, ring, start, reach) for ring in rings]
            good = [fit for fit in fits if fit is not None]
            if good:
                fit, ring = max(good, key=lambda each: each[0].share - each[0].residual)
                self._rings[fixel.name] = ring
                places.append(fit.pose[:2])

    def _fit(
        self, frame: Frame, fixel: Fixel, ring: Ring, start: FloatArray, reach: float
    ) -> tuple[PoseFit, Ring] | None:
        """Fit place and radius of a ring; None where it is not clear."""
        assert isinstance(fixel.shape, Disk)
        share, dark = ring
        pose, fit = np.append(start, 0.0), None
        for _ in range(LOOKS):
            edges = circle_edges(share * fixel.shape.radius, self._height, dark_inside=dark)
            window = window_of(frame, self._camera, edges, pose, reach)
            if window is None:
                return None
            fit = fit_pose(
                window[0], self._camera, edges, pose, reach=reach, turns=False, corner=window[1]
            )
            if fit is None:
                return None
            wider = _wider(edges, fit) if dark else -_wider(edges, fit)
            share += wider * self._scale / fixel.shape.radius
            if not NARROWEST < share < WIDEST:
                return None
            pose, reach = fit.pose, FIXEL_REACH
            if abs(wider) < SAME_RADIUS:
                break
        if fit is None or fit.share < MIN_SHARE or fit.residual > MAX_RESIDUAL:
            return None
        return fit, (share, dark)

    def found(self) -> tuple[FoundFixel, ...]:
        """Return the fixels that were measured often enough."""
        result = []
        for name, places in self._found.items():
            if len(places) < MIN_FRAMES:
                continue
            place = np.median(places, axis=0)
            scatter = float(np.sqrt(np.mean(np.sum((np.array(places) - place) ** 2, axis=1))))
            result.append(FoundFixel(name=name, place=place, scatter=scatter, n=len(places)))
        return tuple(result)


def _wider(edges: OutlineEdges, fit: PoseFit) -> float:
    """Excess of the radius found over that of `edges`, for any middle [px]."""
    slope = np.column_stack((np.ones(len(edges.outward)), edges.outward))[fit.used]
    return float(np.linalg.lstsq(slope, fit.found[fit.used, 0], rcond=None)[0][0])
