"""A film recorded off an emulated bench is the film again, with the fixels read over a wire."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.formats.recording import open_recording
from fixel.formats.scene_file import load_scene
from fixel.model import Scene
from fixel.testbed.emulators import bench as emulated_mega
from fixel.workflows.acquisition import film_experiments
from fixel.workflows.acquisition.track import track_film
from fixel.workflows.demo.camera_demo import record_film

pytestmark = pytest.mark.system

EXAMPLE = Path(__file__).parents[3] / "examples/scenes/peg_slip.yaml"
FRAMES = 45


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film") / "slip"
    film_experiments([str(EXAMPLE)], out=folder, looks="clean", lead=0.2, frames=FRAMES)
    return folder


def short(filmed: Path) -> Scene:
    """A scene whose drive does not go on for long after the film."""
    return replace(load_scene(filmed / "scene.yaml").scene, duration=1.0)


def test_pictures_are_the_same_and_fixels_say_the_same(filmed: Path, tmp_path: Path) -> None:
    missing = emulated_mega.why_not()
    firmware = None if missing else emulated_mega.built(tmp_path / "firmware")
    scene = short(filmed)
    recorded, position = record_film(filmed, tmp_path / "run", scene, 0.2, firmware)
    made, seen = open_recording(filmed), open_recording(tmp_path / "run")
    assert recorded.frames == FRAMES
    assert recorded.lost == 0
    assert [jpeg for _, jpeg in made.jpegs()] == [jpeg for _, jpeg in seen.jpegs()]
    drive = scene.pushers[0].drive
    assert position == pytest.approx(min(drive.travel, drive.speed * scene.duration), abs=1e-4)
    read = seen.readings >= 0
    # A machine that is busy reads a few frames late; what is read is what the film says.
    assert read.mean() > 0.5
    assert np.mean(seen.readings[read] == made.readings[read]) > 0.8


def test_a_drive_that_does_not_move_is_reported(filmed: Path, tmp_path: Path) -> None:
    pusher = short(filmed).pushers[0]
    fast = replace(
        short(filmed), pushers=(replace(pusher, drive=replace(pusher.drive, speed=1.0)),)
    )
    with pytest.raises(InvalidInput, match="the controller's limit"):
        record_film(filmed, tmp_path / "run", fast, 0.2, None)
    assert open_recording(tmp_path / "run").complete


def test_what_no_camera_has_seen_stays_so(filmed: Path, tmp_path: Path) -> None:
    scene = short(filmed)
    record_film(filmed, tmp_path / "run", scene, 0.2, None)
    answer = track_film(tmp_path / "run")
    assert not answer.experiment.real
    assert "film of" in answer.experiment.simulated_by
