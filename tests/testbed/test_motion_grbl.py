import math
import threading
import time
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
from tests.fixtures import refused
from tests.jobs.helpers import await_true

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed import grbl_link as grbl
from fixel.testbed.emulators import grbl as emulated_grbl
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.motion_grbl import GrblActuator
from fixel.testing.actuator_contract import once_moving

from .boards import stranger

FAST = {"acceleration": 2000.0}


@pytest.fixture
def controller():
    with EmulatedGrbl(**FAST) as emulated:
        yield emulated


@contextmanager
def driven(options=None, **emulated):
    """An emulated controller, and a drive at it without its guard, which has tests of its own."""
    with (
        EmulatedGrbl(**emulated) as controller,
        GrblActuator(controller.port, guard=False, **(options or {})) as drive,
    ):
        yield controller, drive


@pytest.fixture
def drive(controller):
    # The guard has tests of its own.
    with GrblActuator(controller.port, guard=False) as connected:
        yield connected


def moves(controller: EmulatedGrbl, beyond: float = 0.0) -> None:
    """Return when it does, and is beyond a place [mm]."""
    await_true(lambda: controller.speed >= 5.0 and controller.place >= beyond, pause_s=0.001)


# --- moves ----------------------------------------------------------------------------------------


def test_speed_is_even_over_pieces_and_never_more_is_queued_than_the_dead_man_allows(
    controller, drive
):
    drive.dead_man = 0.3
    most = 0.0
    drive.move(by=0.02, speed=0.03, wait=False)
    while drive.moving:
        most = max(most, controller.queued)
        time.sleep(0.005)

    assert 0.15 < most <= 0.31
    assert controller.place == pytest.approx(60.0, abs=0.01)
    assert controller.slowest(41.0, 59.0) == pytest.approx(30.0, rel=1e-3)
    moves = [line for line in controller.lines if line.startswith("G")]
    assert len(moves) > 5
    assert all(line.startswith("G21G90G94G53G1X") for line in moves)


def test_millimetres_are_sent_to_a_controller_that_reports_inches():
    with driven({"axes": "XY"}, axes=2, inches=True, **FAST) as (controller, drive):
        drive.go([0.003, 0.004], speed=0.05)

        assert controller.places == pytest.approx((43.0, 44.0), abs=0.01)
        assert drive.place() == pytest.approx([0.003, 0.004], abs=1e-5)
    with driven(inches=True, **FAST) as (controller, drive):
        drive.move(to=0.005, speed=0.05)

        assert controller.place == pytest.approx(45.0, abs=0.01)
        assert drive.position() == pytest.approx(0.005, abs=1e-5)


def test_a_slow_drive_gets_a_longer_queue():
    with driven(acceleration=10.0) as (_, drive):
        assert drive._queue_for(13.5) > 0.9
        drive.dead_man = 0.5
        refused(drive.move, by=0.01, speed=0.0135, match=r"increase the acceleration")
        drive.dead_man = None
        refused(drive.move, by=0.01, speed=0.05, match=r"\$120")


def test_a_speed_beyond_the_controllers_is_refused_not_cut(drive):
    refused(drive.move, by=0.01, speed=0.06, match=r"at most 50 mm/s")


def test_a_stop_that_comes_before_the_move_prevents_it(controller, drive, monkeypatch):
    report = drive._link.fresh_status

    def stopped_meanwhile(*patience: float):
        drive.stop()
        return report(*patience)

    monkeypatch.setattr(drive._link, "fresh_status", stopped_meanwhile)
    with pytest.raises(DeviceFailed, match="a stop was requested"):
        drive.move(to=0.01, speed=0.03)

    assert not drive.moving
    assert not [line for line in controller.lines if line.startswith("G")]
    monkeypatch.undo()
    drive.move(to=0.002, speed=0.03)
    assert controller.place == pytest.approx(42.0, abs=0.01)


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


