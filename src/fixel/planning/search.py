"""Search for a plan: candidates, a race between them, refinement, and fresh scenarios."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, final

import numpy as np
from scipy.special import expit

from fixel.errors import InvalidInput
from fixel.planning.belief import Belief, Scenarios
from fixel.planning.candidates import (
    Numbers,
    displacements,
    plans_of_mechanics,
    sequences,
    spread_pushes,
)
from fixel.planning.race import RaceResult, race
from fixel.planning.rollout import CARRIED_OUT, PlannedMotions, PlanSimulator
from fixel.planning.success import SuccessProbability
from fixel.typing import FloatArray, IntArray

WORLDS: Final = 64  # parameter draws, each with as many runs in the statement of success
RACE: Final = (8, 16, 32, 64, 128, 256, 512, 1024)  # scenarios of a plan, rounds of the race
NEAR: Final = 3.0  # tolerances by which the nominal end of a candidate may miss the goal
ENTRANTS: Final = 1024  # candidates in the race
REFINED: Final = 4  # plans from which the refinement starts
REFINE_WORLDS, REFINE_RUNS = 32, 4
FINALISTS: Final = 8
FINAL_RUNS: Final = 16
APART: Final = 0.1  # shares of the ranges by which plans differ that are refined separately
REACHED: Final = math.log1p(0.8)  # score of a nominal end well inside the goal
SOFTNESS: Final = 0.3  # margin over which a success is counted partly in the refinement
# Shares of the budget of rollouts: candidates, race and refinement; the rest is for fresh samples.
SHARES: Final = (0.15, 0.45, 0.85)

Answers = MutableMapping[str, FloatArray]
Report = Callable[[str, int, int, float], None]  # stage, rollouts, budget, best success so far


@final
@dataclass(kw_only=True, eq=False)
class PlanSearch:
    """Search for the plan that most often reaches a goal.

    Parameters
    ----------
    simulator : PlanSimulator
    belief : Belief
    rollouts : int
        Number of simulated pushes that the search should not exceed by much.
    seed : int
    answers : mutable mapping of str to (m, n) float64
        Margins by what was asked; a stored one makes the search resumable.
    first : sequence of (k, d) float64
        Plans that are candidates in any case.
    report : callable, optional
    """

    simulator: PlanSimulator
    belief: Belief
    rollouts: int = 160_000
    seed: int = 0
    answers: Answers = field(default_factory=dict)
    first: Sequence[FloatArray] = ()
    report: Report | None = None
    best: float = 0.0

    def scenarios(self, stream: int, worlds: int, runs: int) -> Scenarios:
        """Draw scenarios of one stage; no two stages share any."""
        return self.belief.scenarios(
            self.simulator.scene, worlds=worlds, runs=runs, seed=1000 * self.seed + stream
        )

    def margins(self, plans: Sequence[FloatArray], scenarios: Scenarios, name: str) -> FloatArray:
        """Return the margins (m, n) of plans in scenarios."""
        digest = sha256(name.encode())
        for plan in plans:
            digest.update(np.ascontiguousarray(plan).tobytes())
        key = digest.hexdigest()
        if key not in self.answers:
            self.answers[key] = self._simulated(plans, scenarios)
        self._count(scenarios.n * sum(len(plan) for plan in plans))
        return self.answers[key]

    def _simulated(self, plans: Sequence[FloatArray], scenarios: Scenarios) -> FloatArray:
        found = np.zeros((len(plans), scenarios.n))
        n = scenarios.n
        for own, planned in grouped(self.simulator, plans):
            which = np.repeat(np.arange(len(own)), n)
            runs = self.simulator.run(
                planned, which, scenarios.rows(np.tile(np.arange(n), len(own)))
            )
            margin = self.simulator.margins(runs).reshape(len(own), n)
            found[own] = np.where(planned.collides[:, None], -1e3, margin)
        return found

    def _count(self, n: int) -> None:
        self.done += n

    done: int = 0

    # --- stages -----------------------------------------------------------------------------------

    def candidates(self) -> Numbers:
        """Return plans whose nominal end is near the goal, the nearest first."""
        simulator, choice = self.simulator, self.simulator.choice
        n = min(8192, max(256, 2 ** int(math.log2(max(2, 0.5 * SHARES[0] * self.rollouts)))))
        plans = [
            *self.first,
            *plans_of_mechanics(simulator),
            *spread_pushes(simulator.scene, choice, n, self.seed),
        ]
        self._show("candidates")
        if choice.most > 1:
            table = displacements(simulator, self.belief, seed=self.seed)
            for k in range(2, choice.most + 1):
                plans += sequences(simulator, table, k, self.seed)
                self._show("candidates")
        margin = nominal_margins(simulator, plans)
        self.done += sum(len(plan) for plan in plans)
        order = np.argsort(-margin, kind="stable")
        if margin[order[0]] < 0.0 and find_spec("cma") is not None:
            first = [plans[k] for k in order[:64] if margin[k] > -np.inf]
            plans = self.reaching(self.distinct(first, 2 * REFINED)) + plans
            margin = nominal_margins(simulator, plans)
            order = np.argsort(-margin, kind="stable")
        if margin[order[0]] < 0.0:
            raise self._unreachable(float(margin[order[0]]))
        near = order[margin[order] > -NEAR][:ENTRANTS]
        return [plans[k] for k in near]

    def race(self, plans: Numbers) -> RaceResult:
        """Race plans under common scenarios."""
        scenarios = self.scenarios(1, WORLDS, RACE[-1] // WORLDS)
        # Scenario k belongs to parameter draw k % WORLDS.
        order = np.arange(RACE[-1]).reshape(WORLDS, -1).T.reshape(-1)
        scenarios = scenarios.rows(order)

        def evaluate(which: IntArray, rows: IntArray) -> FloatArray:
            name = f"race {rows[0]} {rows[-1]}"
            return self.margins([plans[k] for k in which], scenarios.rows(rows), name)

        def show(turn: Any) -> None:
            self.best = turn.success
            self._show("race")

        budget = int((SHARES[1] - SHARES[0]) * self.rollouts)
        return race(
            evaluate, len(plans), sizes=RACE, worlds=scenarios.world, finalists=FINALISTS,
            budget=budget, report=show,
        )  # fmt: skip

    def reaching(self, plans: Numbers) -> Numbers:
        """Return plans whose nominal end is moved to the goal; those that reach it come first."""
        found = [
            self._improved(plan, self._nominal_scores, 600 * len(plan), 100 + number, REACHED)
            for number, plan in enumerate(plans)
        ]
        margin = nominal_margins(self.simulator, found)
        return [found[k] for k in np.argsort(-margin, kind="stable")]

    def refined(self, plans: Numbers) -> Numbers:
        """Improve plans by CMA-ES, each within its share of the budget; needs the package cma."""
        if find_spec("cma") is None or not plans:
            return []
        share = (SHARES[2] - SHARES[1]) * self.rollouts / len(plans)
        scenarios = self.scenarios(2, REFINE_WORLDS, REFINE_RUNS)

        def evaluate(numbers: Numbers, name: str) -> FloatArray:
            margins = self.margins(numbers, scenarios, name)
            self.best = max(self.best, float((margins >= 0.0).mean(axis=1).max()))
            self._show("refinement")
            return soft_score(margins, REFINE_WORLDS)

        cost = REFINE_WORLDS * REFINE_RUNS
        return [
            self._improved(plan, evaluate, share / cost, number)
            for number, plan in enumerate(plans)
        ]

    def _nominal_scores(self, plans: Numbers, name: str) -> FloatArray:
        self._count(sum(len(plan) for plan in plans))
        margin = np.maximum(nominal_margins(self.simulator, plans), -1e3)
        return np.sign(margin) * np.log1p(np.abs(margin))

    def _improved(
        self,
        plan: FloatArray,
        evaluate: Callable[[Numbers, str], FloatArray],
        budget: float,
        number: int,
        enough: float = math.inf,
    ) -> FloatArray:
        """Return the best plan that CMA-ES finds from one within `budget` pushes, or `enough`."""
        low, high = self.simulator.choice.bounds(self.simulator.scene)
        wide = np.flatnonzero(high > low)
        k = len(plan)
        span = np.tile((high - low)[wide], k)
        begin = (plan[:, wide].reshape(-1) - np.tile(low[wide], k)) / span
        cma = import_module("cma")
        options = {"seed": 1 + 1000 * self.seed + number, "verbose": -9}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            search = cma.CMAEvolutionStrategy(begin, 0.05, options)
        names = self.simulator.choice.names(self.simulator.scene)
        around = np.tile([names[j] == "contact" for j in wide], k)
        best, best_score, spent, turn = plan, -np.inf, 0, 0
        while spent < budget and best_score < enough and not search.stop():
            points = np.array(search.ask())
            inside = np.where(around, points % 1.0, np.clip(points, 0.0, 1.0))
            plans = [_placed(plan, wide, low, (span * x).reshape(k, -1)) for x in inside]
            score = evaluate(plans, f"refine {number} {turn}")
            outside = np.where(around, 0.0, np.abs(points - np.clip(points, 0.0, 1.0))).sum(axis=1)
            search.tell(list(points), list(outside - score))
            if score.max() > best_score:
                best, best_score = plans[int(score.argmax())], float(score.max())
            spent += len(plans) * k
            turn += 1
        return best

    def chosen(self, plans: Numbers) -> tuple[int, FloatArray]:
        """Return the index of the best of some plans in fresh scenarios, and the margins (m, n).

        By the success rate in the worst 5 % of parameter draws, then by the mean, by the margin in
        the worst 5 % of scenarios, by the number of pushes and by the spread of the ends.
        """
        margins = self.margins(plans, self.final_scenarios, "final")
        ranks = []
        for plan, own in zip(plans, margins, strict=True):
            success = self._success(own)
            worst = success.mean if success.quantile is None else success.quantile
            # Differences below the noise of the estimate are ties.
            ranks.append(
                (-round(50 * worst), -round(50 * success.mean), -success.margin, len(plan))
            )
        return min(range(len(plans)), key=ranks.__getitem__), margins

    @cached_property
    def final_scenarios(self) -> Scenarios:
        """Scenarios in which the plan is chosen."""
        return self.scenarios(3, WORLDS, min(FINAL_RUNS, max(2, self.rollouts // 5_000)))

    @cached_property
    def fresh_scenarios(self) -> Scenarios:
        """Scenarios from which the success of the chosen plan is computed.

        64 runs for each of 64 draws of the parameters, less for searches below 64,000 rollouts.
        """
        return self.scenarios(4, WORLDS, min(WORLDS, max(8, self.rollouts // 1_000)))

    def success(self, plan: FloatArray) -> tuple[SuccessProbability, FloatArray]:
        """Estimate the success of one plan from fresh scenarios; return also their margins (n,)."""
        margins = self.margins([plan], self.fresh_scenarios, "success")[0]
        return self._success(margins), margins

    def _success(self, margins: FloatArray) -> SuccessProbability:
        """Estimate success from margins (n,); by parameter draw only if parameters are unknown."""
        known = self.belief.parameters is None
        return SuccessProbability.of(margins if known else margins.reshape(WORLDS, -1))

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

    def _unreachable(self, margin: float) -> InvalidInput:
        if margin == -np.inf:
            found = "no push of the candidates can be carried out"
        else:
            found = f"the nearest candidate misses it by {-margin:.3g} tolerances"
        return InvalidInput(
            "goal",
            found=found,
            expected="a goal that the pushes can reach",
            hint="allow more or longer pushes, another tool or wider tolerances",
        )

    def _show(self, stage: str) -> None:
        if self.report is not None:
            self.report(stage, self.done, self.rollouts, self.best)


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


def _placed(plan: FloatArray, wide: IntArray, low: FloatArray, moved: FloatArray) -> FloatArray:
    found = plan.copy()
    found[:, wide] = low[wide] + moved
    return found
