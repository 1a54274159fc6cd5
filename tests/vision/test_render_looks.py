"""Each disturbance does what it says."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused
from tests.vision.rendered import AWAY, bare_scene, small_rig, still

from fixel import InvalidInput, Trajectory
from fixel.vision.render import CameraEffects, changed, film_scene, frame_times, looks_named
from fixel.vision.render.film import Occlusion
from fixel.vision.render.looks import PRESETS, light
from fixel.vision.render.virtual_camera import Sensor

POSE = np.array([0.15, 0.008, 0.3])
TIMES = np.arange(0.0, 12.0, 1.0 / 30.0)


def resting():
    return {
        name: Trajectory(time=[0.0, 1.0], pose=[pose, pose])
        for name, pose in (("object", POSE), ("actuator", AWAY))
    }


def film(looks, times, seed=1):
    scene, rig = bare_scene(), small_rig()
    return [f.picture for f in film_scene(scene, resting(), rig, looks, np.array(times), seed)]


def test_the_same_seed_gives_the_same_bits_and_another_others():
    looks = replace(looks_named("thesis"), drift=0.0)
    first, again, other = (film(looks, [0.0, 0.1], seed) for seed in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], first[1])  # noise is new in every frame
    assert not np.array_equal(first[0], other[0])


def test_noise_has_the_deviation_it_should():
    size = (200, 100)
    for level, read, shot in ((0.25, 2.0, 0.0), (1.0, 0.0, 4.0), (0.5, 1.5, 3.0)):
        sensor = Sensor(CameraEffects(read_noise=read, shot_noise=shot), size, 1)
        flat = np.full((100, 200, 3), 240.0 * level, np.float32)
        picture = sensor.exposed(flat, np.ones(3), 0).astype(float)
        expected = np.sqrt(read**2 + shot**2 * 240.0 * level / 255.0 + 1.0 / 12.0)
        assert picture.std() == pytest.approx(expected, rel=0.02)
        assert picture.mean() == pytest.approx(240.0 * level, abs=0.05)


def test_a_sensor_without_noise_rounds_and_cuts_off():
    sensor = Sensor(CameraEffects(), (2, 1), 1)
    light = np.array([[[-3.0, 1.4, 1.6], [254.6, 100.0, 100.0]]], np.float32)
    picture = sensor.exposed(light, np.array([1.0, 3.0, 0.4]), 0)
    assert picture.tolist() == [[[0, 4, 1], [255, 255, 40]]]


def test_a_third_of_the_light_goes_and_comes_back():
    factors = light(CameraEffects(light_change=0.3), TIMES, 1)
    assert factors[[0, -1]] == pytest.approx(1.0)
    assert factors.min() == pytest.approx(0.7)
    dim = (factors[:, 1] < 0.71).mean()
    assert 0.2 < dim < 0.35
    assert np.abs(np.diff(factors[:, 1])).max() < 0.05  # no jump
    warm = light(CameraEffects(light_change=0.3, colour_change=0.06), TIMES, 1)
    darkest = warm[np.argmin(factors[:, 1])]
    assert darkest[2] / darkest[0] == pytest.approx(1.06 / 0.94)


def test_the_light_in_the_picture_is_that_light():
    looks = CameraEffects(light_change=0.3)
    factors = light(looks, TIMES, 1)[:, 1]
    dark = int(np.argmin(factors))
    chosen = TIMES[[0, dark, -1]]
    bright = [p.mean() for p in film(looks, chosen)]
    assert bright[0] > 100.0
    # A film of three frames has another course of its light; its darkest frame is still so dark.
    least = light(looks, chosen, 1)[:, 1]
    assert np.array(bright) / bright[0] == pytest.approx(least / least[0], abs=5e-3)


def test_drift_wanders_slowly_about_one():
    factors = light(CameraEffects(drift=0.02), np.arange(0.0, 60.0, 1.0 / 30.0), 1)[:, 1]
    assert factors.std() == pytest.approx(0.02, rel=0.3)
    assert factors.mean() == pytest.approx(1.0, abs=0.01)
    assert np.abs(np.diff(factors)).max() < 0.004


def edge_width(picture):
    """Deviation of the slope across the object's left edge, in the middle row of the picture."""
    profile = picture[150:170, 60:210, 0].mean(axis=0)
    slope = np.abs(np.diff(profile))
    middle = int(np.argmax(slope))
    near = np.arange(middle - 6, middle + 7)
    weight = np.maximum(slope[near] - 1.5, 0.0)
    mean = (weight * near).sum() / weight.sum()
    return float(np.sqrt((weight * (near - mean) ** 2).sum() / weight.sum()))


