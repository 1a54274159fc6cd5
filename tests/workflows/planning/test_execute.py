"""Plans on the simulated testbed and on drives, which stop on Ctrl-C, alarms and other starts."""

import math
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fixel
from fixel.errors import DeviceFailed, InvalidInput
from fixel.formats.recording import open_recording
from fixel.model.fields import pose_of
from fixel.planning.plan import PlanCorrection
from fixel.planning.success import SuccessProbability
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.motion import SimulatedActuator
from fixel.testbed.motion_grbl import GrblActuator
from fixel.testbed.simulated import SimulatedTestbed, repeat_pushes
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm
from fixel.workflows.acquisition import RecordPlan, film_experiments
from fixel.workflows.planning import execute
from fixel.workflows.planning.execute import (
    check_plan,
    present_belief,
    run_on_drive,
    run_on_testbed,
)
from fixel.workflows.planning.request import (
    FoundPlan,
    PlanRequest,
    load_plan,
    load_trials,
    save_plan,
    warnings_of,
)

from .plans import grasp, plan_of, rig_plan, square_plan


def stored(plan, path: Path) -> Path:
    save_plan(FoundPlan(plan=plan, request=PlanRequest(goal={})), path)
    return path


def poses(*given: str) -> Callable[[str], np.ndarray]:
    waiting = iter(given)
    return lambda sentence: pose_of(next(waiting), "seen")


class Clock:
    """Seconds that pass a little whenever one looks."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.05
        return self.now


def test_trials_on_the_testbed_are_those_of_its_own_runs(tmp_path: Path):
    path = stored(square_plan(), tmp_path / "a.plan")
    found = run_on_testbed(path, trials=12, seed=4)
    again = run_on_testbed(stored(square_plan(), tmp_path / "b.plan"), trials=12, seed=4)
    assert [one.end for one in found.trials] == [one.end for one in again.trials]
    assert found.n == 12
    plan = square_plan()
    starts = np.array([one.start for one in found.trials])
    assert (np.abs(starts - plan.start[0]) <= (1e-3, 1e-3, math.radians(1.0))).all()
    file = load_plan(path)
    own = repeat_pushes(SimulatedTestbed(seed=4), plan.scenes, starts, name=file.id, threads=1)
    for trial, pose in zip(found.trials, own.pose, strict=True):
        assert trial.end == tuple(pose[-1].tolist())
        off = np.hypot(*(pose[-1, :2] - (0.03, 0.0))) / 5e-3
        turn = abs(pose[-1, 2]) / math.radians(5.0)
        assert trial.met == (max(off, turn) <= 1.0)


def test_trials_of_a_second_call_are_other_runs(tmp_path: Path):
    """The same runs again would be evidence that is counted twice."""
    path = stored(square_plan(), tmp_path / "a.plan")
    for n in (3, 6):
        found = run_on_testbed(path, trials=3, seed=4)
        assert found.n == n
    assert len({(one.start, one.end) for one in found.trials}) == 6


def test_an_obstacle_on_the_way_fails_a_trial_although_its_end_meets_the_goal(tmp_path: Path):
    """A square of 40 mm passes a post between its start and its end 100 mm ahead."""
    scene = pushed_square()
    body = replace(scene.bodies[0], shape=fixel.Polygon.rectangle(40 * mm, 40 * mm))
    goal = fixel.PoseRegion((0.1, 0.0, 0.0), position=20 * mm, angle=30 * deg)
    post = fixel.Polygon(np.array([[45, 15], [55, 15], [55, 80], [45, 80]]) * mm)
    tool, met = fixel.Polygon.rectangle(10 * mm, 30 * mm), []
    for obstacles in ((), (post,)):
        choose = fixel.FreePushes(tool=tool, obstacles=obstacles, length=(0.01, 0.2))
        plan = plan_of(replace(scene, bodies=(body,)), goal, choose, [(0.875, 0.0, 0.1)])
        found = run_on_testbed(stored(plan, tmp_path / f"{len(met)}.plan"), trials=3)
        met.append((found.successes, plan.success.mean, plan.success_in("quasistatic", 4).value))
    assert met == [(3, 1.0, 1.0), (0, 0.0, 0.0)]
    assert found.failures == {"an obstacle is touched": 3}


def test_a_trial_names_the_event_that_happened(tmp_path: Path):
    event = fixel.ForceAbove(0.01)  # [N] of a square of 150 g
    goal = fixel.AllOf(fixel.PoseRegion((0.03, 0, 0), position=5 * mm), never=event)
    plan = plan_of(pushed_square(), goal, fixel.FreePushes(), [(0.875, 0.0, 0.03)])
    found = run_on_testbed(stored(plan, tmp_path / "a.plan"), trials=2, seed=4)
    assert found.failures == {"a force above 0.01 N": 2}


@pytest.mark.system
def test_trials_with_looks_use_all_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Pushes of one trial are repeated here in one go: the run has the same friction in all.

    A look after which no push is better does not end a trial: the next view may differ, and the
    stated probability counts on it.
    """
    goal = fixel.PoseRegion((0.03, 0.01, 0.2), position=3.5 * mm, angle=5 * deg)
    start = fixel.StartError(x=2 * mm, y=2 * mm, theta=2 * deg, kind="uniform")
    choose, belief = fixel.FreePushes(length=(2 * mm, 60 * mm)), fixel.Belief(start=start)
    plan = fixel.plan(
        pushed_square(), goal, choose, belief, looks=2,
        camera=fixel.StartError(x=1e-9, kind="normal"), rollouts=4000, progress=False,
    )  # fmt: skip
    path = stored(plan, tmp_path / "a.plan")
    looked, correction = [], fixel.PushPlan.correction

    def counted(self: fixel.PushPlan, *seen: np.ndarray) -> PlanCorrection:
        looked.append(len(seen))
        return correction(self, *seen)

    monkeypatch.setattr(fixel.PushPlan, "correction", counted)
    found = run_on_testbed(path, trials=4, seed=4)
    assert looked == 4 * [1, 2]
    name, stops = load_plan(path).id, 0
    for k, trial in enumerate(found.trials):
        start = np.array([trial.start])
        bench, scenes, seen = SimulatedTestbed(seed=4), list(plan.scenes), []
        for _ in range(3):
            own = repeat_pushes(bench, scenes, start, name=f"{name}-{k}", threads=1)
            seen.append(own.pose[0, -1])
            push = plan.correction(*seen).scene if len(seen) <= 2 else None
            stops += push is None and len(seen) == 1
            scenes += [] if push is None else [push]
        np.testing.assert_allclose(trial.end, seen[-1], atol=1e-7)
        off = np.hypot(*(seen[-1][:2] - goal.pose[:2])) / goal.position
        assert trial.met == (max(off, abs(seen[-1][2] - 0.2) / goal.angle) <= 1.0)
    assert stops  # else this test would not show it
    blind = repeat_pushes(
        SimulatedTestbed(seed=4), plan.scenes, np.array([t.start for t in found.trials]), threads=1
    )
    assert any(np.abs(blind.pose[:, -1] - [t.end for t in found.trials]).max(axis=1) > 1e-4)


