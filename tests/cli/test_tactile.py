"""`fixel tactile`, on the firmware in an emulated Mega 2560."""

import json

import pytest
from tests.cli.shell import fixel, output, refusal

from fixel.testbed.emulators import bench as emulated_mega
from fixel.testbed.emulators.grbl import EmulatedGrbl


@pytest.fixture
def mega():
    if reason := emulated_mega.why_not():
        pytest.skip(reason)
    folder = emulated_mega.built(emulated_mega.FIRMWARE / "build")
    with emulated_mega.EmulatedMega(folder) as board:
        yield board


def test_check(capsys, mega):
    arguments = ("--port", mega.port, "--readings", 20, "--deadline", 500)
    out = output(capsys, "tactile", "check", *arguments)
    assert "protocol 2, with time stamps" in out
    assert "answered     20" in out
    assert f"Next: fixel tactile watch --port {mega.port}" in out


def test_check_fails_where_answers_are_missing(capsys, mega):
    code, out, _ = fixel(
        capsys, "tactile", "check", "--port", mega.port, "--deadline", 0.1, "--json"
    )
    answer = json.loads(out)
    assert (code, answer["passed"]) == (1, False)
    assert answer["missing"] + answer["garbled"] > 0
    assert answer["asked"] == 300


def test_check_says_that_the_plug_was_pulled(capsys, mega, monkeypatch):
    from fixel.testbed.tactile import TactileReader

    read = TactileReader.read

    def pulled(reader):
        if reader.statistics.asked == 5:
            mega.tell("unplug")
        return read(reader)

    monkeypatch.setattr(TactileReader, "read", pulled)
    code, out, _ = fixel(capsys, "tactile", "check", "--port", mega.port, "--deadline", 500)

    assert code == 1
    assert "protocol 2, with time stamps" in out
    assert "stopped " in out
    assert "was disconnected" in out


def test_watch(capsys, mega):
    mega.touch(4)
    out = output(capsys, "tactile", "watch", "--port", mega.port, "--duration", 0.05)
    assert out.startswith("green TOUCHED, red free   , blue free")
    assert "4.90 0.40 0.40 V" in out


def test_watch_as_json_with_a_threshold(capsys, mega):
    mega.touch(0)
    arguments = ("--port", mega.port, "--duration", 0.05, "--threshold", 50, "--json")
    out = output(capsys, "tactile", "watch", *arguments)
    bits = [json.loads(line)["bits"] for line in out.splitlines()]
    assert set(bits) <= {7, None}
    assert 7 in bits


def test_the_port_of_a_controller_is_refused_and_left_in_order(capsys):
    with EmulatedGrbl() as controller:
        err = refusal(capsys, "tactile", "check", "--port", controller.port)
        output(capsys, "actuator", "where", "--port", controller.port)
    assert "motion controller" in err


def test_a_limit_has_the_unit_of_its_option(capsys):
    err = refusal(capsys, "tactile", "check", "--deadline", 0.05)
    assert "--deadline is 0.05 ms, but must be at least 0.1" in err


def test_without_a_port(capsys):
    assert "the port of the tactile board" in refusal(capsys, "tactile", "check")
