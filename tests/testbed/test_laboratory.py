"""The emulated laboratory: what its camera and fixels report is the hidden truth, with faults."""

import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.model import LineDrive, pose_error
from fixel.sampling import eight_push_plan, thesis_plan
from fixel.simulation import simulate
from fixel.testbed.emulators.laboratory import EmulatedLaboratory, Faults, smaller
from fixel.testbed.imperfections import nominal_friction
from fixel.testbed.recorder import Recorder
from fixel.testbed.simulated import SimulatedTestbed
from fixel.vision.render.bench import RenderedBench
from fixel.workflows.acquisition.track import track_film

SPEED, TRAVEL = 0.05, 0.02  # of the push


def row():
    """The first push of the thesis, with part and fixels closer to the head."""
    planned = thesis_plan().experiments[0]
    body, pusher, fixels = planned.scene.bodies[0], planned.scene.pushers[0], planned.scene.fixels
    scene = replace(
        planned.scene,
        bodies=(replace(body, pose=body.pose - [0.050, 0.0, 0.0]),),
        pushers=(replace(pusher, drive=replace(pusher.drive, travel=TRAVEL, speed=SPEED)),),
        fixels=tuple(replace(fixel, pose=fixel.pose - [0.0925, 0.0, 0.0]) for fixel in fixels),
    )
    return replace(planned, scene=scene)


ROW = row()
TRUTH = SimulatedTestbed(seed=3)
RIG = smaller(rig_of("thesis-tags"), 0.5)
SMALL = smaller(RIG, 0.5)  # too small to track
START, AHEAD = [0.0, 0.0], [1.0, 0.0]
NO_FAULTS = Faults(jitter=0.0, dropped=0.0)


def laboratory(faults=NO_FAULTS, seed=3, rig=SMALL, **options):
    made = EmulatedLaboratory(rig, truth=TRUTH, seed=seed, faults=faults, **options)
    made.prepare(ROW)
    return made


def pushed(lab, travel=TRAVEL, rest=5):
    """Pictures before, during and after a push, read in this thread."""
    source = lab.source
    source.open()
    frames = source.frames()
    pictures = [next(frames) for _ in range(rest)]
    with lab.drive as drive:
        drive.aim(START, AHEAD)
        drive.move(to=travel, speed=SPEED, wait=False)
        while drive.moving:
            pictures.append(next(frames))
        pictures += [next(frames) for _ in range(rest)]
    source.close()
    return pictures


def part_error(lab):
    return pose_error(lab.moments[-1].part, ROW.scene.bodies[0].pose)


def record(lab, folder):
    """A push in a folder, recorded in one thread while another one moves the drive."""
    over = threading.Event()

    def push():
        with lab.drive as drive:
            drive.aim(START, AHEAD)
            sleep(lab, 0.5)
            drive.move(to=TRAVEL, speed=SPEED)
            sleep(lab, 0.7)
        over.set()

    def prepare(path):
        save_rig(lab.rig, path / "rig.yaml")
        save_scene(SceneFile(scene=ROW.scene), path / "scene.yaml")
        threading.Thread(target=push, daemon=True).start()

    source = lab.source
    recorder = Recorder(
        source=source,
        stream=source.open(),
        folder=folder,
        codec="near",
        tactile=lab.tactile,
        stop=lambda: "done" * over.is_set(),
        prepare=prepare,
    )
    return recorder.run()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laboratory") / "push"
    lab = laboratory(Faults(jitter=1e-3, dropped=0.03), rig=RIG)
    lab.nudge()
    return lab, record(lab, folder), track_film(folder)


def sleep(lab, seconds):
    until = lab.clock() + seconds
    while lab.clock() < until:
        time.sleep(1e-3)


