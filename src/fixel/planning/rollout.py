"""Plans carried out in simulation: sequences of pushes under many scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from fixel.kernels import codes
from fixel.model import Disk, Scene, Shape, rotated
from fixel.model.goals import BodyTrack, Goal, tolerance_of, touching
from fixel.model.overlap import Overlap, overlaps
from fixel.model.trajectory import pose_difference
from fixel.planning.belief import Scenarios, rows_of
from fixel.planning.pushes import PushChoice, fixel_overlap, scene_of_push, swept, touches
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.motion import AbstractMotionModel, OtherEngine
from fixel.simulation.rollouts import RolloutCase, Rollouts, ensemble_of
from fixel.simulation.stepping import AbstractStepper
from fixel.simulation.vary import composed, varied_start
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.uncertainty.predictive import motion_of, spread_of
from fixel.uncertainty.run_to_run import arm_of, rest_at

# What became of a run; all but the first count as failures of the plan.
CARRIED_OUT, NOT_SIMULATED, TOOL_ON_PART, START_OVERLAPS, OBSTACLE, ON_OTHER, MOVED = range(7)
FAILURES: Final = (
    "carried out",
    "could not be simulated",
    "the tool is put down on the part",
    "the part starts inside a fixel",
    "an obstacle is touched",
    "the part or the tool starts on another part",
    "a part that must stay is moved",
)
WORST_MARGIN: Final = -1e3  # of a run that failed, and limit of all margins
START: Final = ("start_x", "start_y", "start_theta")
REGISTRATION: Final = ("registration_x", "registration_y", "registration_theta")
TOUCHED: Final = 1e-9  # smallest overlap of tool and part that counts, relative to the part
# Share of the error of ends after a mean motion that stays where a face of the tool lies on the
# part: regions of CMU's two-finger pushes.
FLUSH: Final = 0.4
TILT: Final = 1e-3  # rotation that shows whether faces lie on each other [rad]
WIDE: Final = 0.1  # least width of such faces, over the radius of the part
SOME: Final = 24  # runs of a push from which the spread of its ends is computed
STAYS: Final = 1e-3  # a part stays if no point of it moves farther than this, relative to it


class Runs(NamedTuple):
    """Runs of plans, one for each pair of a plan and a scenario."""

    pose: FloatArray  # (n, n_time, 3) of the part, the end last [m, m, rad]
    failure: IntArray  # (n,) index into FAILURES
    stalled: BoolArray  # (n,) whether the drive is stalled at the end of the last push
    force: FloatArray  # (n,) largest force of the drive [N]
    fixels: FloatArray | None  # (n, n_fixel, 3) displacements of fixels from the scene's

    @property
    def track(self) -> BodyTrack:
        """Motions of the part, on which goals are judged."""
        return BodyTrack(self.pose, self.stalled, self.force, self.fixels)


class PlannedMotions(NamedTuple):
    """Motions of m plans of k pushes, with the nominal simulation that they are planned from."""

    start: FloatArray  # (m, k, 3) planned pose of the part before each push [m, m, rad]
    path: FloatArray  # (m, k, n_waypoint, 4) tool: time [s] and pose [m, m, rad]
    fixels: FloatArray | None  # (m, n_fixel, 3) planned displacements of fixels
    others: FloatArray  # (m, k, n_other, 3) planned poses of the other parts before each push
    nominal: Runs  # of each plan without any error
    collides: BoolArray  # (m,) whether the tool would touch a fixel

    def rows(self, which: IntArray) -> PlannedMotions:
        """Return some of the plans."""
        own: PlannedMotions = rows_of(self, which)
        return own


@dataclass(kw_only=True, eq=False)
class PlanSimulator:
    """Simulates plans of one scene."""

    # Scene with the part at its start; its pusher is the tool, as `PushChoice.prepared` makes it.
    scene: Scene
    goal: Goal
    choice: PushChoice
    # Parameters of the nominal simulation, whose poses the pushes are planned from.
    nominal: Mapping[str, float]
    motion: AbstractMotionModel
    stepper: AbstractStepper | None = None
    samples: int = 1  # number of poses that are kept of each push
    # Scene that is simulated where its part has fewer corners; the tool moves as for `scene`.
    simplified: Scene | None = None
    threads: int | None = None
    rollouts: int = 0  # number of pushes simulated so far

    @property
    def simulated(self) -> Scene:
        """Scene that is simulated: `simplified`, else `scene`."""
        return self.simplified or self.scene

    @cached_property
    def alone(self) -> PlanSimulator:
        """Simulator of the part at the origin, without fixels and obstacles."""
        return replace(
            self, rollouts=0, choice=replace(self.choice, obstacles=()), scene=_alone(self.scene),
            simplified=None if self.simplified is None else _alone(self.simplified),
        )  # fmt: skip

    def margins(self, runs: Runs) -> FloatArray:
        """Return the margins (n,) of the goal; far below zero where a run failed."""
        margin = np.clip(self.unlimited_margins(runs), WORST_MARGIN, -WORST_MARGIN)
        return np.where(runs.failure == CARRIED_OUT, margin, WORST_MARGIN)

    def unlimited_margins(self, runs: Runs) -> FloatArray:
        """Return the margins (n,) of the goal without limits, for runs that were carried out."""
        return np.asarray(self.goal.margin(self.simulated, runs.track))

    def planned(self, numbers: FloatArray, start: FloatArray | None = None) -> PlannedMotions:
        """Return the motions of plans (m, k, d), each push from the nominal end of the one before.

        `start` has the poses (m, 3) before the first push; by default that of the scene.
        """
        m, k, _ = numbers.shape
        pose = np.tile(self.scene.bodies[0].pose, (m, 1)) if start is None else np.array(start)
        if k == 0:
            return _at_rest(pose, len(self.scene.bodies) - 1)
        others, singles, poses = self.others(m), [], []
        failure, force = np.zeros(m, np.int64), np.zeros(m)
        for push in range(k):
            own = self.single(numbers[:, push], pose, others)
            start, path = own.start[:, 0], own.path[:, 0]
            track, failed, stalled, peak, others = self._push(
                start, path, own.fixels, None, start, others
            )
            failure = np.where(failure == CARRIED_OUT, failed, failure)
            force = np.maximum(force, peak)
            singles.append(own)
            poses.append(track)
            pose = track[:, -1]
        nominal = Runs(np.concatenate(poses, axis=1), failure, stalled, force, own.fixels)
        starts, paths, befores = (
            np.concatenate([getattr(own, name) for own in singles], axis=1)
            for name in ("start", "path", "others")
        )
        hit = np.any([own.collides for own in singles], axis=0)
        return PlannedMotions(starts, paths, own.fixels, befores, nominal, hit)

    def single(
        self, numbers: FloatArray, start: FloatArray, others: FloatArray | None = None
    ) -> PlannedMotions:
        """Return the motions of single pushes (m, d) of parts at `start` (m, 3), not simulated."""
        scene, motions = self.scene, self.choice.motions(self.scene, numbers, start)
        others = self.others(len(numbers)) if others is None else others
        tool, way = scene.pushers[0].shape, swept(motions.path)
        return _at_rest(motions.start, others.shape[1])._replace(
            start=motions.start[:, None], path=motions.path[:, None], fixels=motions.fixels,
            others=others[:, None],
            collides=fixel_overlap(scene, tool, way, motions.fixels) > 0.0,
        )  # fmt: skip

    def run(
        self,
        plans: PlannedMotions,
        which: IntArray,
        scenarios: Scenarios,
        first: int = 0,
        spread: FloatArray | None = None,
    ) -> Runs:
        """Carry out plans `which` (n,), each in the scenario of the same row.

        The errors of the start are those before push `first`; the pushes before it are left out.
        The spread (n,) of the ends over the parameters is that of these runs if it is not given.
        Runs of one plan follow each other.
        """
        part = self.simulated.bodies[0].shape
        n, k = len(which), plans.start.shape[1] - first
        if k == 0:
            return _at_rest(plans.nominal.pose[which, -1] + scenarios.start, 0).nominal
        fixels = _summed(plans.fixels, which, scenarios.fixels)
        actual = plans.start[which, first] + scenarios.start
        failure = np.zeros(n, np.int64)
        inside = part_overlap(self.simulated, actual, fixels) > TOUCHED * part.radius
        placed_off = (scenarios.start != 0.0).any(axis=1)
        failure[inside & placed_off] = START_OVERLAPS
        others = plans.others[which, first]
        on_other = others_overlap(self.simulated, part, actual, others) > TOUCHED * part.radius
        failure[on_other & placed_off] = ON_OTHER
        poses = np.zeros((n, k * self.samples, 3))
        force, stalled = np.zeros(n), np.zeros(n, bool)
        for push in range(k):
            start, path = plans.start[:, first + push], plans.path[:, first + push]
            pose, failed, stalled, peak, after = self._push(
                start[which], path[which], fixels, scenarios, actual, others
            )
            held = self._held(pose[:, -1], fixels, after, scenarios)
            wide, good = spread, (failed == CARRIED_OUT) & ~held
            if wide is None:
                wide = spreads(which, actual, pose[:, -1], good, arm_of(self.scene))
            error = self._error(actual, pose[:, -1], path[which], scenarios, held, wide)
            error /= np.sqrt(k)  # the pushes share one draw: the variance of k independent ones
            pose[:, -1] += np.where(held[:, None], 0.0, error)
            if scenarios.end_error is not None and held.any():
                # Where something holds the part, it comes there off by its error.
                own, along = np.flatnonzero(held), path[which[held], 1] - path[which[held], 0]
                aside = actual[own] + _across(error[own], along)
                again = self._push(
                    start[which[own]], path[which[own]], None if fixels is None else fixels[own],
                    scenarios.rows(own), aside, others[own],
                )  # fmt: skip
                pose[own], failed[own], stalled[own], peak[own], after[own] = again
            failed[touches(part, pose[:, -1:], self.choice.obstacles)] = OBSTACLE
            failure = np.where(failure == CARRIED_OUT, failed, failure)
            force = np.maximum(force, peak)
            poses[:, push * self.samples : (push + 1) * self.samples] = pose
            actual, others = pose[:, -1], after
        return Runs(poses, failure, stalled, force, fixels)

    def _push(
        self,
        planned: FloatArray,
        path: FloatArray,
        fixels: FloatArray | None,
        scenarios: Scenarios | None,
        actual: FloatArray,
        others: FloatArray,
    ) -> tuple[FloatArray, IntArray, BoolArray, FloatArray, FloatArray]:
        """Simulate one push of parts at `actual`, planned at `planned`, among parts at `others`."""
        n, scene = len(path), self.simulated
        self.rollouts += n
        if scenarios is None:
            values = {name: np.full(n, x) for name, x in self.nominal.items()}
        else:
            values = self._values(path, scenarios)
        first = path[:, 0, 1:]
        tool = composed(registration(values, n), first)
        if others.shape[1]:
            # Parameters that shift the part belong to scenes of one part.
            values = {name: x for name, x in values.items() if name not in START}
            begun = np.concatenate((actual[:, None], others), axis=1)
            ensemble = self._ensemble(begun, path)
        else:
            offset = pose_difference(actual, planned)
            values |= dict(zip(START, offset.T.copy(), strict=True))
            shifted = varied_start(scene, planned[:, None], values)
            assert shifted is not None
            begun, ensemble = shifted, self._ensemble(planned[:, None], path)
        put_down = tool_overlap(scene, begun[:, 0], tool)
        outcome = ensemble.simulate(np.arange(n), values, fixels)
        failure = np.zeros(n, np.int64)
        smallest = TOUCHED * scene.bodies[0].shape.radius
        failure[put_down > smallest] = TOOL_ON_PART
        failure[others_overlap(scene, scene.pushers[0].shape, tool, others) > smallest] = ON_OTHER
        failure[self._moved(others, outcome.others)] = MOVED
        failure[self.obstructed(begun[:, :1], outcome.pose, registration(values, n), path)] = (
            OBSTACLE
        )
        ended = np.isin(outcome.status, (codes.CONVERGED, codes.JAMMED))
        failure[~ended & (failure == CARRIED_OUT)] = NOT_SIMULATED
        return outcome.pose, failure, outcome.stalled, outcome.force, outcome.others

    def others(self, n: int) -> FloatArray:
        """Return the poses (n, n_other, 3) of the other parts in the scene."""
        poses = [own.pose for own in self.scene.bodies[1:]]
        return np.tile(np.reshape(poses, (-1, 3)), (n, 1, 1))

    def _moved(self, before: FloatArray, after: FloatArray) -> BoolArray:
        """Return where a part that must stay is moved, from poses (n, n_other, 3) to others."""
        radius = np.array([own.shape.radius for own in self.scene.bodies[1:]])
        stays = [own.name in self.choice.keep for own in self.scene.bodies[1:]]
        off = after - before
        farthest = np.hypot(off[..., 0], off[..., 1]) + radius * np.abs(off[..., 2])
        return np.asarray((farthest > STAYS * radius)[:, stays].any(axis=1))

    def _ensemble(self, begun: FloatArray, path: FloatArray) -> Rollouts:
        """Return the ensemble of pushes of parts at (n, n_free, 3); another engine has a scene for
        each."""
        if not isinstance(self.motion, OtherEngine):
            return Ensemble.of_pushes(
                self.simulated, begun, path, self.samples,
                motion=self.motion, stepper=self.stepper, threads=self.threads,
            )  # fmt: skip
        share = np.arange(1, self.samples + 1) / self.samples
        cases = [
            RolloutCase(scene_of_push(self.simulated, start, way, rest), way[-1, 0] * share)
            for (start, *rest), way in zip(begun, path, strict=True)
        ]
        return ensemble_of(cases, self.motion, threads=self.threads)

    def obstructed(
        self, begun: FloatArray, after: FloatArray, registered: FloatArray, path: FloatArray
    ) -> BoolArray:
        """Return whether the part, at poses (n, k, 3), or the tool touches an obstacle, (n,)."""
        obstacles, scene = self.choice.obstacles, self.simulated
        if not obstacles:
            return np.zeros(len(path), bool)
        tool = composed(registered[:, None], swept(path))
        part = np.concatenate((begun, after), axis=1)
        return touches(scene.pushers[0].shape, tool, obstacles) | touches(
            scene.bodies[0].shape, part, obstacles
        )

    def _values(self, path: FloatArray, scenarios: Scenarios) -> dict[str, FloatArray]:
        """Return the parameters, with the registration of tools that miss their paths."""
        if not scenarios.tool.any():
            return dict(scenarios.values)
        begin, way = path[:, 0, 1:3], path[:, 1, 1:3] - path[:, 0, 1:3]
        along = way / np.maximum(np.hypot(*way.T), 1e-12)[:, None]  # a stroke may be zero
        across = np.column_stack((-along[:, 1], along[:, 0]))
        travel, aside, heading = scenarios.tool.T
        shift = travel[:, None] * along + aside[:, None] * across
        error = np.column_stack((begin - rotated(begin, heading) + shift, heading))
        own = composed(registration(scenarios.values, len(path)), error)
        return {**scenarios.values, **dict(zip(REGISTRATION, own.T.copy(), strict=True))}

    def _error(
        self,
        start: FloatArray,
        end: FloatArray,
        path: FloatArray,
        scenarios: Scenarios,
        held: BoolArray,
        spread: FloatArray,
    ) -> FloatArray:
        """Return the errors (n, 3) of the model for ends; a tool guides those that are not held."""
        error = rest_at(scenarios.rest, end[:, 2] - start[:, 2]) + scenarios.drift
        own, free, normal = scenarios.end_error, np.flatnonzero(~held), np.zeros((len(end), 2))
        if own is None or not scenarios.misfit.any():
            return error
        size = own.deviation(motion_of(start, end, arm_of(self.scene)), spread)
        normal[free] = self.normals(end[free], path[free], scenarios.rows(free))
        return guided(error + size[:, None] * scenarios.misfit, FLUSH * own.size / size, normal)

    def normals(self, ends: FloatArray, path: FloatArray, scenarios: Scenarios) -> FloatArray:
        """Return normals (n, 2) of faces of tools that lie on parts at `ends` (n, 3); else zero."""
        part, tool = self.simulated.bodies[0].shape, self.scene.pushers[0].shape
        if scenarios.end_error is None or isinstance(tool, Disk):
            return np.zeros((len(ends), 2))
        farthest = path[:, max(1, path.shape[1] - 2), 1:]  # before the tool goes back
        tools = composed(registration(self._values(path, scenarios), len(path)), farthest)
        return flush_normals(part, ends, tool, tools)

    def _held(
        self, end: FloatArray, fixels: FloatArray | None, others: FloatArray, scenarios: Scenarios
    ) -> BoolArray:
        """Return which ends (n, 3) touch a fixel or another part, if ends have errors at all."""
        if not any(own.any() for own in (scenarios.rest, scenarios.drift, scenarios.misfit)):
            return np.zeros(len(end), bool)
        scene, body = self.simulated, self.simulated.bodies[0]
        near = others_overlap(scene, body.shape, end, others) > -tolerance_of(None, body)
        return np.asarray(touching(scene, body, end, fixels).any(axis=1) | near)


def _alone(scene: Scene) -> Scene:
    body = replace(scene.bodies[0], pose=np.zeros(3))
    return replace(scene, bodies=(body,), fixels=(), contact_friction=())


def spreads(
    which: IntArray, start: FloatArray, end: FloatArray, good: BoolArray, arm: float
) -> FloatArray:
    """Return the spread (n,) of the ends of each plan `which` over its good runs [m].

    What the starts (n, 3) change, to first order, is left out. NaN where a plan has few good runs.
    """
    found, size = np.full(len(which), np.nan), np.array([1.0, 1.0, arm])
    ends = np.append(np.flatnonzero(np.diff(which)) + 1, len(which))
    size_of = np.diff(ends, prepend=0)
    for last, n in zip(ends[size_of >= SOME], size_of[size_of >= SOME], strict=True):
        rows = slice(last - n, last)
        own = last - n + np.flatnonzero(good[rows])
        if len(own) >= SOME:
            off = start[own] - start[own].mean(axis=0)
            moved = (end[own] - start[own]) * size
            moved -= moved.mean(axis=0)
            # Sums of products without BLAS, whose bits depend on the number of threads.
            gram, cross = (np.einsum("ni,nj->ij", off, x) for x in (off, moved))
            slope = np.linalg.pinv(gram, hermitian=True) @ cross
            found[rows] = spread_of(moved - np.einsum("ni,ij->nj", off, slope))
    return found


def guided(error: FloatArray, share: FloatArray, normal: FloatArray) -> FloatArray:
    """Return errors (..., 3) of which a share (...), at most all, stays where faces lie on others.

    It is that along normals (..., 2) of these faces, and in rotation. Where they are zero, all
    stays.
    """
    lies = normal.any(axis=-1, keepdims=True)
    if not lies.any():
        return error
    lost = np.maximum(1.0 - share, 0.0)[..., None]
    across = np.sum(error[..., :2] * normal, axis=-1, keepdims=True) * normal
    return np.asarray(error - lost * np.concatenate((across, lies * error[..., 2:]), axis=-1))


def flush_normals(part: Shape, ends: FloatArray, tool: Shape, tools: FloatArray) -> FloatArray:
    """Return the normals (n, 2) of faces of tools (n, 3) that lie on faces of parts; else zero.

    There, either rotation of the part makes them overlap more, in the same direction.
    """
    tilt = np.outer((1.0, 0.0, -1.0), (0.0, 0.0, TILT))
    one, now, other = (_overlap(part, ends + turn, tool, tools) for turn in tilt)
    wide = one.depth + other.depth - 2.0 * now.depth > WIDE * TILT * part.radius
    near = np.abs(now.depth) < 0.5 * TILT * part.radius  # poses of a step are off by its error
    same = np.sum(one.way * other.way, axis=1) > 0.9
    return np.where((wide & near & same)[:, None], rotated(now.way, tools[:, 2]), 0.0)


def _across(error: FloatArray, way: FloatArray) -> FloatArray:
    """Return errors (n, 3) without what is along the tool's way (n, 4), which the tool undoes."""
    along = way[:, 1:3] / np.maximum(np.hypot(way[:, 1], way[:, 2]), 1e-12)[:, None]
    found = error.copy()
    found[:, :2] -= np.sum(error[:, :2] * along, axis=1)[:, None] * along
    return found