def damage_reports(controller, damage, reports=1):
    """The next reports arrive damaged; answers to lines of the move do not."""
    say = controller._say

    def damaged(*lines: str) -> None:
        nonlocal reports
        if lines[0].startswith("<") and reports:
            reports -= 1
            lines = (damage(lines[0]),)
        say(*lines)

    controller._say = damaged


def lose_the_place(controller: EmulatedGrbl) -> None:
    """A letter of the next report arrives as another: it says no place any more."""
    damage_reports(controller, lambda line: line.replace("MPos", "MQos"))


def garble_reports(controller: EmulatedGrbl) -> None:
    """Every byte of some reports arrives as another."""
    damage_reports(controller, lambda line: "".join(chr(ord(c) ^ 0x2A) for c in line), reports=5)


# --- alarms and limits ----------------------------------------------------------------------------


def test_a_drive_that_must_be_homed_says_so():
    with driven(homing=True, start=5.0, **FAST) as (controller, drive):
        assert drive.state == "Alarm"
        assert drive.zero_known  # by its switches, without a person
        with pytest.raises(DeviceFailed, match="fixel actuator home"):
            drive.move(to=0.01)

        drive.home()

        assert drive.position() == pytest.approx(0.001)
        drive.move(to=0.005, speed=0.05)
        assert controller.place == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("homing", [True, False])
def test_reach_is_cut_to_the_travel_of_the_controller(homing):
    with driven(homing=homing, travel=80.0) as (_, drive):
        assert drive.reach == (0.0, 0.08)


def test_homing_without_switches_is_refused(drive):
    with pytest.raises(DeviceFailed, match=r"homing is off.*by hand.*\$22=1"):
        drive.home()


def report_nothing_at_home(controller: EmulatedGrbl) -> None:
    """Controllers like GRBL answer no status request while they home."""
    report = controller._report
    controller._report = lambda: None if controller.state == "Home" else report()


@pytest.mark.parametrize("happens", ["a stop", "a timeout"])
def test_homing_ends_at_once(happens, monkeypatch):
    with driven(homing=True, start=900.0, travel=1000.0) as (controller, drive):
        report_nothing_at_home(controller)
        if happens == "a timeout":
            monkeypatch.setattr("fixel.testbed.motion_grbl.HOMING_TIME", 0.3)
        else:
            begins = partial(await_true, lambda: controller.place < 899.0)
            stop = threading.Thread(target=lambda: (begins(), drive.stop()))
            stop.start()
        with pytest.raises(DeviceFailed, match="homing failed"):
            drive.home()
        await_true(lambda: "alarm 6" in [event.what for event in controller.events])
        assert controller.place > 720.0


def test_a_move_that_another_thread_stops_keeps_its_zero():
    with driven({"reach": (0.0, 1.0)}, acceleration=200.0, travel=1000.0) as (_, drive):
        drive.set_zero()
        for _ in range(6):
            stop = once_moving(drive, drive.stop)
            with pytest.raises(DeviceFailed, match="stop was requested"):
                drive.move(to=0.9, speed=0.04)
            stop.join()
            assert drive.zero_known


@pytest.mark.parametrize("happens", [EmulatedGrbl.power_cycle, EmulatedGrbl.hit_switch])
def test_without_homing_zero_is_unknown_until_confirmed_and_after_each_loss(happens):
    with driven({"axes": "XY"}, axes=2, start=20.0) as (controller, drive):
        assert not drive.zero_known
        drive.go([0.010, 0.0], speed=0.05)
        drive.set_zero()
        assert drive.zero_known
        assert drive.place() == pytest.approx([0.0, 0.0], abs=1e-5)
        drive.move(to=0.010, speed=0.02, wait=False)
        moves(controller)
        drive.stop()  # slows down, so that the position stays known
        assert drive.zero_known
        there = np.subtract(controller.places, [30.0, 20.0])
        assert 1e3 * drive.place() == pytest.approx(there, abs=0.01)

        happens(controller)
        await_true(lambda: not drive.zero_known)
        drive.set_zero()
        assert drive.zero_known
        before = np.array(controller.places)
        drive.go([0.005, 0.002], speed=0.05)
        assert np.array(controller.places) - before == pytest.approx([5.0, 2.0], abs=0.01)