def test_tracked_poses_are_the_hidden_ones(recorded):
    lab, summary, answer = recorded
    assert summary.lost == 0
    experiment = answer.experiment
    assert experiment.simulated_by.startswith("fixel emulated laboratory")
    kept = [moment for moment in lab.moments if not moment.lost][: summary.frames]
    stamps = np.array([moment.stamp for moment in kept])
    track = experiment.trajectory
    frame = np.abs(track.time[:, None] - (stamps - stamps[0])).argmin(axis=1)
    assert len(track.time) > 0.95 * summary.frames
    assert np.abs(track.time - (stamps - stamps[0])[frame]).max() < 1e-5
    hidden = np.array([kept[k].part for k in frame])
    far, turned = pose_error(track.pose, hidden)
    assert np.hypot(*(hidden[-1] - hidden[0])[:2]) > 0.005
    assert np.median(far) < 1e-4
    assert far.max() < 5e-4
    assert np.abs(turned).max() < 8e-3
    at_head = np.array([moment.head for moment in kept])
    head = experiment.pusher
    frame = np.abs(head.time[:, None] - (stamps - stamps[0])).argmin(axis=1)
    assert pose_error(head.pose, at_head[frame])[0].max() < 5e-4


def test_readings_are_those_of_their_own_frames(recorded):
    lab, summary, answer = recorded
    kept = [moment for moment in lab.moments if not moment.lost][: summary.frames]
    read = answer.film.readings.value
    assert read.tolist() == [moment.bits for moment in kept]
    touches = np.array([moment.touches for moment in kept])
    assert not touches[:15].any()
    assert touches.any()
    felt = np.array([[bits >> bit & 1 for bit in (2, 1, 0)] for bits in read.tolist()])
    assert (felt == touches).mean() > 0.9


def test_the_part_moves_as_in_one_simulation_of_the_true_scene():
    """Moved frame by frame by an even drive, it ends where an undivided simulation takes it."""
    even = replace(TRUTH, ripple=0.0)
    lab = EmulatedLaboratory(SMALL, truth=even, seed=3, faults=NO_FAULTS)
    lab.prepare(ROW)
    lab.nudge()
    pushed(lab)
    begun = lab.moments[0].part
    scene = even.true_scene(ROW)
    head, body = scene.pushers[0], scene.bodies[0]
    drive = LineDrive(
        direction=AHEAD, speed=SPEED, travel=TRAVEL, force_limit=head.drive.force_limit
    )
    whole = replace(
        scene,
        bodies=(replace(body, pose=begun),),
        pushers=(replace(head, pose=np.zeros(3), drive=drive),),
        duration=TRAVEL / SPEED + 0.5,
    )
    far, turned = pose_error(lab.moments[-1].part, simulate(whole).pose[body.name][-1])
    assert far < 1e-4
    assert abs(turned) < 1e-3
    assert far < 0.02 * pose_error(begun, lab.moments[-1].part)[0]


@pytest.mark.parametrize("number", [0, 198])
def test_pushes_of_the_thesis_end_as_the_simulated_testbed_performs_them(monkeypatch, number):
    """The second is squeezed between head and fixels; only speeds differ a little."""
    planned = thesis_plan().experiments[number]
    (performed,) = TRUTH.run([planned])
    monkeypatch.setattr(EmulatedLaboratory, "_taken", lambda self, view, tracks, middle: None)
    exact = replace(NO_FAULTS, placement=(0.0, 0.0))
    lab = EmulatedLaboratory(SMALL, truth=TRUTH, seed=3, faults=exact)
    lab.prepare(planned)
    with lab.drive as drive:
        drive.aim(START, AHEAD)
        drive.move(to=0.15, speed=0.0135, wait=False)
        while drive.moving:
            lab.advance()
    end = [performed.conditions[f"truth_final_{name}"] for name in ("x_m", "y_m", "angle_rad")]
    far, turned = pose_error(lab._part, end)
    assert far < 1.5e-4
    assert abs(turned) < 3e-3
    assert "".join(str(int(touch)) for touch in lab._touches) == performed.contact_mode


