"""Straight pushes of the MIT push dataset as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.mit_plates import MU_PUSHER, MU_SUPPORT
from fixel.datasets.mit_push import LARGEST_GAP, STROKE, MitPush, published_ends
from fixel.errors import InvalidInput
from fixel.model import Body, Experiment
from fixel.typing import BoolArray, FloatArray, IntArray

# Nothing is fitted: friction at the tip as in the published simulator, even pressure. Friction of
# the plane has no effect on quasi-static motion.
NOMINAL: Final = {"mu_pusher": MU_PUSHER, "mu_support": MU_SUPPORT, "support_points": 64}

# A larger difference from the nominal stroke means that a record contradicts itself [m].
MAX_STROKE_ERROR: Final = 1e-3


@final
@dataclass(frozen=True)
class MitPushes:
    """Imported pushes of the end-point set; every array has one row for each.

    Attributes
    ----------
    names, surface, shape : (n,) str
    bodies : mapping from shape to Body
        Plates, with their outlines in the frame of the dataset's poses.
    start, end : (n, 3) float64
        Measured poses of the object [m, m, rad].
    tip_start, tip_end : (n, 2) float64
        Measured centres of the tip [m].
    speed : (n,) float64
        Speed of the tip [m/s].
    gap_start, gap_end : (n,) float64
        Gap from the surface of the tip to the outline [m].
    published : mapping from name to (n, 3) float64
        End pose by the published simulator, one per limit surface; NaN if missing.
    experiments : tuple of Experiment
        The imported pushes, in the same order.
    """

    names: NDArray[np.str_]
    surface: NDArray[np.str_]
    shape: NDArray[np.str_]
    bodies: Mapping[str, Body]
    start: FloatArray
    end: FloatArray
    tip_start: FloatArray
    tip_end: FloatArray
    speed: FloatArray
    gap_start: FloatArray
    gap_end: FloatArray
    published: dict[str, FloatArray]
    experiments: tuple[Experiment, ...]

    def __len__(self) -> int:
        return len(self.start)

    @cached_property
    def astray(self) -> BoolArray:
        """Mask (n,) of pushes with a gap that contradicts their own geometry."""
        return (np.abs(self.gap_start) > LARGEST_GAP) | (self.gap_end < -LARGEST_GAP)

    @cached_property
    def short(self) -> BoolArray:
        """Mask (n,) of other pushes with a stroke that is not the nominal one."""
        stroke = np.hypot(*(self.tip_end - self.tip_start).T)
        return np.asarray((np.abs(stroke - STROKE) > MAX_STROKE_ERROR) & ~self.astray)

    @property
    def usable(self) -> IntArray:
        """Rows that are consistent with their own geometry."""
        return np.flatnonzero(~self.astray & ~self.short)


def read_mit_pushes(folder: Path) -> MitPushes:
    """Import the end-point set of the MIT push dataset."""
    experiments = list(MitPush().read(folder).experiments())
    bodies: dict[str, Body] = {}
    for experiment in experiments:
        if experiment.scene is not None:
            bodies.setdefault(str(experiment.conditions["shape"]), experiment.scene.bodies[0])

    def condition(name: str) -> NDArray[np.generic]:
        return np.array([experiment.conditions[name] for experiment in experiments])

    shape = np.asarray(condition("shape"), dtype=np.str_)
    for name in np.unique(shape).tolist():
        if name not in bodies:
            raise InvalidInput(
                f"{folder.name}: {name}",
                found="no push that starts outside the plate",
                expected="at least one",
            )
    poses = np.array([experiment.trajectory.pose for experiment in experiments])
    tips = np.array([e.pusher.pose[:, :2] for e in experiments if e.pusher is not None])
    return MitPushes(
        names=np.array([experiment.name for experiment in experiments]),
        surface=np.asarray(condition("surface"), dtype=np.str_),
        shape=shape,
        bodies=bodies,
        start=poses[:, 0],
        end=poses[:, -1],
        tip_start=tips[:, 0],
        tip_end=tips[:, -1],
        speed=np.asarray(condition("speed_m_s"), dtype=np.float64),
        gap_start=np.asarray(condition("gap0_m"), dtype=np.float64),
        gap_end=np.asarray(condition("gap1_m"), dtype=np.float64),
        published=published_ends(folder, [experiment.name for experiment in experiments]),
        experiments=tuple(experiments),
    )