ENDS = {
    "limit switch": (EmulatedGrbl.hit_switch, "a limit switch was hit"),
    "power": (EmulatedGrbl.power_cycle, "reset"),
    "plug": (EmulatedGrbl.unplug, "was lost"),
    "silence": (lambda controller: setattr(controller, "mute", True), "has not responded"),
    "owing": (fall_silent_owing_an_answer, "has not responded"),
    "lost answer": (lose_an_answer, "reply of the controller was lost"),
    "hold button": (EmulatedGrbl.press_hold, "in the state Hold"),
    "refused line": (lambda controller: setattr(controller, "refuse", 1), "it does not know"),
}


@pytest.mark.parametrize(("happens", "why"), ENDS.values(), ids=ENDS)
def test_whatever_ends_a_move_early_is_reported(controller, drive, happens, why):
    drive.move(by=0.05, speed=0.03, wait=False)
    moves(controller)
    happens(controller)

    with pytest.raises(DeviceFailed, match=why):
        drive.wait()
    drive.stop()
    assert not drive.moving


def test_after_a_hold_nothing_is_left_that_a_button_would_continue(controller, drive):
    drive.move(by=0.05, speed=0.03, wait=False)
    moves(controller)
    controller.press_hold()
    with pytest.raises(DeviceFailed, match="in the state Hold"):
        drive.wait()
    there = controller.place
    controller._do(lambda: controller._take(b"~"))
    time.sleep(0.1)

    assert controller.place == there


def test_after_a_lost_answer_the_drive_can_be_moved_on(controller, drive):
    lose_an_answer(controller)
    with pytest.raises(DeviceFailed, match="lost"):
        drive.move(by=0.005, speed=0.03)

    drive.move(to=0.01, speed=0.03)

    assert controller.place == pytest.approx(50.0, abs=0.01)


def test_an_unexpected_reset_is_reported(controller, drive):
    drive.move(by=0.1, speed=0.05, wait=False)
    moves(controller, beyond=65.0)
    lose_the_banner(controller)

    with pytest.raises(DeviceFailed, match=r"short of its target|reply of the controller was lost"):
        drive.wait()


def test_a_failure_of_the_conversation_itself_is_reported(controller, drive, monkeypatch):
    def fail(*_: object) -> str:
        raise ZeroDivisionError("without a cause")

    drive.move(by=0.05, speed=0.03, wait=False)
    moves(controller)
    monkeypatch.setattr(grbl, "move_line", fail)

    with pytest.raises(DeviceFailed, match="was lost: without a cause"):
        drive.wait()


def lose_an_axis(controller: EmulatedGrbl) -> None:
    """Reports lack an axis for a while."""
    whole, controller._axes = controller._axes, 2
    time.sleep(0.1)
    controller._axes = whole


@pytest.mark.parametrize(
    "damage",
    [lose_the_place, lose_an_axis, garble_reports],
    ids=["without a place", "without an axis", "garbled"],
)
def test_damaged_reports_are_passed_over(controller, drive, damage):
    drive.move(by=0.02, speed=0.03, wait=False)
    moves(controller)
    damage(controller)
    drive.wait()

    assert controller.place == pytest.approx(60.0, abs=0.01)


def test_whoever_finds_a_drive_moving_stops_it_first(controller):
    controller.obey("G1X60F600")
    moves(controller)

    with GrblActuator(controller.port, guard=False) as drive:
        assert drive.state == "Idle"
        assert controller.speed == 0.0


@pytest.mark.parametrize("half", [b"G21G90G94G53G1X60.000F300", b"G0X60", b"$H"])
def test_half_a_line_of_another_program_is_not_executed(half):
    with EmulatedGrbl(homing=half == b"$H") as controller:
        controller._do(lambda: [controller._take(bytes([byte])) for byte in half])
        with GrblActuator(controller.port, guard=False) as drive:
            assert drive.reach == (0.0, 0.15)
        assert controller.trace == []
        assert controller.place == 40.0