def test_a_picture_at_rest_shows_where_the_part_came_to_rest():
    """The light of a resting scene is rendered once: that after the motion, not that within it."""
    lab = laboratory()
    pictures = pushed(lab)
    assert (lab.moments[-3].part == lab.moments[-1].part).all()
    copy = laboratory()
    copy._part, copy._head = lab._part, lab._head
    copy.drive = lab.drive
    (fresh,) = (next(frames) for frames in [copy.source.frames()])
    assert np.abs(pictures[-1].picture().astype(int) - fresh.picture()).mean() < 3.0
    assert (np.abs(pictures[-1].picture().astype(int) - fresh.picture()) > 25).sum() == 0


def test_pictures_are_rendered_when_they_are_looked_at_as_if_at_once(monkeypatch):
    light, advance, rendered = RenderedBench.light, EmulatedLaboratory.advance, []

    def counted(view, poses):
        rendered.append(poses)
        return light(view, poses)

    def looked_at(lab):
        (picture := advance(lab)).picture()
        return picture

    monkeypatch.setattr(RenderedBench, "light", counted)
    later = pushed(laboratory(), 0.015)
    assert rendered == []
    monkeypatch.setattr(EmulatedLaboratory, "advance", looked_at)
    for own, other in zip(pushed(laboratory(), 0.015)[::-1], later[::-1], strict=True):
        assert own.size == other.picture().shape[1::-1]
        assert (own.picture() == other.picture()).all()


def test_same_seed_same_pictures():
    one, two, other = (pushed(laboratory(Faults(), seed=seed), 0.015) for seed in (3, 3, 4))
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        assert (a.picture() == b.picture()).all()
    assert any((a.picture() != b.picture()).any() for a, b in zip(one, other, strict=False))


def test_a_part_is_placed_roughly_and_then_corrected():
    lab = EmulatedLaboratory(SMALL, truth=TRUTH, faults=NO_FAULTS)
    rough, better = [], []
    frames = lab.source.frames()
    for _ in range(8):
        lab.prepare(ROW)
        next(frames)
        rough.append(part_error(lab))
        lab.nudge()
        next(frames)
        better.append(part_error(lab))
    (far, turned), (near, straight) = np.array(rough).T, np.array(better).T
    assert far.max() < 3e-3 < 2.0 * far.max()
    assert np.abs(turned).max() < np.radians(3.0) < 2.0 * np.abs(turned).max()
    assert near.max() < 2.1e-4
    assert np.abs(straight).max() < np.radians(0.3)
    assert len(set(far)) == 8


def test_a_withdrawn_head_leaves_the_part_where_it_is():
    lab = laboratory()
    pushed(lab)
    there = lab.moments[-1].part
    frames = lab.source.frames()
    with lab.drive as drive:
        drive.move(to=-0.02, speed=SPEED, wait=False)
        while drive.moving:
            next(frames)
        next(frames)
    assert pose_error(lab.moments[-1].part, there)[0] < 1e-6
    assert lab.moments[-1].head == pytest.approx([-0.02, 0.0, 0.0], abs=1e-9)


def test_time_stamps_scatter_and_frames_are_lost():
    lab = laboratory(Faults(jitter=2e-3, dropped=0.1))
    frames = lab.source.frames()
    taken = [next(frames) for _ in range(200)]
    error = np.array([moment.stamp - moment.time for moment in lab.moments])
    assert np.std(error) == pytest.approx(2e-3, rel=0.2)
    lost = np.array([moment.lost for moment in lab.moments])
    assert 0.05 < lost.mean() < 0.16
    assert len(lab.moments) - lost.sum() == len(taken)
    steps = np.diff([picture.captured for picture in taken])
    assert steps.min() > 0.0
    assert (np.rint(steps * 30.0) - 1.0).sum() == lost.sum()


