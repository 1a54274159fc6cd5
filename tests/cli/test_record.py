"""`fixel record`, `record check`, `record repair` and `testbed serve` as a shell runs them."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request

import pytest
from tests.cli.shell import fixel, json_of, output, refusal
from tests.processes import line_of
from tests.testbed.films import SIZE, film

from fixel.cli.record import duration, status_line
from fixel.formats.recording import open_recording
from fixel.formats.recording_files import ROWS, VIDEO
from fixel.formats.rig_file import rig_of, save_rig
from fixel.testbed.file_source import LoopbackCamera
from fixel.testbed.recorder import RecordingStatus

FIXEL = [sys.executable, "-c", "from fixel.cli.main import run; run()"]


def test_a_film_is_recorded(capsys, tmp_path):
    played, out = film(tmp_path / "film"), tmp_path / "push 1"
    said = output(capsys, "record", "--camera", played, "--fast", "--tactile", "film", "--out", out)
    assert "30 frames in 0.290 s, 100.00 frames/s, 0 lost" in said
    assert "ended: the file has ended" in said
    # Without a rig and a scene, `fixel track` would be refused.
    command = f"Next: fixel track '{out}' --rig RIG --scene SCENE"
    after = f"{command}, with your own files for RIG and SCENE"
    assert said.splitlines()[-1] == after
    said = output(capsys, "record", "check", out)
    assert "30 readings, 160 x 120 pixels, as-it-comes\nevery frame matches its row" in said
    assert said.splitlines()[-1] == after
    save_rig(rig_of("thesis-tags"), out / "rig.yaml")
    said = output(capsys, "record", "check", out)
    after = f"Next: fixel track '{out}' --scene SCENE, with your own files for SCENE"
    assert said.splitlines()[-1] == after
    (out / "scene.yaml").write_text("fixel_scene: 1\n")
    said = output(capsys, "record", "check", out)
    assert said.splitlines()[-1] == f"Next: fixel track '{out}'"


@pytest.mark.parametrize("rig", [None, "thesis-tags"])
def test_it_ends_when_the_fixels_say_so(capsys, tmp_path, monkeypatch, rig):
    played = film(tmp_path / "film", n=200, bits=lambda k: 0b100 if k >= 20 else 0)
    out = tmp_path / "r"
    monkeypatch.setattr("fixel.workflows.acquisition.record.check_size", lambda *_: None)
    answer = json_of(
        capsys, "record", "--camera", played, "--fast", "--tactile", "film", "--out", out,
        "--until", "seated", "--mode", "100", *(["--rig", rig] if rig else []),
    )  # fmt: skip
    assert (answer["frames"], answer["without_reading"]) == (71, 0)
    assert answer["reason"] == "seated: contact mode 100 for 0.5 s"
    assert (out / "rig.yaml").exists() == (rig is not None)
    kept = open_recording(out)
    assert kept.header.rig == (rig or "")
    assert kept.reading_time.tolist() == kept.time.tolist()


def test_what_broke_off_is_checked_and_repaired(capsys, tmp_path):
    folder = film(tmp_path / "r")
    (folder / "end.json").unlink()
    video = folder / VIDEO
    video.write_bytes(video.read_bytes()[:-99])
    said = output(capsys, "record", "check", folder)
    assert "problem: interrupted at t = 0.280 s: no end mark" in said
    assert f"Next: fixel record repair {folder}" in said
    answer = json_of(capsys, "record", "repair", folder)
    assert (answer["complete"], answer["frames"]) == (True, 29)
    assert "interrupted at t = 0.280 s" in answer["reason"]
    rows = (folder / ROWS).read_bytes()
    (folder / ROWS).write_bytes(rows[:100] + b"0" + rows[101:])
    assert "damaged row" in refusal(capsys, "record", "check", folder)


@pytest.mark.parametrize("verb", ["check", "repair"])
def test_a_folder_without_a_recording_is_named(capsys, tmp_path, verb):
    needs = "but fixel needs a folder written by `fixel record`"
    (tmp_path / "empty").mkdir()
    for name, found in (("nowhere", "no such folder"), ("empty", "no recording.json")):
        folder = tmp_path / name
        assert f"fixel: {folder}: found {found}, {needs}\n" == refusal(
            capsys, "record", verb, folder
        )


@pytest.mark.parametrize(("arguments", "complaint"), [
    ([], "--camera"),
    (["--camera", "FILM"], "--out is missing"),
    (["--camera", "FILM", "--out", "OUT", "--rate", "0.5"], "--rate is 0.5, but must be at least"),
    (["--camera", "FILM", "--out", "OUT", "--size", "640x480"], "found pictures of 160 x 120"),
    (["--camera", "FILM", "--out", "OUT", "--size", "big"], "must be WIDTHxHEIGHT"),
    (["--camera", "FILM", "--out", "OUT", "--rig", "thesis-tags"], "fixel needs 1280 x 720"),
    (["--camera", "FILM", "--out", "OUT", "--rig", "nowhere"], "rig: found no file"),
    (["--camera", "FILM", "--out", "FILM"], "found a recording, but fixel needs a new folder"),
    (["--camera", "FILM", "--out", "OUT/.."], "found an existing file or folder"),
    (["--camera", "FILM", "--out", "OUT", "--codec", "h264"], "as-it-comes, near, exact"),
    (["--camera", "EXACT", "--out", "OUT", "--codec", "as-it-comes"], "does not send JPEG"),
    (["--camera", "FILM", "--out", "OUT", "--until", "limit"], "a duration such as 15s"),
    (["--camera", "FILM", "--out", "OUT", "--limit", "soon"], "must be a duration"),
    (["--camera", "FILM", "--out", "OUT", "--limit", "0s"], "more than 0 s"),
    (["--camera", "FILM", "--out", "OUT", "--mode", "010"], "--until seated"),
    (["--camera", "FILM", "--out", "OUT", "--mode", "01", "--until", "seated", "--tactile",
      "film"], "each of 3 fixels"),
    (["--camera", "/dev/video77", "--out", "OUT"], "no such device"),
    (["--camera", "no.mp4", "--out", "OUT"], "no such file"),
    (["--camera", "FILM", "--out", "OUT", "--tactile", "/dev/nothing"],
     "--tactile /dev/nothing: found no port"),
])  # fmt: skip
def test_what_cannot_be_recorded_is_refused(capsys, tmp_path, arguments, complaint):
    (tmp_path / "out").mkdir()
    out = tmp_path / "out" / "r"
    names = {"FILM": tmp_path / "film", "OUT": out, "OUT/..": tmp_path / "out"}
    film(tmp_path / "film", n=3)
    if "EXACT" in arguments:
        names["EXACT"] = film(tmp_path / "exact", n=3, codec="exact")
    code, said, complaints = fixel(capsys, "record", *[filled(a, names) for a in arguments])
    assert code == 2
    assert complaint in complaints + said
    assert not out.exists()


def filled(argument, names):
    """An argument, or the `--name=VALUE` of one, with the path that it stands for."""
    name, sign, value = argument.rpartition("=")
    return f"{name}{sign}{names.get(value, value)}"


def ended_by(tmp_path, end):
    """Record on a terminal until something is done to the process; the reason it gives."""
    played, out = film(tmp_path / "film", n=600, rate=20.0), tmp_path / "r"
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*FIXEL, "record", "--camera", played, "--tactile", "film", "--out", out, "--json"],
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    until = time.monotonic() + 60.0
    while not ((out / ROWS).exists() and (out / ROWS).read_bytes().count(b"\n") > 5):
        if process.poll() is not None or time.monotonic() > until:
            process.kill()
            pytest.fail(f"it does not record: {process.communicate()}")
        time.sleep(0.01)
    end(process, ours)
    said, complaints = process.communicate(timeout=60.0)
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 0, complaints
    kept = open_recording(out)
    assert kept.complete
    assert kept.n_frames < 600
    answer = json.loads(said)
    assert answer["frames"] == kept.n_frames
    return str(answer["reason"])


@pytest.mark.system
@pytest.mark.parametrize(("end", "reason"), [
    (lambda p, tty: os.write(tty, b"\n"), "stopped with Enter"),
    (lambda p, tty: p.send_signal(signal.SIGINT), "stopped with Ctrl-C"),
    (lambda p, tty: p.terminate(), "stopped by a signal"),
])  # fmt: skip
def test_whatever_stops_it_ends_it_well(tmp_path, end, reason):
    assert ended_by(tmp_path, end) == reason


@pytest.mark.system
def test_a_served_film_is_a_camera(tmp_path, capsys):
    played, out = film(tmp_path / "film"), tmp_path / "r"
    server = subprocess.Popen(
        [*FIXEL, "testbed", "serve", played, "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        served = json.loads(line_of(server))
        assert served["size_px"] == list(SIZE)
        code, said, _ = fixel(capsys, "record", "--camera", served["url"], "--out", out)
    finally:
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=60.0)
    assert code == 1  # the end was not requested
    assert "30 frames" in said
    assert "ended early: the camera ended the stream" in said


def test_the_preview_shows_and_ends_it(tmp_path, capsys, monkeypatch):
    from fixel.web.security import WORD_HEADER
    from fixel.web.serve import WebServer

    pages = []
    start = WebServer.start

    def started(self):
        start(self)
        threading.Thread(target=press_stop, args=(self.link, self.gate.word)).start()
        return self

    def press_stop(link, word):
        visit = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        with visit.open(link) as answer:
            pages.append(answer.read().decode())
            stop = f"{answer.url}/stop"
        request = urllib.request.Request(stop, b"", {WORD_HEADER: word}, method="POST")
        visit.open(request).close()

    monkeypatch.setattr(WebServer, "start", started)
    played = film(tmp_path / "film", n=600, rate=20.0)
    code, said, complaints = fixel(
        capsys, "record", "--camera", played, "--out", tmp_path / "r", "--preview"
    )
    assert code == 0
    assert "ended: stopped in the browser" in said
    assert re.search(r"preview: http://127\.0\.0\.1:\d+/\?token=", complaints)
    assert "Recording" in pages[0]


def test_the_status_line():
    shown = status_line(RecordingStatus(12.34, 370, 2, 30.0, 0b010, 61_000_000_000, ()))
    assert shown == "   12.3 s  370 frames  2 lost  30.0 frames/s  fixels 010  61.0 GB free"


def test_durations():
    assert [duration(text) for text in ("15s", "15", "10min", "1.5 h")] == [15, 15, 600, 5400]


def test_a_recording_that_ends_early_says_so_in_its_exit_code(capsys, tmp_path):
    """A network camera that goes away after 30 frames; then a limit that is reached."""
    with LoopbackCamera(film(tmp_path / "film")) as camera:
        code, said, _ = fixel(
            capsys, "record", "--camera", camera.url, "--out", tmp_path / "a", "--limit", "20s",
            "--json",
        )  # fmt: skip
        answer = json.loads(said)
        assert (code, answer["early"], answer["frames"]) == (1, True, 30)
        said = output(
            capsys, "record", "--camera", camera.url, "--out", tmp_path / "b", "--limit", "0.1s"
        )
        assert "ended: the limit of 0.1 s" in said
