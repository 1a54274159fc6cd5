import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from tests.fixtures import refused
from tests.jobs.helpers import await_true

from fixel.errors import InvalidInput
from fixel.testbed import tactile_protocol as frames
from fixel.testbed.tactile import TactileReader, contact_mode, fixels_of

from .boards import stranger

PATIENT = 10.0  # [s] a deadline that a loaded computer keeps, too


@pytest.fixture
def reader(mega):
    with TactileReader(mega.port, deadline=PATIENT) as fixels:
        yield fixels


def old_board(bits: int = 5):
    return stranger(lambda heard: bytes([bits]) * len(heard))


# --- readings -------------------------------------------------------------------------------------


def test_readings_follow_the_contacts(mega, reader):
    found = []
    for bits in range(8):
        mega.touch(bits)
        found.append(reader.read())

    assert [reading.bits for reading in found] == list(range(8))
    assert all(reading.problem == "" for reading in found)
    assert all((value > 900) == bool(7 >> k & 1) for k, value in enumerate(found[7].values))
    assert reader.protocol == 2


def test_times_are_of_the_reading_and_on_the_clock_of_this_computer(mega, reader):
    times, device = [], []
    for _ in range(50):
        before = time.monotonic()
        reading = reader.read()
        assert before <= reading.time <= time.monotonic()
        times.append(reading.time)
        device.append(reading.device_time)

    assert np.all(np.diff(times) > 0.0)
    assert np.all(np.diff(device) > 0.0)


def test_thresholds_can_be_set_and_survive_a_restart(mega, reader):
    mega.touch(0)
    mega.volts(2, 2.0)
    before = reader.read().bits
    reader.set_thresholds((900, 900, 300))
    after = reader.read().bits

    mega.tell("reset 0")
    noticed = reader.read()

    assert (before, after) == (0, 4)
    assert "restarted" in noticed.problem
    assert reader.read().bits == 4
    assert reader.statistics.restarts == 1


def test_thresholds_that_get_lost_after_a_restart_are_a_problem(mega, reader, monkeypatch):
    mega.touch(0)
    mega.volts(2, 2.0)
    reader.set_thresholds((900, 900, 300))
    reader.read()
    mega.tell("reset 0")
    ask = reader._frame_of
    monkeypatch.setattr(
        TactileReader,
        "_frame_of",
        lambda self, kind, until: None if kind == frames.SET_THRESHOLDS else ask(kind, until),
    )

    assert "does not accept its thresholds" in reader.read().problem
    assert "does not accept its thresholds" in reader.read().problem
    monkeypatch.undo()
    assert "restarted" in reader.read().problem
    assert (reader.read().bits, reader.read().problem) == (4, "")
    assert reader.statistics.restarts == 1


def test_thresholds_that_an_old_board_cannot_take_leave_the_port_free():
    with old_board() as port:
        reader = TactileReader(port, thresholds=(1, 2, 3))
        refused(reader.connect, match="upload firmware/tactile")

        assert not reader.connected
        TactileReader(port).connect().disconnect()


def test_a_board_that_goes_away_while_it_is_greeted_is_refused(monkeypatch):
    def gone(link, port, settle):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("fixel.testbed.tactile.shake_hands", gone)
    with old_board() as port:
        reader = TactileReader(port)
        refused(reader.connect, match="was disconnected")
        assert not reader.reconnect()
        assert "connect it" in reader.trouble


@pytest.mark.parametrize("thresholds", [(1, 2), (1, 2, 1024), (1.5, 2, 3)])
def test_thresholds_that_cannot_be_are_refused(thresholds):
    refused(TactileReader, "/dev/null", thresholds=thresholds, match="from 0 to 1023")


# --- faults ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("fault", "counted"), [
    ("garble 1", {"garbled": 1, "missing": 0}),
    ("garble 18", {"garbled": 1, "missing": 0}),
    ("drop 1", {"garbled": 1, "missing": 0}),
    ("drop 18", {"garbled": 0, "missing": 1}),
    ("lose 1", {"garbled": 1, "missing": 0}),
    ("lose 5", {"garbled": 0, "missing": 1}),
])  # fmt: skip
def test_a_damaged_answer_is_counted_and_the_next_one_is_right(mega, reader, fault, counted):
    mega.touch(6)
    reader.deadline = 0.05
    mega.tell(fault)

    damaged = reader.read()
    reader.deadline = PATIENT
    following = reader.read()

    assert damaged.bits is None
    assert damaged.problem
    assert (following.bits, following.problem) == (6, "")
    summary = reader.statistics.summary()
    assert {name: summary[name] for name in counted} == counted
    assert summary["asked"] == summary["answered"] + 1


def test_a_stray_byte_harms_nothing(mega, reader):
    mega.touch(2)
    mega.tell("stray 250")

    assert reader.read().bits == 2
    assert reader.statistics.stray_bytes == 1


def test_a_late_answer_is_not_taken_for_the_next_one(mega, reader):
    mega.touch(1)
    reader.deadline = 0.02
    mega.tell("delay 1000")
    first = reader.read()
    mega.tell("delay 0")
    mega.touch(4)
    reader.deadline = PATIENT
    second, third = reader.read(), reader.read()
    await_true(lambda: reader.statistics.late or reader._serial.in_waiting)
    fourth = reader.read()

    assert (first.bits, first.problem) == (None, "no answer within 20 ms")
    assert [second.bits, third.bits, fourth.bits] == [4, 4, 4]
    assert (reader.statistics.missing, reader.statistics.late) == (1, 1)


