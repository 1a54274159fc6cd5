"""The whole loop at the emulated laboratory, judged by the laboratory's hidden truth."""

import math
import os
import queue
import signal
import threading
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from tests.fixtures import short_plan
from tests.jobs.helpers import await_true as until

from fixel.database.project import Project
from fixel.errors import DeviceFailed, JobRefused, StoreRefused
from fixel.formats.plan_file import plan_text
from fixel.formats.recording import VIDEO, open_recording
from fixel.sampling import eight_push_plan, thesis_plan
from fixel.testbed.motion import SimulatedActuator
from fixel.testbed.simulated import SimulatedTestbed
from fixel.workflows.bench import loop as loop_module
from fixel.workflows.bench.campaign import Campaign
from fixel.workflows.bench.judge import TrackedAttempt
from fixel.workflows.bench.loop import Background, BenchLoop
from fixel.workflows.bench.run import open_bench, report_of

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("small_laboratory")]


def begun(folder):
    """Create a project, and a plan of two quick pushes of a square."""
    (folder / "few.yaml").write_text(plan_text(short_plan()))
    return Project.create(folder / "lab"), folder / "few.yaml"


@pytest.fixture
def bench(tmp_path):
    return begun(tmp_path)


def opened(bench, **options):
    project, plan = bench
    return open_bench(project, plan, **{"emulated": True, "fit": ("mu_support",), **options})


class Hand:
    """A person who acts by what the status shows."""

    def __init__(self, loop):
        self.loop, self.statuses = loop, []
        loop.show = lambda draw, status: self.statuses.append(status)
        self.thread = threading.Thread(target=loop.run)

    def now(self):
        return self.statuses[-1] if self.statuses else {"phase": "", "checks": [], "attempts": []}

    def ready(self):
        checks = self.now()["checks"]
        return bool(checks) and all(check["passed"] for check in checks)

    def place(self):
        """Move the part until it is in place."""
        until(lambda: self.now()["phase"] == "placing")

        def placed():
            if not self.ready():
                self.loop.ask("place")
                time.sleep(0.3)
            return self.ready()

        until(placed)


@contextmanager
def operated(bench):
    """A loop and the person at it, who ends it."""
    with opened(bench) as loop:
        hand = Hand(loop)
        hand.thread.start()
        yield loop, hand
        loop.ask("end")
        hand.thread.join(60.0)


@pytest.fixture(scope="module")
def performed(tmp_path_factory, small_laboratory):
    """A bench whose plan was performed by two programs; what they showed, and the true poses."""
    bench = begun(tmp_path_factory.mktemp("performed"))
    truth, statuses = [], []
    with opened(bench, auto=True, limit=1) as loop:
        assert loop.run() == "the limit is reached"
        truth += [moment.part for moment in loop.devices.laboratory.moments]
    with opened(bench, auto=True) as loop:
        loop.show = lambda draw, status: statuses.append(status)
        assert loop.run() == "every row of the plan is done"
        truth += [moment.part for moment in loop.devices.laboratory.moments]
        return SimpleNamespace(
            bench=bench, loop=loop, numbers=report_of(loop).analysis.numbers,
            truth=np.array(truth), phases={status["phase"] for status in statuses},
        )  # fmt: skip


def nearest(truth, found):
    """The true pose that is nearest to a found one."""
    return truth[np.hypot(*(truth - found)[:, :2].T).argmin()]


def test_a_plan_is_performed_tracked_stored_and_calibrated(performed):
    campaign, (project, _) = performed.loop.campaign, performed.bench
    attempts = campaign.accepted
    assert [own.row for own in attempts] == [row.name for row in campaign.rows]
    with project.store() as store:
        stored = [store.experiment(own.experiment) for own in attempts]
    assert not any(own.real for own in stored)
    for own, attempt in zip(stored, attempts, strict=True):
        assert own.dataset == "few"
        recording = open_recording(campaign.recording(attempt))
        assert recording.complete
        assert recording.end.lost == 0
        # The end of the track is a pose that the part truly had.
        end = own.trajectory.pose[-1]
        off = np.abs(nearest(performed.truth, end) - end)
        assert off[:2].max() < 3e-4
        assert off[2] < 5e-3
    assert performed.numbers["accepted"] == 2
    assert performed.numbers["half_widths"]["mu_support"] > 0.0
    assert performed.phases >= {"placing", "moving", "pushing", "finished"}

    with opened(performed.bench, auto=True) as loop:  # again: nothing is left, nothing is doubled
        assert loop.run() == "every row of the plan is done"
    with project.store() as store:
        assert store.datasets() == {"few": 2}


