"""Faults of a bench and of requests are named before anything moves."""

import re
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from tests.fixtures import short_plan
from tests.jobs.helpers import await_true as until
from tests.testbed.boards import stranger
from tests.workflows.bench.test_loop import Hand

from fixel.database.project import Project
from fixel.errors import DeviceFailed, InvalidInput
from fixel.formats.plan_file import plan_text
from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.formats.rig_file import rig_of, save_rig
from fixel.model import placed
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.emulators.laboratory import smaller
from fixel.testbed.file_source import LoopbackCamera
from fixel.testbed.motion_grbl import GrblActuator
from fixel.vision.frame import Frame
from fixel.workflows.bench.run import open_bench

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A project, a plan of one push of 0.1 m at 30 mm/s, a small rig, a film of its size."""
    folder = tmp_path_factory.mktemp("bench")
    plan = short_plan("one", repetitions=1, speed=0.03)
    (folder / "one.yaml").write_text(plan_text(plan))
    Project.create(folder / "lab")
    rig = smaller(rig_of("thesis-tags"), 0.25)
    save_rig(rig, folder / "rig.yaml")
    width, height = rig.camera.lens.image_size
    with RecordingWriter(
        folder / "film", RecordingHeader(size=(width, height), codec="near")
    ) as film:
        for k in range(30):
            film.write(Frame(k / 30.0, np.full((height, width, 3), 90, np.uint8)), 0, k / 30.0)
    return folder


@pytest.fixture(scope="module")
def camera(folder):
    with LoopbackCamera(folder / "film", loop=True) as served:
        yield served.url


@pytest.fixture
def controller():
    with EmulatedGrbl(travel=200.0, start=0.0, acceleration=2000.0) as emulated:
        yield emulated


def opened(folder, **options):
    """The bench with the small rig, or with other options."""
    options = {"rig": str(folder / "rig.yaml")} | options
    return open_bench(Project(folder / "lab"), folder / "one.yaml", **options)


def refused(folder, kind=InvalidInput, **options):
    """The error of a bench that is not opened."""
    with (
        pytest.raises(kind) as caught,
        opened(folder, **options),
    ):
        pass
    return caught.value


def test_a_whole_bench_opens_and_its_drive_stays_where_it_is(folder, camera, controller):
    with opened(folder, camera=camera, port=controller.port) as loop:
        assert len(loop.campaign.left) == 1
    assert controller.trace == []


@pytest.mark.parametrize("check", [False, True])
def test_a_controller_that_does_not_home_waits_for_its_zero(folder, camera, controller, check):
    """Nothing moves before a person confirms it, also after the controller was off and on."""
    with opened(folder, camera=camera, port=controller.port, check=check) as loop:
        loop.ask("again")  # nothing was requested yet
        hand = Hand(loop)

        def asked():
            return "by hand to its position 0" in "".join(hand.now().get("problems", ()))

        hand.thread.start()
        for _ in range(1 if check else 2):
            until(asked)
            loop.ask("push")
            assert not loop.devices.drive.zero_known
            if not check:  # else the head would move now
                loop.ask("again")
                until(lambda: loop.devices.drive.zero_known)
                until(lambda: hand.now()["phase"] == "placing")
                controller.power_cycle()
        loop.ask("end")
        hand.thread.join(60.0)
        assert not hand.thread.is_alive()
        assert not loop.campaign.attempts
    assert controller.trace == []


@pytest.mark.parametrize(("options", "where", "found"), [
    ({"rig": None}, "rig", "none"),
    ({"rig": "no-such"}, "rig", "no file 'no-such'"),
    ({"camera": "17"}, "/dev/video17", "no such device"),
    ({"fit": ("mu_nonsense",)}, "mu_nonsense", ""),
    ({"motion": "fast"}, "motion", "'fast'"),
    ({"until": "mu_pusher=wide"}, "until", "'mu_pusher=wide'"),
    ({"until": "mu_pusher=0.02", "fit": ("mu_support",)}, "until", "'mu_pusher'"),
    ({"until": "mu_pusher"}, "until", "'mu_pusher'"),
    ({"name": "../elsewhere"}, "name", "'../elsewhere'"),
    ({"emulated": True, "rig": None, "camera": "0"}, "camera", "'0'"),
])  # fmt: skip
def test_what_is_missing_or_unknown_is_named(folder, options, where, found):
    error = refused(folder, **options)
    assert where in str(error)
    assert found in str(error.found)
    assert error.expected


def test_a_part_that_the_head_would_miss_is_named(folder):
    """Values in a wrong unit leave the part far away, where the drive could still move."""
    scene = short_plan().experiments[0].scene
    scene.save(folder / "scene.yaml")
    (folder / "far.csv").write_text("name,offset_y_m\nnear,0.001\nfar,1\n")
    part = placed(scene.bodies[0].shape.outline, scene.bodies[0].pose)[:, 1].min() + 1.0
    head = placed(scene.pushers[0].shape.outline, scene.pushers[0].pose)[:, 1].max()
    own = {"emulated": True, "dry_run": True}
    with (
        pytest.raises(InvalidInput) as caught,
        open_bench(Project(folder / "lab"), folder / "far.csv", **own),
    ):
        pass
    assert caught.value.where.startswith("row far")
    assert f"a part {1e3 * (part - head):.1f} mm away" in str(caught.value)


@pytest.mark.parametrize(("options", "where"), [
    ({"rig": "thesis-tags"}, "video.mjpg"),  # whose pictures are larger
    ({"port": "/dev/ttyNone"}, "/dev/ttyNone"),
    ({"tactile": "/dev/ttyNone"}, "tactile /dev/ttyNone"),
    ({"driver": "servo"}, "driver"),
    ({"axes": "XY"}, "drive_pose"),
    ({"axes": "XY", "drive_pose": "500,0,0"}, "row 1-"),
], ids=lambda own: str(own) if isinstance(own, str) else None)  # fmt: skip
def test_a_device_that_is_missing_or_another_one_is_named(
    folder, camera, controller, options, where
):
    error = refused(folder, **{"camera": camera, "port": controller.port} | options)
    assert where in error.where
    assert error.expected
    assert controller.trace == []


@pytest.mark.parametrize(
    "limits", [{"fastest": 10.0}, {"travel": 50.0}, {"travel": 50.0, "homing": True}]
)
def test_a_row_that_the_drive_cannot_perform_is_named(folder, camera, limits):
    with EmulatedGrbl(**{"travel": 200.0, "start": 0.0, "rate": 5.0} | limits) as controller:
        if controller.state == "Alarm":
            error = refused(folder, DeviceFailed, camera=camera, port=controller.port)
            assert error.hint == "home it: fixel actuator home"
            with GrblActuator(controller.port, guard=False) as drive:
                drive.home()
        moved = len(controller.trace)
        error = refused(folder, camera=camera, port=controller.port)
        assert error.where.startswith("row 1-square")
        assert error.hint
        assert len(controller.trace) == moved


@pytest.mark.parametrize("known", [(), ("object",), ("actuator",)])
@pytest.mark.parametrize("emulated", [False, True])
def test_a_rig_without_the_part_or_the_head_of_the_plan_is_refused(
    folder, camera, controller, known, emulated
):
    """The head would move, but no attempt could be tracked."""
    rig = rig_of(str(folder / "rig.yaml"))
    parts = {name: rig.parts[name] for name in known}
    save_rig(replace(rig, parts=parts), folder / "fewer.yaml")
    devices = {"emulated": True} if emulated else {"camera": camera, "port": controller.port}
    error = refused(folder, rig=str(folder / "fewer.yaml"), **devices)
    lacking = {"object", "actuator"} - {*known}
    assert all(name in error.expected for name in lacking)
    assert "names of the scene" in error.hint
    assert controller.trace == []


def test_a_board_that_was_unplugged_is_connected_again_unless_another_device_is_there(
    folder, camera, controller, tmp_path
):
    port = tmp_path / "ttyACM0"

    @contextmanager
    def plugged_in(device):
        with device as name:
            port.symlink_to(name)
            yield
        port.unlink()

    def troubled(hand, words):
        until(lambda: words in "".join(hand.now().get("problems", ())))

    board = partial(stranger, lambda heard: bytes([5]) * len(heard))
    with ExitStack() as opening:
        with plugged_in(board()):
            devices = {"camera": camera, "tactile": str(port), "port": controller.port}
            loop = opening.enter_context(opened(folder, **devices))
            hand = Hand(loop)
            hand.thread.start()
            troubled(hand, "by hand")
            loop.ask("again")
            until(lambda: hand.now()["phase"] == "placing")
        troubled(hand, "the tactile board no longer answers")
        loop.ask("again")
        troubled(hand, f"tactile {port}: found no port")
        with plugged_in(stranger(lambda heard: heard)):
            loop.ask("again")
            troubled(hand, "echo of every byte")
        with plugged_in(board()):
            loop.ask("again")
            until(lambda: hand.now()["phase"] == "placing")
            loop.ask("end")
            hand.thread.join(60.0)  # then one thread reads the board
            until(lambda: loop.devices.tactile.read().bits == 5)  # an answer may be late


@pytest.mark.parametrize(
    ("text", "where"), [("{camra: 1}", "fixel.yaml: bench"), ("{rate: fast}", "bench.rate")]
)
def test_a_wrong_setting_of_the_project_is_named(folder, tmp_path, text, where):
    lab = Project.create(tmp_path / "lab")
    with (lab.folder / "fixel.yaml").open("a") as settings:
        settings.write(f"bench: {text}\n")
    with pytest.raises(InvalidInput) as caught:
        open_bench(Project(lab.folder), folder / "one.yaml")
    assert where in caught.value.where


def test_an_alarm_while_a_part_is_placed_is_named_and_ended_by_homing(folder, camera):
    with EmulatedGrbl(travel=200.0, start=0.0, homing=True, rate=5.0) as controller:
        with GrblActuator(controller.port, guard=False) as drive:
            drive.home()
        with opened(folder, camera=camera, port=controller.port) as loop:
            hand = Hand(loop)
            hand.thread.start()
            until(lambda: hand.now()["phase"] == "placing")
            controller.hit_switch()
            until(lambda: hand.now()["phase"] == "trouble")
            assert "in the state Alarm" in hand.now()["problems"][0]
            loop.ask("again")
            until(lambda: hand.now()["phase"] == "placing")
            assert controller.state == "Idle"
            loop.ask("end")
            hand.thread.join(60.0)
            assert not hand.thread.is_alive()
            assert not loop.campaign.attempts


def test_a_disk_on_which_no_minute_fits_is_named_before_the_push(
    folder, camera, controller, monkeypatch
):
    monkeypatch.setattr(
        "fixel.testbed.recorder.shutil.disk_usage", lambda _: SimpleNamespace(free=33 << 20)
    )
    with opened(folder, camera=camera, port=controller.port) as loop:
        check = loop._disk_check()
        assert not check.passed
        assert re.match(r"35 MB free on its disk, but needs \d+ MB, for 60 s of video", check.words)
        assert "free disk space" in check.words
