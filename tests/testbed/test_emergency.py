"""The drive stops when the program that drives it cannot do that any more.

The program is another process, its drive an emulated controller in this one, and what counts is
when the controller came to rest.
"""

import json
import os
import pty
import signal
import subprocess
import sys
import time
import tty
from contextlib import contextmanager, nullcontext

import pytest
from tests.jobs.helpers import await_true
from tests.processes import line_of

from fixel.errors import DeviceFailed
from fixel.testbed import emergency
from fixel.testbed.emergency import stop_actuators
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.motion_grbl import GrblActuator

pytestmark = pytest.mark.system

PROGRAM = """
import sys, time
from fixel.testbed.motion_grbl import GrblActuator
drive = GrblActuator(sys.argv[1], dead_man=1.2, keys=True)
drive.connect()
drive.move(by=0.1, speed=0.02, wait=False)
time.sleep(0.1)
print(drive._guard.pid, flush=True)
{then}
"""
BUSY = "sum(range(10**10))"  # minutes during which no other Python code runs
BLOCKED = "import os; os.read(os.pipe()[0], 1)"
WAITING = "drive.wait()"
AT_ONCE = 0.5  # [s] on a computer with other things to do
DEAD_MAN = 1.2


@pytest.fixture(autouse=True)
def own_announcements(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))


@contextmanager
def program(then: str):
    """A program that moves the drive of a controller; yields both, and the guard's process id."""
    with EmulatedGrbl(acceleration=2000.0) as controller:
        command = [sys.executable, "-c", PROGRAM.format(then=then), controller.port]
        running = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        try:
            guard = int(line_of(running))
            time.sleep(0.02)  # it is deep in it now
            assert controller.speed > 0.0
            yield controller, running, guard
        finally:
            running.kill()
            running.wait()
            running.stdout.close()


def time_to_rest(controller: EmulatedGrbl, since: float, patience: float = 3.0) -> float:
    while controller.speed > 0.0 and time.monotonic() < since + patience:
        time.sleep(0.0005)
    took = time.monotonic() - since
    time.sleep(0.05)
    assert controller.speed == 0.0, "it did not stop, or went on again"
    return took


@pytest.mark.parametrize(("then", "sent", "within"), [
    (BUSY, {"program": signal.SIGINT}, AT_ONCE),
    (BLOCKED, {"program": signal.SIGINT}, AT_ONCE),
    (WAITING, {"program": signal.SIGINT}, AT_ONCE),
    (BUSY, {"program": signal.SIGKILL}, AT_ONCE),
    (BUSY, {"guard": signal.SIGKILL, "program": signal.SIGKILL}, DEAD_MAN + AT_ONCE),
    (WAITING, {"program": signal.SIGSTOP}, DEAD_MAN + AT_ONCE),
], ids=["busy", "blocked", "waiting", "killed", "killed with its guard", "hung"])  # fmt: skip
def test_a_signal_leaves_no_moving_drive_whatever_the_program_does(then, sent, within):
    with program(then) as (controller, running, guard):
        since = time.monotonic()
        for name, number in sent.items():
            os.kill({"program": running.pid, "guard": guard}[name], number)

        assert time_to_rest(controller, since) < within


def test_another_process_stops_the_drive_of_a_busy_program():
    with program(BUSY) as (controller, running, _):
        (found,) = emergency.running()
        since = time.monotonic()
        emergency.stop_drive(found.port)

        assert time_to_rest(controller, since) < AT_ONCE
        assert found.pid == running.pid
        assert os.path.samefile(found.port, controller.port)


def test_any_key_stops_the_drive_of_a_busy_program():
    with EmulatedGrbl(acceleration=2000.0) as controller:
        child, terminal = pty.fork()
        if child == 0:
            command = [sys.executable, "-c", PROGRAM.format(then=BUSY), controller.port]
            os.execv(sys.executable, command)
        try:
            until = time.monotonic() + 60.0
            while controller.place < 43.0 and time.monotonic() < until:
                time.sleep(0.002)
            since = time.monotonic()
            os.write(terminal, b" ")

            assert time_to_rest(controller, since) < AT_ONCE
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os.close(terminal)


def test_nothing_runs_where_nothing_was_announced(tmp_path):
    assert emergency.running() == []
    folder = emergency.announcements()[-1]
    folder.mkdir(parents=True)
    (folder / "dead.json").write_text(json.dumps({"port": "x", "pid": 2**22 + 1, "guard": 0}))
    (folder / "damaged.json").write_text("{")

    assert emergency.running() == []
    assert not (folder / "dead.json").exists()


def test_one_port_that_is_gone_does_not_save_the_others_and_is_reported(tmp_path):
    with EmulatedGrbl() as controller:
        folder = emergency.announcements()[0]
        folder.mkdir()
        for name, port in (("a", "/dev/ttyGONE"), ("b", controller.port)):
            entry = {"port": port, "pid": os.getpid(), "guard": 0}
            (folder / f"{name}.json").write_text(json.dumps(entry))

        with pytest.raises(DeviceFailed, match=f"ttyGONE.*stopped: {controller.port}"):
            stop_actuators(None)
        await_true(lambda: "reset" in [event.what for event in controller.events])


