"""A film tracked, stored and drawn."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.database.project import Project
from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.formats.rig_file import save_rig
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.formats.video_file import VideoWriter
from fixel.model import (
    Body,
    Disk,
    Fixel,
    LineDrive,
    PairFriction,
    Polygon,
    Provenance,
    Pusher,
    Scene,
    Tripod,
)
from fixel.model.shape import placed
from fixel.testing.tracking_contract import moving, painted, tag_rig
from fixel.vision.frame import Frame
from fixel.vision.marks import Tag
from fixel.vision.tracking import FilmTracks, FoundFixel, PartObservation
from fixel.vision.tracking.judge import judged
from fixel.workflows.acquisition.track import drawn, track_film
from fixel.workflows.acquisition.tracked_experiment import experiment_of

N = 8


def scene():
    square = Polygon.rectangle(0.04, 0.04)
    poses, drive = moving(0.0), LineDrive(direction=(1.0, 0.0), speed=0.0135)
    support = Tripod(radius=0.01, friction=0.3)
    part = Body("object", square, mass=0.1, pose=poses["object"], support=support)
    head = Polygon(square.vertices * 0.6)
    pusher = Pusher("actuator", head, pose=poses["actuator"], drive=drive, friction=0.3)
    return Scene(part, pusher, duration=1.0)


@pytest.fixture
def film(tmp_path):
    painter = painted(tag_rig())
    save_rig(painter.rig, tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=scene()), tmp_path / "scene.yaml")
    with VideoWriter(tmp_path / "push.mp4", (320, 240)) as writer:
        for k in range(N):
            writer.write(Frame(1.0 + k / 30.0, painter.frame(k / 30.0).picture))
    return tmp_path / "push.mp4"


def test_a_film_becomes_an_experiment(film, tmp_path):
    Project.create(tmp_path / "lab")
    answer = track_film(
        film,
        project=tmp_path / "lab",
        overlay=tmp_path / "overlay.mp4",
        sheet=tmp_path / "sheet.png",
        plot=tmp_path / "plot.png",
    )
    assert all(path.stat().st_size > 1000 for path in answer.files.values())
    with Project(tmp_path / "lab").store() as store:
        stored = store.experiment(answer.number)
        assert store.video(answer.number).read_bytes() == film.read_bytes()
    assert stored.real
    assert stored.scene is not None
    assert stored.trajectory.time == pytest.approx(np.arange(N) / 30.0, abs=2e-5)
    truth = np.array([moving(k / 30.0)["object"] for k in range(N)])
    assert stored.trajectory.pose == pytest.approx(truth, abs=2e-3)
    assert np.abs(stored.trajectory.pose[:, :2] - truth[:, :2]).max() < 1e-4
    json.dumps(answer.summary(), allow_nan=False)


@pytest.mark.system
def test_outlines_of_a_registered_camera_lie_on_the_parts(tmp_path):
    """Drawn where the film has them, not where they would be if the camera had not been moved."""
    rig = tag_rig(plate=True)
    corners = [(-0.063, 0.034), (0.066, 0.038), (0.066, -0.042), (-0.06, -0.055)]
    plate = tuple(
        Tag(id=20 + k, size=0.024, pose=(*place, 0.0), height=0.0)
        for k, place in enumerate(corners)
    )
    painter = painted(replace(rig, plate=plate))
    away = replace(rig.camera, translation=rig.camera.translation + np.array([0.006, 0, 0]))
    save_rig(replace(painter.rig, camera=away), tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=scene()), tmp_path / "scene.yaml")
    with VideoWriter(tmp_path / "push.mp4", (320, 240)) as writer:
        writer.write(painter.frame(0.0))
    refused(track_film, tmp_path / "push.mp4", match="was moved")
    answer = track_film(tmp_path / "push.mp4", register=True)
    assert answer.experiment.conditions["camera"] == "registered again"
    (frame,) = answer.film.frames()
    before, after = frame.picture.astype(int), drawn(frame, 0, scene(), answer.tracked).astype(int)
    changed = np.abs(after - before).max(axis=-1)[32:] > 60  # but for the words
    corner = painter.rig.camera.project_at(
        placed(scene().bodies[0].shape.vertices, moving(0.0)["object"]), 0.0254
    )
    where = np.argwhere(changed)[:, ::-1] + (0, 32)
    for pixel in corner:
        assert np.hypot(*(where - pixel).T).min() < 3.0


def test_what_the_fixels_felt_is_in_the_experiment(tmp_path):
    """Bit 0 is the third fixel; where no reading came, there is none."""
    painter = painted(tag_rig())
    posts = tuple(
        Fixel(name=f"fixel-{k}", shape=Disk(0.01), pose=(0.2, 0.05 * (k - 2), 0.0), friction=0.3)
        for k in (1, 2, 3)
    )
    save_rig(painter.rig, tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=replace(scene(), fixels=posts)), tmp_path / "scene.yaml")
    readings = [0b000, 0b100, None, 0b001, 0b011, 0b011, 0b011, 0b011]
    late = 0.004  # [s] after its picture
    with RecordingWriter(tmp_path / "push", RecordingHeader(size=(320, 240))) as writer:
        for k, reading in enumerate(readings):
            frame = Frame(1.0 + k / 30.0, painter.frame(k / 30.0).picture)
            writer.write(frame, reading, frame.time + late)
    answer = track_film(
        tmp_path / "push", rig=str(tmp_path / "rig.yaml"), scene=tmp_path / "scene.yaml"
    )
    (tactile,) = answer.experiment.channels
    assert tactile.name == "tactile"
    assert tactile.columns == ("fixel_1_bool", "fixel_2_bool", "fixel_3_bool")
    felt = [[0, 0, 0], [1, 0, 0], [np.nan] * 3, [0, 0, 1], *[[0, 1, 1]] * 4]
    assert tactile.values == pytest.approx(np.array(felt, dtype=float), nan_ok=True)
    times = np.arange(8) / 30.0 + late
    came = [k for k, reading in enumerate(readings) if reading is not None]
    assert tactile.time[came] == pytest.approx(times[came], abs=2e-6)
    assert answer.experiment.contact_mode == "011"


def test_what_was_rendered_is_never_real(tmp_path):
    path = tmp_path / "push.mp4"
    painter = painted(tag_rig())
    save_rig(painter.rig, tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=scene()), tmp_path / "scene.yaml")
    with VideoWriter(path, (320, 240), note="SIMULATED by a test") as writer:
        writer.write(painter.frame(0.0))
    assert track_film(path).experiment.simulated_by == "SIMULATED by a test"


def pushed(along, first=0, fixels=(), planned=None, others=()):
    """An experiment of an actuator at places along x, and an object ahead of it, seen from some
    frame on, and other bodies that stay where they are seen."""
    time = np.arange(len(along)) / 30.0
    head, touch = moving(0.0)["actuator"], 0.005
    sights = {
        "actuator": head + np.outer(along, [1.0, 0.0, 0.0]),
        "object": moving(0.0)["object"]
        + np.outer(np.maximum.accumulate(np.maximum(along - touch, 0.0)), [1.0, 0.0, 0.0]),
    }
    sights |= {name: np.tile(pose, (len(along), 1)) for name, pose in others}
    parts = {}
    for name, poses in sights.items():
        own = [
            PartObservation(pose=pose, residual=0.05, scale=0.55e-3, sd=np.full(3, 1e-5))
            for pose in poses
        ]
        if name == "object":
            own[:first] = [PartObservation(reason="a hand")] * first
        parts[name] = judged(name, time, own)
    return experiment_of(
        FilmTracks(method="tags", rig=tag_rig(), time=time, parts=parts, fixels=fixels),
        tag_rig(),
        planned or scene(),
        None,
        dataset="bench",
        name="push",
        provenance=Provenance(version="0", command="", source=""),
    )


PUSH = np.interp(np.arange(90) / 30.0, [0.5, 3.0], [0.0, 0.034])


@pytest.mark.parametrize("first", [0, 20])
def test_a_start_that_was_seen_makes_a_scene(first):
    """Before it is touched, it does not matter when."""
    experiment = pushed(PUSH, first)
    assert experiment.scene is not None
    assert experiment.scene.bodies[0].pose == pytest.approx(moving(0.0)["object"], abs=1e-4)


def test_every_body_that_is_seen_starts_where_it_was_seen():
    plan, (x, y, _) = scene(), moving(0.0)["object"]
    second = replace(plan.bodies[0], name="second", pose=(x + 0.3, y, 0.0))
    third = replace(second, name="third", pose=(x, y + 0.3, 0.0))
    contacts = PairFriction(("*", "*"), friction=0.3)
    plan = replace(plan, bodies=(*plan.bodies, second, third), contact_friction=contacts)
    seen = (x + 0.21, y - 0.02, 0.4)
    made = pushed(PUSH, planned=plan, others=[("second", seen)]).scene
    assert made.bodies[0].pose == pytest.approx(moving(0.0)["object"], abs=1e-4)
    assert made.bodies[1].pose == pytest.approx(seen, abs=1e-9)
    assert np.array_equal(made.bodies[2].pose, third.pose)
    # Side by side, the measured squares overlap by 0.1 mm, as noise makes them do.
    seen = (*placed([[0.0399, 0.0]], moving(0.0)["object"])[0], moving(0.0)["object"][2])
    made = pushed(PUSH, planned=plan, others=[("second", seen)])
    assert 0.0 < np.hypot(*(made.scene.bodies[1].pose[:2] - seen[:2])) < 2e-4
    assert [flag.name for flag in made.flags if "start" in flag.name] == ["start-moved"]


def test_a_start_that_was_not_seen_makes_no_scene():
    (flag,) = [flag for flag in pushed(PUSH, 45).flags if flag.name == "no-scene"]
    assert "first visible at 1.50 s, when it already moved" in flag.detail


def test_two_pushes_in_one_film_make_no_scene():
    along = np.interp(np.arange(150) / 30.0, [0.5, 2.0, 2.5, 3.0, 4.5], [0.0, 0.02, 0.0, 0.0, 0.02])
    (flag,) = [flag for flag in pushed(along).flags if flag.name == "no-scene"]
    assert "moves back" in flag.detail
    assert "one by one" in flag.detail


def test_a_moving_fixel_is_reported():
    fixels = [FoundFixel(name=f"fixel-{k}", place=(0, 0), scatter=3e-4 * k, n=5) for k in (0, 1)]
    (flag,) = [f for f in pushed(PUSH, fixels=tuple(fixels)).flags if "restless" in f.name]
    assert flag.name == "fixel-1-restless"
    assert "0.30 mm" in flag.detail


def test_files_that_are_missing_are_named(film, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    refused(track_film, film, match=r"^rig: found no rig\.yaml next to the film")
    refused(track_film, tmp_path, rig="thesis-tags", match="a folder without a recording")
