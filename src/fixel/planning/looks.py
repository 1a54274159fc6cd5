"""Plans that look at the part between pushes: policies, and how likely they reach the goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import fraction, instance, whole
from fixel.model.goals import Beyond, Inside, PoseRegion
from fixel.model.scene import check_push
from fixel.model.trajectory import pose_difference
from fixel.planning.belief import Belief, Scenarios
from fixel.planning.candidates import Numbers
from fixel.planning.corrections import (
    ENOUGH,
    WORLDS,
    Correction,
    CorrectionTable,
    likelihoods,
    towards,
)
from fixel.planning.pushes import FreePushes
from fixel.planning.rollout import CARRIED_OUT, WORST_MARGIN, PlannedMotions, PlanSimulator
from fixel.planning.search import (
    ROLLOUTS,
    PlanSearch,
    SearchStage,
    Views,
    fresh_stages,
    stage_scenarios,
)
from fixel.planning.success import SuccessProbability
from fixel.progress import Progress
from fixel.simulation.vary import composed
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.uncertainty.error_terms import StartError

MOST: Final = 5  # looks
TABLE, CHOICE, LATER = 11, 12, 13  # streams of random values
LEAST: Final = 1e-9  # weight of a world that a seen pose speaks against
RUNS: Final = 24  # of each world, to tell from a seen pose which worlds are likely
COUNTING: Final = 24.0  # effective number of runs that must agree with a seen pose
COUNTING_WORLDS: Final = 6.0
UNKNOWN: Final = 1e3  # deviation of ends that are not predicted [m], [rad]
COMPARED: Final = 4  # policies that meet the second number of scenarios
COMPARED_RUNS: Final = (48, 400)
CHUNK: Final = 256  # seen poses that are corrected at a time, which bounds the memory
OFTEN, SLOWER = 0.2, 12  # share of refined corrections from which stages have 1/12 of the rollouts


# Weights (n, w) of worlds before a push, its ends (n, w, 3) in them, and their deviations.
Before = tuple[FloatArray, FloatArray, FloatArray]


class Walk(NamedTuple):
    """Runs of a policy in n scenarios."""

    margin: FloatArray  # (looks + 1, n) of the goal before the first look, and after each
    pushes: IntArray  # (n,) number of pushes
    pose: FloatArray  # (n, 3) of the part at the end [m, m, rad]
    failure: IntArray  # (n,) index into FAILURES
    seen: FloatArray  # (n, 3) pose at the first look [m, m, rad]
    row: IntArray  # (n,) push of the table that was chosen then; -1 for none
    probability: FloatArray  # (n,) stated then for that push


@dataclass(frozen=True, kw_only=True, eq=False)
class Looks:
    """Looks at the part after the planned pushes, each with a correction, and their worth.

    Attributes
    ----------
    most : int
        Number of looks.
    camera : StartError
        Error of a seen pose.
    lost_views : float
        Share of the looks that see nothing; the part then stays where it is.
    table : CorrectionTable
        Pushes that it chooses among.
    worth : tuple of SuccessProbability
        Success probability with 0, 1, ... looks.
    pushes : float
        Expected number of pushes.
    stops : float
        Share of the runs without a push after the first look: none promises more, or the view
        is lost.
    walk : Walk
        Runs in which the success probability was computed.
    """

    most: int
    camera: StartError
    lost_views: float
    table: CorrectionTable = field(repr=False)
    worth: tuple[SuccessProbability, ...]
    pushes: float
    stops: float
    walk: Walk = field(repr=False)

    @property
    def sentences(self) -> list[str]:
        """Worth of each look, and the expected number of pushes, in sentences."""
        values = [own.mean for own in self.worth]
        lines = [
            f"Look {k} raises the success probability from {before:.2f} to {after:.2f}."
            for k, (before, after) in enumerate(pairwise(values), 1)
        ]
        camera = str(self.camera).removeprefix("start: ")
        return [
            *lines,
            f"On average it needs {self.pushes:.1f} pushes; after the first look,"
            f" {100.0 * self.stops:.0f} % of the runs need no push, or none would help.",
            f"Error of a seen pose: {camera}.",
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """Planned pushes, and corrections from a table, in one simulator."""

    simulator: PlanSimulator
    belief: Belief
    planned: PlannedMotions  # of the first pushes
    table: CorrectionTable
    views: Views
    refined: bool = True  # whether the pushes of the table are refined
    report: Callable[[int], None] | None = None  # called with the number of parts just corrected

    def stages(self, belief: Belief, rollouts: int = ROLLOUTS) -> tuple[SearchStage, ...]:
        """Return stages that state its worth, with fewer scenarios if many pushes are refined."""
        scene = self.simulator.scene
        some = belief.scenarios(scene, worlds=COMPARED_RUNS[0], runs=1, seed=self.table.seed)
        rough = replace(self, refined=False, report=None).walk(some, self.table.seed)
        slow = (rough.probability < ENOUGH).mean() > OFTEN
        return fresh_stages(belief, scene, rollouts // SLOWER if slow else rollouts)

    def walk(self, scenarios: Scenarios, seed: int) -> Walk:
        """Carry out the policy once in each scenario, each with its own errors of the camera."""
        rng, n = np.random.default_rng([seed, 5]), scenarios.n
        runs = self.simulator.run(self.planned, np.zeros(n, np.int64), scenarios)
        pose, failure = runs.pose[:, -1].copy(), runs.failure.copy()
        margin = self.simulator.margins(runs)
        margins, pushes = [margin], np.full(n, self.planned.start.shape[1])
        ends, deviation = np.zeros((2, n, WORLDS, 3))
        before: Before = (np.ones((n, WORLDS)), ends, deviation)
        new, met = np.ones(n, bool), np.full(n, (margin >= 0.0).mean())
        first: tuple[FloatArray, Correction] | None = None
        for _ in range(self.views.looks):
            error = self.views.camera.samples(n, int(rng.integers(2**31)))
            seen = pose + error[rng.permutation(n)]
            lost = rng.random(n) < self.views.lost_views
            found = self._chosen_unless(lost, seen, new, before, met)
            new &= lost
            first = first or (seen, found)
            own = np.flatnonzero((found.row >= 0) & (failure == CARRIED_OUT))
            if len(own):
                drawn = scenarios.rows(rng.permutation(n)[: len(own)])  # of the model's errors
                mine = scenarios.rows(own)._replace(
                    start=pose[own] - seen[own],
                    rest=drawn.rest, drift=drawn.drift, misfit=drawn.misfit,
                )  # fmt: skip
                planned = self.simulator.single(found.numbers[own], seen[own])
                spread = self.table.spread[found.row[own]]
                runs = self.simulator.run(planned, np.arange(len(own)), mine, spread=spread)
                pose[own], failure[own] = runs.pose[:, -1], runs.failure
                after = np.where(planned.collides, WORST_MARGIN, self.simulator.margins(runs))
                margin = margin.copy()
                margin[own] = after
                pushes[own] += 1
            margins.append(margin)
        assert first is not None
        return Walk(
            np.array(margins), pushes, pose, failure,
            first[0], first[1].row, first[1].probability,
        )  # fmt: skip

    def _chosen_unless(
        self, lost: BoolArray, seen: FloatArray, new: BoolArray, before: Before, met: FloatArray
    ) -> Correction:
        """Choose pushes for seen poses (n, 3), and add what these change to `before`.

        Nothing is learned, and nothing is pushed, where the view is lost; the goal is met with the
        probabilities `met` (n,) then. Parts that no look has seen before are `new`.
        """
        n, numbers = len(seen), np.zeros((len(seen), *self.table.numbers.shape[1:]))
        found = Correction(np.full(n, -1), np.zeros(n), met.copy(), numbers, np.zeros(n, bool))
        for known in (None, before):
            own = np.flatnonzero(~lost & (new == (known is None)))
            if len(own):
                earlier = known and (known[0][own], known[1][own], known[2][own])
                chosen, after = self._look(seen[own], earlier)
                found.put(own, chosen)
                for whole, some in zip(before, after, strict=True):
                    whole[own] = some
        return found

    def next(self, seen: FloatArray) -> Correction:
        """Choose the push after the last of some seen poses (k, 3), one after each push."""
        before: Before | None = None
        for pose in np.asarray(seen, np.float64).reshape(-1, 1, 3):
            found, before = self._look(pose, before)
        return found

    def _look(self, seen: FloatArray, before: Before | None) -> tuple[Correction, Before]:
        """Choose pushes for seen poses (n, 3), and return what is known before the next look."""
        weight, start = self._likely(seen, before), self._starts(seen, before)
        found = self._chosen(seen, weight, start)
        return found, (weight, *self._expected(seen, start, found))

    def _chosen(self, seen: FloatArray, weight: FloatArray, start: FloatArray) -> Correction:
        found = []
        for rows in np.array_split(np.arange(len(seen)), -(-len(seen) // CHUNK)):
            case = (seen[rows], weight[rows], start[rows])
            found.append(self.table.chosen(self.simulator, case, self._aims, self.refined))
            if self.report is not None:
                self.report(len(rows))
        return Correction(*(np.concatenate(own) for own in zip(*found, strict=True)))

    @cached_property
    def _aims(self) -> FloatArray:
        return towards(self.simulator, self.planned.nominal.pose[0, -1], self.table.seed)

    @cached_property
    def _ends(self) -> FloatArray:
        """Ends (WORLDS RUNS, 3) of the first pushes in the table's worlds; NaN for failures."""
        scenarios = self.belief.scenarios(
            self.simulator.scene, worlds=WORLDS, runs=RUNS, seed=self.table.seed
        )
        runs = self.simulator.run(self.planned, np.zeros(scenarios.n, np.int64), scenarios)
        return np.where((runs.failure == CARRIED_OUT)[:, None], runs.pose[:, -1], np.nan)

    def _likely(self, seen: FloatArray, before: Before | None) -> FloatArray:
        """Return the weights (n, w) of worlds for seen poses, from those before the last push."""
        if before is None:
            found = likelihoods(seen, self._ends[None], self.views.camera.deviation, COUNTING)
            return np.asarray(found.reshape(len(seen), WORLDS, RUNS).sum(axis=-1) + LEAST)
        weight, ends, deviation = before
        return np.asarray(weight * likelihoods(seen, ends, deviation, COUNTING_WORLDS) + LEAST)

    def _starts(self, seen: FloatArray, before: Before | None) -> FloatArray:
        """Draw the poses (n, w, 3) of seen parts in each world, from prediction and view.

        The first look has predictions. A world whose prediction is unlike the seen pose counts by
        as much less as it is off.

        Source
        ------
        Kalman (1960); Evensen (1994), who estimates the covariance by an ensemble.
        """
        view = np.diag(np.maximum(self.views.camera.deviation, 1e-9) ** 2)
        if before is not None:
            return np.asarray(seen[:, None] + self.views.camera.deviation * self.table.draws[0])
        ends = self._ends.reshape(WORLDS, RUNS, 3)
        good = np.asarray(np.isfinite(ends).all(axis=(1, 2)))[:, None]
        mean = np.where(good, ends.mean(axis=1), 0.0)
        ends = ends - ends.mean(axis=1, keepdims=True)
        spread = np.einsum("wri,wrj->wij", ends, ends) / (RUNS - 1)
        spread = np.where(good[..., None], spread, np.eye(3))
        off = pose_difference(seen[:, None], mean)
        far = np.einsum("nwi,wij,nwj->nw", off, np.linalg.inv(spread + view), off) / 3.0
        spread = np.maximum(far, 1.0)[..., None, None] * spread + 1e-18 * np.eye(3)
        gain = spread @ np.linalg.inv(spread + view)
        root = np.linalg.cholesky(gain @ view)
        drawn = root @ self.table.draws[0][..., None] + gain @ off[..., None]
        return np.asarray(mean + drawn[..., 0])

    def _expected(
        self, seen: FloatArray, start: FloatArray, found: Correction
    ) -> tuple[FloatArray, FloatArray]:
        """Return the ends (n, w, 3) of chosen pushes in each world, and their deviations."""
        ends = composed(start, self.table.moved[found.row].astype(np.float64))
        ends = np.where((found.row >= 0)[:, None, None], ends, start)
        deviation = self.table.deviation(found.row, start, ends)
        # The ends of a refined push are unknown, so that the next view changes no weights.
        deviation[(found.row >= 0) & found.refined] = UNKNOWN
        return ends, np.hypot(self.views.camera.deviation, deviation)