# --- other firmware -------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", emulated_grbl.FIRMWARE)
def test_a_restart_is_recognised_by_its_greeting(firmware):
    with driven(firmware=firmware, **FAST) as (controller, drive):
        drive.move(by=0.05, speed=0.03, wait=False)
        moves(controller)
        controller.power_cycle()

        with pytest.raises(DeviceFailed, match="the controller was reset"):
            drive.wait()


def test_an_axis_that_the_controller_lacks_is_refused():
    with EmulatedGrbl(firmware="FluidNC", axes=1) as controller:
        drive = GrblActuator(controller.port, axis="Y", guard=False)
        refused(drive.connect, match="is 'Y', but must be an axis of the controller: X")
        assert not drive.connected


# --- several axes ---------------------------------------------------------------------------------


def distance_to_line(place, begin, end) -> float:
    """Distance of a place from the straight line through two others, in a plane [mm]."""
    (x, y), (x0, y0), (x1, y1) = place, begin, end
    area = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
    return abs(area) / math.hypot(x1 - x0, y1 - y0)


@pytest.mark.parametrize("degrees", [1.0, 38.0, 90.0, 205.0, 301.0])
def test_a_line_over_two_axes_is_straight_and_keeps_its_speed(degrees):
    way = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    with driven({"axes": "XY", "reach": (-0.05, 0.05)}, axes=2, start=(50.0, 60.0), **FAST) as (
        controller,
        drive,
    ):
        drive.aim([0.0, 0.0], way)
        drive.move(to=0.02, speed=0.03)

        end = 50.0 + 20.0 * way[0], 60.0 + 20.0 * way[1]
        places = [places for places, _ in controller.trace]
        # Coordinates of a line have three decimals.
        assert max(distance_to_line(each, (50.0, 60.0), end) for each in places) < 1e-3
        assert controller.places == pytest.approx(end, abs=1e-3)
        assert len([line for line in controller.lines if line.startswith("G")]) > 5
        inner = [
            speed for each, speed in controller.trace if 1.0 < math.dist(each, (50.0, 60.0)) < 19.0
        ]
        assert min(inner) == pytest.approx(30.0, rel=1e-3)
        assert 1e3 * drive.place() == pytest.approx([20.0 * part for part in way], abs=2e-3)


def test_a_stop_in_a_line_over_two_axes_keeps_the_place():
    with driven({"axes": "XY"}, axes=2, homing=True, start=5.0) as (controller, drive):
        drive.home()
        drive.go([0.02, 0.03], speed=0.04)
        drive.aim([0.02, 0.03], [0.6, 0.8])
        drive.move(to=0.08, speed=0.04, wait=False)
        await_true(lambda: controller.speed == pytest.approx(40.0), pause_s=0.001)
        drive.stop()

        assert drive.state == "Idle"
        assert not [event for event in controller.events if event.what.startswith("alarm")]
        stopped = controller.places
        assert distance_to_line(stopped, (20.0, 30.0), (26.0, 38.0)) < 2e-3
        assert 1e3 * drive.place() == pytest.approx(stopped, abs=2e-3)
        assert 1e3 * drive.position() == pytest.approx(math.dist(stopped, (20.0, 30.0)), abs=2e-3)
        drive.move(by=0.01, speed=0.04)
        further = stopped[0] + 6.0, stopped[1] + 8.0
        assert controller.places == pytest.approx(further, abs=3e-3)