def test_the_check_measures_an_emulated_laboratory(performed):
    with performed.bench[0].store() as store:
        accepted = performed.loop.campaign.accepted
        ends = [store.experiment(own.experiment).trajectory.pose[-1] for own in accepted]
    first, second = (nearest(performed.truth, end) for end in ends)
    true_scatter = np.hypot(*(first - second)[:2]) / math.sqrt(2.0)

    with opened(performed.bench, check=True) as loop:
        assert loop.run() == "the bench was measured"
        figures = {own.name: own for own in loop.figures}
        moments = list(loop.devices.laboratory.moments)
        report = report_of(loop).analysis
    assert not loop.campaign.left  # no row was performed or changed
    # The part never moved after it was placed; the head stood at one place after each move.
    parts = np.array([moment.part for moment in moments[-200:]])
    assert np.ptp(parts, axis=0).max() < 1e-9
    assert 0.0 < figures["camera noise"].value < 1e-4
    assert 0.0 < figures["camera noise, angle"].value < math.radians(0.2)
    heads = np.array([moment.head[:2] for moment in moments])
    start = heads[-1]
    gone = np.hypot(*(heads - start).T)
    assert 5e-3 < gone.max() < 21e-3
    assert figures["repeatability of the drive"].value < 5e-5
    # In accelerated time the begin of a move is known to a frame.
    assert abs(figures["latency of the camera"].value) < 1.0 / 30.0
    assert figures["error of placement"].value < 1e-3
    assert figures["scatter between runs"].value == pytest.approx(true_scatter, abs=3e-4)
    assert figures["round trip of the tactile board"].verdict == "good"
    assert abs(figures["delay of the tactile board"].value or 0.0) < 1.0 / 30.0
    assert len(report.numbers["check"]) == 8
    assert report.tables[0].title == "Check of the bench"


def test_a_stop_ends_the_push_at_once_and_the_row_is_performed_again(bench):
    with operated(bench) as (loop, hand):
        hand.place()
        loop.ask("push")
        until(lambda: hand.now()["phase"] == "pushing" and loop.devices.drive.moving)
        loop.ask("stop")
        stopped = loop.devices.drive.place()
        until(lambda: hand.now()["phase"] == "trouble")
        assert np.array_equal(loop.devices.drive.place(), stopped)
        assert "stopped by the person" in hand.now()["problems"][0]
        first = next(iter(loop.campaign.attempts.values()))
        assert first.state == "stopped"
        assert loop.campaign.left[0].name == first.row

        loop.ask("again")
        hand.place()
        assert hand.now()["row"] == first.row
    assert loop.finish == "ended by the person at the bench"


@pytest.mark.parametrize("after", ["stop", "end"])
def test_a_push_that_was_asked_for_before_does_not_begin_after(after, bench):
    with operated(bench) as (loop, hand):
        hand.place()
        loop.ask("push")
        loop.ask(after)
        if after == "end":
            hand.thread.join(60.0)
        n = len(hand.statuses)
        until(lambda: after == "end" or len(hand.statuses) > n + 5)
        assert not loop.campaign.attempts
        assert "moving" not in {status["phase"] for status in hand.statuses}


def test_a_push_that_was_asked_for_before_an_error_does_not_begin_after(bench, monkeypatch):
    with operated(bench) as (loop, hand):
        hand.place()
        turn, failed = loop._turn, []

        def failing(frames):
            if loop._wants_push and not failed:
                failed.append(True)
                raise DeviceFailed("no status report")
            turn(frames)

        monkeypatch.setattr(loop, "_turn", failing)
        loop.ask("push")
        until(lambda: failed and hand.now()["phase"] == "trouble")
        loop.ask("again")
        until(lambda: hand.now()["phase"] == "placing")
        n = len(hand.statuses)
        until(lambda: len(hand.statuses) > n + 5)
        assert not loop.campaign.attempts


