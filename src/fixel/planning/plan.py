"""Plans of open-loop pushes, with their stated success probability."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, counted
from fixel.model import Scene
from fixel.model.bodies import POSE
from fixel.model.fields import MAX_SEED, instance, vector, whole
from fixel.model.goal_checks import check_goal
from fixel.model.goals import BodyTrack, Goal, as_goal, body_of, events_in
from fixel.model.probability import Probability
from fixel.planning.belief import UNKNOWN_UNITS, Belief, Scenarios, check_centres
from fixel.planning.causes import MIN_SCENARIOS, Explanation
from fixel.planning.looks import Looks, Policy, check_looks, looks_of, policy_of
from fixel.planning.pushes import (
    FreePushes,
    PlanPush,
    PushChoice,
    RigPush,
    RigPushes,
    scene_of_push,
)
from fixel.planning.rollout import FAILURES, PlannedMotions, PlanSimulator, Runs
from fixel.planning.search import (
    UNSEEN,
    PlanSearch,
    Rounds,
    Views,
    fresh_stages,
    grouped,
    pose_text,
    stage_scenarios,
)
from fixel.planning.success import SuccessProbability
from fixel.progress import Progress
from fixel.results import Player, Result, Summary
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.result import Simulation
from fixel.simulation.simulate import simulate
from fixel.simulation.stepping import AbstractStepper
from fixel.table import Column, Table
from fixel.trust import permit
from fixel.typing import FloatArray, IntArray

SAMPLES: Final = 12  # poses of each push that goals about the whole motion regard
MIN_ROLLOUTS, MAX_ROLLOUTS = 1000, 10**9
FRESH: Final = 1_000_003  # added to the seed of a plan, so that a check draws other scenarios
MISSED: Final = "misses the goal"


class PlanCorrection(NamedTuple):
    """Push that is chosen after a look at the part."""

    push: PlanPush | RigPush | None  # none where no push promises more
    scene: Scene | None  # of that push, with the part at its seen pose and the path of the tool
    probability: float  # that the goal is met then, without further looks


class PlanRuns(NamedTuple):
    """Runs of one plan in its scenarios."""

    scenarios: Scenarios
    margin: FloatArray  # (n,) of the goal, in units of its tolerance
    end: FloatArray  # (n, 3) pose of the part [m, m, rad]
    outcome: tuple[str, ...]  # empty for success, else why a run failed


@final
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PushPlan(Result):
    """Open-loop plan of pushes with its stated success probability.

    Made by `fixel.plan`.

    Attributes
    ----------
    scene : Scene
        Scene with the tool, the part at its planned start.
    goal : Goal
    choose : FreePushes or RigPushes
        Pushes that could be chosen.
    belief : Belief
        What is unknown.
    pushes : tuple of PlanPush or RigPush
        Pushes in sequence; none where a part that already meets the goal is best left alone.
    start : (k, 3) float64
        Planned pose of the part before each push [m, m, rad].
    path : (k, n, 4) float64
        Motion of the tool in each push: time [s] and pose in the world [m, m, rad].
    end : (3,) float64
        Planned end pose [m, m, rad].
    fixels : (n_fixel, 3) float64 or None
        Planned displacements of the fixels [m, m, rad].
    others : (k, n_other, 3) float64 or None
        Planned poses of the other parts before each push [m, m, rad]; None without other parts.
    success : SuccessProbability
        Stated success probability, from scenarios that the search has not seen.
    nominal_success : SuccessProbability
        The same for the plan that would be best if nothing were unknown.
    runs : PlanRuns
        Runs from which the mean of `success` is computed.
    alternatives : (m, n) float64
        Margins of the best plans of the search, this one first, in `compared`.
    compared : Scenarios
        Scenarios in which the plan was chosen.
    unseen : tuple of str
        What no experiment of the calibration has about a push of the plan.
    motion : AbstractMotionModel
    stepper : AbstractStepper or None
    looks : Looks or None
        Looks at the part after these pushes, each with a correction; None for an open-loop plan.
        `success` is then that of the whole.
    rollouts : int
        Number of pushes simulated in the search.
    seed : int

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import deg, mm
    >>> goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=5 * mm, angle=5 * deg)
    >>> plan = fixel.plan(pushed_square(), goal, rollouts=4_000, progress=False)
    >>> len(plan.pushes)
    1
    """

    scene: Scene
    goal: Goal
    choose: FreePushes | RigPushes
    belief: Belief
    pushes: tuple[PlanPush | RigPush, ...]
    start: FloatArray
    path: FloatArray
    end: FloatArray
    fixels: FloatArray | None
    success: SuccessProbability
    nominal_success: SuccessProbability
    runs: PlanRuns
    alternatives: FloatArray
    compared: Scenarios
    unseen: tuple[str, ...]
    motion: AbstractMotionModel
    stepper: AbstractStepper | None
    others: FloatArray | None = None
    looks: Looks | None = None
    rollouts: int
    seed: int

    @property
    def other_poses(self) -> FloatArray:
        """Planned poses (k, n_other, 3) of the other parts before each push [m, m, rad]."""
        return np.zeros((len(self.pushes), 0, 3)) if self.others is None else self.others

    @property
    def first_pose(self) -> FloatArray:
        """Planned pose (3,) of the part before any push [m, m, rad]."""
        return self.start[0] if self.pushes else self.end

    @property
    def count(self) -> str:
        """Numbers of pushes and looks as text."""
        n, looks = len(self.pushes), 0 if self.looks is None else self.looks.most
        if n == looks == 0:
            return "no push, for the part already meets the goal"
        pushes = counted(n, "push") if n else "no push"
        return f"{pushes} and up to {counted(looks, 'look')}" if looks else pushes

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """Scene of each push: the part at its planned pose, the tool on its path."""
        scene = self.scene
        if self.fixels is not None:
            moved = [
                replace(fixel, pose=np.asarray(fixel.pose) + shift)
                for fixel, shift in zip(scene.fixels, self.fixels, strict=True)
            ]
            scene = replace(scene, fixels=tuple(moved))
        return tuple(
            scene_of_push(scene, start, path, others)
            for start, path, others in zip(self.start, self.path, self.other_poses, strict=True)
        )

    def waypoints(self) -> Table:
        """Return the motion of the tool as a table: push, time, x, y and angle."""
        names = ("push", "time", "x", "y", "angle")
        units = ("", "s", "m", "m", "rad")
        columns = [Column(name, unit) for name, unit in zip(names, units, strict=True)]
        return Table(
            columns, [(k + 1, *row) for k, path in enumerate(self.path) for row in path.tolist()]
        )

    def push_table(self, title: str = "") -> Table:
        """Return the pushes as a table."""
        rows = [(k, str(push)) for k, push in enumerate(self.pushes, 1)]
        return Table(("push", "what"), rows, title=title, left=2 if title else 1)

    def success_table(self, title: str = "") -> Table:
        """Return the success of this plan, and of the best one without errors, as a table."""
        names = ("stated", "low", "high", "worst", "best")
        plans = {"this plan": self.success, "best without errors": self.nominal_success}
        return Table(
            ("success", *(Column(name, format=".4f") for name in names)),
            [(name, *(getattr(own, one) for one in names)) for name, own in plans.items()],
            title=title,
        )

    def as_planned(self) -> tuple[Simulation, ...]:
        """Simulate each push from its planned pose, with the best known parameters."""
        given = self.belief.nominal(self.scene)
        return tuple(
            simulate(scene, given, motion=self.motion, stepper=self.stepper)
            for scene in self.scenes
        )

    def animate(
        self, path: str | Path | None = None, *, push: int = 1, progress: Any = None
    ) -> Path | Player:
        """Show the planned motion of a push in a notebook, or write an animation of it.

        Parameters
        ----------
        path : str or path, optional
            As for `Simulation.animate`.
        push : int
            Number of the push, from 1.
        progress : bool or callable, optional
            As for `fixel.progress.show_progress`.

        Returns
        -------
        pathlib.Path or Player
        """
        runs = self.as_planned()
        if not 1 <= push <= len(runs):
            raise InvalidInput("push", found=push, expected="the number of one of its pushes")
        return runs[push - 1].animate(path, progress=progress)

    def simulate(self, n: int = 200, *, samples: int = SAMPLES, threads: int | None = None) -> Runs:
        """Simulate the plan again in n of its scenarios, with the poses on the way.

        Parameters
        ----------
        n : int
            Number of runs, evenly spread over the scenarios.
        samples : int
            Number of poses of each push.
        threads : int, optional

        Returns
        -------
        Runs
        """
        rows = np.linspace(0, len(self.runs.margin) - 1, min(n, len(self.runs.margin)))
        own = self.runs.scenarios.rows(rows.astype(np.int64))
        return self.run(own, samples=samples, threads=threads)

    def run(
        self, scenarios: Scenarios, *, samples: int = SAMPLES, threads: int | None = None
    ) -> Runs:
        """Simulate the plan once in each of some scenarios, with `samples` poses of each push."""
        simulator = replace(self.simulator(threads), samples=samples)
        return simulator.run(self.planned(), np.zeros(scenarios.n, np.int64), scenarios)

    def capture(
        self, push: int, offsets: FloatArray, *, runs: int = 16, threads: int | None = None
    ) -> FloatArray:
        """Return the success rate from other poses before a push of the plan.

        Parameters
        ----------
        push : int
            Number of the push, from 0.
        offsets : (n, 3) float64
            Offsets of the part from its planned pose before that push [m, m, rad].
        runs : int
            Number of scenarios for each.
        threads : int, optional

        Returns
        -------
        (n,) float64
            Share of the scenarios in which the rest of the plan reaches the goal.
        """
        rows = np.linspace(0, len(self.runs.margin) - 1, runs).astype(np.int64)
        own = self.runs.scenarios.rows(np.tile(rows, len(offsets)))
        own = own._replace(start=np.repeat(np.asarray(offsets, np.float64), runs, axis=0))
        simulator = self.simulator(threads)
        found = simulator.run(self.planned(), np.zeros(own.n, np.int64), own, first=push)
        return np.asarray((simulator.margins(found) >= 0.0).reshape(-1, runs).mean(axis=1))

    def under(self, belief: Belief) -> PushPlan:
        """Return the plan with another belief, and with its motion model unless one was chosen."""
        chosen = self.motion != self.belief.motion
        return replace(self, belief=belief, motion=self.motion if chosen else belief.motion)

    def success_under(self, belief: Belief) -> SuccessProbability:
        """Compute the success probability from fresh scenarios of a belief, such as a later one."""
        simulator, planned = self.under(belief).simulator(), self.planned()
        if self.looks is not None:
            policy = self.policy
            return looks_of(policy, policy.stages(belief), self.seed + FRESH, belief)[0].worth[-1]
        margins = []
        for own in fresh_stages(belief, self.scene):
            seed = self.seed + FRESH + own.stream
            scenarios = stage_scenarios(belief, self.scene, own, seed)
            runs = simulator.run(planned, np.zeros(scenarios.n, np.int64), scenarios)
            margins.append(simulator.margins(runs).reshape(own.worlds, own.runs))
        return SuccessProbability.of(margins[-1], independent=margins[0][:, 0])

    def success_in(
        self, engine: str, runs: int = 100, *, seed: int = 1, threads: int | None = None
    ) -> Probability:
        """Carry the plan out in another simulator, and return how often it reaches the goal.

        What is unknown is drawn again for every run, as for the stated success probability.

        Parameters
        ----------
        engine : str
            Engine, such as `"pymunk"`, or the path of a program.
        runs : int
            Number of runs.
        seed : int
            Seed of what is drawn.
        threads : int, optional

        Returns
        -------
        Probability
            Share of the runs that reached the goal, with its 95 % interval.

        Raises
        ------
        InvalidInput
            The engine is unknown or does not support the scene, or the plan has looks.
        """
        if self.looks is not None:
            raise InvalidInput("plan", found="looks", expected="a plan without looks")
        permit(engine)
        try:
            motion = motion_model(engine)
        except InvalidInput as problem:
            raise problem.at("engine") from None
        simulator = replace(self, motion=motion).simulator(threads)
        found = simulator.run(self.planned(), np.zeros(runs, np.int64), self.draw(runs, seed))
        met = simulator.margins(found) >= 0.0
        return Probability.of(int(met.sum()), runs)

    def draw(self, n: int, seed: int = 1) -> Scenarios:
        """Draw n fresh scenarios, which neither the search nor its statement has used."""
        return self.belief.scenarios(self.scene, worlds=n, runs=1, seed=self.seed + FRESH + seed)

    @cached_property
    def policy(self) -> Policy:
        """Policy of a plan with looks, which chooses corrections of seen poses."""
        own = self.looks
        if own is None:
            hint = "plan with looks=1 or more"
            raise InvalidInput("plan", found="no looks", expected="a plan with looks", hint=hint)
        return Policy(
            simulator=self.simulator(), belief=self.belief, planned=self.planned(),
            table=own.table, views=Views(own.most, own.camera, own.lost_views),
        )  # fmt: skip

    def correction(self, *seen: ArrayLike) -> PlanCorrection:
        """Choose what to do after the part was seen.

        Parameters
        ----------
        *seen : (3,) array_like
            Poses of the part that were seen so far: after the planned pushes, and after each
            correction [m, m, rad].

        Returns
        -------
        PlanCorrection
            Push with its scene, or none where no push promises more, and the probability that the
            goal is met then, without further looks.
        """
        poses, policy = np.array([vector(pose, "seen", POSE) for pose in seen]), self.policy
        if not 1 <= len(poses) <= policy.views.looks:
            expected = f"1 to {policy.views.looks}, one for each look"
            raise InvalidInput("seen", found=f"{len(poses)} poses", expected=expected)
        found = policy.next(poses)
        row, probability = int(found.row[0]), float(found.probability[0])
        if row < 0:
            return PlanCorrection(None, None, probability)
        numbers = found.numbers[:1]
        path = self.choose.motions(self.scene, numbers, poses[-1:]).path[0]
        return PlanCorrection(
            self.choose.pushes(self.scene, numbers)[0],
            scene_of_push(self.scene, poses[-1], path),
            probability,
        )

    def perform(
        self, push: Callable[[Scene], object], look: Callable[[], ArrayLike | None]
    ) -> tuple[PlanCorrection, ...]:
        """Carry out the plan with one's own robot and camera.

        Parameters
        ----------
        push : callable
            Carries out the push of a scene: its tool moves along the path of its drive.
        look : callable
            Returns the pose of the part (3,) [m, m, rad], or None where it was not seen.

        Returns
        -------
        tuple of PlanCorrection
            What was chosen after each look that saw the part.
        """
        for scene in self.scenes:
            push(scene)
        seen: list[ArrayLike] = []
        chosen: list[PlanCorrection] = []
        for _ in range(0 if self.looks is None else self.looks.most):
            if (pose := look()) is None:
                continue
            seen.append(pose)
            chosen.append(self.correction(*seen))
            if (after := chosen[-1].scene) is not None:
                push(after)
        return tuple(chosen)

    def explain(self) -> Explanation:
        """Return the reasons why the plan fails, and what measuring each unknown is worth.

        Failures are those of the runs that state its success probability. The worth of measuring
        comes from the best plans of the search, in the scenarios in which one of them was chosen;
        a plan with looks has none, since these plans are carried out without a look.

        Examples
        --------
        >>> import fixel
        >>> from fixel.planning.belief import Belief
        >>> from fixel.testing.scenes import pushed_square
        >>> from fixel.units import deg, mm
        >>> goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=5 * mm, angle=5 * deg)
        >>> belief = Belief(start=fixel.StartError(y=8 * mm, kind="uniform"))
        >>> plan = fixel.plan(pushed_square(), goal, belief=belief, rollouts=4_000, progress=False)
        >>> plan.explain().effects[0].name
        'start y'
        """
        own, others = self.runs.scenarios, self.compared
        failures = Explanation.of(
            self.runs.margin[None], own.unknowns(), worlds=self._sets(own), units=UNKNOWN_UNITS,
            kinds=self.runs.outcome,
        )  # fmt: skip
        if self.looks is not None:
            return failures
        compared = Explanation.of(
            self.alternatives, others.unknowns(), worlds=self._sets(others), units=UNKNOWN_UNITS
        )
        return failures.with_worth(compared)

    def _sets(self, own: Scenarios) -> IntArray:
        """Number the parameter sets (n,) of scenarios, of which draws may repeat some."""
        if self.belief.run_to_run is not None or not own.values:
            return own.world
        sets = np.unique(np.array([*own.values.values()]), axis=1, return_inverse=True)[1]
        return sets if sets.max() >= MIN_SCENARIOS else own.world  # few sets are all there is

    @property
    def advice(self) -> str:
        """Sentence on the parameter whose measurement decides most; empty for a narrow range."""
        if not self.success.calibrate_first:
            return ""
        text = "Success differs much between possible worlds"
        own = [one for one in self.explain().effects if one.name in self.runs.scenarios.values]
        most = max(own, key=lambda one: (one.worth, one.share), default=None)
        if most is None or not most.worth + most.share:
            return f"{text}: calibrate with pushes like these first"
        gain = f"raise success to {self.success.mean + most.worth:.2f} by another choice"
        shown = gain if most.worth else "show whether the plan works"
        return f"{text}: measuring {most.name} would {shown}"

    def simulator(self, threads: int | None = None) -> PlanSimulator:
        """Return the simulator of the plan."""
        return simulator_of(
            self.scene, self.goal, self.choose, self.belief, self.motion, self.stepper, threads
        )

    def planned(self) -> PlannedMotions:
        """Return the planned motions, to simulate them in other scenarios."""
        fixels = None if self.fixels is None else self.fixels[None]
        nominal = Runs(
            self.end[None, None], np.zeros(1, np.int64), np.zeros(1, bool), np.zeros(1), fixels
        )
        others, hit = self.other_poses[None], np.zeros(1, bool)
        return PlannedMotions(self.start[None], self.path[None], fixels, others, nominal, hit)

    @property
    def failures(self) -> Mapping[str, float]:
        """Share of the runs that failed, by what became of them, the most frequent first."""
        kinds = Counter(sorted(filter(None, self.runs.outcome))).most_common()
        return {why: count / len(self.runs.outcome) for why, count in kinds}

    @property
    def other_parts(self) -> str:
        """Sentence on the other parts of the scene; empty without any."""
        kept, others = self.choose.keep, self.scene.bodies[1:]
        texts = [f"{x.name} {'must stay' if x.name in kept else 'may be pushed'}" for x in others]
        return f"other parts: {', '.join(texts)}" if texts else ""

    def _summary(self) -> Summary:
        notes = [
            *(self.looks.sentences if self.looks else ()),
            *filter(None, [self.belief.error_text, self.other_parts]),
            self.belief.start_text,
            *(f"fails: {100.0 * share:.1f} % {why}" for why, share in self.failures.items()),
        ]
        if advice := self.advice:
            notes.append(advice)
        if self.belief.misfit:
            notes.insert(0, f"calibration: {self.belief.misfit}")
        if not self.belief.is_calibrated:
            notes.append("not compared with experiments: parameters are given or nominal")
        notes.append(f"planned end {pose_text(self.end)}")
        return Summary(
            f"Plan of {self.count}: {self.success.sentence}",
            [self.push_table(), self.success_table()],
            notes,
            {"rollouts": str(self.rollouts), "seed": str(self.seed), "motion": self.motion.name},
            self.unseen,
        )

    def _data(self) -> Table:
        """Return the motion of the tool."""
        return self.waypoints()


def simulator_of(
    scene: Scene,
    goal: Goal,
    choose: PushChoice,
    belief: Belief,
    motion: AbstractMotionModel | None,
    stepper: AbstractStepper | None,
    threads: int | None,
) -> PlanSimulator:
    """Return the simulator of plans; `scene` has the tool."""
    whole = choose.obstacles or any(own.whole_motion for own in goal.clauses)
    return PlanSimulator(
        scene=scene,
        goal=goal,
        choice=choose,
        nominal=belief.nominal(scene),
        motion=motion or belief.motion,
        stepper=stepper,
        samples=SAMPLES if whole else 1,
        threads=threads,
    )


def search_of(
    scene: Scene,
    goal: Goal,
    choose: PushChoice,
    belief: Belief,
    *,
    rollouts: int,
    seed: int,
    threads: int | None = None,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    first: Sequence[Sequence[PlanPush | RigPush]] = (),
    views: Views = UNSEEN,
    report: Callable[[Progress], None] | None = None,
) -> PlanSearch:
    """Return the search for a plan, after checks; parameters as for `fixel.plan`."""
    as_goal(goal)
    instance(choose, FreePushes | RigPushes, "choose", "FreePushes or RigPushes")
    instance(belief, Belief, "belief", "a Belief")
    whole(rollouts, "rollouts", MIN_ROLLOUTS, MAX_ROLLOUTS)
    whole(seed, "seed", 0, MAX_SEED)
    check_goal(goal, scene)
    scene = _part_first(scene, goal)
    check_centres(belief, scene)
    prepared = choose.prepared(scene)
    search = PlanSearch(
        simulator=simulator_of(prepared, goal, choose, belief, motion, stepper, threads),
        belief=belief, rollouts=rollouts, seed=seed, report=report,
        first=[choose.numbers(own) for own in first], views=views,
    )  # fmt: skip
    check_looks(search)
    return search


def _part_first(scene: Scene, goal: Goal) -> Scene:
    """Return the scene with the part that the goal is about before the other parts."""
    parts = {body_of(scene, own.body).name for own in goal.clauses}
    if len(parts) > 1:
        found = f"conditions on {' and '.join(sorted(parts))}"
        raise InvalidInput("goal.body", found=found, expected="conditions on one part")
    first, *others = sorted(scene.bodies, key=lambda own: own.name not in parts)
    return replace(scene, bodies=(first, *others))


def plan_rounds(search: PlanSearch, *, untrusted: bool = False) -> Rounds[PushPlan]:
    """Search for a plan in rounds of requests, whose answers may come from anywhere."""
    simulator, belief = search.simulator, search.belief
    checked = belief.has_known_pushes and not untrusted
    found = yield from search.rounds(partial(_unseen, simulator, belief) if checked else None)
    plan, margin, looks = found.plans[0], found.margins[0][:, 0], None
    success = SuccessProbability.of(found.margins[-1], independent=margin)
    if search.views.looks:
        trusted = partial(_trusted, simulator, belief, plan) if checked else None
        plan, policy = policy_of(search, found.plans, trusted)
        stages = policy.stages(belief, search.rollouts)
        looks, scenarios = looks_of(policy, stages, 1000 * search.seed, report=search.report)
        success, margin = looks.worth[-1], looks.walk.margin[-1]
    planned = simulator.planned(plan[None])
    if looks:
        failure, track = looks.walk.failure, BodyTrack.of_ends(looks.walk.pose)
    else:
        scenarios = search.scenarios(search.fresh_stages[0])
        runs = simulator.run(planned, np.zeros(scenarios.n, np.int64), scenarios)
        failure, track = runs.failure, runs.track
    why = _why(simulator, margin, failure, track)
    return PushPlan(
        scene=simulator.scene, goal=simulator.goal, choose=simulator.choice, belief=belief,
        pushes=simulator.choice.pushes(simulator.scene, plan),
        start=planned.start[0], path=planned.path[0], end=planned.nominal.pose[0, -1],
        fixels=None if planned.fixels is None else planned.fixels[0],
        others=planned.others[0] if planned.others.size else None,
        success=success, nominal_success=SuccessProbability.of(found.nominal_margins),
        runs=PlanRuns(scenarios, margin, track.pose[:, -1], why),
        alternatives=found.compared, compared=search.scenarios(search.final_stage),
        unseen=_unseen(simulator, belief, [plan])[0], motion=simulator.motion,
        stepper=simulator.stepper, looks=looks, rollouts=search.done, seed=search.seed,
    )  # fmt: skip


def _why(
    simulator: PlanSimulator, margin: FloatArray, failure: IntArray, track: BodyTrack
) -> tuple[str, ...]:
    """Return why runs failed (n,); empty for a success."""
    events = events_in(simulator.goal, simulator.simulated, track)
    return tuple(
        "" if ok >= 0.0 else FAILURES[code] if code else event or MISSED
        for ok, code, event in zip(margin, failure, events, strict=True)
    )


def _trusted(
    simulator: PlanSimulator, belief: Belief, plan: FloatArray, numbers: FloatArray
) -> bool:
    """Return whether experiments resemble a push (d,), taken as long as the first of a plan.

    Corrections are shorter than what was recorded, and so part of it.
    """
    own = numbers.copy()
    own[2:3] = plan[:1, 2] if len(plan) else own[2]
    return not _unseen(simulator, belief, [own[None]])[0]


def _unseen(
    simulator: PlanSimulator, belief: Belief, plans: Sequence[FloatArray]
) -> list[tuple[str, ...]]:
    part = replace(simulator.scene, bodies=simulator.scene.bodies[:1], contact_friction=())
    found: list[tuple[str, ...]] = [()] * len(plans)
    for own, planned in grouped(simulator, plans):
        for k, *ways in zip(own, planned.start, planned.path, strict=True):
            pushes = (scene_of_push(part, *way) for way in zip(*ways, strict=True))
            found[k] = tuple(dict.fromkeys(text for push in pushes for text in belief.unseen(push)))
    return found
