"""Search for a plan: candidates, a race between them, refinement, and fresh scenarios."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Generator, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from importlib import import_module
from typing import Final, NamedTuple, TypeVar

import numpy as np
from scipy.special import expit

from fixel.calibration.study import relayed, run_study
from fixel.errors import InvalidInput
from fixel.model import Scene
from fixel.model.goals import AllOf, PoseRegion
from fixel.planning.belief import Belief, Scenarios
from fixel.planning.candidates import (
    Numbers,
    displacements,
    last_pushes,
    plans_of_mechanics,
    sequences,
    spread_pushes,
)
from fixel.planning.pushes import FreePushes
from fixel.planning.race import SIZES, RaceRequest, RaceRound, race_rounds
from fixel.planning.rollout import CARRIED_OUT, WORST_MARGIN, PlannedMotions, PlanSimulator
from fixel.planning.simplified import simplified
from fixel.planning.success import SuccessProbability
from fixel.progress import Progress
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.error_terms import RPI_CAMERA, StartError

WORLDS: Final = 64  # parameter draws of the race and of the choice
ROLLOUTS: Final = 160_000
NEARLY: Final = 9.0  # tolerances off, up to which wider ones are advised by number
NEAR: Final = 3.0  # tolerances by which the nominal end of a candidate may miss the goal
ENTRANTS: Final = 1024  # candidates in the race
REFINED: Final = 4  # plans from which the refinement starts
FINALISTS: Final = 8
FINAL_RUNS: Final = 16
SLOW_RUNS: Final = 4  # the same for traced outlines
APART: Final = 0.1  # shares of the ranges by which plans differ that are refined separately
REACHED: Final = math.log1p(0.8)  # score of a nominal end well inside the goal
REACH_ROUNDS: Final = 80  # of CMA-ES, to move nominal ends to the goal
SOFTNESS: Final = 0.3  # margin over which a success is counted partly in the refinement
# Shares of the budget of rollouts: candidates, race and refinement; the rest is for fresh samples.
SHARES: Final = (0.15, 0.45, 0.85)

Answers = MutableMapping[str, FloatArray]


Unseen = Callable[[Sequence[FloatArray]], list[tuple[str, ...]]]


class SearchStage(NamedTuple):
    """Scenarios of one stage of a search; no two stages share any."""

    stream: int  # of random values
    worlds: int  # parameter draws
    runs: int  # of each draw


RACE_STAGE: Final = SearchStage(1, WORLDS, SIZES[-1] // WORLDS)
REFINE_STAGE: Final = SearchStage(2, 32, 1)  # few, so that each plan takes many steps
SOME: Final = SearchStage(11, 8, 1)  # whether any part of the belief meets the goal
NEAREST: Final = SearchStage(12, WORLDS, 4)  # how likely the nearest end is
FINAL, DRAWS, RANGE = 3, 4, 5  # streams of the last stages
POOL: Final = 16  # draws of which one is chosen at random for the mean


class MarginRequest(NamedTuple):
    """Plans whose margins are wanted, in scenarios `first` to `last` of a stage."""

    plans: Numbers
    stage: SearchStage
    first: int
    last: int

    @property
    def name(self) -> str:
        """Name that differs for every other request of a search."""
        digest = sha256(repr((self.stage, self.first, self.last)).encode())
        for plan in self.plans:
            digest.update(np.ascontiguousarray(plan).tobytes())
        return digest.hexdigest()


T = TypeVar("T")
Rounds = Generator[MarginRequest, FloatArray, T]  # is sent the margins (m, n)


class FoundNumbers(NamedTuple):
    """Result of a search, as numbers of pushes."""

    plans: Numbers  # the best of the search, the chosen one first
    compared: FloatArray  # (m, n) their margins in the scenarios in which it was chosen
    margins: Sequence[FloatArray]  # (n_worlds, n_runs) of the chosen plan in every fresh stage
    # (n,) of the plan that would be best if nothing were unknown, in the first of these stages.
    nominal_margins: FloatArray


class Views(NamedTuple):
    """Looks at the part after the planned pushes, each followed by a correction."""

    looks: int = 0  # number of times that the part is seen
    camera: StartError = RPI_CAMERA  # error of a seen pose
    lost_views: float = 0.0  # share of the looks that see nothing


UNSEEN: Final = Views()  # no look


@dataclass(kw_only=True, eq=False)
class PlanSearch:
    """Search for the plan that most often reaches a goal."""

    simulator: PlanSimulator
    belief: Belief
    rollouts: int = ROLLOUTS  # number of simulated pushes that the search should not exceed by much
    seed: int = 0
    first: Sequence[FloatArray] = ()  # plans that are candidates in any case
    views: Views = UNSEEN
    report: Callable[[Progress], None] | None = None
    best: float = 0.0
    done: int = 0
    reached: bool = True  # whether a candidate meets the goal without a look
    # Simulates the search itself; the plan is chosen and its success stated by `simulator`.
    quick: PlanSimulator = field(init=False)

    def __post_init__(self) -> None:
        own = self.simulator
        fewer = simplified(own.scene, own.goal)
        self.quick = own if fewer is own.scene else replace(own, simplified=fewer)

    @property
    def final_stage(self) -> SearchStage:
        """SearchStage in which the plan is chosen, with fewer runs where each takes long."""
        most = FINAL_RUNS if self.quick is self.simulator else SLOW_RUNS
        return SearchStage(FINAL, WORLDS, min(most, max(2, self.rollouts // 5_000)))

    @property
    def fresh_stages(self) -> tuple[SearchStage, ...]:
        """Stages from which the success of the chosen plan is computed."""
        return fresh_stages(self.belief, self.simulator.scene, self.rollouts)

    def scenarios(self, stage: SearchStage) -> Scenarios:
        """Draw the scenarios of a stage."""
        if stage not in self._drawn:
            seed = 1000 * self.seed + stage.stream
            drawn = stage_scenarios(self.belief, self.simulator.scene, stage, seed)
            if stage == RACE_STAGE:  # scenario k belongs to parameter draw k % WORLDS
                order = np.arange(drawn.n).reshape(stage.worlds, -1).T.reshape(-1)
                drawn = drawn.rows(order)
            self._drawn[stage] = drawn
        return self._drawn[stage]

    _drawn: dict[SearchStage, Scenarios] = field(default_factory=dict)

    def margins(self, request: MarginRequest) -> FloatArray:
        """Simulate the margins (m, n) of a request."""
        scenarios = self.scenarios(request.stage).rows(np.arange(request.first, request.last))
        quick = request.stage in (RACE_STAGE, REFINE_STAGE, SOME)
        simulator = self.quick if quick else self.simulator
        n = scenarios.n
        found = np.zeros((len(request.plans), n))
        for own, planned in grouped(simulator, request.plans):
            which = np.repeat(np.arange(len(own)), n)
            runs = simulator.run(planned, which, scenarios.rows(np.tile(np.arange(n), len(own))))
            margin = simulator.margins(runs).reshape(len(own), n)
            found[own] = np.where(planned.collides[:, None], WORST_MARGIN, margin)
        return found

    def _ask(
        self, plans: Numbers, stage: SearchStage, first: int = 0, last: int | None = None
    ) -> Rounds[FloatArray]:
        last = stage.worlds * stage.runs if last is None else last
        self.done += (last - first) * sum(len(plan) for plan in plans)
        return (yield MarginRequest(plans, stage, first, last))

    # --- stages -----------------------------------------------------------------------------------

    def rounds(self, unseen: Unseen | None = None) -> Rounds[FoundNumbers]:
        """Search in rounds of requests; to resume, the stored margins are sent again.

        A plan about which `unseen` returns sentences, on what no experiment has, may not be chosen.
        Raise `InvalidInput` if the goal cannot be reached, or only by pushes that resemble no
        experiment.
        """
        plans = self.candidates()
        nominal_best = plans[0]
        if unseen is not None:
            texts = unseen(plans)
            plans = [plan for plan, text in zip(plans, texts, strict=True) if not text]
            if not plans:
                raise _refused(texts[0])
        ranked = yield from self._race(plans)
        finalists = self.distinct(ranked, FINALISTS)
        if self.simulator.choice.cost != "pushes":
            finalists += [ranked[k] for k in np.argsort(self._costs(ranked))[:FINALISTS]]
        better = yield from self._refined(self.distinct(ranked, REFINED))
        can = nominal_margins(self.simulator, better)
        good = [plan for plan, margin in zip(better, can, strict=True) if margin > -np.inf]
        good.append(nominal_best)
        texts = [()] * len(good) if unseen is None else unseen(good)
        finalists += [plan for plan, text in zip(good, texts, strict=True) if not text]
        compared = yield from self._ask(finalists, self.final_stage)
        order = self._order(finalists, compared)
        chosen = finalists[order[0]]
        draws, *more = self.fresh_stages
        both = yield from self._ask([chosen, nominal_best], draws)
        margins = [both[0][:, None]]
        for stage in more:
            found = yield from self._ask([chosen], stage)
            margins.append(found.reshape(stage.worlds, stage.runs))
        return FoundNumbers([finalists[k] for k in order], compared[order], margins, both[1])

    def candidates(self) -> Numbers:
        """Return plans whose nominal end is near the goal, the nearest first."""
        simulator, choice = self.quick, self.simulator.choice
        n = min(8192, max(256, 2 ** int(math.log2(max(2, 0.5 * SHARES[0] * self.rollouts)))))
        plans = [
            *self.first,
            *self._no_push(),
            *plans_of_mechanics(simulator),
            *spread_pushes(simulator.scene, choice, n, self.seed),
        ]
        self._show("candidates")
        if choice.most > 1:
            table = displacements(simulator, self.belief, self.rollouts, self.seed)
            ends = last_pushes(simulator, table, self.seed)
            for k in range(2, choice.most + 1):
                plans += sequences(simulator, table, ends, k, self.seed)
                self._show("candidates")
        margin = nominal_margins(simulator, plans)
        order = np.argsort(-margin, kind="stable")
        if margin[order[0]] < 0.0:
            first = [plans[k] for k in order[:64] if margin[k] > -np.inf]
            plans = self._reaching(self.distinct(first, 2 * REFINED)) + plans
            margin = nominal_margins(simulator, plans)
            order = np.argsort(-margin, kind="stable")
        if margin[order[0]] < 0.0:
            # Some part of the belief may meet what its middle misses.
            some = order[margin[order] > -np.inf][:ENTRANTS]
            request = MarginRequest([plans[k] for k in some], SOME, 0, SOME.worlds)
            margin[some] = np.maximum(margin[some], self.margins(request).max(axis=1))
            self.reached = margin.max() >= 0.0
            if not self.reached and not self.views.looks:
                raise self.unreachable(plans)
        self.done = simulator.rollouts
        # Where only corrections can reach the goal, any first pushes may lead to a pose for them.
        near = order[margin[order] > (-NEAR if self.reached else -np.inf)][:ENTRANTS]
        return [plans[k] for k in near]

    def _no_push(self) -> Numbers:
        """Return the plan without a push where the part already meets the goal."""
        if not isinstance(self.simulator.choice, FreePushes):
            return []  # the part is placed on a rig first
        empty = np.zeros((0, len(self.simulator.choice.bounds(self.simulator.scene)[0])))
        return [empty] if nominal_margins(self.simulator, [empty])[0] >= 0.0 else []

    def _race(self, plans: Numbers) -> Rounds[Numbers]:
        """Race plans under common scenarios; return those of the last round, the best first."""

        def show(turn: RaceRound) -> None:
            self.best = turn.success
            self._show("race")

        def ask(wanted: RaceRequest) -> Rounds[FloatArray]:
            own, rows = [plans[int(k)] for k in wanted.plans], wanted.scenarios
            return self._ask(own, RACE_STAGE, int(rows[0]), int(rows[-1]) + 1)

        rounds = race_rounds(
            len(plans), worlds=self.scenarios(RACE_STAGE).world,
            finalists=FINALISTS, budget=int((SHARES[1] - SHARES[0]) * self.rollouts), report=show,
        )  # fmt: skip
        found = yield from relayed(rounds, ask)
        return [plans[int(k)] for k in found.plans]

    def _refined(self, plans: Numbers) -> Rounds[Numbers]:
        """Improve plans by CMA-ES side by side, each within its share of the budget."""
        plans = [plan for plan in plans if len(plan)]
        if not plans:
            return []
        searches = self._refinements(plans)
        budget = (SHARES[2] - SHARES[1]) * self.rollouts
        spent, busy = 0, searches
        while busy and spent < budget:
            asked = [plan for search in busy for plan in search.ask()]
            margins = yield from self._ask(asked, REFINE_STAGE)
            spent += margins.shape[1] * sum(map(len, asked))
            scores = soft_score(margins, REFINE_STAGE.worlds)
            for search in busy:
                scores = search.tell(scores)
            self.best = max(self.best, float((margins >= 0.0).mean(axis=1).max()))
            self._show("refinement")
            busy = [search for search in busy if not search.is_done]
        return [search.best for search in searches]

    def _reaching(self, plans: Numbers) -> Numbers:
        """Return plans whose nominal end is moved to the goal by CMA-ES."""
        busy = searches = self._refinements(plans, 100)
        for _ in range(REACH_ROUNDS if plans else 0):
            asked = [plan for search in busy for plan in search.ask()]
            margin = np.maximum(nominal_margins(self.quick, asked), WORST_MARGIN)
            scores = np.sign(margin) * np.log1p(np.abs(margin))
            for search in busy:
                scores = search.tell(scores)
            busy = [own for own in busy if own.score < REACHED and not own.is_done]
            if not busy:
                break
        return [search.best for search in searches]

    def _refinements(self, plans: Numbers, first: int = 0) -> list[PlanRefinement]:
        """Return searches about plans, which have random values of their own."""
        return [
            PlanRefinement(self.simulator, plan, 1000 * self.seed + number)
            for number, plan in enumerate(plans, first)
        ]

    def _order(self, plans: Numbers, margins: FloatArray) -> IntArray:
        """Return the order of plans by their margins (m, n) in fresh scenarios.

        By the middle between the mean success rate and that in the worst 5 % of parameter draws,
        then by their cost, the margin in the worst 5 % of scenarios and the number of pushes. The
        worst draws alone would decide by chance where all plans fail under some of them.
        """
        ranks = []
        for plan, own, cost in zip(plans, margins, self._costs(plans), strict=True):
            known = self.belief.parameters is None
            success = SuccessProbability.of(own if known else own.reshape(WORLDS, -1))
            worst = success.mean if success.worst is None else success.worst
            # Differences below the noise of the estimate are ties.
            middle = 0.5 * (worst + success.mean)
            ranks.append((-round(50 * middle), cost, -success.margin, len(plan)))
        return np.array(sorted(range(len(plans)), key=ranks.__getitem__), np.int64)

    def _costs(self, plans: Numbers) -> FloatArray:
        """Return the time [s] or the length [m] of plans (n,), zeros where neither is asked for."""
        cost, found = self.simulator.choice.cost, np.zeros(len(plans))
        for own, planned in grouped(self.quick, plans) if cost != "pushes" else ():
            step = np.diff(planned.path, axis=2)
            each = step[..., 0] if cost == "time" else np.hypot(step[..., 1], step[..., 2])
            found[own] = each.sum(axis=(1, 2))
        return found

    def distinct(self, plans: Numbers, n: int) -> Numbers:
        """Return the first n plans of which no two are near each other."""
        low, high = self.simulator.choice.bounds(self.simulator.scene)
        span = np.where(high > low, high - low, 1.0)
        found: Numbers = []
        for plan in plans:
            others = [own for own in found if len(own) == len(plan)]
            if all(np.abs((plan - own) / span).max() > APART for own in others):
                found.append(plan)
            if len(found) == n:
                break
        return found

    def unreachable(self, plans: Numbers) -> InvalidInput:
        """Return the error for a goal that no candidate reaches, with the nearest end."""
        wider, found = "wider tolerances", "that no push of the candidates can be carried out"
        least = -np.inf
        for _, planned in grouped(self.quick, plans):
            own = planned.nominal
            good = ~planned.collides & (own.failure == CARRIED_OUT)
            margin = np.where(good, self.quick.unlimited_margins(own), -np.inf)
            k = int(np.argmax(margin))
            if margin[k] > least:
                least, nearest = float(margin[k]), planned.rows(np.array([k]))
        if least > -np.inf:
            end = nearest.nominal.pose[0, -1]
            found = (
                f"that the nearest candidate ends at {pose_text(end)}: it misses by {-least:.3g}"
            )
            found += f" tolerances{self._chance(nearest, end)}"
        if least > -NEARLY:
            wider = f"tolerances {1.01 - least:.3g} times as wide, which that end meets"
        return InvalidInput(
            "goal",
            found=found,
            expected="a goal that the pushes can reach",
            hint=f"allow more or longer pushes, another tool or {wider}",
        )

    def _chance(self, planned: PlannedMotions, end: FloatArray) -> str:
        """Return how likely a plan ends near a pose (3,), by the goal's tolerances of poses."""
        regions = [one for one in self.simulator.goal.clauses if isinstance(one, PoseRegion)]
        if not regions:
            return ""
        scenarios = self.scenarios(NEAREST)
        runs = self.simulator.run(planned, np.zeros(scenarios.n, np.int64), scenarios)
        near = AllOf(*(replace(one, pose=end) for one in regions))
        chance = np.mean(replace(self.simulator, goal=near).margins(runs) >= 0.0)
        return f"; it ends within the same tolerances of that pose with probability {chance:.2g}"

    def _show(self, stage: str) -> None:
        if self.report is not None:
            note = f"success {self.best:.3f}"
            self.report(Progress(stage, self.done, max(self.done, self.rollouts), note=note))


