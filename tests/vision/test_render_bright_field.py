"""The microscope's picture: outlines against the truth."""

import numpy as np
import pytest
import shapely

from fixel.formats.rig_file import rig_of
from fixel.model.shape import placed
from fixel.sampling.published import PART_LENGTH, PART_WIDTH
from fixel.testing.scenes import micro_push
from fixel.vision.render import CameraEffects, film, looks_named

TAB = (173e-6, 53e-6)
CLEAN = looks_named("microscope-clean")


@pytest.fixture(scope="module")
def rig():
    return rig_of("microscope")


def darkness(light):
    return (film.GROUND - light[..., 0].astype(float)) / (film.GROUND - film.BLACK)


def test_the_part_is_as_large_as_it_is(rig):
    scene = micro_push(1)
    view = film.BrightField(scene, rig, CLEAN, 1)
    pixel = rig.camera.metres_per_pixel(38.1e-6)
    far = np.array([-5e-3, 0.0, 0.0])  # the needle is out of the field
    for pose in ([2e-4, 1e-4, 0.3], [-1e-4, -5e-5, 1.1]):
        dark = darkness(view.light([{"part": np.array(pose), "probe": far}]))
        v, u = np.indices(dark.shape)
        middle = np.array([(dark * u).sum(), (dark * v).sum()]) / dark.sum()
        edge = 2.0 * (PART_WIDTH + PART_LENGTH) / pixel

        area = PART_WIDTH * PART_LENGTH / pixel**2
        assert dark.sum() == pytest.approx(area, abs=0.01 * edge)  # 0.01 px at every edge
        assert middle == pytest.approx(rig.camera.project_at(pose[:2], 38.1e-6), abs=2e-3)


def test_the_tab_sits_in_the_middle_of_a_short_side():
    body = micro_push(1).bodies[0]
    outline = shapely.Polygon(film.part_outline(body, TAB, 5.3e-6))
    assert outline.area == pytest.approx(PART_WIDTH * PART_LENGTH + TAB[0] * TAB[1], rel=1e-9)
    tab = outline.difference(shapely.Polygon(body.shape.outline))
    assert tab.centroid.x == pytest.approx(0.0, abs=1e-9)
    assert abs(tab.centroid.y) == pytest.approx(0.5 * PART_LENGTH + 0.5 * TAB[1], abs=1e-9)


def test_the_needle_ends_in_the_probe_and_comes_from_behind(rig):
    scene = micro_push(3)
    probe = scene.pushers[0]
    needle = film.needle_outline(probe, 5.3e-6)

    assert needle[:, 0].max() == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(needle[np.abs(needle[:, 0]) < 20e-6, 1]) == pytest.approx(25e-6)
    poses = {thing.name: thing.pose for thing in (*scene.bodies, probe)}
    dark = darkness(film.BrightField(scene, rig, CLEAN, 1).light([poses]))
    tip = rig.camera.project_at(placed([12.5e-6, 0.0], probe.pose), 1e-4)
    assert dark[round(tip[1]), round(tip[0])] > 0.9  # part and probe touch: one black blob
    assert dark[round(tip[1]), 5] > 0.9  # and it reaches the side of the picture


def test_defocus_vignetting_and_dust_are_there_and_small(rig):
    scene = micro_push(1)
    away = {"part": np.array([0.1, 0.0, 0.0]), "probe": np.array([0.1, 0.0, 0.0])}
    light = film.BrightField(scene, rig, looks_named("microscope"), 1).light([away])
    assert light[2:8, 2:8].mean() == pytest.approx(0.85 * film.GROUND, rel=0.02)
    assert light[230:250, 310:330].mean() == pytest.approx(film.GROUND, rel=0.06)
    assert light.min() > 0.7 * film.GROUND
    assert CameraEffects(lighting="through").tab == (0.0, 0.0)