def test_a_pulled_plug_is_a_problem_with_a_reason_and_can_be_plugged_in_again(mega, reader):
    mega.tell("unplug")
    gone = [reader.read(), reader.read()]
    in_vain = reader.reconnect()

    mega.tell("plug")
    mega.touch(3)

    assert all(reading.bits is None for reading in gone)
    assert all("was disconnected" in reading.problem for reading in gone)
    assert not in_vain
    assert reader.reconnect()
    assert reader.read().bits == 3


# --- protocol 1 -----------------------------------------------------------------------------------


def test_an_old_board_is_recognised():
    with old_board() as port, TactileReader(port, deadline=PATIENT) as reader:
        reading = reader.read()

        assert (reader.protocol, reading.bits, reading.device_time) == (1, 5, None)
        refused(reader.set_thresholds, (1, 2, 3), match="upload firmware/tactile")


def test_an_old_board_that_answers_late_does_not_shift_the_readings():
    answers = iter(range(7))
    late, missed = [], threading.Event()

    def answer(heard: bytes) -> bytes:
        if len(heard) > 1 or not late:
            return bytes(len(heard))
        number = next(answers)
        if number == 1:
            missed.wait(60.0)
        return bytes([number])

    with stranger(answer) as port, TactileReader(port, deadline=PATIENT) as reader:
        late.append(True)
        first = reader.read().bits
        reader.deadline = 0.02
        missing = reader.read()
        missed.set()
        await_true(lambda: reader._serial.in_waiting)
        reader.deadline = PATIENT
        following = [reader.read().bits for _ in range(3)]

    assert (first, missing.bits) == (0, None)
    assert following == [2, 3, 4]
    assert (reader.statistics.missing, reader.statistics.late) == (1, 1)


def test_an_old_board_that_says_too_much_is_noticed():
    wild = []

    def answer(heard: bytes) -> bytes:
        return bytes([1]) * len(heard) + bytes([2]) * len(wild)

    with stranger(answer) as port, TactileReader(port, deadline=PATIENT) as reader:
        wild.append(1)
        reader.read()
        time.sleep(0.01)
        problem = reader.read().problem

    assert "extra byte" in problem or reader.statistics.stray_bytes


# --- the wrong port -------------------------------------------------------------------------------


@pytest.mark.parametrize(("says", "found"), [
    pytest.param(lambda heard: heard, "echo of every byte", id="echo"),
    pytest.param(
        lambda heard: b"\r\nGrbl 1.1h ['$' for help]\r\n", "a motion controller", id="grbl"
    ),
    pytest.param(lambda heard: b"login: ", '"login:"', id="console"),
    pytest.param(lambda heard: b"\x80\x91\xf0" * 4, "80 91 f0", id="garbage"),
    pytest.param(lambda heard: bytes(len(heard) + 1), "00 00 00", id="one byte too many"),
    pytest.param(lambda heard: b"", "no answer", id="silence"),
])  # fmt: skip
def test_a_port_of_something_else_is_refused_with_what_it_said(says, found, monkeypatch):
    monkeypatch.setattr("fixel.testbed.tactile_protocol.PATIENCE", 0.03)
    with stranger(says) as port, pytest.raises(InvalidInput, match=found):
        TactileReader(port).connect()


def test_a_board_of_the_future_is_refused():
    def answer(heard: bytes) -> bytes:
        content = frames._IDENTITY.pack(3, 3, 900, 900, 900, 1, b"fixel-tactile")
        summed = heard[1:3] + bytes([len(content)]) + content
        return b"\xfa" + summed + frames._checksum(summed)

    with stranger(answer) as port, pytest.raises(InvalidInput, match="protocol 3"):
        TactileReader(port).connect()


@pytest.mark.parametrize(("port", "found"), [
    (None, r"ports here|no serial port"),
    ("/dev/ttyNOSUCH", "found no port"),
    ("/dev/null", "found no serial port"),
    ("/", "found no serial port"),
])  # fmt: skip
def test_what_is_no_port_is_refused(port, found):
    with pytest.raises(InvalidInput, match=found):
        TactileReader(port).connect()


def test_two_programs_cannot_have_one_port(mega, reader):
    program = (
        f"from fixel.testbed.tactile import TactileReader\nTactileReader({mega.port!r}).connect()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )

    assert "in use by" in done.stderr
    assert f"process {os.getpid()}" in done.stderr
    assert reader.read().problem == ""


# --- which fixel ----------------------------------------------------------------------------------


def test_the_byte_is_the_contact_mode_of_the_thesis():
    for bits in range(8):
        one, two, three = fixels_of(bits)
        assert 4 * one + 2 * two + three == bits
        assert contact_mode(bits) == f"{bits:03b}"


def test_another_wiring():
    assert contact_mode(0b001, ("blue", "red", "green")) == "100"
    refused(contact_mode, 1, ("blue", "blue", "green"), match="each once")
