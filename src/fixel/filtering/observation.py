"""How well a pose agrees with what the camera saw and what the fixels felt."""

from __future__ import annotations

from typing import final

import numpy as np

from fixel.kernels.measure import measure_gaps
from fixel.model import Scene, wrapped
from fixel.model.fields import FloatArray
from fixel.simulation.geometry import pack_shapes


def squared_distance(
    pose: FloatArray, seen: FloatArray, position_deviation: float, angle_deviation: float
) -> FloatArray:
    """(n,) squared deviations of poses (n, 3) from one that was seen (3,), in standard deviations.

    The logarithm of the camera's likelihood is minus half of it.
    """
    away = pose - seen
    position = np.sum(away[:, :2] ** 2, axis=1) / position_deviation**2
    return np.asarray(position + (wrapped(away[:, 2]) / angle_deviation) ** 2)


def tactile_log_likelihood(
    contact: FloatArray, touches: FloatArray, silent: float, heard: float
) -> FloatArray:
    """(n,) logarithm of the probability of readings, given which fixels each particle touches.

    Parameters
    ----------
    contact : (n, n_fixel) float64
        Probability that there is contact, from `contact_probability`.
    touches : (n_fixel,) float64
        Readings, 1 for contact; NaN where there was none.
    silent, heard : float
        P(read 0 | no contact) and P(read 1 | contact) [-].
    """
    one = contact * heard + (1.0 - contact) * (1.0 - silent)
    probability = np.where(touches > 0.5, one, 1.0 - one)
    return np.asarray(np.sum(np.where(np.isnan(touches), 0.0, np.log(probability)), axis=1))


def contact_probability(gap: FloatArray, touch_gap: float) -> FloatArray:
    """1 where shapes touch, 0 from a gap of `touch_gap` on, linear between [-].

    One frame of a push may be half a millimetre long. With a sharp edge, the frame or two in which
    a particle is within the edge but the object does not touch yet would cost it a factor of 77
    each.
    """
    return np.asarray(np.clip(1.0 - gap / touch_gap, 0.0, 1.0))


@final
class FixelGaps:
    """Distances from the object to every fixel, for many poses at a time.

    Parameters
    ----------
    scene : Scene
        With one free body.
    """

    def __init__(self, scene: Scene) -> None:
        shapes = pack_shapes([scene.bodies[0].shape, *(f.shape for f in scene.fixels)])
        # Sizes of order one: the kernels' tolerances are meant for that.
        self._size = float(max(np.abs(shapes.vertex).max(), shapes.piece_radius.max()))
        self._shapes = shapes._replace(
            vertex=shapes.vertex / self._size, piece_radius=shapes.piece_radius / self._size
        )
        self._fixel = np.array([f.pose for f in scene.fixels]).reshape(-1, 3)

    @property
    def n_fixel(self) -> int:
        """How many fixels there are."""
        return len(self._fixel)

    def of(self, pose: FloatArray) -> FloatArray:
        """(n, n_fixel) gaps [m] at poses (n, 3); negative in overlap."""
        n, n_fixel = len(pose), self.n_fixel
        if n_fixel == 0:
            return np.zeros((n, 0))
        apart = np.zeros((n, n_fixel, 3))
        apart[:, :, :2] = (pose[:, None, :2] - self._fixel[:, :2]) / self._size
        apart[:, :, 2] = pose[:, None, 2]
        about = np.zeros((n * n_fixel, 3))
        about[:, 2] = np.tile(self._fixel[:, 2], n)
        second = np.tile(np.arange(1, n_fixel + 1), n)
        found = measure_gaps(
            *self._shapes, np.zeros_like(second), second, apart.reshape(-1, 3), about
        )
        return np.asarray(self._size * found[:, 0].reshape(n, n_fixel))