def test_an_interruption_stops_the_head_on_its_way(bench):
    """Ctrl-C interrupts the loop where it runs in the main thread."""
    with opened(bench, auto=True) as loop:
        drive, start = loop.devices.drive, loop.devices.stroke(loop.campaign.rows[0].scene).start

        def interrupted(draw, status):
            if status["phase"] == "moving" and drive.moving:
                raise KeyboardInterrupt

        loop.show = interrupted
        with pytest.raises(KeyboardInterrupt):
            loop.run()
        assert not drive.moving
        assert np.linalg.norm(drive.place() - start) > 5e-3


def test_a_repeated_key_confirms_no_zero_that_was_not_asked_for(bench, monkeypatch):
    confirmed = []
    with operated(bench) as (loop, hand):
        hand.place()
        drive = type(loop.devices.drive)
        loop.devices.camera.source.close()
        until(lambda: "camera" in "".join(hand.now()["problems"]))
        monkeypatch.setattr(drive, "zero_known", property(lambda self: bool(confirmed)))
        monkeypatch.setattr(drive, "set_zero", lambda self: confirmed.append(1))
        loop.ask("again")
        loop.ask("again")
        until(lambda: "by hand" in "".join(hand.now()["problems"]))
        n = len(hand.statuses)
        until(lambda: len(hand.statuses) > n + 3)
        assert not confirmed


def test_a_stop_during_recovery_prevents_homing(bench, monkeypatch):
    with operated(bench) as (loop, hand):
        hand.place()
        devices, homed = loop.devices, []
        monkeypatch.setattr(type(devices.drive), "home", lambda self: homed.append(1))
        monkeypatch.setattr(type(devices.drive), "state", "Alarm", raising=False)
        until(lambda: hand.now()["phase"] == "trouble")
        monkeypatch.setattr(devices.drive, "set_zero", lambda: loop.ask("stop"))
        loop.ask("again")
        until(lambda: "stopped by the person" in "".join(hand.now()["problems"]))
        assert "moving" in {status["phase"] for status in hand.statuses}  # any key stops
        assert not homed


def test_a_drive_of_unknown_position_does_not_move_before_a_person_confirms_its_zero(
    bench, monkeypatch
):
    """At the begin, and after its controller was switched off and on during a campaign."""
    lost = ["begin"]
    drive = SimulatedActuator
    monkeypatch.setattr(drive, "zero_known", property(lambda self: not lost), raising=False)
    monkeypatch.setattr(drive, "set_zero", lambda self: lost.clear(), raising=False)
    with operated(bench) as (loop, hand):
        until(lambda: hand.now()["phase"] == "trouble")
        assert "by hand to its position 0" in hand.now()["problems"][0]
        place = loop.devices.drive.place()
        loop.ask("push")
        loop.ask("again")
        hand.place()
        assert np.array_equal(loop.devices.drive.place(), place)

        lost.append("power cycle")
        until(lambda: hand.now()["phase"] == "trouble")
        loop.ask("push")
        loop.ask("again")
        hand.place()
        n = len(hand.statuses)
        until(lambda: len(hand.statuses) > n + 5)  # a push would have begun
        assert np.array_equal(loop.devices.drive.place(), place)
        assert not loop.campaign.attempts


def test_a_lost_page_stops_the_push_that_it_asked_for(bench):
    with operated(bench) as (loop, hand):
        loop.page_left = lambda: "the page is lost" if loop.devices.drive.moving else ""
        hand.place()
        loop.ask("push", by="page")
        until(lambda: hand.now()["phase"] == "trouble")
        assert hand.now()["problems"] == ["the page is lost"]


def test_a_lost_camera_stops_the_push_and_is_opened_again(bench, monkeypatch):
    with operated(bench) as (loop, hand):
        hand.place()
        loop.ask("push")
        until(lambda: hand.now()["phase"] == "pushing" and loop.devices.drive.moving)
        loop.devices.camera.source.close()
        until(lambda: hand.now()["phase"] == "trouble")
        assert not loop.devices.drive.moving
        loop.ask("again")
        hand.place()