@pytest.mark.system
def test_a_hand_hides_the_part_in_the_first_push_of_a_row_only():
    lab = laboratory(replace(NO_FAULTS, hidden=(ROW.name,), hand=0.2))
    pictures = pushed(lab)
    hidden = np.array([moment.hidden for moment in lab.moments])
    assert 0.2 <= hidden.sum() / 30.0 < 0.9
    bare = pushed(laboratory())
    changed = np.array(
        [
            (np.abs(a.picture().astype(int) - b.picture()) > 40).mean()
            for a, b in zip(pictures, bare, strict=True)
        ]
    )
    assert (changed[~hidden] < 1e-3).all()
    assert changed[hidden].max() > 0.03
    begin(lab)
    again = len(lab.moments)
    pushed(lab)
    assert not any(moment.hidden for moment in list(lab.moments)[again:])


@pytest.mark.system
def test_a_tracked_push_lacks_what_a_hand_hid_and_what_an_overload_stopped(tmp_path):
    lab = laboratory(Faults(hidden=(ROW.name,), hand=0.3, overload=(ROW.name,)), rig=RIG)
    lab.nudge()
    record(lab, tmp_path / "push")
    summary = track_film(tmp_path / "push").summary()
    (gap,) = summary["parts"]["object"]["gaps"]
    assert 0.2 < gap["to_s"] - gap["from_s"] < 1.3
    assert summary["parts"]["actuator"]["gaps"] == []
    assert summary["actuator"]["travel_m"] == pytest.approx(0.4 * TRAVEL, abs=2e-3)
    assert lab.drive.place()[0] == pytest.approx(TRAVEL)


def test_an_overload_stops_the_head_in_the_first_push_of_a_row_only():
    lab = laboratory(replace(NO_FAULTS, overload=(ROW.name,)))
    pushed(lab)
    assert lab.drive.place() == pytest.approx([TRAVEL, 0.0])
    assert lab.moments[-1].head[0] == pytest.approx(0.4 * TRAVEL, abs=2e-3)
    begin(lab)
    pushed(lab)
    assert lab.moments[-1].head[0] > 0.6 * TRAVEL


def test_a_row_begun_by_an_earlier_program_has_no_second_fault():
    """Else a campaign that is killed in such a row meets the fault each time, and skips the row."""
    lab = laboratory(replace(NO_FAULTS, overload=(ROW.name,)))
    first = true_parameters(lab)
    lab.prepare(ROW, 1)
    assert true_parameters(lab)["mu_pusher"] != first["mu_pusher"]
    pushed(lab)
    assert lab.moments[-1].head[0] > 0.6 * TRAVEL


def begin(lab):
    """The head goes back, and the row is prepared again."""
    frames = lab.source.frames()
    with lab.drive as drive:
        drive.move(to=0.0, speed=0.2, wait=False)
        while drive.moving:
            next(frames)
        next(frames)
    lab.prepare(ROW, 1)


def true_parameters(lab):
    """Hidden true values in the present row [-]."""
    scene = lab._scene
    return {
        "mu_pusher": scene.pushers[0].friction,
        "mu_fixel": max((fixel.friction for fixel in scene.fixels), default=0.0),
        "mu_support": nominal_friction(scene.bodies[0], scene.gravity) or 0.0,
    }


def test_a_repetition_has_its_own_scatter():
    lab = laboratory()
    first = true_parameters(lab)
    assert first["mu_pusher"] == TRUTH.true_scene(ROW).pushers[0].friction
    lab.prepare(ROW)  # before a push it is the same attempt
    assert true_parameters(lab) == first
    pushed(lab, 0.01)
    begin(lab)
    second = true_parameters(lab)
    assert second.keys() == {"mu_pusher", "mu_fixel", "mu_support"}
    for name in second:
        assert second[name] != first[name]
        assert second[name] == pytest.approx(first[name], rel=0.3)


