"""Films of scenes, plans and stored experiments, with their true motions."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused
from tests.vision.rendered import small_rig

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.plan_file import plan_text
from fixel.formats.recording import open_recording
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import SceneFile, load_scene, save_scene
from fixel.formats.video_file import open_video
from fixel.sampling import thesis_plan
from fixel.simulation import simulate
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import grasp, micro_push
from fixel.workflows.acquisition import film_experiments
from fixel.workflows.acquisition.film import ABOUT, ARRAYS, SAMPLE
from fixel.workflows.project.importing import run_testbed


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A file of a rig of small pictures."""
    path = tmp_path_factory.mktemp("rig") / "small.yaml"
    save_rig(small_rig(size=(160, 120)), path)
    return str(path)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "push.yaml"
    save_scene(SceneFile(scene=grasp()), path)
    return str(path)


def truth_of(folder) -> tuple[dict, dict]:
    with np.load(folder / ARRAYS) as arrays:
        return dict(arrays), json.loads((folder / ABOUT).read_text())


def test_a_scene_becomes_a_recording_with_its_truth_in_a_file(tmp_path, rig, scene):
    out = tmp_path / "film"
    (filmed,) = film_experiments([scene], out=out, rig=rig, looks="clean", frames=25, exact=True)
    recording = open_recording(out)
    arrays, about = truth_of(out)

    assert (filmed.name, filmed.frames, filmed.status) == ("push", 25, "converged")
    assert recording.complete
    assert recording.problems == ()
    assert recording.header.rig == rig_of(rig).name
    assert recording.time == pytest.approx(arrays["time_s"], abs=1e-6)
    assert recording.readings.tolist() == arrays["reading"].tolist()
    assert load_scene(out / "scene.yaml").scene == grasp()
    assert rig_of(out / "rig.yaml") == rig_of(rig)
    assert about["motion_s"] == [0.5, 11.5]
    # At rest for half a second, then as simulated.
    pose = arrays["pose_actuator"]
    assert pose[:15] == pytest.approx(np.tile(pose[0], (15, 1)))
    moved = simulate(grasp(), output_interval=SAMPLE)["actuator"].at(24 / 30 - 0.5)
    assert pose[24] == pytest.approx(moved, abs=1e-9)


def test_the_same_seed_makes_the_same_files(tmp_path, rig, scene):
    for name in ("a", "b"):
        film_experiments([scene], out=tmp_path / name, rig=rig, frames=3, exact=True)

    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_fixels_report_as_often_wrong_as_the_testbed_says(tmp_path, rig):
    """A plan is performed by the simulated testbed; a scene file is exact."""
    thesis = thesis_plan()
    plan = replace(thesis, shapes=thesis.shapes[:1], layouts=thesis.layouts[:1])
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(plan))
    settings = dict(rig=rig, looks="clean", rest=0.0, rate=2.5)
    (first, second) = film_experiments([str(path)], out=tmp_path / "films", **settings, limit=2)
    wrong, total = 0, 0
    for one in (first, second):
        arrays, _ = truth_of(one.folder)
        bits = np.stack([arrays["reading"] >> bit & 1 for bit in (2, 1, 0)], axis=1)  # fixel 1 to 3
        wrong += (bits != arrays["touches"]).sum()
        total += bits.size

    assert first.folder == tmp_path / "films" / plan.experiments[0].name
    assert 0.01 < wrong / total < 0.08  # 4.25 % without contact, 1.25 % with it


def test_an_exact_scene_has_exact_fixels(tmp_path, rig, scene):
    film_experiments([scene], out=tmp_path / "film", rig=rig, looks="clean", rate=2.0)
    arrays, _ = truth_of(tmp_path / "film")

    touches = arrays["touches"].astype(int)
    assert touches[-1].any()  # it is a grasp
    assert not touches[0].any()
    assert arrays["reading"].tolist() == (touches @ [4, 2, 1]).tolist()  # blue is fixel 3


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "lab"
    project = Project.create(folder)
    run_testbed(project, None, seed=3, limit=1, threads=1)
    return folder


def test_a_stored_experiment_moves_in_the_film_as_it_truly_did(tmp_path, rig, project):
    planned = thesis_plan().experiments[0]
    settings = dict(rig=rig, looks="clean", rate=2.0, seed=5)
    (filmed,) = film_experiments([planned.name], out=tmp_path / "film", **settings, project=project)
    arrays, about = truth_of(tmp_path / "film")
    (measured,) = SimulatedTestbed(seed=3).run([planned], threads=1)
    end = [measured.conditions[f"truth_final_{k}"] for k in ("x_m", "y_m", "angle_rad")]

    assert filmed.name == planned.name
    assert arrays["pose_object"][-1] == pytest.approx(end, abs=1e-4)
    assert about["testbed_seed"] == 3
    assert about["conditions"]["truth_size_ratio"] == 0.998
    # The plan is stored with the film, not the true scene.
    assert load_scene(tmp_path / "film" / "scene.yaml").scene == planned.scene


def test_a_microscope_films_what_lies_under_it(tmp_path):
    path = tmp_path / "micro.yaml"
    save_scene(SceneFile(scene=micro_push(3), motion="quasistatic"), path)
    film_experiments([str(path)], out=tmp_path / "film", rig="microscope", frames=2)
    frame = next(open_recording(tmp_path / "film").frames())

    assert frame.picture.shape == (480, 640, 3)
    assert frame.picture[240, 263].max() < 60  # the part, before a bright ground
    assert frame.picture[30, 600].min() > 150


def test_what_cannot_be_filmed_is_refused_before_any_work(tmp_path, rig, scene):
    (tmp_path / "there").mkdir()
    refused(film_experiments, [], out=tmp_path / "x", rig=rig, match="nothing to film")
    refused(film_experiments, [scene], out=tmp_path / "there", rig=rig, match="an existing folder")
    with pytest.raises(InvalidInput, match="microscope or microscope-clean for a microscope"):
        film_experiments([scene], out=tmp_path / "x", rig=rig, looks="microscope")
    with pytest.raises(InvalidInput, match="2 films, but fixel needs one"):
        film_experiments([scene, scene], out=tmp_path / "x", rig=rig, video=tmp_path / "x.mp4")
    assert not (tmp_path / "x").exists()


def test_a_film_that_is_broken_off_is_readable_up_to_there(tmp_path, rig, scene):
    def tired(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film_experiments([scene], out=tmp_path / "film", rig=rig, frames=9, progress=tired)
    recording = open_recording(tmp_path / "film")

    assert recording.n_frames == 3
    assert not recording.complete
    assert len(truth_of(tmp_path / "film")[0]["time_s"]) == 9


def test_a_full_film_leaves_a_video_too(tmp_path, rig, scene):
    film_experiments([scene], out=tmp_path / "film", rig=rig, frames=4, video=tmp_path / "film.mp4")
    video = open_video(tmp_path / "film.mp4")
    times = [frame.time for frame in video.frames()]

    assert video.size == (160, 120)
    assert times == pytest.approx(open_recording(tmp_path / "film").time, abs=1e-4)
    shutil.rmtree(tmp_path / "film")