def test_a_camera_that_stays_lost_is_the_trouble_after_each_try(bench, monkeypatch):
    """The second try said that the drive was stopped."""

    def broken():
        raise DeviceFailed("no such camera")

    with operated(bench) as (loop, hand):
        hand.place()
        loop.ask("push")
        until(lambda: hand.now()["phase"] == "pushing" and loop.devices.drive.moving)
        with monkeypatch.context() as lost:
            lost.setattr(loop.devices.laboratory, "advance", broken)
            until(lambda: hand.now()["phase"] == "trouble")
            said = len(hand.statuses)
            loop.ask("again")
            until(lambda: "moving" in [own["phase"] for own in hand.statuses[said:]])
            until(lambda: hand.now()["phase"] == "trouble")
            assert "no such camera" in hand.now()["problems"][0]
        loop.ask("again")
        hand.place()


def test_an_attempt_with_a_fault_waits_for_a_decision(bench, monkeypatch):
    real = BenchLoop._tracked

    def doubted(self, attempt, found):
        real(self, attempt, found._replace(reasons=("2 frames were lost",)))

    monkeypatch.setattr(loop_module.BenchLoop, "_tracked", doubted)
    with operated(bench) as (loop, hand):
        hand.place()
        loop.ask("push")
        until(lambda: hand.now()["attempts"] and hand.now()["attempts"][0]["state"] == "tracked")
        first = hand.now()["attempts"][0]
        assert first["reasons"] == ("2 frames were lost",)
        loop.ask("repeat", first["name"])
        until(lambda: hand.now()["attempts"][0]["state"] == "repeated")
        assert loop.campaign.recording(next(iter(loop.campaign.attempts.values()))).is_dir()
        assert loop.campaign.left[0].name == first["row"]


class Estimator:
    """Estimator that computes nothing."""

    waiting = 0

    def __init__(self):
        self.calls = []

    def call(self, done, experiments, *_):
        self.calls.append((done, [own.name for own in experiments]))

    def close(self):
        pass


def test_the_emulated_laboratory_counts_the_pushes_of_earlier_programs(bench, monkeypatch):
    counts = []
    for _ in range(3):
        with opened(bench) as loop:
            lab = loop.devices.laboratory
            monkeypatch.setattr(lab, "prepare", lambda row, done: counts.append((row.name, done)))
            first, second = loop.campaign.rows
            loop._begin_row(first)
            loop._begin_row(second)
            loop.campaign.begin(first.name)  # and is killed
    assert counts == [(first.name, 0), (second.name, 0), (first.name, 1), (second.name, 0),
                      (first.name, 2), (second.name, 0)]  # fmt: skip


def test_an_accepted_attempt_that_is_repeated_leaves_the_estimates(bench):
    with opened(bench) as loop:
        rows, loop._estimator = loop.campaign.rows, Estimator()
        for row in rows:
            (experiment,) = SimulatedTestbed(seed=1).run([row])
            with loop.project.store() as store:
                number = store.add_experiment(experiment).id
            loop.campaign.note(loop.campaign.begin(row.name), "accepted", experiment=number)
        loop._estimate()
        first, second = [own.name for own in loop.campaign.accepted]
        loop._granted("repeat", first)
        assert [names for _, names in loop._estimator.calls] == [
            [row.name for row in rows], [rows[1].name],
        ]  # fmt: skip
        loop.live = "estimates of the second"
        loop._estimator.calls[0][0](None)  # the answer with both comes late
        loop._events.get()()
        assert loop.live == "estimates of the second"
        loop._granted("repeat", second)
        assert loop.live is None