def policy_of(
    search: PlanSearch, plans: Numbers, trusted: Callable[[FloatArray], bool] | None
) -> tuple[FloatArray, Policy]:
    """Return the first pushes (k, d) and the policy that most often reach the goal.

    The first look may follow any push of the plans of a search. All such policies meet a few
    scenarios, and the best of them meet more. Corrections are pushes (d,) for which `trusted` is
    true. `InvalidInput` is raised where neither plans nor policies ever reach the goal.
    """
    simulator, belief, seed = search.simulator, search.belief, 1000 * search.seed
    table = CorrectionTable.of(simulator, belief, search.rollouts, seed + TABLE, trusted)
    few = plans[: 2 * COMPARED]
    begun = [own[:after] for own in few for after in range(min(1, len(own)), len(own) + 1)]
    found = [
        (numbers, Policy(
            simulator=simulator, belief=belief, planned=simulator.planned(numbers[None]),
            table=table, views=search.views, refined=False,
        )) for numbers in {own.tobytes(): own for own in begun}.values()
    ]  # fmt: skip
    for runs in COMPARED_RUNS:
        scenarios = belief.scenarios(simulator.scene, worlds=runs, runs=1, seed=seed + CHOICE)
        walks = [policy.walk(scenarios, seed + CHOICE) for _, policy in found]
        order = sorted(range(len(found)), key=lambda k: _rank(walks[k]), reverse=True)
        found = [found[k] for k in order[:COMPARED]]
    numbers, policy = found[0][0], replace(found[0][1], refined=True)
    if not search.reached and not _rank(walks[order[0]])[0]:
        some = np.arange(COMPARED_RUNS[0])
        if not _rank(policy.walk(scenarios.rows(some), seed + CHOICE))[0]:
            raise search.unreachable(plans)
    return numbers, policy


