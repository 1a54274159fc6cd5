"""Straight pushes of the MIT push dataset as arrays, prepared for thousands of simulations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.datasets.contact import moved_to_contact
from fixel.datasets.mit_push import NOMINAL, MitPushes
from fixel.datasets.mit_push_records import TIP
from fixel.model import (
    PathDrive,
    Pusher,
    Scene,
    Support,
    SupportPoints,
    UniformPressure,
    wrapped,
)
from fixel.model.support import support_grid
from fixel.simulation import StewartTrinkle
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.load_profile import PROFILE_NAMES, TABLE_NAMES, LoadNet, factors_on_table
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import BoolArray, FloatArray, IntArray

# Quasi-static pushes do not depend on time: all are simulated at one speed [s], in steps of 1 mm.
# Steps of 0.5 mm gave the same held-out errors within 0.01 mm and 0.01 degrees.
DURATION: Final = 5.0
STEP: Final = 0.1
# The correction of an overlap at the start fades over this share of the stroke.
FADE: Final = 0.1

# Names of logarithmic factors on the loads of a part of the net, relative to edges, or to the
# inside if the outline is smooth; they describe irregularities of plates and tables.
PART_NAMES: Final = {"corner": "at_corners", "inside": "inside", "ring": "at_rim"}
_ON_LOADS: Final = (*TABLE_NAMES, *PROFILE_NAMES, *PART_NAMES.values())

Key = tuple[str, str]  # surface, shape
Tracker = Callable[[IntArray, Mapping[str, FloatArray]], tuple[FloatArray, BoolArray]]


class PushEnds(NamedTuple):
    """End poses of simulated pushes."""

    end: FloatArray  # (n, 3) pose of the object [m, m, rad]
    good: BoolArray  # (n,) whether the simulation converged


@final
class PushGroup:
    """Pushes of one plate on one surface, at all speeds.

    Parameters
    ----------
    data : MitPushes
    key : (str, str)
        Surface and shape.
    rows : (n,) int
        Rows of the data.
    threads : int, optional
        Number of threads; by default all cores.
    """

    def __init__(
        self, data: MitPushes, key: Key, rows: IntArray, threads: int | None = None
    ) -> None:
        self.key = key
        self.rows = rows
        self.body = data.bodies[key[1]]
        self.shape = self.body.shape
        self.start, self.end = data.start[rows], data.end[rows]
        self.tip_start, self.tip_end = data.tip_start[rows], data.tip_end[rows]
        self.points, self._part = support_grid(self.shape)
        self._load_net = LoadNet.of(self.shape)
        friction = NOMINAL["mu_support"]
        even = UniformPressure(friction=friction, n_points=int(NOMINAL["support_points"]))
        stepper = StewartTrinkle(step=STEP)
        paths = self._paths()
        self._even = Ensemble(self._cases(even, paths), stepper=stepper, threads=threads)
        points = SupportPoints(points=self.points, friction=friction)
        self.cases = self._cases(points, paths)
        self._net = Ensemble(self.cases, stepper=stepper, threads=threads)
        self.nominal = self._nominal()
        turned = wrapped(self.nominal.end[:, 2] - self.start[:, 2])
        # Loads are those half way through a push, at the angle estimated with even pressure.
        self.middle = self.start[:, 2] + 0.5 * np.where(self.nominal.good, turned, 0.0)

    def __len__(self) -> int:
        return len(self.rows)

    def simulate(self, which: IntArray, values: Mapping[str, FloatArray]) -> PushEnds:
        """Simulate members on the net of support points.

        Parameters
        ----------
        which : (n,) int
            Indices of the members.
        values : mapping of name to (n,) float64
            Parameters of the scene, and those in `TABLE_NAMES` and `PART_NAMES`.
        """
        outcome = self._net.simulate(which, self._given(which, values))
        return PushEnds(outcome.pose[:, -1], outcome.converged)

    def ends(self, which: IntArray, values: Mapping[str, float]) -> FloatArray:
        """Simulate members with equal values; end poses (n, 3) are NaN without convergence."""
        found = self.simulate(which, {name: np.full(len(which), x) for name, x in values.items()})
        return np.where(found.good[:, None], found.end, np.nan)

    def tracks(self, samples: int, threads: int | None = None) -> Tracker:
        """Create a function like `simulate` that returns poses (n, samples, 3) of the object at
        equal intervals, and a mask (n,) of converged simulations."""
        times = DURATION * np.arange(1, samples + 1) / samples
        cases = [case._replace(times=times) for case in self.cases]
        ensemble = Ensemble(cases, stepper=StewartTrinkle(step=STEP), threads=threads)

        def track(
            which: IntArray, values: Mapping[str, FloatArray]
        ) -> tuple[FloatArray, BoolArray]:
            outcome = ensemble.simulate(which, self._given(which, values))
            return outcome.pose, outcome.converged

        return track

    def _given(self, which: IntArray, values: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Convert factors on loads to parameters of the scene."""
        given = {name: v for name, v in values.items() if name not in _ON_LOADS}
        if any(name in values for name in _ON_LOADS):
            given |= self._loads(which, values)
        return given

    def _loads(self, which: IntArray, values: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        middle, centroid = self.middle[which], self.shape.centroid
        if any(name in values for name in PROFILE_NAMES):
            factor = self._load_net.shares(values, self.body.com, middle, centroid)
            factor = factor * len(self.points)
        else:
            factor = factors_on_table(self.points - centroid, middle, values)
        for part, name in PART_NAMES.items():
            if name in values:
                factor[:, self._part == part] *= np.exp(values[name])[:, None]
        names = [f"load_{k + 1}" for k in range(len(self.points))]
        return {name: values.get(name, 1.0) * factor[:, k] for k, name in enumerate(names)}

    def _nominal(self) -> PushEnds:
        """Simulate uncalibrated pushes: even pressure, friction as in the published simulator."""
        n = len(self.rows)
        mu = np.full(n, NOMINAL["mu_pusher"])
        outcome = self._even.simulate(np.arange(n), {"mu_pusher": mu})
        return PushEnds(outcome.pose[:, -1], outcome.converged)

    def _paths(self) -> FloatArray:
        """Waypoints (n, 3, 4) of the tips, moved out of the object at the start."""
        begin, way = self.tip_start, self.tip_end - self.tip_start
        _, offset = moved_to_contact(self.shape, TIP.radius, self.start, begin)
        path = np.zeros((len(begin), 3, 4))
        path[:, :, 0] = DURATION * np.array([0.0, FADE, 1.0])
        path[:, 0, 1:3] = begin + offset
        path[:, 1, 1:3] = begin + FADE * way
        path[:, 2, 1:3] = begin + way
        return path

    def _cases(self, support: Support, paths: FloatArray) -> list[RolloutCase]:
        body = replace(self.body, support=support)
        times = np.array([DURATION])
        return [
            RolloutCase(
                Scene(
                    bodies=(replace(body, pose=start),), pushers=(_pusher(path),), duration=DURATION
                ),
                times,
            )
            for start, path in zip(self.start, paths, strict=True)
        ]


def _pusher(path: FloatArray) -> Pusher:
    return Pusher(
        name="pusher",
        shape=TIP,
        pose=path[0, 1:],
        drive=PathDrive(waypoints=path),
        friction=NOMINAL["mu_pusher"],
    )


def rows_by_key(data: MitPushes, rows: IntArray) -> dict[Key, IntArray]:
    """Rows of each surface and shape, sorted by their names."""
    surface, shape = data.surface.tolist(), data.shape.tolist()
    keys = [(surface[row], shape[row]) for row in rows.tolist()]
    return {
        key: np.array([r for r, own in zip(rows.tolist(), keys, strict=True) if own == key])
        for key in sorted(set(keys))
    }