def test_a_stopped_drive_stops_the_head():
    lab = laboratory()
    frames = lab.source.frames()
    with lab.drive as drive:
        drive.aim(START, AHEAD)
        drive.move(to=TRAVEL, speed=SPEED, wait=False)
        for _ in range(6):
            next(frames)
        drive.stop()
        for _ in range(3):
            next(frames)
    assert lab.moments[-1].head[0] == pytest.approx(6 / 30.0 * SPEED, rel=0.1)
    assert (lab.moments[-1].head == lab.moments[-2].head).all()


def test_in_real_time_frames_come_at_their_rate(monkeypatch):
    """On a clock of the test, which only waiting advances."""
    now = [1e3]
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr("fixel.testbed.emulators.laboratory.time", clock)
    lab = laboratory(pace=1.0)
    source = lab.source
    monkeypatch.setattr(
        source._stop, "wait", lambda seconds: now.append(now.pop() + max(0.0, seconds))
    )
    assert source.open().live
    frames = source.frames()
    times = [next(frames).captured for _ in range(20)]
    assert now[0] - 1e3 == pytest.approx(20 / 30.0)
    assert abs(now[0] - times[-1]) < 0.1
    assert lab.clock() == now[0]
    source.close()
    assert list(frames) == []
    assert source.ended


def test_a_smaller_rig_sees_the_same_places():
    whole = rig_of("thesis-tags")
    part = smaller(whole, 0.5)
    assert part.camera.lens.image_size == (640, 360)
    place = np.array([[0.1, 0.03], [0.2, -0.05]])
    big, small = (rig.camera.project_at(place, 0.02) for rig in (whole, part))
    assert 0.5 * (big + 0.5) - 0.5 == pytest.approx(small, abs=1e-6)


@pytest.mark.parametrize(("build", "options"), [
    (EmulatedLaboratory, {"pace": 2.0}),
    (EmulatedLaboratory, {"rate": 0.0}),
    (Faults, {"dropped": 1.5}),
    (Faults, {"jitter": -1.0}),
    (Faults, {"placement": (-1.0, 0.0)}),
    (Faults, {"hand": 0.0}),
])  # fmt: skip
def test_bad_options_and_faults_are_refused(build, options):
    with pytest.raises(InvalidInput, match=next(iter(options))):
        build(**options) if build is Faults else build(SMALL, truth=TRUTH, **options)


def test_no_pictures_before_a_row_is_prepared():
    lab = EmulatedLaboratory(SMALL, truth=TRUTH)
    with pytest.raises(InvalidInput, match="prepared row"):
        next(lab.source.frames())
    assert lab.tactile.read().bits is None


@pytest.mark.system
def test_a_push_of_two_axes_under_the_microscope():
    """The sixth push of the ASME paper, along -y: the part ends where it should."""
    planned = eight_push_plan().experiments[15]
    centred = SimulatedTestbed(
        seed=3, centre_of_pressure=(0.0, 0.0), centre_of_pressure_spread=0.0, stall_force=None
    )
    exact = replace(NO_FAULTS, placement=(0.0, 0.0))
    lab = EmulatedLaboratory(rig_of("microscope"), truth=centred, faults=exact)
    lab.prepare(planned)
    needle = planned.scene.pushers[0]
    way = needle.drive
    frames = lab.source.frames()
    with lab.drive as drive:
        drive.go(needle.pose[:2] - 2e-4 * way.direction, speed=0.01, wait=False)
        before = next(frames)
        while drive.moving:
            next(frames)
        drive.aim(needle.pose[:2], way.direction)
        drive.move(to=way.travel, speed=way.speed, wait=False)
        while drive.moving:
            after = next(frames)
    (performed,) = centred.run([planned])
    end = [performed.conditions[f"truth_final_{name}"] for name in ("x_m", "y_m", "angle_rad")]
    far, _ = pose_error(lab.moments[-1].part, end)
    assert far < 2e-5
    assert pose_error(planned.scene.bodies[0].pose, end)[0] > 3e-4
    assert (np.abs(after.picture().astype(int) - before.picture()) > 60).mean() > 0.01
    assert lab.moments[-1].bits == -1
