"""Scenes that are packed once and simulated repeatedly with varying parameters.

A calibration makes thousands of short calls, each with a few parameter sets on many scenes. Scenes
that differ only in start poses and in the pusher's path share one template.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.kernels.arrays import REACHED, SAMPLES, BatchRecord
from fixel.model import Pusher, Scene
from fixel.model.scene import check_push
from fixel.simulation.motion import AbstractMotionModel, QuasiStatic
from fixel.simulation.pack import PackedBatch, Template, fastest_motion, pusher_path, stack
from fixel.simulation.rollouts import INFEASIBLE, EnsembleOutcome, RolloutCase
from fixel.simulation.simulate import check_compiled, method_of
from fixel.simulation.stepping import AbstractStepper, Adaptive, Newton
from fixel.simulation.threads import empty_record, hold_last, rollout_in_threads, shape_poses
from fixel.simulation.vary import Variation, infeasible
from fixel.typing import FloatArray, IntArray

# Largest number of poses recorded in one pass by all rollouts; more need several passes.
MAX_POSES = 300_000
# The same if poses are recorded without velocities and forces.
MAX_BARE_POSES = 5 * MAX_POSES


# Receives numbers (k,) of rollouts of one template, which are packed like this, and their record.
_Use = Callable[[IntArray, PackedBatch, BatchRecord], None]


class Ensemble:
    """Set of scenes that are simulated many times, each with one free body and at most one pusher.

    Results depend bit for bit on a case, its parameters and the method only: not on other cases,
    their order or the number of threads, by default that of the cores. The method is by default
    `QuasiStatic()` and `Adaptive()`, with `Newton()`. Outcomes of `several` bodies are the first's.
    """

    def __init__(
        self,
        cases: Sequence[RolloutCase],
        motion: AbstractMotionModel | None = None,
        stepper: AbstractStepper | None = None,
        threads: int | None = None,
        several: bool = False,
    ) -> None:
        self.motion = motion or QuasiStatic()
        self.stepper = stepper or Adaptive()
        check_compiled(self.motion, self.stepper, Newton())
        if not cases:
            raise InvalidInput("cases", found="none", expected="at least one")
        for case in cases:
            _check_case(case, several)
        self.cases = tuple(cases)
        self._threads = threads
        polygons = any(case.scene.support_directions for case in cases)
        self._method = method_of(self.motion, self.stepper, Newton(), 4096, polygons)
        # Hashing and comparing scenes takes long: once for each case.
        number: dict[Any, int] = {}
        groups = [number.setdefault(_key(case.scene), len(number)) for case in cases]
        self._group, firsts = np.array(groups), np.unique(groups, return_index=True)[1]
        self._templates = [self._template(cases[k].scene) for k in firsts]
        self._start = np.array([[body.pose for body in case.scene.bodies] for case in cases])
        self._duration = np.array([case.times[-1] for case in cases])
        self._place, self._paths = self._stacked_paths()
        longest = max(len(case.times) for case in cases)
        self._times = np.array(
            [np.pad(c.times, (0, longest - len(c.times)), "edge") for c in cases], np.float64
        )

    @classmethod
    def of_pushes(
        cls,
        scene: Scene,
        start: FloatArray,
        path: FloatArray,
        n_sample: int,
        *,
        motion: AbstractMotionModel | None = None,
        stepper: AbstractStepper | None = None,
        threads: int | None = None,
    ) -> Ensemble:
        """Return an ensemble of pushes of one scene with one pusher, without a scene for each.

        They have start poses (n, 3) or (n, n_free, 3) of the free bodies [m, m, rad], paths
        (n, n_waypoint, 4) of the pusher [s, m, m, rad], at whose ends they end, and `n_sample`
        samples at equal intervals.
        """
        share = np.arange(1, n_sample + 1) / n_sample
        times = path[:, -1, :1] * share
        case = RolloutCase(scene, times[0])
        own = cls([case], motion, stepper, threads=threads, several=True)
        own._group = np.zeros(len(start), np.int64)
        own._start = start.reshape(len(start), -1, 3)
        own._duration, own._times = times[:, -1], times
        own._place, own._paths = np.arange(len(start)), [path]
        return own

    @property
    def n_sample(self) -> int:
        """Number of samples of the case that has the most."""
        return int(self._times.shape[1])

    def simulate(
        self, which: IntArray, values: Mapping[str, FloatArray], fixels: FloatArray | None = None
    ) -> EnsembleOutcome:
        """Simulate cases by their indices `which` (n,) under parameters (n,) by name.

        `fixels` (n, n_fixel, 3) are added to the poses of the fixels [m, m, rad]; `n_fixel` is at
        least the number of fixels of every case, and further rows are ignored. Raises
        `InvalidInput` for another shape, or a number that is not finite.
        """
        if fixels is not None:
            fixels = self._checked_fixels(fixels, len(which))
        n = len(which)
        ends = self._start[which]
        pose = np.repeat(ends[:, :1], self.n_sample, axis=1)
        force, stalled = np.zeros(n), np.zeros(n, bool)

        def store(own: IntArray, packed: PackedBatch, record: BatchRecord) -> None:
            track = _tracks(packed, record)
            pose[own], ends[own] = track[:, :, 0], track[:, -1]
            drive = record.drive.max(axis=2, initial=0.0)  # zeros after an early stop
            force[own] = drive[:, :, 0].max(axis=1) * packed.units.force
            last = np.maximum(record.count[:, SAMPLES] - 1, 0)
            stalled[own] = drive[np.arange(len(own)), last, 1] > 0.0

        status, reached, reasons = self._run(which, values, store, fixels)
        return EnsembleOutcome(status, pose, reached, force, stalled, reasons, ends[:, 1:])

    def simulate_into(
        self,
        use: Callable[[IntArray, FloatArray], None],
        which: IntArray,
        values: Mapping[str, FloatArray],
    ) -> tuple[NDArray[np.bool_], list[str]]:
        """Simulate cases under parameters, and pass their poses to a function at once.

        This is faster than `simulate` for functions that reduce poses to a few numbers: all threads
        share their work too, and neither forces nor all poses are stored. Several threads call
        ``use(rollouts, pose)``, each time with the numbers (k,) of other rollouts and their poses
        (k, n_sample, 3), without infeasible ones. Returns which converged (n,), and reasons why
        others have no simulation or ended early; empty for those that converged.
        """

        def pass_on(own: IntArray, packed: PackedBatch, record: BatchRecord) -> None:
            use(own, _tracks(packed, record)[:, :, 0])

        status, _, reasons = self._run(which, values, pass_on, bare=True)
        return np.equal(status, codes.CONVERGED), reasons

    def _checked_fixels(self, fixels: FloatArray, n: int) -> FloatArray:
        least = max(len(case.scene.fixels) for case in self.cases)
        found = np.asarray(fixels, np.float64)
        fits = found.ndim == 3 and found.shape[::2] == (n, 3) and found.shape[1] >= least
        if not fits or not np.isfinite(found).all():
            raise InvalidInput(
                "fixels",
                found=f"shape {found.shape}" + (", not all finite" if fits else ""),
                expected=f"finite numbers of shape ({n}, {least}, 3)",
            )
        return found

    def _run(
        self,
        which: IntArray,
        values: Mapping[str, FloatArray],
        use: _Use,
        fixels: FloatArray | None = None,
        bare: bool = False,
    ) -> tuple[IntArray, FloatArray, list[str]]:
        """Simulate in passes; return statuses (n,), times reached (n,) [s], and reasons."""
        reasons = self.refused(which, values)
        ready = np.flatnonzero([not reason for reason in reasons])
        status, reached = np.full(len(which), INFEASIBLE, np.int64), np.zeros(len(which))

        def end(own: IntArray, packed: PackedBatch, record: BatchRecord) -> None:
            status[own] = record.status
            reached[own] = record.total[:, REACHED] * packed.units.time
            use(own, packed, record)

        per_pass = max(1, (MAX_BARE_POSES if bare else MAX_POSES) // self.n_sample)
        for k in range(0, len(ready), per_pass):
            self._pass(ready[k : k + per_pass], which, values, fixels, end, bare)
        for k in ready[status[ready] != codes.CONVERGED].tolist():
            reasons[k] = f"{codes.STATUS_NAMES[int(status[k])]} at {reached[k]:.4g} s"
        return status, reached, reasons

    def _pass(
        self,
        ready: IntArray,
        which: IntArray,
        values: Mapping[str, FloatArray],
        fixels: FloatArray | None,
        use: _Use,
        bare: bool,
    ) -> None:
        """Simulate rollouts `ready` (k,); all threads share the calls of `use`."""
        rows, packed = self._packed(ready, which, values, fixels)
        batch = stack(packed)
        ends = np.cumsum([len(own) for own in rows]).tolist()
        record = empty_record(packed[0]._replace(batch=batch), self.n_sample, 0, bare=bare)
        for part, own, last in zip(packed, rows, ends, strict=True):
            record.time[last - len(own) : last] = self._times[which[own]] / part.units.time

        def share(first: int, last: int) -> None:
            for part, own, end in zip(packed, rows, ends, strict=True):
                begin = end - len(own)
                a, b = max(first, begin), min(last, end)
                if a < b:
                    outline = None if part.outline is None else part.outline[a - begin : b - begin]
                    use(
                        own[a - begin : b - begin],
                        part._replace(outline=outline),
                        BatchRecord._make(array[a:b] for array in record),
                    )

        rollout_in_threads(batch, self._method, record, self._threads, then=share)

    def refused(self, which: IntArray, values: Mapping[str, FloatArray]) -> list[str]:
        """Reasons why rollouts of cases `which` (n,) are infeasible; empty for feasible ones."""
        reasons = [""] * len(which)
        if not values:
            return reasons
        group = self._group[which]
        for g in np.unique(group):
            own = np.flatnonzero(group == g)
            found = infeasible(self._templates[g].scene, {m: v[own] for m, v in values.items()})
            for k, reason in zip(own, found, strict=True):
                reasons[k] = reason
        return reasons

    def _packed(
        self,
        ready: IntArray,
        which: IntArray,
        values: Mapping[str, FloatArray],
        fixels: FloatArray | None,
    ) -> tuple[list[IntArray], list[PackedBatch]]:
        """Pack a batch for each template; return also the rollouts in each."""
        group = self._group[which[ready]]
        rows, packed = [], []
        for g in np.unique(group):
            own = ready[group == g]
            cases = which[own]
            paths, n_fixel = self._paths[g], len(self._templates[g].scene.fixels)
            variation = Variation(
                {m: v[own] for m, v in values.items()},
                self._start[cases],
                paths,
                None if paths is None else self._place[cases],
                None if fixels is None else fixels[own, :n_fixel],
            )
            rows.append(own)
            packed.append(self._templates[g].packed(variation, len(own), self._duration[cases]))
        return rows, packed

    def _template(self, scene: Scene) -> Template:
        return Template(scene, self.motion, self.stepper, _round_speed(scene) or None)

    def _stacked_paths(self) -> tuple[IntArray, list[FloatArray | None]]:
        """Stack paths (n_case, n_waypoint, 4) of each template; return also indices of cases."""
        place = np.zeros(len(self.cases), np.int64)
        paths: list[FloatArray | None] = []
        for g in range(len(self._templates)):
            own = np.flatnonzero(self._group == g)
            place[own] = np.arange(len(own))
            scenes = [self.cases[k].scene for k in own]
            if not scenes[0].pushers:
                paths.append(None)
                continue
            tracks = [
                pusher_path(s.pushers[0], float(self._duration[k]))
                for s, k in zip(scenes, own, strict=True)
            ]
            longest = max(len(track) for track in tracks)
            paths.append(np.array([_padded(track, longest) for track in tracks]))
        return place, paths


def _check_case(case: RolloutCase, several: bool) -> None:
    scene, times = case.scene, np.asarray(case.times)
    check_push(scene, "case.scene", pushers=(0, 1), several=several)
    if len(times) == 0 or times[0] <= 0.0 or (np.diff(times) <= 0.0).any():
        raise InvalidInput("case.times", found=times, expected="increasing times above 0 s")


def _key(scene: Scene) -> tuple[Any, ...]:
    """Key of scenes of one template: all but the starts of the bodies and the pusher's path."""
    bodies = tuple(replace(body, pose=np.zeros(3)) for body in scene.bodies)
    pushers = [(*_fields(p, "pose", "drive"), p.drive.force_limit) for p in scene.pushers]
    rest = _fields(scene, "bodies", "pushers", "duration")
    return bodies, tuple(pushers), rest, _round_speed(scene)


def _fields(record: Scene | Pusher, *others: str) -> tuple[Any, ...]:
    """Values of all fields but some, so that a new field cannot be forgotten in a key."""
    return tuple(getattr(record, own.name) for own in fields(record) if own.name not in others)


def _round_speed(scene: Scene) -> float:
    """Round the characteristic speed to a power of two, so that results do not depend on the first
    scene of a template; zero where nothing moves."""
    body = scene.bodies[0]
    speed = fastest_motion(scene, math.sqrt(body.moment_of_inertia / body.mass))
    return 2.0 ** round(math.log2(speed)) if speed > 0.0 else 0.0


def _padded(track: FloatArray, n: int) -> FloatArray:
    """Append waypoints at rest, which do not change a path."""
    more = n - len(track)
    rest = np.repeat(track[-1:], more, axis=0)
    rest[:, 0] += 1.0 + np.arange(more)
    return np.concatenate((track, rest))


def _tracks(packed: PackedBatch, record: BatchRecord) -> FloatArray:
    """Poses (n, n_sample, n_free, 3) of free bodies; the last repeated after an early stop."""
    pose = shape_poses(packed, record.pose)[:, :, : len(packed.com)]
    hold_last(record, pose)
    return pose
