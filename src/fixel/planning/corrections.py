"""Pushes that correct the pose of a part after it was seen: what each does in possible worlds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fixel.errors import InvalidInput
from fixel.model import rotated
from fixel.model.goals import BodyTrack
from fixel.model.trajectory import wrapped
from fixel.planning.belief import Belief, Scenarios
from fixel.planning.candidates import embedded, goal_poses, poses_within, spread_pushes
from fixel.planning.rollout import CARRIED_OUT, FLUSH, WORST_MARGIN, PlanSimulator, guided
from fixel.simulation.vary import composed, inverted
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.uncertainty.predictive import EndError, motion_of, spread_of
from fixel.uncertainty.run_to_run import arm_of, rest_at

WORLDS: Final = 32  # draws of what is unknown in a table
WAYS: Final = (128, 2048)  # least and largest number of contacts and directions in it
LENGTHS: Final = 16  # lengths of each
SHARE: Final = 0.25  # of the rollouts of a search that its table may use
NEAREST: Final = 24  # pushes that are compared for a seen pose
TRIED: Final = 6  # of these, simulated among the fixels
TRIED_WORLDS: Final = 8
AIMS: Final = 3  # poses in a region of the goal that corrections aim at
ITERATIONS: Final = 4  # of Gauss-Newton
SLOPE: Final = 1e-3  # its steps for slopes, in shares of the ranges
REACH: Final = 0.15  # largest distance of a refined push from one of the table, in such shares
ENOUGH: Final = 0.95  # probability from which a push is not refined
PARENTS, CHILDREN = 4, 12  # pushes of each generation of a refinement
GENERATIONS: Final = 6
STEPS: Final = (0.03, 0.003)  # largest and smallest of its children, in shares of the ranges
FAR: Final = 1e-3  # weight of the distance from the goal relative to the probability of meeting it
SHORTER: Final = 0.2  # least length of a correction over that of a push, where none is given
# Share of the spread of predicted poses by which the error of a seen pose is made wider, until
# enough predictions count.
WIDER: Final = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)


# Seen poses (n, 3), weights (n, w) of the worlds, and poses (n, w, 3) of the part in each.
SeenParts = tuple[FloatArray, ...]


class Correction(NamedTuple):
    """Pushes for n seen poses: the chosen one (n,), or m that are compared (n, m)."""

    row: IntArray  # of the table; -1 where no push is better
    score: FloatArray  # the probability, less a share of the distance from the goal
    probability: FloatArray  # that the goal is met after it
    numbers: FloatArray  # (..., d) of the push
    refined: BoolArray  # whether these are not those of the table

    def at(self, which: Any) -> Correction:
        """Return some of the pushes."""
        return Correction(*(own[which] for own in self))

    def put(self, which: Any, others: Correction) -> None:
        """Replace some of the pushes."""
        for own, other in zip(self, others, strict=True):
            own[which] = other

    def joined(self, others: Correction) -> Correction:
        """Return these pushes (n, m), then others."""
        return Correction(*(np.concatenate(own, axis=1) for own in zip(self, others, strict=True)))

    def best(self, k: int, by: str = "score") -> Correction:
        """Return the k best of m pushes for each pose."""
        order = np.argsort(-getattr(self, by), axis=1, kind="stable")[:, :k]
        return self.at((np.arange(len(order))[:, None], order))


@dataclass(frozen=True, eq=False)
class CorrectionTable:
    """Pushes of a part away from fixels, simulated in samples of what is unknown."""

    numbers: FloatArray  # (m, d) of each push
    # (m, w, 3) float32: pose after it in the frame of the part before it, in w worlds; NaN where it
    # failed.
    moved: np.ndarray
    normal: np.ndarray  # (m, w, 2) float32 of a face of the tool on the part then; zero without
    worlds: Scenarios  # these worlds (w,), without errors of the start or of ends
    arm: float  # radius of gyration of the part, at which rotations count [m]
    seed: int

    @classmethod
    def of(
        cls,
        simulator: PlanSimulator,
        belief: Belief,
        rollouts: int,
        seed: int,
        trusted: Callable[[FloatArray], bool] | None = None,
    ) -> CorrectionTable:
        """Simulate pushes of the part alone; poses on the way are the ends of shorter pushes.

        Pushes (d,) for which `trusted` is false are left out.
        """
        none = np.zeros((WORLDS, 3))
        alone = replace(simulator.alone, samples=LENGTHS)
        low, high = _bounds(alone)
        n = 2 ** int(math.log2(np.clip(SHARE * rollouts / WORLDS, *WAYS)))
        ways = spread_pushes(alone.scene, alone.choice, n, seed)
        ways[:, :, 2] = high[2]
        if trusted is not None:
            ways = ways[[trusted(own[0]) for own in ways]]
        if not len(ways):
            found = "no correction that resembles an experiment"
            hint = "record pushes of all sides, or plan with untrusted=True"
            raise InvalidInput("looks", found=found, expected="some", hint=hint)
        planned = alone.planned(ways)
        good = np.flatnonzero(planned.nominal.failure == CARRIED_OUT)
        planned, ways = planned.rows(good), ways[good]
        worlds = belief.scenarios(alone.scene, worlds=WORLDS, runs=1, seed=seed)
        worlds = worlds._replace(start=none, misfit=none)
        exact = worlds._replace(rest=none, drift=none)
        which = np.repeat(np.arange(len(ways)), WORLDS)
        runs = alone.run(planned, which, exact.rows(np.tile(np.arange(WORLDS), len(ways))))
        simulator.rollouts += alone.rollouts
        moved = np.where((runs.failure == CARRIED_OUT)[:, None, None], runs.pose, np.nan)
        moved = moved.reshape(-1, WORLDS, LENGTHS, 3).swapaxes(1, 2).astype(np.float32)
        length = _lengths(planned.path[:, 0], ways[:, 0, 2])
        numbers = np.repeat(ways, LENGTHS, axis=1)
        numbers[:, :, 2] = length
        # On a shorter way along the same arc the tool turns less.
        numbers[:, :, 3:] *= np.minimum(length / high[2], 1.0)[..., None]
        inside = (length >= low[2]) & (length <= high[2]) & np.isfinite(moved).any(axis=(2, 3))
        numbers, moved = numbers[inside], moved[inside]
        path = alone.choice.motions(alone.scene, numbers, np.zeros((len(numbers), 3))).path
        world = np.arange(WORLDS).repeat(len(path)).reshape(WORLDS, -1)
        normal = [alone.normals(moved[:, k], path, exact.rows(own)) for k, own in enumerate(world)]
        flush = np.stack(normal, axis=1).astype(np.float32)
        return cls(numbers, moved, flush, worlds, arm_of(alone.scene), seed)

    @cached_property
    def tree(self) -> cKDTree:
        """Mean displacements, to find the pushes nearest to a wanted one."""
        return cKDTree(embedded(np.nanmean(self.moved.astype(np.float64), axis=1), self.arm))

    @cached_property
    def spread(self) -> FloatArray:
        """Spread (m,) of the ends of each push over the worlds [m]."""
        return spread_of(self.moved.astype(np.float64) * (1.0, 1.0, self.arm))

    @cached_property
    def draws(self) -> FloatArray:
        """Errors of scale 1 (2, w, 3), drawn: of seen poses, and of the model."""
        rng = np.random.default_rng([self.seed, 9])
        return np.stack((rng.standard_normal((WORLDS, 3)), EndError.draws(rng, (WORLDS,))))

    def after(self, row: IntArray, start: FloatArray) -> FloatArray:
        """Return poses (n, w, 3) after pushes `row` (n,) from poses (n, w, 3)."""
        ends = composed(start, self.moved[row].astype(np.float64))
        rest = rest_at(self.worlds.rest, ends[..., 2] - start[..., 2]) + self.worlds.drift
        return np.asarray(ends + rest + self.errors(row, start, ends, self.draws[1]))

    def errors(
        self, row: IntArray, start: FloatArray, end: FloatArray, draws: FloatArray
    ) -> FloatArray:
        """Return the model's errors (n, w, 3) of ends of pushes `row`, drawn as `draws`."""
        error = self.worlds.end_error
        if error is None:
            return np.zeros_like(end)
        moved = motion_of(start.reshape(-1, 3), end.reshape(-1, 3), self.arm)
        moved = np.nan_to_num(moved).reshape(end.shape[:-1])
        size = error.deviation(moved, self.spread[row][:, None])
        drawn = size[..., None] / np.array([1.0, 1.0, self.arm]) * draws
        normal = rotated(self.normal[row], start[..., 2])
        return guided(drawn, FLUSH * error.size / size, normal)

    def deviation(self, row: IntArray, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the scales (n, w, 3) of these errors [m, m, rad]."""
        squares = [self.errors(row, start, end, unit) ** 2 for unit in np.eye(3)]
        return np.asarray(np.sqrt(sum(squares)))

    def chosen(
        self, simulator: PlanSimulator, case: SeenParts, towards: FloatArray, refined: bool = True
    ) -> Correction:
        """Choose a push, or none, for each of n seen parts.

        The pushes that lead nearest to the poses `towards` (t, 3) in the goal are compared. Where
        none of them is good enough, they are refined.
        """
        seen, weight, start = case
        rest = self._scores(simulator, start[:, None], weight[:, None])
        ranks = np.arange(1, min(NEAREST, len(self.numbers)) + 1)
        near = np.hstack([
            self.tree.query(embedded(composed(inverted(seen), pose), self.arm), k=ranks)[1]
            for pose in towards
        ])  # fmt: skip
        many = near.shape[1]
        ends = self.after(near.reshape(-1), np.repeat(start, many, axis=0))
        ends = ends.reshape(len(seen), many, WORLDS, 3)
        scores = self._scores(simulator, ends, weight[:, None])
        pushes = Correction(near, *scores, self.numbers[near], np.zeros(near.shape, bool))
        alone = not (simulator.scene.fixels or simulator.choice.obstacles)
        if not alone:
            pushes = self._tried(simulator, case, pushes.best(TRIED), TRIED_WORLDS)
        best = pushes.best(1).at((slice(None), 0))
        low = np.flatnonzero(np.maximum(rest[1][:, 0], best.probability) < ENOUGH)
        if refined and len(low):
            own: SeenParts = (seen[low], weight[low], start[low])
            first = near[low, :: many // len(towards)]  # nearest to each aim
            parents = pushes.at(low).best(PARENTS)
            if alone:  # else they have been simulated
                parents = self._tried(simulator, own, parents, TRIED_WORLDS)
            best.put(low, self._refined(simulator, own, parents, first, towards))
        stays = rest[0][:, 0] >= best.score
        best.row[stays], best.probability[stays] = -1, rest[1][stays, 0]
        return best

    def _scores(
        self, simulator: PlanSimulator, ends: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return scores and probabilities (n, m) of meeting the goal, of ends (n, m, w, 3)."""
        good = np.asarray(np.isfinite(ends).all(axis=-1))
        track = BodyTrack.of_ends(np.where(good[..., None], ends, 0.0))
        margin = np.asarray(simulator.goal.margin(simulator.scene, track)).reshape(good.shape)
        return _scored(np.where(good, np.maximum(margin, WORST_MARGIN), WORST_MARGIN), weight)

    def _tried(
        self, simulator: PlanSimulator, case: SeenParts, pushes: Correction, worlds: int
    ) -> Correction:
        """Simulate pushes (n, m) among the fixels, in the most likely worlds."""
        (seen, weight, start), (n, m) = case, pushes.row.shape
        likely = np.argsort(-weight, axis=1, kind="stable")[:, :worlds]
        planned = simulator.single(pushes.numbers.reshape(n * m, -1), np.repeat(seen, m, axis=0))
        which = np.repeat(np.arange(n * m), worlds)
        world = np.repeat(likely, m, axis=0).reshape(-1)
        error = np.take_along_axis(start - seen[:, None], likely[..., None], axis=1)
        scenarios = self.worlds.rows(world)._replace(
            start=np.repeat(error, m, axis=0).reshape(-1, 3),
            misfit=self.draws[1][world] / np.array([1.0, 1.0, self.arm]),
        )
        spread = self.spread[pushes.row.reshape(-1)][which]
        margin = simulator.margins(simulator.run(planned, which, scenarios, spread=spread))
        margin = np.where(planned.collides[which], WORST_MARGIN, margin).reshape(n, m, worlds)
        own = np.take_along_axis(weight, likely, axis=1)[:, None]
        score, probability = _scored(margin, own)
        return pushes._replace(score=score, probability=probability)

    def _refined(
        self,
        simulator: PlanSimulator,
        case: SeenParts,
        first: Correction,
        near: IntArray,
        towards: FloatArray,
    ) -> Correction:
        """Return the best push (n,) of an evolution strategy that ends where it is enough.

        Parents are the first pushes (n, m), which have been simulated, and those of the table,
        `near` (n, t), moved to the aims (t, 3). Where no push meets the goal, the first parents
        stay: before a slot, the distance from the goal misleads.

        Source
        ------
        Beyer & Schwefel (2002), Natural Computing 1, 3-52: parents and children compete.
        """
        low, high = _bounds(simulator)
        span, rng = high - low, np.random.default_rng([self.seed, 13])
        none, moved = np.zeros(near.shape), self._aimed(simulator, case, near, towards)
        aimed = Correction(near, none, none, moved, (moved != self.numbers[near]).any(axis=2))
        own = self._tried(simulator, case, aimed, TRIED_WORLDS).joined(first)
        found = own.best(PARENTS, by="probability")
        parents = np.arange(CHILDREN) % found.row.shape[1]
        for _ in range(GENERATIONS):
            moved = np.geomspace(*STEPS, CHILDREN)[:, None] * span
            moved = moved * rng.standard_normal(moved.shape)
            busy = np.flatnonzero(found.probability.max(axis=1) < ENOUGH)
            if not len(busy):
                break
            own = found.at((busy[:, None], parents))
            children = self._near(simulator, own.numbers + moved, own.row)
            own = own._replace(numbers=children, refined=np.ones(own.row.shape, bool))
            mine: SeenParts = tuple(x[busy] for x in case)
            own = self._tried(simulator, mine, own, TRIED_WORLDS)
            found.put(busy, found.at(busy).joined(own).best(PARENTS, by="probability"))
        best, begun = (own.at((slice(None), [0])) for own in (found, first))
        last = self._tried(simulator, case, best.joined(begun), WORLDS)
        return last.best(1).at((slice(None), 0))

    def _aimed(
        self, simulator: PlanSimulator, case: SeenParts, row: IntArray, towards: FloatArray
    ) -> FloatArray:
        """Move pushes `row` (n, t) until they lead to the aims (t, 3) where there is no fixel.

        By Gauss-Newton with difference quotients, in the most likely world.
        """
        alone, (seen, weight, _) = simulator.alone, case
        numbers = self.numbers[row]
        n, t, d = numbers.shape
        low, high = _bounds(alone)
        steps = np.vstack((np.zeros(d), SLOPE * np.diag(high - low)))
        wanted = np.stack([composed(inverted(seen), pose) for pose in towards], axis=1)
        scenarios = self.worlds.rows(np.repeat(weight.argmax(axis=1), t * (d + 1)))
        scenarios = scenarios._replace(rest=np.zeros((scenarios.n, 3)), drift=np.zeros((1, 3)))
        best, least = numbers, np.full((n, t), np.inf)
        for _ in range(ITERATIONS):
            trial = (numbers[:, :, None] + steps).reshape(-1, d)
            planned = alone.single(trial, np.zeros((len(trial), 3)))
            runs = alone.run(planned, np.arange(len(trial)), scenarios)
            off = wanted[:, :, None] - runs.pose[:, -1].reshape(n, t, d + 1, 3)
            off[..., 2] = self.arm * wrapped(off[..., 2])
            size = np.linalg.norm(off[:, :, 0], axis=-1)
            best = np.where((size < least)[..., None], numbers, best)
            least = np.minimum(size, least)
            slope = (off[:, :, :1] - off[:, :, 1:]).swapaxes(-1, -2) / SLOPE
            step = (np.linalg.pinv(slope, rcond=1e-3) @ off[:, :, 0, :, None])[..., 0]
            numbers = self._near(alone, numbers + (high - low) * step, row)
        return best

    def _near(self, simulator: PlanSimulator, numbers: FloatArray, row: IntArray) -> FloatArray:
        """Return pushes (n, m, d) limited to the ranges, and to the reach of pushes of the table.

        So they resemble the experiments that pushes of the table resemble.
        """
        low, high = _bounds(simulator)
        own, reach = self.numbers[row], REACH * (high - low)
        low[0], high[0] = -np.inf, np.inf  # the way round the outline is closed
        low, high = np.maximum(low, own - reach), np.minimum(high, own + reach)
        return np.asarray(np.clip(numbers, low, high))


def _bounds(simulator: PlanSimulator) -> tuple[FloatArray, FloatArray]:
    """Return the bounds (d,) of corrections, which may be shorter than the pushes of a plan."""
    low, high = simulator.choice.bounds(simulator.scene)
    if getattr(simulator.choice, "length", None) is None:
        low[2] *= SHORTER
    return low, high


def _scored(margin: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scores and probabilities (n, m) of margins (n, m, w) with weights (n, 1, w)."""
    share = weight / weight.sum(axis=-1, keepdims=True)
    meets = np.sum(share * (margin >= 0.0), axis=-1)
    far = np.sum(share * np.log1p(np.maximum(-margin, 0.0)), axis=-1)
    return meets - FAR * far, meets


def likelihoods(
    seen: FloatArray, predicted: FloatArray, deviation: FloatArray, least: float
) -> FloatArray:
    """Return the weights (n, k) of predictions (n, k, 3) or (1, k, 3) of seen poses (n, 3).

    They are normal densities with the given deviation, made wider until predictions of the
    effective number `least` count. Predictions that are not finite do not count.
    """
    good = np.asarray(np.isfinite(predicted).all(axis=-1))
    spread = np.nan_to_num(np.nanstd(predicted, axis=1, keepdims=True))
    off = [predicted[..., c] - seen[:, None, c] for c in range(3)]
    off[2] = wrapped(off[2])
    found, rows = np.zeros(off[0].shape), np.arange(len(seen))
    for wider in WIDER:
        width = np.maximum(np.hypot(deviation, wider * spread), 1e-9)
        square = sum(
            (own[rows] / (x[rows] if len(x) > 1 else x)) ** 2
            for own, x in zip(off, np.moveaxis(width, -1, 0), strict=True)
        )
        square = np.where(good[rows] if len(good) > 1 else good, square, np.inf)
        nearest = square.min(axis=1, keepdims=True)
        weight = np.exp(-0.5 * (square - np.where(np.isfinite(nearest), nearest, 0.0)))
        found[rows] = weight
        rows = rows[weight.sum(axis=1) ** 2 < least * np.sum(weight**2, axis=1)]
        if not len(rows):
            break
    return found


def towards(simulator: PlanSimulator, end: FloatArray, seed: int) -> FloatArray:
    """Return the poses (t, 3) that corrections aim at: of the goal, else the planned end.

    Poses well inside a region of the goal, the nearest to that end, are added.
    """
    poses = goal_poses(simulator.scene, simulator.goal)
    within = poses_within(simulator, seed)
    if len(poses) or not len(within):
        return poses if len(poses) else end[None]
    margin = simulator.goal.margin(simulator.scene, BodyTrack.of_ends(within))
    within, arm = within[np.argsort(-margin)[: len(within) // 4]], arm_of(simulator.scene)
    near = np.linalg.norm(embedded(within, arm) - embedded(end[None], arm), axis=1)
    return np.vstack((within[np.argsort(near)[:AIMS]], end))


def _lengths(path: FloatArray, longest: FloatArray) -> FloatArray:
    """Return the way after contact (m, LENGTHS) at the sampled times of paths (m, n, 4)."""
    time = path[:, -1, 0, None] * (np.arange(1, LENGTHS + 1) / LENGTHS)
    first = np.hypot(*(path[:, 1, 1:3] - path[:, 0, 1:3]).T)
    speed, whole = first / path[:, 1, 0], first * (path[:, -2, 0] / path[:, 1, 0])
    way = speed[:, None] * time - (whole - longest)[:, None]
    # Samples after the longest way show the end of the whole push once.
    past = way > longest[:, None]
    once = past & (np.cumsum(past, axis=1) == 1)
    return np.where(once, longest[:, None], np.where(past, np.inf, way))
