"""`fixel overlay`: placing parts, from the shell."""

import _thread
import itertools
import json
import threading
import time
import urllib.request

import pytest
from tests.cli.shell import fixel, json_of, output, refusal
from tests.vision.plate import plate_picture, small_rig

from fixel.formats.rig_file import save_rig
from fixel.formats.video_file import VideoWriter
from fixel.testbed import open_source
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.vision.frame import Frame

RIG = small_rig()
SCENE = """
fixel: 1
duration: 11.0
bodies:
  - name: object
    shape: {polygon: [[-0.054, -0.054], [0.054, -0.054], [0.054, 0.054], [-0.054, 0.054]]}
    mass: 0.15
    pose: [0.11, -0.01, 0.35]
    support: {tripod: {radius: 0.040, friction: 0.25, angle: 1.5}}
pushers:
  - name: actuator
    shape: {disk: 0.0145}
    pose: [0.0, 0.0, 0.0]
    drive: {direction: [1, 0], speed: 0.0135}
    friction: 0.25
"""


def picture(x):
    return plate_picture(RIG, {"object": (x, -0.01, 0.35), "actuator": (0.0, 0.0, 0.0)})


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a scene, its rig, and films of the part in place and 6 mm off."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "scene.yaml").write_text(SCENE)
    save_rig(RIG, folder / "rig.yaml")
    for name, x in (("placed", 0.11), ("off", 0.116)):
        with VideoWriter(folder / f"{name}.mp4", (640, 360)) as film:
            for k in range(3):
                film.write(Frame(k / 30.0, picture(x)))
    return folder


class Endless(FrameSource):
    """A camera over a part that lies in its place."""

    name = "endless"

    def __init__(self):
        self.closed = threading.Event()

    def open(self):
        return Stream((640, 360), 100.0, jpeg=False, live=True)

    def frames(self):
        for k in itertools.count():
            if self.closed.wait(0.01):
                return
            yield CameraPicture(0.01 * k, pixels=picture(0.11))

    def close(self):
        self.closed.set()


def asked(bench, film, *more):
    return "overlay", bench / "scene.yaml", "--rig", bench / "rig.yaml", "--camera", film, *more


def once(bench, film, *more):
    return *asked(bench, bench / film, "--once", "--output", bench / f"{film}.png"), *more


def test_in_place(bench, capsys):
    out = output(capsys, *once(bench, "placed.mp4"))
    assert out.startswith("In place")
    assert "tolerance: 1 mm, 1 deg" in out
    setting = f"--camera {bench}/placed.mp4 --rig {bench}/rig.yaml --scene {bench}/scene.yaml"
    assert f"Next: fixel record {setting} --out recording" in out
    assert (bench / "placed.mp4.png").read_bytes()[:4] == b"\x89PNG"


def test_off(bench, capsys):
    code, out, _ = fixel(capsys, *once(bench, "off.mp4"))
    assert code == 4
    assert out.startswith("object: push 6.")
    assert " +5.9" in out or " +6.0" in out


def test_tolerances_are_those_asked_for(bench, capsys):
    answer = json_of(capsys, *once(bench, "off.mp4", "--tolerance-mm", "7"))
    assert answer["placed"]
    assert answer["tolerance_mm"] == 7.0
    assert answer["parts"][0]["dx_mm"] == pytest.approx(6.0, abs=0.1)
    assert answer["files"] == {"picture": str(bench / "off.mp4.png")}


def test_poses_from_the_object_as_it_is_seen(bench, capsys):
    """Anchored at the object, which is 6 mm off, the actuator is off by as much."""
    code, out, _ = fixel(capsys, *once(bench, "off.mp4", "--anchor", "object", "--json"))
    part, actuator = json.loads(out)["parts"]
    assert code == 4
    assert part["within"]
    assert actuator["dx_mm"] == pytest.approx(-6.0, abs=0.1)
    err = refusal(capsys, *once(bench, "off.mp4", "--anchor", "head"))
    assert "anchor is 'head', but must be one of object, actuator" in err


def test_the_page_until_the_film_ends(bench, capsys):
    code, out, err = fixel(capsys, *asked(bench, bench / "off.mp4"))
    assert code == 0
    assert out.startswith("object: push 6.")
    assert "Open http://127.0.0.1:" in err
    assert "the file has ended" in err


def test_ctrl_c_ends_the_page(bench, capsys, monkeypatch):
    source = Endless()
    monkeypatch.setattr(open_source, "source_of", lambda *_, **__: source)
    seen = {}

    def visit():
        until = time.monotonic() + 60.0
        while not (link := capsys.readouterr().err.partition("Open ")[2].split("\n")[0]):
            wait(until)
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        page = opener.open(link, timeout=60)
        seen["page"] = page.read()
        while not (status := json.load(opener.open(f"{page.url}/status", timeout=60))):
            wait(until)
        seen["status"] = status

    def wait(until):
        assert time.monotonic() < until, "no page, or nothing on it"
        assert not source.closed.wait(0.02), "the program has ended already"

    def visit_and_leave():
        try:
            visit()
        finally:  # or the page would stay for ever
            if not source.closed.is_set():
                _thread.interrupt_main()

    visitor = threading.Thread(target=visit_and_leave)
    visitor.start()
    code, out, _ = fixel(capsys, *asked(bench, "0"))
    visitor.join()
    assert code == 0
    assert out.startswith("In place")
    assert b"scene.yaml on small" in seen["page"]
    assert seen["status"]["state"] == "placed"
    assert source.closed.is_set()


@pytest.mark.parametrize(("arguments", "words"), [
    (["--rig", "nowhere"], "a rig file, or one of thesis-tags"),
    (["--rig", "thesis-tags"], "neither scene nor experiment"),
    (["scene.yaml", "--rig", "microscope"], "found part, probe"),
    (["scene.yaml", "--rig", "rig.yaml", "--tolerance-mm", "0"],
     "--tolerance-mm is 0 mm, but must be more than 0"),
    (["scene.yaml", "--rig", "rig.yaml", "--camera", "none.mp4"], "none.mp4"),
    (["scene.yaml", "--rig", "rig.yaml", "--once", "--output", "a.txt"], ".png"),
    (["scene.yaml", "--rig", "thesis-tags", "--camera", "off.mp4", "--once"],
     "calibrate the lens at this size"),
])  # fmt: skip
def test_refusals(bench, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(bench)
    assert words in refusal(capsys, "overlay", *arguments)


def test_the_place_of_a_stored_experiment(bench, capsys, tmp_path):
    project = tmp_path / "lab"
    output(capsys, "new", project)
    err = refusal(
        capsys, "overlay", "--rig", bench / "rig.yaml", "--experiment", "nothing/1",
        "--project", project, "--once", "--output", tmp_path / "a.png",
    )  # fmt: skip
    assert "nothing/1" in err
    err = refusal(capsys, *asked(bench, "0"), "--experiment", "nothing/1")
    assert "both a scene and an experiment" in err


def test_a_camera_that_fails_says_so(bench, capsys, monkeypatch):
    class Failing(Endless):
        def frames(self):
            yield CameraPicture(0.0, pixels=picture(0.11))
            raise OSError("the plug was pulled")

    monkeypatch.setattr(open_source, "source_of", lambda *_, **__: Failing())
    code, out, err = fixel(capsys, *asked(bench, "0"))
    assert code == 0
    assert "the plug was pulled" in err
    assert out.startswith("In place")
