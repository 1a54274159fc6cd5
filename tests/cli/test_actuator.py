"""`fixel actuator`, on an emulated controller."""

import io
import json
import subprocess
import sys

import pytest
from tests.cli.shell import fixel, json_of, output, refusal
from tests.jobs.helpers import await_true

from fixel.testbed.emulators.grbl import EmulatedGrbl


@pytest.fixture
def controller(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))
    with EmulatedGrbl(homing=True, start=5.0, acceleration=2000.0) as emulated:
        yield emulated


def test_a_day_with_a_controller(capsys, controller):
    port = ("--port", controller.port)

    out = output(capsys, "actuator", "where", *port)
    assert "Alarm" in out
    assert "Next: fixel actuator home" in out

    assert json_of(capsys, "actuator", "home", *port)["position_m"] == pytest.approx(0.001)

    moved = json_of(capsys, "actuator", "move", *port, "--to", 6, "--speed", 40)
    assert moved["state"] == "Idle"
    assert controller.place == pytest.approx(6.0, abs=0.01)

    out = output(capsys, "actuator", "move", *port, "--by", -2, "--speed", 40)
    assert "at 4.000 mm of 0 to 150 mm, Idle" in out


def test_two_axes_move_together(capsys, controller):
    port = ("--port", controller.port, "--axes", "XY")
    fixel(capsys, "actuator", "home", *port)
    out = output(capsys, "actuator", "move", *port, "--to", "6,3", "--speed", 40)
    assert "at 6.000, 3.000 mm, Idle" in out
    assert f"Next: fixel actuator move --by 10,10 --port {controller.port} --axes XY" in out
    assert controller.places == pytest.approx((6.0, 3.0, 1.0), abs=0.01)
    moved = json_of(capsys, "actuator", "move", *port, "--by=-2,1", "--speed", 40)
    assert moved["place_m"] == pytest.approx([0.004, 0.004])


def test_a_locked_controller_is_unlocked_when_asked(capsys, controller):
    arguments = ("actuator", "move", "--port", controller.port, "--by", -2, "--speed", 40)
    code, _, err = fixel(capsys, *arguments)
    assert (code, "locked" in err) == (1, True)
    assert "at 3.000 mm" in output(capsys, *arguments, "--unlock")


def test_stop_writes_to_the_port_that_is_named(capsys, controller):
    answer = json_of(capsys, "actuator", "stop", "--port", controller.port)
    assert answer == {"stopped": [controller.port]}
    await_true(lambda: "reset" in [event.what for event in controller.events])


def test_a_stop_waits_for_neither_numerics_nor_a_database():
    code = (
        "import sys\n"
        "from fixel.cli.main import run\n"
        "sys.argv = ['fixel', 'actuator', 'stop', '--port', '/dev/none']\n"
        "try:\n"
        "    run()\n"
        "finally:\n"
        "    print({'numpy', 'sqlalchemy'} & set(sys.modules))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ended.stdout, "/dev/none" in ended.stderr) == ("set()\n", True)


@pytest.mark.parametrize("device", ["actuator", "tactile"])
def test_ports(capsys, device):
    assert isinstance(json_of(capsys, device, "ports")["ports"], list)


def test_the_simulated_drive(capsys):
    arguments = ("--driver", "simulated", "--to", 1, "--speed", 100)
    assert json_of(capsys, "actuator", "move", *arguments)["position_m"] == 0.001


def test_questions_to_the_operator_stay_out_of_the_answer(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n12\n\n\n"))
    code, out, err = fixel(capsys, "actuator", "move", "--driver", "manual", "--to", 40, "--json")
    assert (code, json.loads(out)["position_m"]) == (0, 0.04)
    assert "Position of the drive in mm: " in err


@pytest.mark.parametrize(("arguments", "says"), [
    (("stop",), "no program of yours"),
    (("where",), "the port of the actuator's controller"),
    (("where", "--driver", "robot"), "one of grbl, manual, simulated"),
    (("move", "--driver", "simulated"), "--to is missing: give a target position"),
    (("move", "--driver", "simulated", "--to", 5, "--by", 5), "--to: found by too"),
    (("move", "--driver", "simulated", "--to", 5, "--speed", -1), "--speed is -1 mm/s"),
    (("move", "--driver", "simulated", "--to", 5, "--dead-man", -1), "--dead-man is -1"),
    (("where", "--driver", "simulated", "--axes", "Q"), "--axes is 'Q'"),
    (("where", "--driver", "simulated", "--axes", "XX"), "--axes is 'XX'"),
    (("where", "--driver", "simulated", "--port", "COM5"), "--port is 'COM5'"),
    (("move", "--driver", "simulated", "--to", 500), "from 0 to 150 mm"),
    (("move", "--driver", "simulated", "--to", "5,5"), "must be a number [mm]"),
    (("move", "--driver", "simulated", "--to", "far"), "must be a number [mm]"),
    (("move", "--driver", "simulated", "--axes", "XY", "--by", "5"), "2 numbers with commas"),
    (("move", "--driver", "simulated", "--axes", "XY", "--to", "5,500"), "the travels"),
    (("where", "--driver", "manual", "--axes", "XY"), "one axis with --driver manual"),
])  # fmt: skip
def test_what_cannot_be_is_refused(capsys, controller, arguments, says):
    assert says in refusal(capsys, "actuator", *arguments)
