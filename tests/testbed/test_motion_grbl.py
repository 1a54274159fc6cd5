import time

import pytest

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed import grbl_lines as grbl
from fixel.testbed.emulators import grbl as emulated_grbl
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.motion_grbl import GrblActuator

from .boards import stranger

FAST = {"acceleration": 2000.0}


@pytest.fixture
def controller():
    with EmulatedGrbl(**FAST) as emulated:
        yield emulated


@pytest.fixture
def drive(controller):
    # The guard has tests of its own.
    with GrblActuator(controller.port, guard=False) as connected:
        yield connected


def moves(controller: EmulatedGrbl, beyond: float = 0.0) -> None:
    """Return when it does, and is beyond a place [mm]."""
    until = time.monotonic() + 5.0
    while controller.speed < 5.0 or controller.place < beyond:
        assert time.monotonic() < until
        time.sleep(0.001)


# --- moves ----------------------------------------------------------------------------------------


def test_the_drive_keeps_its_speed_from_piece_to_piece(controller, drive):
    drive.move(by=0.02, speed=0.03)

    assert controller.place == pytest.approx(60.0, abs=0.01)
    assert controller.slowest(41.0, 59.0) == pytest.approx(30.0, rel=1e-3)
    moves = [line for line in controller.lines if line.startswith("G")]
    assert len(moves) > 5
    assert all(line.startswith("G21G90G94G53G1X") for line in moves)


def test_never_more_is_queued_than_the_dead_man_allows(controller, drive):
    drive.dead_man = 0.3
    most = 0.0
    drive.move(by=0.02, speed=0.03, wait=False)
    while drive.moving:
        most = max(most, controller.queued)
        time.sleep(0.005)

    assert 0.15 < most <= 0.31
    assert controller.slowest(41.0, 59.0) == pytest.approx(30.0, rel=1e-3)


def test_millimetres_are_sent_to_a_controller_that_reports_inches():
    with (
        EmulatedGrbl(inches=True, **FAST) as controller,
        GrblActuator(controller.port, guard=False) as drive,
    ):
        drive.move(to=0.005, speed=0.05)

        assert controller.place == pytest.approx(45.0, abs=0.01)
        assert drive.position() == pytest.approx(0.005, abs=1e-5)


def test_a_slow_drive_gets_a_longer_queue():
    with (
        EmulatedGrbl(acceleration=10.0) as controller,
        GrblActuator(controller.port, guard=False) as drive,
    ):
        assert drive._queue_for(13.5) > 0.9
        drive.dead_man = 0.5
        with pytest.raises(InvalidInput, match=r"increase the acceleration"):
            drive.move(by=0.01, speed=0.0135)
        drive.dead_man = None
        with pytest.raises(InvalidInput, match=r"\$120"):
            drive.move(by=0.01, speed=0.05)


def test_a_speed_beyond_the_controllers_is_refused_not_cut(drive):
    with pytest.raises(InvalidInput, match=r"at most 50 mm/s"):
        drive.move(by=0.01, speed=0.06)


def test_stopping_keeps_the_place(controller, drive):
    drive.move(by=0.05, speed=0.05, wait=False)
    time.sleep(0.1)
    drive.stop()

    assert drive.state == "Idle"
    assert not [event for event in controller.events if event.what.startswith("alarm")]
    assert 1e3 * drive.position() == pytest.approx(controller.place - 40.0, abs=0.01)


def fall_silent_owing_an_answer(controller: EmulatedGrbl) -> None:
    """The next line is never answered, nor anything after it."""

    def swallow(line: str) -> str:
        controller.mute = True
        return "ok"

    controller._motion = swallow


def lose_an_answer(controller: EmulatedGrbl) -> None:
    """The next line is obeyed and never answered."""
    obey = controller._motion

    def lose(line: str) -> str:
        obey(line)
        controller._motion = obey
        return ""

    controller._motion = lose