def guard_of(source: str, tmp_path, monkeypatch) -> None:
    """Another program in place of the guard."""
    script = tmp_path / "guard.py"
    script.write_text(source)
    monkeypatch.setattr(emergency, "GUARD", script)


def test_a_guard_that_does_not_start_is_reported(tmp_path, monkeypatch):
    guard_of("import time; time.sleep(60.0)", tmp_path, monkeypatch)
    monkeypatch.setattr(emergency, "START_TIME", 0.2)
    with EmulatedGrbl() as controller:
        since = time.monotonic()
        with pytest.raises(DeviceFailed, match="did not start"):
            GrblActuator(controller.port).connect()

        assert time.monotonic() - since < 10.0
        assert emergency.running() == []


def test_a_guard_that_hangs_is_let_go_of(tmp_path, monkeypatch):
    guard_of("import time; print('ready', flush=True); time.sleep(60.0)", tmp_path, monkeypatch)
    monkeypatch.setattr(emergency, "END_TIME", 0.2)
    with EmulatedGrbl() as controller:
        drive = GrblActuator(controller.port).connect()
        guard = drive._guard._process
        drive.disconnect()

        assert guard.returncode == -signal.SIGKILL


def test_a_port_that_cannot_be_stopped_is_reported():
    with pytest.raises(DeviceFailed, match="switch off the power of the drive"):
        stop_actuators("/dev/ttyGONE")


def test_what_is_no_port_is_not_written_to(tmp_path):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(DeviceFailed, match="not a serial port"):
        stop_actuators(str(tmp_path / "notes"))
    assert (tmp_path / "notes").read_text() == "mine"


def test_a_session_folder_that_cannot_be_had_keeps_no_drive_from_being_found(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    with EmulatedGrbl() as controller, GrblActuator(controller.port):
        (found,) = emergency.running()
        assert found.port == controller.port


@pytest.mark.parametrize("how", ["of another user", "a link"])
def test_a_folder_that_another_user_created_is_not_used(how, tmp_path, monkeypatch):
    """Through a link in it, a program would overwrite a file; its entries may be anything."""
    foreign = emergency.announcements()[0]
    place = tmp_path / "foreign" if how == "a link" else foreign
    place.mkdir(mode=0o777)
    if how == "a link":
        foreign.symlink_to(place)
    else:
        other = os.getuid() + 1
        monkeypatch.setattr(os, "getuid", lambda: other)
        foreign.rename(place := emergency.announcements()[0])
    (place / "a.json").write_text(json.dumps({"port": "/dev/x", "pid": os.getpid(), "guard": 0}))
    assert emergency.running() == []
    refused = nullcontext() if how == "a link" else pytest.raises(DeviceFailed)
    with EmulatedGrbl() as controller, refused:
        GrblActuator(controller.port).connect().disconnect()
    assert [path.name for path in place.iterdir()] == ["a.json"]


def test_a_drive_that_cannot_be_registered_is_not_driven(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "file"))
    with EmulatedGrbl() as controller:
        with pytest.raises(DeviceFailed, match="cannot register this program"):
            GrblActuator(controller.port).connect()
        assert signal.set_wakeup_fd(-1) == -1
        GrblActuator(controller.port, guard=False).connect().disconnect()


# --- the guard alone ------------------------------------------------------------------------------


@pytest.fixture
def guarded():
    """A guard, the far end of the port it writes to, and that of the terminal it listens to."""
    (port, ours), (keys, typing) = pty.openpty(), pty.openpty()
    tty.setraw(ours)
    command = [sys.executable, "-I", "-S", emergency.GUARD, str(ours), str(typing)]
    guard = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=(ours, typing)
    )
    assert guard.stdout.readline() == b"ready\n"
    os.close(typing)
    os.set_blocking(port, False)
    try:
        yield guard, port, keys
    finally:
        guard.kill()
        guard.communicate()
        os.close(port)
        os.close(ours)


def test_a_stop_is_not_forgotten_over_a_release(guarded):
    guard, port, _ = guarded
    guard.stdin.write(bytes([signal.SIGINT]) + b"q")
    guard.stdin.flush()

    assert guard.wait(60.0) == 0
    assert os.read(port, 9) == emergency.STOP


def test_a_terminal_that_is_closed_stops_the_drive_once(guarded):
    guard, port, keys = guarded
    os.close(keys)

    assert guard.stdout.readline().startswith(b"stopped")
    assert os.read(port, 9) == emergency.STOP
    time.sleep(0.1)
    with pytest.raises(BlockingIOError):
        os.read(port, 9)
    assert guard.poll() is None