def test_blur_widens_edges_by_what_it_says():
    rig = small_rig()
    pose = np.array([0.17, 0.008, -0.021])  # upright in a camera that is turned by 1.2 degrees
    widths = [
        edge_width(still(rig, CameraEffects(shadows=0.0, blur=b), pose)) for b in (0.0, 1.0, 2.0)
    ]
    assert np.sqrt(widths[1] ** 2 - widths[0] ** 2) == pytest.approx(1.0, abs=0.2)
    assert widths[2] > 1.6


def test_motion_smears_by_the_way_made_in_an_exposure():
    """16 mm/s for 1/8 s are 2 mm, 3.8 px: a box of that width has a deviation of 1.1 px."""
    scene, rig = bare_scene(), small_rig()
    start = np.array([0.17, 0.008, -0.021])
    far = start + np.array([0.16, 0.0, 0.0])
    tracks = resting() | {"object": Trajectory(time=[-5.0, 5.0], pose=[2 * start - far, far])}
    looks = CameraEffects(shadows=0.0, exposure=1.0 / 8.0)
    sharp, smeared = (
        next(film_scene(scene, tracks, rig, look, np.array([0.0]))).picture
        for look in (CameraEffects(shadows=0.0), looks)
    )
    width = 0.032 * looks.exposure / rig.camera.metres_per_pixel(0.0254)

    found = np.sqrt(edge_width(smeared) ** 2 - edge_width(sharp) ** 2)
    assert found == pytest.approx(width / np.sqrt(12.0), rel=0.25)


def test_corners_are_darker_by_the_vignetting():
    rig = small_rig()
    full, dark = (still(rig, CameraEffects(vignetting=v), AWAY) for v in (0.0, 0.3))
    assert dark[0, 0] / full[0, 0] == pytest.approx(0.7, abs=1e-3)
    assert dark[160, 210] / full[160, 210] == pytest.approx(1.0, abs=1e-3)


def test_the_hand_covers_the_share_it_should_for_as_long_as_it_should():
    looks = CameraEffects(occlusion=2.0, occluded=0.5)
    scene, rig = bare_scene(), small_rig()
    occlusion = Occlusion(scene, rig, looks, TIMES, 1)
    begins, ends = occlusion.interval
    covered = np.array([occlusion.share(occlusion.pose(t, POSE), POSE) for t in TIMES[::3]])
    there = (TIMES[::3] >= begins) & (TIMES[::3] <= ends)

    assert ends - begins == pytest.approx(2.0)
    assert covered[there] == pytest.approx(0.5, abs=0.01)
    assert covered[[0, -1]].tolist() == [0.0, 0.0]
    assert (covered > 0.0).mean() < 0.3

    free = still(rig, CameraEffects(), POSE)
    hidden = still(rig, CameraEffects(), POSE, hand=occlusion.pose(0.5 * (begins + ends), POSE))
    skin = hidden[..., 2] - hidden[..., 0] > 40.0
    assert skin.mean() > 0.1
    assert not (free[..., 2] - free[..., 0] > 40.0).any()


def test_no_hand_where_none_is_asked_for():
    occlusion = Occlusion(bare_scene(), small_rig(), CameraEffects(), TIMES, 1)
    assert occlusion.interval == (0.0, 0.0)
    assert occlusion.pose(3.0, POSE) is None


def test_frames_are_lost_and_late_as_often_as_they_should():
    looks = CameraEffects(dropped=0.1, jitter=0.05)
    times = frame_times(200.0, 30.0, looks, 1)
    count = np.rint(times * 30.0)
    assert len(times) / 6001 == pytest.approx(0.9, abs=0.015)
    assert np.all(np.diff(times) > 0.0)
    assert (times * 30.0 - count).std() == pytest.approx(0.05, rel=0.1)
    assert times[0] == 0.0
    assert frame_times(1.0, 30.0, CameraEffects(), 1) == pytest.approx(np.arange(31) / 30.0)


def test_presets_have_names_and_strangers_are_refused():
    assert {"clean", "thesis", "hard", "microscope"} <= set(PRESETS)
    refused(looks_named, "thessis", match="did you mean 'thesis'")
    refused(CameraEffects, dropped=1.5, match=r"looks.dropped is 1.5")
    refused(CameraEffects, lighting="below", match=r"looks.lighting")


def test_numbers_of_looks_are_changed_by_name():
    looks = changed(looks_named("hard"), ["occlusion=1.5", "light_change=0.2"])
    assert (looks.occlusion, looks.light_change, looks.blur) == (1.5, 0.2, 1.1)
    for text in ("occlusion", "colour=3", "tab=1"):
        refused(changed, looks, [text], match="must be NAME=VALUE, where NAME is one of")
    refused(changed, looks, ["blur=much"], match=r"changes blur is 'much', but must be a number")


def test_a_motion_that_lacks_a_body_is_refused():
    with pytest.raises(InvalidInput, match="no trajectory of 'actuator'"):
        next(
            film_scene(
                bare_scene(), {"object": resting()["object"]}, small_rig(), CameraEffects(),
                np.zeros(1),
            )
        )  # fmt: skip