def _at_rest(pose: FloatArray, n_other: int) -> PlannedMotions:
    """Return plans without a push of parts at poses (m, 3)."""
    m = len(pose)
    others = np.zeros((m, 0, n_other, 3))
    runs = Runs(pose[:, None], np.zeros(m, np.int64), np.zeros(m, bool), np.zeros(m), None)
    start, path = pose[:, None][:, :0], np.zeros((m, 0, 2, 4))
    return PlannedMotions(start, path, None, others, runs, runs.stalled)


def registration(values: Mapping[str, FloatArray], n: int) -> FloatArray:
    """Return the calibrated registration (n, 3) of the tool's path [m, m, rad]."""
    return np.column_stack([np.broadcast_to(values.get(name, 0.0), n) for name in REGISTRATION])


def tool_overlap(scene: Scene, parts: FloatArray, tools: FloatArray) -> FloatArray:
    """Return the overlap (n,) of the part at poses (n, 3) with the tool at poses (n, 3) [m]."""
    return _overlap(scene.bodies[0].shape, parts, scene.pushers[0].shape, tools).depth


def others_overlap(scene: Scene, shape: Shape, poses: FloatArray, others: FloatArray) -> FloatArray:
    """Return the deepest overlap (n,) of a shape at poses (n, 3) with the other parts of a scene at
    poses (n, n_other, 3) [m]."""
    deepest = np.full(len(poses), -np.inf)
    for k, other in enumerate(scene.bodies[1:]):
        depth = _overlap(shape, poses, other.shape, others[:, k]).depth
        deepest = np.maximum(deepest, depth)
    return deepest


def _overlap(shape: Shape, poses: FloatArray, other: Shape, others: FloatArray) -> Overlap:
    """Return the overlap of a shape at poses (n, 3) with another at poses (n, 3), in its frame."""
    place = rotated(poses - others, -others[:, 2])
    relative = np.column_stack((place, poses[:, 2] - others[:, 2]))
    return overlaps(shape, relative, other, np.zeros(3))


def part_overlap(scene: Scene, poses: FloatArray, fixels: FloatArray | None) -> FloatArray:
    """Return the deepest overlap (n,) of the part at poses (n, 3) with fixels [m]."""
    return fixel_overlap(scene, scene.bodies[0].shape, poses[:, None], fixels)


def _summed(
    planned: FloatArray | None, which: IntArray, errors: FloatArray | None
) -> FloatArray | None:
    if planned is None:
        return errors
    return planned[which] if errors is None else planned[which] + errors