def fresh_stages(belief: Belief, scene: Scene, rollouts: int = ROLLOUTS) -> tuple[SearchStage, ...]:
    """Return the stages from which the success of a plan is computed.

    The first has 2,400 draws of the parameters with one run each, for the mean. If parameters are
    unknown, the second has 256 draws with 16 runs each, for the range of their success rates: what
    stays the same in all trials. A search with fewer rollouts has fewer draws.
    """
    stages = [SearchStage(DRAWS, min(2400, max(512, rollouts // 16)), 1)]
    scatter = belief.run_to_run and replace(belief.run_to_run, centre=0.0, friction=0.0)
    drawn = replace(belief, run_to_run=scatter).scenarios(scene, worlds=WORLDS, runs=1)
    if any(np.ptp(values) > 0.0 for values in drawn.values.values()):
        worlds = min(256, max(WORLDS, rollouts // 250))
        stages.append(SearchStage(RANGE, worlds, min(16, max(8, rollouts // 4_000))))
    return tuple(stages)


def stage_scenarios(belief: Belief, scene: Scene, stage: SearchStage, seed: int) -> Scenarios:
    """Draw the scenarios of a stage.

    Those of the mean are independent: beliefs draw evenly, so that the mean of many draws scatters
    less than the interval of independent ones, but a few of many even ones are independent.
    Those of the range have one error of the model for all runs of a draw, as a laboratory has.
    """
    n = (POOL if stage.stream == DRAWS else 1) * stage.worlds
    drawn = belief.scenarios(scene, worlds=n, runs=stage.runs, seed=seed)
    if stage.stream == DRAWS:
        return drawn.rows(np.random.default_rng(seed).permutation(n)[: stage.worlds])
    if stage.stream == RANGE:
        first = drawn.world * stage.runs
        drawn = drawn._replace(misfit=drawn.misfit[first], drift=drawn.drift[first])
    return drawn


def conduct(search: PlanSearch, rounds: Rounds[T], answers: Answers) -> T:
    """Answer the requests of a search, from stored answers where there are some.

    Answers (m, n) are stored by the names of their requests; new ones are added.
    """

    def answer(request: MarginRequest) -> FloatArray:
        if request.name not in answers:
            answers[request.name] = search.margins(request)
        return answers[request.name]

    return run_study(rounds, answer)


def _refused(unseen: tuple[str, ...]) -> InvalidInput:
    found = f"no experiment that resembles a push towards the goal: {'; '.join(unseen)}"
    expected = "experiments with similar pushes"
    hint = "record some (fixel next proposes them), or plan with untrusted=True"
    return InvalidInput("belief.parameters", found=found, expected=expected, hint=hint)


def grouped(
    simulator: PlanSimulator, plans: Sequence[FloatArray]
) -> list[tuple[IntArray, PlannedMotions]]:
    """Return the planned motions of plans with equal numbers of pushes, with their indices."""
    lengths = np.array([len(plan) for plan in plans])
    found = []
    for k in np.unique(lengths):
        own = np.flatnonzero(lengths == k)
        found.append((own, simulator.planned(np.array([plans[int(j)] for j in own]))))
    return found


def pose_text(pose: FloatArray) -> str:
    """Return a pose (3,) [m, m, rad] as text."""
    x, y, theta = np.round((1e3 * pose[0], 1e3 * pose[1], np.degrees(pose[2])), 4) + 0.0
    return f"{x:.6g} mm, {y:.6g} mm, {theta:.6g} deg"


def nominal_margins(simulator: PlanSimulator, plans: Sequence[FloatArray]) -> FloatArray:
    """Return the margins (n,) of plans without any error; -inf where they cannot be carried out."""
    margin = np.full(len(plans), -np.inf)
    for own, planned in grouped(simulator, plans):
        good = ~planned.collides & (planned.nominal.failure == CARRIED_OUT)
        margin[own] = np.where(good, simulator.margins(planned.nominal), -np.inf)
    return margin


def soft_score(margins: FloatArray, worlds: int) -> FloatArray:
    """Return scores (m,) of margins (m, n), half of them from the worst quarter of the draws.

    Successes are counted partly near the tolerance, so that a score has a slope where the share of
    successes has none.
    """
    squashed = np.sign(margins) * np.log1p(np.abs(margins))
    rate = expit(squashed / SOFTNESS).reshape(len(margins), worlds, -1).mean(axis=2)
    # A failure is worse the farther it is from the goal: a slope far away, too.
    far = 1e-3 * squashed.mean(axis=1)
    worst = np.sort(rate, axis=1)[:, : max(1, worlds // 4)].mean(axis=1)
    return np.asarray(0.5 * rate.mean(axis=1) + 0.5 * worst + far)


WIDTH: Final = 0.05  # standard deviation of the first plans, in shares of the ranges


class PlanRefinement:
    """Search by CMA-ES about one plan (k, d), with the best plan so far and its score.

    Source
    ------
    Hansen & Ostermeier (2001); the package pycma.
    """

    def __init__(self, simulator: PlanSimulator, plan: FloatArray, seed: int) -> None:
        low, high = simulator.choice.bounds(simulator.scene)
        self._low = low
        self._wide = np.flatnonzero(high > low)
        k = len(plan)
        self._span = np.tile((high - low)[self._wide], k)
        begin = (plan[:, self._wide] - low[self._wide]).reshape(-1) / self._span
        names = simulator.choice.names(simulator.scene)
        self._around = np.tile([names[j] == "contact" for j in self._wide], k)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._search = import_module("cma").CMAEvolutionStrategy(
                begin, WIDTH, {"seed": 1 + seed, "verbose": -9}
            )
        self.best, self.score = plan, -np.inf

    @property
    def is_done(self) -> bool:
        """Whether CMA-ES itself stops."""
        return bool(self._search.stop())

    def ask(self) -> Numbers:
        """Return the plans to evaluate next."""
        self._points = np.array(self._search.ask())
        inside = np.where(self._around, self._points % 1.0, np.clip(self._points, 0.0, 1.0))
        self._plans = [_placed(self.best, self._wide, self._low, self._span * x) for x in inside]
        return self._plans

    def tell(self, scores: FloatArray) -> FloatArray:
        """Take the scores of these plans, larger for better ones; return those of later plans."""
        scores, later = np.split(scores, [len(self._plans)])
        off = np.abs(self._points - np.clip(self._points, 0.0, 1.0))
        outside = np.where(self._around, 0.0, off).sum(axis=1)
        self._search.tell(list(self._points), list(outside - scores))
        if scores.max() > self.score:
            self.best, self.score = self._plans[int(scores.argmax())], float(scores.max())
        return later


def _placed(plan: FloatArray, wide: IntArray, low: FloatArray, moved: FloatArray) -> FloatArray:
    found = plan.copy()
    found[:, wide] = low[wide] + moved.reshape(len(plan), -1)
    return found