def test_a_drive_carries_out_a_stroke_and_the_trial_is_stored(tmp_path: Path):
    path = stored(rig_plan(), tmp_path / "a.plan")
    actuator = SimulatedActuator(clock=Clock())
    done = run_on_drive(
        path, actuator, seen=poses("90,0,22.5", "100,0,22"), notify=lambda _: None, by="me"
    )
    (trial,) = done.trials
    assert (trial.met, trial.by) == (True, "me")
    with actuator:
        assert actuator.position() == pytest.approx(0.015)  # a stroke of 20 mm, back by 5 mm
    assert load_trials(path, load_plan(path)).trials == (trial,)


@pytest.mark.slow  # renders and tracks 20 pictures
def test_a_camera_records_the_move_and_sees_the_end(tmp_path: Path):
    plan = rig_plan()
    path = stored(plan, tmp_path / "a.plan")
    scene = plan.scenes[0].save(tmp_path / "scene.yaml")
    (filmed,) = film_experiments(
        [str(scene)], out=tmp_path / "film", looks="clean", rate=8.0, lead=0.3
    )
    out = tmp_path / "recorded"
    done = run_on_drive(
        path,
        SimulatedActuator(speed_ratio=1.0),
        seen=poses("90,0,22.5"),
        notify=lambda _: None,
        recording=RecordPlan(camera=str(filmed.folder), folder=out, rig="thesis-tags", fast=True),
    )
    np.testing.assert_allclose(done.trials[0].end, plan.end, atol=0.005)
    assert open_recording(out).complete


def test_an_end_that_the_camera_did_not_see_is_asked_for(tmp_path: Path, monkeypatch):
    """The push was made: whatever fails after it must not lose the trial."""
    path, said = stored(rig_plan(), tmp_path / "a.plan"), []

    def lost(*_: object) -> None:
        raise InvalidInput("recording", found="no part in its last frame", expected="the part")

    monkeypatch.setattr(execute, "_recorded", lambda _: nullcontext())
    monkeypatch.setattr(execute, "_tracked_end", lost)
    done = run_on_drive(
        path,
        SimulatedActuator(clock=Clock()),
        seen=poses("90,0,22.5", "100,0,22"),
        notify=said.append,
        recording=RecordPlan(camera="0", folder=tmp_path / "out", rig="thesis-tags"),
    )
    assert done.trials[0].end == pytest.approx((0.1, 0.0, math.radians(22.0)))
    assert "no part in its last frame" in said[-1]


@pytest.mark.parametrize(("seen", "camera", "message"), [
    ("90,0,22.5", "none.mp4", "none.mp4"),
    ("94,0,22.5", "", r"\+4\.00, \+0\.00 mm.*fixel plan next"),
])  # fmt: skip
def test_no_camera_and_another_start_than_planned_do_not_move_the_drive(
    tmp_path: Path, seen: str, camera: str, message: str
):
    path = stored(rig_plan(), tmp_path / "a.plan")
    actuator = SimulatedActuator(clock=Clock())
    own = RecordPlan(camera=str(tmp_path / camera), folder=tmp_path / "out") if camera else None
    with pytest.raises(InvalidInput, match=message):
        run_on_drive(path, actuator, seen=poses(seen), notify=print, recording=own)
    with actuator:
        assert actuator.position() == 0.0
    assert load_trials(path, load_plan(path)).n == 0