def _rank(walk: Walk) -> tuple[int, float, int]:
    """Return success, nearness and few pushes of a policy, the more important first."""
    far = np.log1p(np.maximum(-walk.margin[-1], 0.0)).sum()
    return int((walk.margin[-1] >= 0.0).sum()), -far, -int(walk.pushes.sum())


def looks_of(
    policy: Policy,
    stages: Sequence[SearchStage],
    seed: int,
    belief: Belief | None = None,
    report: Callable[[Progress], None] | None = None,
) -> tuple[Looks, Scenarios]:
    """State what a policy is worth in unseen scenarios of a belief; by default in its own."""
    truth, scene = belief or policy.belief, policy.simulator.scene
    drawn = [stage_scenarios(truth, scene, own, seed + own.stream) for own in stages]
    done, total = 0, policy.views.looks * sum(own.n for own in drawn)

    def show(parts: int) -> None:
        nonlocal done
        done += parts
        if report is not None:
            report(Progress("looks", done, total))

    policy = replace(policy, report=show)
    walks = [policy.walk(own, seed + LATER) for own in drawn]
    last = stages[-1]
    worth = [
        SuccessProbability.of(own[-1].reshape(last.worlds, last.runs), independent=own[0])
        for own in zip(*(walk.margin for walk in walks), strict=True)
    ]
    walk = walks[0]
    looks = Looks(
        most=policy.views.looks, camera=policy.views.camera, lost_views=policy.views.lost_views,
        table=policy.table, worth=tuple(worth), pushes=float(walk.pushes.mean()),
        stops=float(np.mean(walk.row < 0)), walk=walk,
    )  # fmt: skip
    return looks, drawn[0]


def check_looks(search: PlanSearch) -> None:
    """Raise `InvalidInput` where a search cannot use the looks that it is asked for."""
    simulator, (looks, camera, lost_views) = search.simulator, search.views
    instance(camera, StartError, "camera", "a StartError")
    whole(looks, "looks", 0, MOST)
    if fraction(lost_views, "lost_views") == 1.0:
        raise InvalidInput("lost_views", found=lost_views, expected="at least 0 and below 1")
    if looks and not isinstance(simulator.choice, FreePushes):
        raise InvalidInput(
            "looks", found="pushes of a rig", expected="FreePushes, which can push from any pose"
        )
    if looks:
        check_push(simulator.scene)  # a look sees one part
    pose_alone = (PoseRegion, Inside, Beyond)
    for own in simulator.goal.clauses if looks else ():
        if not isinstance(own, pose_alone):
            expected = "a goal that a seen pose can meet: PoseRegion, Inside or Beyond"
            raise InvalidInput("looks", found=f"the goal: {own}", expected=expected)