@pytest.mark.parametrize(("firmware", "axes", "used"), [
    ("GRBL", 2, "XY"),
    ("grblHAL", 4, "XYZ"),
    ("FluidNC", 3, "YX"),
    ("GRBL", 4, "X"),
    ("FluidNC", 1, "X"),
    *(
        pytest.param(*rest, marks=pytest.mark.system)
        for rest in (("GRBL", 4, "XZ"), ("FluidNC", 4, "XYZA"))
    ),
])  # fmt: skip
def test_every_axis_has_its_own_travel_speed_and_acceleration(firmware, axes, used):
    travel, fastest = (80.0, 60.0, 40.0, 30.0)[:axes], (50.0, 20.0, 10.0, 15.0)[:axes]
    with (
        EmulatedGrbl(
            homing=True, travel=travel, fastest=fastest, start=5.0, firmware=firmware, axes=axes,
            acceleration=(2000.0, 100.0, 3000.0, 4000.0)[:axes],
        ) as controller,
        GrblActuator(controller.port, axes=used, guard=False) as drive,
    ):  # fmt: skip
        numbers = ["XYZA".index(axis) for axis in used]
        assert drive.travels.tolist() == [[0.0, pytest.approx(1e-3 * travel[k])] for k in numbers]
        drive.home()
        # FluidNC has the coordinate of the place where homing ends in its configuration.
        home = 0.0 if firmware == "FluidNC" else 1.0
        assert drive.place() == pytest.approx([1e-3 * home] * len(used))

        share = 1.0 / math.sqrt(len(used))
        drive.aim([1e-3 * home] * len(used), [share] * len(used))
        limit, shortest = min(fastest[k] for k in numbers) / share, min(travel[k] for k in numbers)
        assert drive.reach[1] == pytest.approx(1e-3 * (shortest - home) / share)
        refused(drive.move, by=0.001, speed=1.02e-3 * limit, match=f"at most {limit:.4g} mm/s")
        drive.move(by=0.003, speed=0.99e-3 * limit)

        there = {k: 1.0 + 3.0 * share for k in numbers}
        assert controller.places == pytest.approx(
            [there.get(k, 1.0) for k in range(axes)], abs=0.01
        )


@pytest.mark.parametrize("mask", range(4))
def test_coordinates_of_two_axes_are_not_mirrored(mask):
    with EmulatedGrbl(axes=2, homing=True, travel=(80.0, 60.0)) as controller:
        controller._settings[23] = float(mask)  # which axes home at their low ends
        with GrblActuator(controller.port, axes="XY", guard=False) as drive:
            x_low, y_low = (-80.0, -60.0)
            corner, right, up = (
                drive._place_of(np.array(place))
                for place in ((x_low, y_low), (0.0, y_low), (x_low, 0.0))
            )
            (a, b), (c, d) = right - corner, up - corner
            assert a * d - b * c == pytest.approx(0.08 * 0.06)
            # The travels are from 0 to the length of the axis for each of them.
            ends = np.sort([corner, right + up - corner], axis=0)
            assert ends == pytest.approx(np.array([[0.0, 0.0], [0.08, 0.06]]))


def test_the_axis_that_is_too_slow_is_named():
    with driven({"axes": "XY"}, axes=2, acceleration=(500.0, 5.0)) as (controller, drive):
        drive.check(to=0.1, speed=0.04)
        drive.aim([0.0, 0.0], [0.6, 0.8])
        refused(drive.check, to=0.1, speed=0.04, match=r"acceleration of 6\.25 mm/s\^2 \(\$121\)")
        assert controller.lines[-1].startswith("$")


def test_a_check_finds_what_a_move_would_find_and_moves_nothing():
    with driven({"axes": "XY"}, axes=2, homing=True, start=5.0, travel=(80.0, 60.0)) as (
        controller,
        drive,
    ):
        drive.aim([0.02, 0.01], [0.0, 1.0])
        with pytest.raises(DeviceFailed, match="fixel actuator home"):
            drive.check(to=0.01)
        drive.home()
        before = controller.places

        drive.check(to=0.05)
        refused(drive.check, to=0.051, match="from -10 to 50 mm")
        with pytest.raises(DeviceFailed, match=r"19\.00 mm off the line"):
            drive.move(to=0.05)

        assert controller.places == before
        assert not [line for line in controller.lines if line.startswith("G")]


