"""Agreement of poses with the measurements of the camera and the fixels."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from fixel.kernels.measure import measure_gaps
from fixel.model import Scene
from fixel.simulation.geometry import pack_shapes
from fixel.typing import FloatArray

CLEAR: Final = 1e-3  # probability from which a contact is clear
FAR_GAP: Final = 5e-3  # [m] gaps beyond it are bounded, not measured


def contact_probability(gap: FloatArray, touch_gap: float, spread: FloatArray) -> FloatArray:
    """Return the probability that shapes touch, from the gap between them [-].

    A half at half of `touch_gap`; how far on both sides it is in between is given by `touch_gap`
    and by how uncertain the gap itself is.

    Parameters
    ----------
    gap : (n, n_fixel) float64
        [m]
    touch_gap : float
        [m]
    spread : (n, 1) float64
        Standard deviation of the gap [m].
    """
    width = np.sqrt((0.25 * touch_gap) ** 2 + spread**2)
    # The logistic function is the normal distribution's within 0.01 on this scale.
    return np.asarray(0.5 * (1.0 + np.tanh(0.851 * (0.5 * touch_gap - gap) / width)))


def lasting(contact: FloatArray, before: FloatArray, memory: FloatArray) -> FloatArray:
    """Return probabilities of contact (n, n_fixel) that remember those of the frame before.

    Where the pose is uncertain, it is as uncertain in the next frame, in the same direction: sixty
    frames at an unclear gap are one unknown, not sixty. Contacts that are clear remember nothing.

    Parameters
    ----------
    contact, before : (n, n_fixel) float64
        By the gaps now, and after the readings of the frame before.
    memory : (n, 1) float64
        Share of the old one that is kept [-].
    """
    unclear = (contact > CLEAR) & (contact < 1.0 - CLEAR)
    return np.asarray(np.where(unclear, contact + memory * (before - contact), contact))


def told(
    contact: FloatArray, ones: FloatArray, zeros: FloatArray, silent: float, heard: float
) -> tuple[FloatArray, FloatArray]:
    """Return the log likelihood of readings, and probabilities of contact after them (Bayes' rule).

    Parameters
    ----------
    contact : (n, n_fixel) float64
        Probability that there is contact, before the readings.
    ones, zeros : (n_fixel,) float64
        How often each fixel has read 1 and 0.
    silent, heard : float
        P(read 0 | no contact) and P(read 1 | contact) [-].

    Returns
    -------
    likelihood : (n,) float64
        Logarithm of the probability of the readings.
    contact : (n, n_fixel) float64
        Probability that there is contact, after the readings.
    """
    likely = contact * (heard**ones * (1.0 - heard) ** zeros)
    other = (1.0 - contact) * (silent**zeros * (1.0 - silent) ** ones)
    both = likely + other
    return np.asarray(np.sum(np.log(both), axis=1)), np.asarray(likely / both)


@final
class FixelGaps:
    """Distances from the object to every fixel, for many poses at a time.

    Parameters
    ----------
    scene : Scene
        With one free body.
    """

    def __init__(self, scene: Scene) -> None:
        pieces = [scene.bodies[0].shape, *(f.shape for f in scene.fixels)]
        shapes = pack_shapes(pieces)
        # Sizes of order one: the kernels' tolerances are meant for that.
        self._size = float(max(np.abs(shapes.vertex).max(), shapes.piece_radius.max()))
        self._shapes = shapes._replace(
            vertex=shapes.vertex / self._size, piece_radius=shapes.piece_radius / self._size
        )
        self._fixel = np.array([f.pose for f in scene.fixels]).reshape(-1, 3)
        reach = np.array([np.hypot(*shape.outline.T).max() for shape in pieces])
        self._reach = reach[0] + reach[1:]

    @property
    def n_fixel(self) -> int:
        """Number of fixels."""
        return len(self._fixel)

    def of(self, pose: FloatArray) -> FloatArray:
        """(n, n_fixel) gaps [m] at poses (n, 3); negative in overlap, lower bounds from 5 mm on."""
        away = pose[:, None, :2] - self._fixel[:, :2]
        gap = np.asarray(np.hypot(away[:, :, 0], away[:, :, 1]) - self._reach)
        row, fixel = np.nonzero(gap < FAR_GAP)
        if len(row) == 0:
            return gap
        first = np.column_stack((away[row, fixel] / self._size, pose[row, 2]))
        second = np.zeros_like(first)
        second[:, 2] = self._fixel[fixel, 2]
        found = measure_gaps(*self._shapes, np.zeros_like(fixel), 1 + fixel, first, second)
        gap[row, fixel] = self._size * found[:, 0]
        return gap