@pytest.mark.parametrize("refusing", ["the database", "the journal"])
def test_an_attempt_that_cannot_be_stored_is_stored_once_it_can_be(bench, monkeypatch, refusing):
    project, _ = bench
    with opened(bench) as loop:
        row, loop._estimator = loop.campaign.rows[0], Estimator()
        attempt = loop.campaign.note(loop.campaign.begin(row.name), "recorded")
        loop.campaign.recording(attempt).mkdir()
        (loop.campaign.recording(attempt) / VIDEO).write_bytes(b"pictures")
        found = TrackedAttempt(*SimulatedTestbed(seed=1).run([row]), ())

        def refuse(*_, **__):
            raise (StoreRefused if refusing == "the database" else JobRefused)("full")

        with monkeypatch.context() as faulty:
            where = {"the database": (Project, "store"), "the journal": (Campaign, "note")}
            faulty.setattr(*where[refusing], refuse)
            loop._events.put(lambda: loop._tracked(attempt, found))
            assert loop._in_trouble()
            loop.ask("again")
            assert loop._in_trouble()  # still
            assert "No recording is lost" in loop._trouble
        loop.ask("again")
        assert not loop._in_trouble()
        assert [own.row for own in loop.campaign.accepted] == [row.name]
    with project.store() as store:
        assert [*store.datasets().values()] == [1]


def test_a_camera_lost_while_a_part_is_placed_is_opened_again(bench):
    with operated(bench) as (loop, hand):
        hand.place()
        loop.devices.camera.source.close()
        until(lambda: hand.now()["phase"] == "trouble")
        assert "the camera stopped" in hand.now()["problems"][0]
        loop.ask("again")
        hand.place()


def test_a_plate_without_fixels_needs_no_reading_of_them(bench):
    project, plan = bench
    layout = replace(thesis_plan().layouts[0], pegs=())
    shapes, schemes = thesis_plan().shapes[:1], thesis_plan().schemes[:1]
    empty = replace(thesis_plan(), shapes=shapes, layouts=(layout,), schemes=schemes)
    plan.write_text(plan_text(empty))
    with operated((project, plan)) as (_, hand):
        hand.place()
        assert "fixels" not in [check["name"] for check in hand.now()["checks"]]


def dies_twice(folder):
    """Kill the own process at the first two calls."""
    n = len(list(folder.iterdir()))
    (folder / str(n)).touch()
    if n < 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def test_a_calculation_whose_process_was_killed_is_repeated(tmp_path, monkeypatch):
    answers = queue.Queue()
    with closing(Background(dies_twice)) as background:
        background.call(answers.put, tmp_path)
        assert answers.get(timeout=120.0) == "done"
    monkeypatch.setattr(loop_module, "TRIES", 1)
    with closing(Background(os._exit)) as background:
        background.call(answers.put, 1)
        assert isinstance(answers.get(timeout=300.0), JobRefused)


def test_a_small_part_is_pushed_where_it_lies_from_two_sides(tmp_path):
    """Pushes of the ASME paper with two axes, under the microscope."""
    plan = replace(eight_push_plan(), repetitions=1)
    (offsets,) = plan.schemes
    plan = replace(plan, schemes=(replace(offsets, rows=(offsets.rows[0], offsets.rows[5])),))
    (tmp_path / "two.yaml").write_text(plan_text(plan))
    rig = (files("fixel.testing") / "examples/rigs/microscope.yaml").read_text()
    named = rig.replace("\n  part:", "\n  object:").replace("\n  probe:", "\n  actuator:")
    (tmp_path / "rig.yaml").write_text(named)
    project = Project.create(tmp_path / "lab")
    options = {"rig": str(tmp_path / "rig.yaml"), "fit": ("mu_pusher",), "about_part": True}
    with open_bench(project, tmp_path / "two.yaml", emulated=True, auto=True, **options) as loop:
        assert loop.run() == "every row of the plan is done"
        ids = [own.experiment for own in loop.campaign.accepted]
    with project.store() as store:
        stored = [store.experiment(number) for number in ids]
    starts = np.array([own.trajectory.pose[0] for own in stored])
    ways = [own.pusher.pose[-1, :2] - own.pusher.pose[0, :2] for own in stored]
    assert np.abs(starts[0] - starts[1])[:2].max() < 5e-5  # the part lay at one place
    assert abs(np.dot(*[way / np.hypot(*way) for way in ways])) < 0.05  # pushes at right angles
    assert [float(np.hypot(*way)) for way in ways] == pytest.approx([7e-4, 7e-4], rel=0.05)