def test_a_rotary_axis_is_refused():
    with pytest.raises(InvalidInput, match="'A' in degrees"):
        grbl.settings_of(["$113=600", "$123=10", "$133=150", "$376=1"], "A")


def test_homing_of_an_axis_follows_the_masks_of_its_passes():
    """An axis of grblHAL that is in no pass is not homed, although homing is enabled."""
    lines = [*GRBL_HAL.splitlines(), "$44=4", "$45=1"]
    assert not grbl.settings_of(lines, "Y").homing
    assert grbl.settings_of([*lines, "$46=2"], "Y").homing


@pytest.mark.parametrize("axes", ["", "XX", "XQ", "xy", "X Y"])
def test_axes_that_no_controller_has_are_refused(axes):
    refused(GrblActuator, "/dev/null", axes=axes, match="axes")


# --- the wrong port -------------------------------------------------------------------------------


@pytest.mark.parametrize(("says", "found"), [
    pytest.param(lambda heard: heard, "echo of every byte", id="echo"),
    pytest.param(lambda heard: b"\x05" * len(heard), "the tactile board", id="tactile board"),
    pytest.param(lambda heard: b"ERROR\r\n", '"ERROR"', id="modem"),
    pytest.param(lambda heard: b"\x80\x91\xf0" * 4, "80 91 f0", id="garbage"),
    pytest.param(lambda heard: b"", "no answer", id="silence"),
])  # fmt: skip
def test_a_port_of_something_else_is_refused_with_what_it_said(says, found):
    with stranger(says) as port, pytest.raises(InvalidInput, match=found):
        GrblActuator(port).connect()


def test_a_port_that_is_in_use_is_refused(controller, drive):
    refused(GrblActuator(controller.port).connect, match="in use by")


def test_an_emulated_controller_takes_no_file_away(tmp_path, monkeypatch):
    (tmp_path / "notes").write_text("mine")
    monkeypatch.setattr("sys.argv", ["emulated_grbl", "--link", str(tmp_path / "notes")])
    with pytest.raises(SystemExit):
        emulated_grbl.main()
    assert (tmp_path / "notes").read_text() == "mine"


# --- lines ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("line", "state", "place"), [
    ("<Idle|MPos:1.000,2.000,3.000|FS:0,0>", ("Idle", None), (1.0, 2.0, 3.0)),
    ("<Hold:0|MPos:-1.5,0.0,0.0|Bf:15,128|FS:0,0|WCO:1,2,3>", ("Hold", 0), (-1.5, 0.0, 0.0)),
    ("<Run,MPos:1.0,2.0,3.0,WPos:4.0,5.0,6.0>", ("Run", None), (1.0, 2.0, 3.0)),
    ("<Idle|MPos:-1.500|FS:0,0>", ("Idle", None), (-1.5,)),
    ("<Alarm:11|MPos:1.0,2.0|Bf:100,1023|FS:0,0,0|Pn:P>", ("Alarm", 11), (1.0, 2.0)),
    ("<Idle|MPos:1.0,2.0,3.0,4.0|FS:0,0|WCO:0,0,0,0>", ("Idle", None), (1.0, 2.0, 3.0, 4.0)),
])  # fmt: skip
def test_status_reports_of_both_versions(line, state, place):
    status = grbl.status_of(line)

    assert status[:2] == state
    assert status.machine == place


@pytest.mark.parametrize(
    "line",
    ["", "ok", "<Idle", "<Idle|MPos:1.0,,3.0|>", "<Idle|MPos:1..0,2,3|>", "[MSG:x]",
     "<Idle|MPos:1.0,2.0|FS:0,0|WCO:0,0,0>"],
)  # fmt: skip
def test_anything_else_is_no_report(line):
    assert grbl.status_of(line) is None