def lose_the_banner(controller: EmulatedGrbl) -> None:
    """Off and on again, and what it says of that is lost."""
    controller.mute = True
    controller.power_cycle()
    controller.mute = False


def damage_a_report(controller: EmulatedGrbl) -> None:
    """A letter of the next report arrives as another: it says no place any more."""
    notify = controller._say

    def damaged(*lines: str) -> None:
        if lines[0].startswith("<"):
            controller._say = notify
            lines = (lines[0].replace("MPos", "MQos"),)
        notify(*lines)

    controller._say = damaged


# --- alarms and limits ----------------------------------------------------------------------------


def test_a_drive_that_must_be_homed_says_so():
    with (
        EmulatedGrbl(homing=True, start=5.0, **FAST) as controller,
        GrblActuator(controller.port, guard=False) as drive,
    ):
        assert drive.state == "Alarm"
        with pytest.raises(DeviceFailed, match="fixel actuator home"):
            drive.move(to=0.01)

        drive.home()

        assert drive.position() == pytest.approx(0.001)
        drive.move(to=0.005, speed=0.05)
        assert controller.place == pytest.approx(5.0, abs=0.01)


def test_reach_is_cut_to_the_travel_of_the_controller():
    with (
        EmulatedGrbl(homing=True, travel=80.0) as controller,
        GrblActuator(controller.port, guard=False) as drive,
    ):
        assert drive.reach == (0.0, 0.08)


def test_homing_without_switches_is_refused(drive):
    with pytest.raises(DeviceFailed, match=r"not enabled.*--unlock"):
        drive.home()


@pytest.mark.parametrize(
    ("happens", "why"),
    [
        (lambda controller: controller.hit_switch(), "a limit switch was hit"),
        (lambda controller: controller.power_cycle(), "reset"),
        (lambda controller: controller.unplug(), "was lost"),
        (lambda controller: setattr(controller, "mute", True), "has not responded"),
        (fall_silent_owing_an_answer, "has not responded"),
        (lose_an_answer, "reply of the controller was lost"),
        (lambda controller: controller.press_hold(), "in the state Hold"),
        (lambda controller: setattr(controller, "refuse", 1), "a command it does not know"),
    ],
    ids=[
        "limit switch",
        "power",
        "plug",
        "silence",
        "owing",
        "lost answer",
        "hold button",
        "refused line",
    ],
)
def test_whatever_ends_a_move_early_is_told(controller, drive, happens, why, monkeypatch):
    monkeypatch.setattr("fixel.testbed.grbl_link.SILENCE", 0.3)
    drive.move(by=0.05, speed=0.03, wait=False)
    moves(controller)
    happens(controller)

    with pytest.raises(DeviceFailed, match=why):
        drive.wait()
    drive.stop()
    assert not drive.moving


def test_after_a_lost_answer_the_drive_can_be_moved_on(controller, drive, monkeypatch):
    monkeypatch.setattr("fixel.testbed.grbl_link.SILENCE", 0.3)
    lose_an_answer(controller)
    with pytest.raises(DeviceFailed, match="lost"):
        drive.move(by=0.005, speed=0.03)

    drive.move(to=0.01, speed=0.03)

    assert controller.place == pytest.approx(50.0, abs=0.01)


def test_a_reset_that_nobody_heard_of_is_told(controller, drive):
    drive.move(by=0.1, speed=0.05, wait=False)
    moves(controller, beyond=65.0)
    lose_the_banner(controller)

    with pytest.raises(DeviceFailed, match=r"short of its target|reply of the controller was lost"):
        drive.wait()


def test_a_failure_of_the_conversation_itself_is_told(controller, drive, monkeypatch):
    def fail(*_: object) -> str:
        raise ZeroDivisionError("of nobody's making")

    drive.move(by=0.05, speed=0.03, wait=False)
    moves(controller)
    monkeypatch.setattr(grbl, "move_line", fail)

    with pytest.raises(DeviceFailed, match="was lost: of nobody's making"):
        drive.wait()