def test_an_alarm_of_a_real_controller_stops_the_plan(tmp_path: Path):
    """The controller is emulated: a limit switch is hit while the part is pushed."""
    path = stored(rig_plan(), tmp_path / "a.plan")
    with EmulatedGrbl(acceleration=2000.0) as controller:
        drive = GrblActuator(controller.port, guard=False)

        def hit() -> None:
            until = time.monotonic() + 60.0
            while controller.speed < 5.0 and time.monotonic() < until:
                time.sleep(0.001)
            controller.hit_switch()

        thread = threading.Thread(target=hit)
        thread.start()
        with pytest.raises(DeviceFailed):
            run_on_drive(path, drive, seen=poses("90,0,22.5"), notify=lambda _: None)
        thread.join()
    (trial,) = load_trials(path, load_plan(path)).trials
    assert not trial.met


@pytest.mark.parametrize(
    ("problem", "failure"),
    [(KeyboardInterrupt(), "Ctrl-C"), (DeviceFailed("hard limit: a limit switch"), "hard limit")],
)
def test_ctrl_c_and_alarms_stop_the_drive_and_count_as_a_failure(
    problem: BaseException, failure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = stored(rig_plan(), tmp_path / "a.plan")
    actuator = SimulatedActuator(clock=Clock())
    waited = actuator.wait

    def wait(self: SimulatedActuator) -> None:
        for _ in range(5):
            actuator.position()  # time passes: the part is pushed
        raise problem

    monkeypatch.setattr(SimulatedActuator, "wait", wait)
    with pytest.raises(type(problem)):
        run_on_drive(path, actuator, seen=poses("90,0,22.5"), notify=lambda _: None)
    monkeypatch.setattr(SimulatedActuator, "wait", lambda self: waited())
    with actuator:
        assert not actuator.moving
        assert 0.0 < actuator.position() < 0.02
    (trial,) = load_trials(path, load_plan(path)).trials
    assert not trial.met
    assert trial.failure.startswith("drive stopped")
    assert failure in trial.failure


def test_pushes_of_a_free_tool_are_not_for_one_axis(tmp_path: Path):
    path = stored(square_plan(), tmp_path / "a.plan")
    with pytest.raises(InvalidInput, match="one stroke along the axis"):
        run_on_drive(path, SimulatedActuator(), seen=poses("0,0,0"), notify=lambda _: None)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,x", "1,2,nan", "1;2;3"])
def test_poses_that_are_not_three_numbers_are_refused(text: str):
    with pytest.raises(InvalidInput, match="in mm, mm and degrees"):
        pose_of(text, "--seen")


def test_a_check_counts_trials_and_repeats_the_statement(tmp_path: Path):
    path = stored(square_plan(), tmp_path / "a.plan")
    run_on_testbed(path, trials=3, seed=4)
    checked = check_plan(None, path)
    assert checked.trials.n == 3
    assert not checked.changed
    assert abs(checked.now.mean - checked.found.plan.success.mean) < 0.15
    assert "3 trials" in " ".join(checked.sentences)
    close = SuccessProbability.of(np.where(np.arange(2400) < 2279, 1.0, -1.0))
    below = "0.9496 is below the wanted 0.95"
    assert f"{below}: plan again." in checked._replace(now=close).sentences
    assert any(below in one for one in warnings_of(replace(square_plan(), success=close), 0.95))


def test_displaced_fixels_are_where_the_plan_wants_them():
    choose = fixel.RigPushes(stroke=(0.02, 0.1), fixels={"fixel-1": ((-0.01, 0.01), (0.0, 0.01))})
    plan = plan_of(
        grasp("seated"), fixel.Seated("fixel-1"), choose, [(0, 0, 0, 0.02, 0.004, 0.006)]
    )
    before, after = plan.scene.fixels[0].pose, plan.scenes[0].fixels[0].pose
    np.testing.assert_allclose(after - before, (0.004, 0.006, 0.0), atol=1e-12)


def test_the_present_belief_of_a_part_that_was_seen_starts_where_it_was_seen(monkeypatch):
    """A new calibration has other parameters; what the camera saw stays."""
    seen = fixel.Belief(start=fixel.StartError(x=0.05 * mm, kind="normal"), parameters={})
    first = fixel.Belief(start=fixel.StartError(x=3 * mm, kind="normal"), parameters={"mass": 0.2})
    request = PlanRequest(goal={}, folder="")
    found = FoundPlan(plan=replace(square_plan(), belief=seen), request=request, calibration=4)
    for number, parameters in ((4, {}), (5, {"mass": 0.2})):
        own = SimpleNamespace(belief=first, calibration=number)
        monkeypatch.setattr("fixel.workflows.planning.request.inputs_of", lambda *a, own=own: own)
        belief, found_number = present_belief(object(), found)
        assert (belief.start, belief.parameters, found_number) == (seen.start, parameters, number)
