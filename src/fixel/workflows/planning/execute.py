"""Check plans, and carry them out: on the simulated testbed, or on a rig with one straight axis."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.project import Project
from fixel.errors import FixelError, InvalidInput
from fixel.formats.recording import SCENE_FILE
from fixel.model import Experiment, Scene
from fixel.model.fields import path_of, whole
from fixel.model.goals import BodyTrack, events_in
from fixel.model.scene import check_push
from fixel.model.trajectory import pose_difference
from fixel.planning.belief import Belief
from fixel.planning.held_out import HeldSuccess, held_success
from fixel.planning.plan import PlanCorrection, PushPlan
from fixel.planning.pushes import RigPush
from fixel.planning.rollout import FAILURES, OBSTACLE
from fixel.planning.seen import is_met, plan_again
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import PlanTrial, Trials
from fixel.progress import show_progress
from fixel.testbed.motion import AbstractActuator
from fixel.testbed.simulated import RepeatedPushes, SimulatedTestbed, repeat_pushes
from fixel.typing import FloatArray, Notify
from fixel.workflows.acquisition import RecordPlan
from fixel.workflows.acquisition.record import record
from fixel.workflows.acquisition.track import track_film
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.run import calibrate
from fixel.workflows.calibration.stored import newest_calibration
from fixel.workflows.planning import request

# Standard deviations of the start by which a seen start may differ from the planned one; more
# would carry out a plan for another start.
MAX_DEVIATION: Final = 3.0
# Least deviation that is allowed: 1 mm and 1 degree, as for placing parts of a rig.
LEAST: Final = np.array([1e-3, 1e-3, math.radians(1.0)])

AskPose = Callable[[str], FloatArray]  # sentence -> seen pose (3,) [m, m, rad]


def run_on_testbed(path: str | Path, *, trials: int = 1, seed: int = 1) -> Trials:
    """Carry out a plan on the simulated testbed, which is another model, and add its trials.

    Parameters
    ----------
    path : str or Path
        Plan file.
    trials : int
        Number of new trials.
    seed : int
        Seed of the testbed: its plate and its conditions.

    Returns
    -------
    Trials
        All trials of the plan.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> goal = fixel.PoseRegion((0.02, 0.0, 0.0), position=0.009)
    >>> plan = fixel.plan(pushed_square(), goal, rollouts=1_000, progress=False)
    >>> fixel.run_on_testbed(plan.save("push.plan"), trials=2).n
    2
    """
    path, trials = path_of(path, "path"), whole(trials, "trials")
    file = request.load_plan(path)
    plan = file.found.plan
    _check_pushes(plan)
    # Trials after others have their own starts and conditions: the same runs would count twice.
    before = request.load_trials(path, file).n
    rng, error = np.random.default_rng([seed, 18, before]), plan.belief.start
    own, name = (int(rng.integers(2**31)), f"{file.id}-{before}") if before else (seed, file.id)
    drawn = np.zeros((trials, 3)) if error is None else error.samples(trials, own)
    starts = plan.first_pose + drawn[rng.permutation(trials)]
    testbed = SimulatedTestbed(seed=seed)
    if plan.looks is None:
        done = _carried_out(plan, testbed, plan.scenes, starts, name)
        fixels = None if plan.fixels is None else np.repeat(plan.fixels[None], trials, axis=0)
        way = done.way.reshape(trials, -1, 3)
        track = BodyTrack(way, done.stalled, done.force, fixels)
        ends, failure = done.pose[:, -1], done.failure
    else:
        each = [
            _with_looks(plan, testbed, start, f"{name}-{k}", rng) for k, start in enumerate(starts)
        ]
        ends, failure = np.array([end for end, _ in each]), tuple(why for _, why in each)
        track = BodyTrack.of_ends(ends)
    met = plan.goal.met(plan.scene, track) & np.equal(failure, "")
    events = events_in(plan.goal, plan.scene, track)
    failure = tuple(own or event for own, event in zip(failure, events, strict=True))
    by = f"simulated testbed, seed {seed}"
    runs = zip(starts, ends, met, failure, strict=True)
    return request.add_trials(path, file, *(_trial(*run, by) for run in runs))


def _carried_out(
    plan: PushPlan,
    testbed: SimulatedTestbed,
    scenes: Sequence[Scene],
    starts: FloatArray,
    name: str,
) -> RepeatedPushes:
    """Carry out pushes from starts (n, 3); a run in which an obstacle is touched has failed."""
    simulator, n = plan.simulator(), len(starts)
    done = repeat_pushes(testbed, scenes, starts, name=name, samples=simulator.samples)
    touched = np.zeros(n, bool)
    for k, scene in enumerate(scenes):
        path = np.tile(scene.pushers[0].drive.waypoints, (n, 1, 1))  # type: ignore[union-attr]
        touched |= simulator.obstructed(
            done.pose[:, k, None], done.way[:, k], np.zeros((n, 3)), path
        )
    why = zip(done.failure, touched, strict=True)
    return done._replace(
        failure=tuple(own or ("", FAILURES[OBSTACLE])[int(hit)] for own, hit in why)
    )


def _with_looks(
    plan: PushPlan, testbed: SimulatedTestbed, pose: FloatArray, name: str, rng: np.random.Generator
) -> tuple[FloatArray, str]:
    """Carry out a plan with looks once; return the end pose (3,) and the reason of a failure."""
    looks, failure = plan.looks, ""
    assert looks is not None

    def push(scene: Scene) -> None:
        nonlocal pose, failure
        if not failure:
            # The conditions of a run depend on its name: they are the same for all its pushes.
            done = _carried_out(plan, testbed, [scene], pose[None], name)
            pose, failure = done.pose[0, -1], done.failure[0]

    def look() -> FloatArray | None:
        if failure or rng.random() < looks.lost_views:
            return None
        return np.asarray(pose + looks.camera.samples(1, int(rng.integers(2**31)))[0])

    plan.perform(push, look)
    return pose, failure


def run_on_drive(
    path: Path,
    actuator: AbstractActuator,
    *,
    seen: AskPose,
    notify: Notify,
    by: str = "",
    recording: RecordPlan | None = None,
    project: Path | None = None,
) -> Trials:
    """Carry out a plan once with a drive that moves along one straight axis, and add the trial.

    The part is placed and seen first. The drive does not move if the seen start differs from the
    planned one by more than the plan allows for. It stops on Ctrl-C and on any alarm.

    `seen` asks for the pose of the part, such as the one that a camera sees. If the move is
    recorded with a rig, the end is tracked in the recording instead, and the experiment is stored
    in the project. All trials of the plan are returned, each with the person or program that
    carried it out (`by`). If the drive fails after the part was pushed, the trial is a failure.
    """
    file = request.load_plan(path)
    plan = file.found.plan
    push = _straight(plan)
    x, y, angle = plan.start[0]
    place = f"{1e3 * x:.2f}, {1e3 * y:.2f} mm, {math.degrees(angle):.2f} deg"
    start = seen(f"Place the part at {place}.")
    check_start(plan, start)
    notify(f"Moving the drive by {1e3 * push.stroke:.2f} mm.")
    speed = plan.scene.pushers[0].drive.speed  # type: ignore[union-attr]
    with actuator:
        begun = actuator.position()
        try:
            back = getattr(plan.choose, "retract", 0.0)
            with _recorded(recording):
                actuator.move(by=push.stroke, speed=speed)
                if back:
                    actuator.move(by=-back, speed=speed)
        except (FixelError, KeyboardInterrupt) as problem:
            why = "Ctrl-C" if isinstance(problem, KeyboardInterrupt) else str(problem)
            if _moved(actuator, begun):
                why = f"drive stopped: {why}"[:200]
                request.add_trials(path, file, _trial(start, None, False, why, by))
            raise
    end = None
    if recording is not None and recording.rig is not None:
        try:
            end = _tracked_end(plan, recording, project)
        except FixelError as problem:  # the push was made: its trial must not be lost
            notify(f"The end was not tracked: {problem}")
    end = seen("Enter the pose of the part at its end.") if end is None else end
    # These drives report neither stalls nor forces: the goal is judged by the pose alone.
    fixels = None if plan.fixels is None else plan.fixels[None]
    track = BodyTrack(end[None, None], np.array([True]), np.zeros(1), fixels)
    met = bool(plan.goal.met(plan.scene, track)[0])
    return request.add_trials(path, file, _trial(start, end, met, "", by))


@contextmanager
def _recorded(plan: RecordPlan | None) -> Iterator[None]:
    """Record from before a move until after it; an error of the camera is raised at the end."""
    if plan is None:
        yield
        return
    begun, ended = threading.Event(), threading.Event()
    problems: list[BaseException] = []

    def work() -> None:
        try:
            record(
                plan,
                stop=lambda: "the drive has arrived" if ended.is_set() else "",
                watch=lambda arrived, status: begun.set(),
            )
        except BaseException as problem:
            problems.append(problem)
        begun.set()

    thread = threading.Thread(target=work, name="fixel-recording", daemon=True)
    thread.start()
    try:
        begun.wait()
        if problems:  # the camera cannot be opened: the drive does not move
            raise problems[0]
        yield
    finally:
        ended.set()
        thread.join()
    if problems:
        raise problems[0]


def _tracked_end(plan: PushPlan, recording: RecordPlan, project: Path | None) -> FloatArray:
    """Return the last tracked pose (3,) of the part in a recording."""
    scene = recording.folder / SCENE_FILE
    plan.scenes[0].save(scene)
    tracked = track_film(recording.folder, rig=recording.rig or "", scene=scene, project=project)
    return np.asarray(tracked.experiment.trajectory.pose[-1])


def check_start(plan: PushPlan, seen: FloatArray) -> None:
    """Raise `InvalidInput` if a seen start differs from the planned one by more than allowed."""
    own = plan.belief.start
    allowed = np.maximum(LEAST, 0.0 if own is None else MAX_DEVIATION * own.deviation)
    off = pose_difference(seen, plan.start[0])
    if (np.abs(off) > allowed).any():
        (x, y, angle), (a, b, c) = np.array([off, allowed]) * (1e3, 1e3, math.degrees(1.0))
        found = f"{x:+.2f}, {y:+.2f} mm and {angle:+.2f} deg from the planned one"
        expected = f"at most {a:.2f}, {b:.2f} mm and {c:.2f} deg"
        hint = "place the part again, or plan from where it is: fixel plan next"
        raise InvalidInput("seen start", found=found, expected=expected, hint=hint)


def _check_pushes(plan: PushPlan) -> None:
    check_push(plan.scene)  # the bench places and tracks one part
    if not plan.pushes and plan.looks is None:
        hint = "the part already meets the goal, and is best left alone"
        raise InvalidInput("plan", found="no pushes", expected="a push to carry out", hint=hint)


def _straight(plan: PushPlan) -> RigPush:
    _check_pushes(plan)
    push = plan.pushes[0] if len(plan.pushes) == 1 else None
    if isinstance(push, RigPush):
        return push
    hint = "give its waypoints to a robot: fixel plan check PLAN --waypoints way.csv"
    if plan.looks is not None:
        hint += ", and after each look: fixel plan next PLAN --seen X,Y,ANGLE --json"
    raise InvalidInput(
        "plan",
        found="pushes of a free tool",
        expected="one stroke along the axis of the rig",
        hint=hint,
    )


def _moved(actuator: AbstractActuator, begun: float) -> bool:
    """Return whether the drive has moved; also where its position is lost."""
    try:
        return actuator.position() != begun
    except FixelError:
        return True


def _trial(
    start: FloatArray, end: FloatArray | None, met: bool, failure: str, by: str
) -> PlanTrial:
    return PlanTrial(
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        met=bool(met),
        failure="" if met else failure or "missed the goal",
        start=tuple(start.tolist()),
        end=None if end is None else tuple(end.tolist()),
        by=by,
    )


class CheckedPlan(NamedTuple):
    """Plan with its success probability under the present calibration, and its trials."""

    found: request.FoundPlan
    id: str
    now: SuccessProbability
    calibration: int | None  # id of the present calibration
    changed: bool  # whether the plan was made with another calibration
    trials: Trials

    @property
    def sentences(self) -> list[str]:
        """Results of the check, in sentences."""
        plan = self.found.plan
        lines = [
            f"Stated when it was made: {plan.success.sentence}.",
            f"{plan.belief.start_text.capitalize()}.",
        ]
        if self.changed:
            lines.append(f"The calibration has changed: now {self.calibration}.")
        lines.append(f"Under the present calibration: {self.now.sentence}.")
        if self.now.stated < self.found.wanted:
            lines.append(
                f"{self.now.stated:.4f} is below the wanted {self.found.wanted:g}: plan again."
            )
        else:
            share = 100.0 * self.now.spare(self.found.wanted)
            lines.append(
                f"It is at least the wanted {self.found.wanted:g} as long as less than"
                f" {share:.1f} % of the samples are misplaced."
            )
        done = str(self.trials).splitlines()[0] if self.trials.n else "No trials yet"
        return [*lines, f"{done}."]


def check_plan(project: Project | None, path: Path) -> CheckedPlan:
    """Compute the success probability of a stored plan under the present calibration."""
    file = request.load_plan(path)
    trials = request.load_trials(path, file)
    belief, number = present_belief(project, file.found)
    return CheckedPlan(
        found=file.found,
        id=file.id,
        now=file.found.plan.success_under(belief),
        calibration=number,
        changed=number != file.found.calibration,
        trials=trials,
    )


def present_belief(project: Project | None, found: request.FoundPlan) -> tuple[Belief, int | None]:
    """Return the belief of a plan with the present calibration of its project, and its id."""
    if project is None or found.calibration is None:
        return found.plan.belief, found.calibration
    given = found.request
    scene = Path(given["scene"]) if given.get("scene") else None
    own = request.inputs_of(
        project, given["goal"], Path(given["folder"]), scene, given.get("experiment", "")
    )
    if own.calibration == found.calibration:  # also of a part that was seen on its way
        return found.plan.belief, own.calibration
    return replace(own.belief, start=found.plan.belief.start), own.calibration


def held_out_success(
    calibration: Calibration, experiments: Sequence[Experiment], **options: Any
) -> HeldSuccess:
    """Compare stated with held success for the parameters and the motion of a calibration.

    Options are those of `held_success`.
    """
    space = {
        own.label: own.nominal if own.frozen else (own.low, own.high)
        for own in calibration.space.unknowns
    }

    def fit(train: Sequence[Experiment], seed: int) -> Calibration:
        return calibrate(train, space, motion=calibration.motion, seed=seed, progress=False)

    return held_success(fit, experiments, **options)


def stored_held_success(project: Project, number: int | None = None, **options: Any) -> HeldSuccess:
    """Compare stated with held success for a stored calibration; by default the newest."""
    with project.store() as store:
        number = newest_calibration(store) if number is None else number
        if number is None:
            hint = "fixel calibrate makes one"
            raise InvalidInput("project", found="no calibration", expected="one", hint=hint)
    calibration, experiments = request.with_experiments(project, number)
    return held_out_success(calibration, experiments, **options)


class NextStep(NamedTuple):
    """Answer to a seen pose that needs no new plan."""

    met: bool  # whether the seen pose meets the goal
    chosen: PlanCorrection | None = None  # by a plan with looks

    @property
    def sentence(self) -> str:
        """The answer in one sentence."""
        own = self.chosen
        if own is not None and own.push is not None:
            return f"Push: {own.push}. It reaches the goal with probability {own.probability:.2f}."
        if self.met:
            return "The goal is met: no push is needed."
        return "No push is better than leaving the part where it is."

    @property
    def numbers(self) -> dict[str, Any]:
        """The same as plain values in SI units, for `--json`."""
        if self.chosen is None:
            return {"met": self.met, "push": None}
        push, scene, probability = self.chosen
        way: Any = None if scene is None else scene.pushers[0].drive
        return {
            "met": self.met,
            "push": None if push is None else str(push),
            "probability": probability,
            "waypoints_s_m_rad": [] if way is None else way.waypoints.tolist(),
        }


def next_step(path: Path, seen: Sequence[FloatArray], done: int = 0) -> NextStep | None:
    """Choose the next push of a plan with looks, or report that a seen pose meets the goal.

    Poses (3,) of the part were seen [m, m, rad]: in a plan with looks after the planned pushes and
    after each correction, else once, after `done` pushes. None is returned where an open-loop plan
    must be made again, see `next_plan`.
    """
    plan = request.load_plan(path).found.plan
    most = 1 if plan.looks is None else plan.looks.most
    if not 1 <= len(seen) <= most:
        raise InvalidInput(
            "seen", found=f"{len(seen)} poses", expected=f"1 to {most}, one for each look"
        )
    met = is_met(plan, seen[-1])
    if plan.looks is None:
        return NextStep(True) if met else None
    if done:
        expected = "none for a plan with looks, which is seen after its planned pushes"
        raise InvalidInput("done", found=done, expected=expected)
    return NextStep(met, plan.correction(*seen))


def next_plan(
    project: Project | None, path: Path, seen: FloatArray, done: int = 0, **options: Any
) -> request.FoundPlan:
    """Plan again from a seen pose (3,) of the part [m, m, rad], with the pushes that are left.

    Of the plan, `done` pushes were carried out. Options are those of `plan_again`.
    """
    found = request.load_plan(path).found
    belief, number = present_belief(project, found)
    old = found.plan.under(belief)
    with show_progress(None, "planning") as report:
        asked = {name: x for name, x in found.request.items() if name == "untrusted"}
        again, note = plan_again(old, seen, done, **{**asked, **options}, report=report.show)
    warnings = (*request.warnings_of(again, found.wanted), *filter(None, [note]))
    return replace(found, plan=again, calibration=number, warnings=warnings)