def test_a_report_without_a_place_is_passed_over(controller, drive):
    drive.move(by=0.02, speed=0.03, wait=False)
    moves(controller)
    damage_a_report(controller)
    drive.wait()

    assert controller.place == pytest.approx(60.0, abs=0.01)


def test_damaged_reports_are_passed_over(controller, drive):
    controller.garble = 200
    drive.move(by=0.005, speed=0.03)

    assert controller.place == pytest.approx(45.0, abs=0.01)


def test_whoever_finds_a_drive_moving_stops_it_first(controller):
    controller.obey("G1X60F600")
    moves(controller)

    with GrblActuator(controller.port, guard=False) as drive:
        assert drive.state == "Idle"
        assert controller.speed == 0.0


# --- the wrong port -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("says", "found"),
    [
        pytest.param(lambda heard: heard, "echo of every byte", id="echo"),
        pytest.param(lambda heard: b"\x05" * len(heard), "the tactile board", id="tactile board"),
        pytest.param(lambda heard: b"ERROR\r\n", '"ERROR"', id="modem"),
        pytest.param(lambda heard: b"\x80\x91\xf0" * 4, "80 91 f0", id="garbage"),
        pytest.param(lambda heard: b"", "no answer", id="silence"),
    ],
)
def test_a_port_of_something_else_is_refused_with_what_it_said(says, found, monkeypatch):
    monkeypatch.setattr("fixel.testbed.grbl_link.PATIENCE", 0.03)
    with stranger(says) as port, pytest.raises(InvalidInput, match=found):
        GrblActuator(port).connect()


def test_a_port_that_is_in_use_is_refused(controller, drive):
    with pytest.raises(InvalidInput, match="in use by"):
        GrblActuator(controller.port).connect()


def test_an_emulated_controller_takes_no_file_away(tmp_path, monkeypatch):
    (tmp_path / "notes").write_text("mine")
    monkeypatch.setattr("sys.argv", ["emulated_grbl", "--link", str(tmp_path / "notes")])
    with pytest.raises(SystemExit):
        emulated_grbl.main()
    assert (tmp_path / "notes").read_text() == "mine"


# --- lines ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "state", "place"),
    [
        ("<Idle|MPos:1.000,2.000,3.000|FS:0,0>", ("Idle", None), (1.0, 2.0, 3.0)),
        ("<Hold:0|MPos:-1.5,0.0,0.0|Bf:15,128|FS:0,0|WCO:1,2,3>", ("Hold", 0), (-1.5, 0.0, 0.0)),
        ("<Run,MPos:1.0,2.0,3.0,WPos:4.0,5.0,6.0>", ("Run", None), (1.0, 2.0, 3.0)),
    ],
)
def test_status_reports_of_both_versions(line, state, place):
    status = grbl.status_of(line)

    assert status[:2] == state
    assert status.machine == place


@pytest.mark.parametrize(
    "line", ["", "ok", "<Idle", "<Idle|MPos:1.0,2.0|>", "<Idle|MPos:1..0,2,3|>", "[MSG:x]"]
)
def test_anything_else_is_no_report(line):
    assert grbl.status_of(line) is None


@pytest.mark.parametrize(
    ("more", "coordinate_at_10_mm"),
    [
        (["$22=1", "$23=0"], -10.0),
        (["$22=1", "$23=1"], -140.0),
        (["$22=1", "$23=1", "[OPT:VZ,15,128]"], 10.0),
        (["$22=0"], 10.0),
    ],
)
def test_machine_coordinates_follow_where_the_controller_homes(more, coordinate_at_10_mm):
    settings = grbl.settings_of(["$110=600", "$120=10", "$130=150", *more], "X")

    assert settings.coordinate(0.010) == pytest.approx(coordinate_at_10_mm)
    assert settings.position(coordinate_at_10_mm) == pytest.approx(0.010)