@pytest.mark.parametrize(("more", "coordinate_at_10_mm"), [
    (["$22=1", "$23=0"], -10.0),
    (["$22=1", "$23=1"], -140.0),
    (["$22=1", "$23=1", "[OPT:VZ,15,128]"], 10.0),
    (["$22=0"], 10.0),
])  # fmt: skip
def test_machine_coordinates_follow_where_the_controller_homes(more, coordinate_at_10_mm):
    settings = grbl.settings_of(["$110=600", "$120=10", "$130=150", *more], "X")

    assert settings.coordinate(0.010) == pytest.approx(coordinate_at_10_mm)
    assert settings.position(coordinate_at_10_mm) == pytest.approx(0.010)


GRBL_09 = """$13=0 (report inches, bool)
$22=1 (homing cycle, bool)
$23=2 (homing dir invert mask:00000010)
$110=3000.000 (x max rate, mm/min)
$111=1500.000 (y max rate, mm/min)
$120=200.000 (x accel, mm/sec^2)
$121=100.000 (y accel, mm/sec^2)
$130=150.000 (x max travel, mm)
$131=90.000 (y max travel, mm)"""
GRBL_HAL = """[VER:1.1f.20240420:]
[OPT:VNMZHSL,35,1024,4,0]
[NEWOPT:ENUMS,RT+,HOME,TC]
[IP:192.168.5.1]
$10=511
$13=0
$20=0
$22=79
$23=3
$70=11
$110=3000.000
$111=1500.000
$120=200.000
$121=100.000
$130=150.000
$131=90.000
$300=grblHAL
$302=192.168.5.1
$304=255.255.255.0
$490=
$535=02:08:dc:2b:eb:ec"""
FLUID_NC = """[VER:3.7 FluidNC v3.7.8:]
[OPT:MPHS]
[MSG:Mode=STA:SSID=lab:Status=Connected:IP=192.168.1.50:MAC=A0-A3-B3-AB-7C-FC]
/axes/y:
  steps_per_mm: 80.000000
  max_rate_mm_per_min: 1500.000000
  acceleration_mm_per_sec2: 100.000000
  max_travel_mm: 90.000000
  soft_limits: true
  homing:
    cycle: 1
    allow_single_axis: true
    positive_direction: false
    mpos_mm: 150.000000

  motor0:
    limit_neg_pin: gpio.39
    hard_limits: false
    tmc_2209:
      addr: 0
$13=1
$10=1
$30=1000"""


@pytest.mark.parametrize(
    ("answer", "at_10_mm", "soft", "inches"),
    [(GRBL_09, -80.0, False, False), (GRBL_HAL, 10.0, False, False), (FLUID_NC, 160.0, True, True)],
    ids=["GRBL 0.9", "grblHAL", "FluidNC"],
)
def test_settings_are_read_by_name_and_others_may_be_text(answer, at_10_mm, soft, inches):
    """Answers as the firmware prints them, for the second axis."""
    settings = grbl.settings_of(answer.splitlines(), "Y")

    assert (settings.fastest, settings.acceleration, settings.travel) == (25.0, 100.0, 90.0)
    assert settings.homing
    assert settings.coordinate(0.010) == pytest.approx(at_10_mm)
    assert (settings.soft_limits, settings.inches) == (soft, inches)


def test_homing_that_is_off_in_a_mask_or_a_cycle_is_off():
    without = GRBL_HAL.replace("$22=79", "$22=78"), FLUID_NC.replace("cycle: 1", "cycle: -1")
    for answer in without:
        settings = grbl.settings_of(answer.splitlines(), "Y")
        assert not settings.homing
        assert settings.coordinate(0.010) == pytest.approx(10.0)


@pytest.mark.parametrize(("damage", "found"), [
    (("$111=1500.000", "$111=fast"), r"\$111=fast"),
    (("$131=90.000", "$131=nan"), r"\$131=nan"),
    (("$121=100.000", ""), r"no setting \$121"),
])  # fmt: skip
def test_a_needed_setting_that_is_no_number_is_named(damage, found):
    with pytest.raises(
        InvalidInput, match=f"the controller: found {found}, but fixel needs a number"
    ):
        grbl.settings_of(GRBL_HAL.replace(*damage).splitlines(), "Y")
