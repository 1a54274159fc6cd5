"""Moving, turning, mirroring, renaming or rescaling a scene does so to its motion (A22)."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, reject, settings, strategies as st
from tests.laws.scenes import SIZE, mirrored, quarter_turned, rescaled, scenes, table_push

from fixel.simulation import Adaptive, Dynamic, FirstOrder, QuasiStatic, StewartTrinkle, simulate
from fixel.testing.scenes import grasp, micro_push, moved

MOTIONS = [Dynamic(), QuasiStatic(), FirstOrder()]
FIXED = StewartTrinkle(step=0.005)

# Each step is solved to 1e-11 or so in scaled units, and rounding differs between the two scenes
# from the start. Contacts amplify that: 1e-7 of a body, in place of the 1e-12 that holds until the
# first contact.
CLOSE = 1e-7


def _poses(scene, motion, stepper=FIXED):
    run = simulate(scene, motion=motion, stepper=stepper, output_interval=scene.duration / 20)
    if not run.converged:
        # Whether every step can be solved is the matter of test_contacts_obey.
        reject()
    assert run.max_residual <= 1e-9
    return run.pose


def _same(a, b, length=SIZE, close=CLOSE):
    for name in a:
        difference = np.abs(a[name] - b[name]) * [1.0, 1.0, length]
        assert difference.max() < close * length, name


@pytest.mark.parametrize("motion", MOTIONS)
@given(scene=scenes(), x=st.floats(-2, 2), y=st.floats(-2, 2))
@settings(max_examples=15)
def test_moved_scene_moves_its_motion(motion, scene, x, y):
    there = {
        name: poses - [x, y, 0.0]
        for name, poses in _poses(moved(scene, (x, y), 0.0), motion).items()
    }
    _same(_poses(scene, motion), there)


@pytest.mark.parametrize("motion", MOTIONS)
@given(scene=scenes(), turn=st.floats(-3, 3))
@settings(max_examples=15)
def test_turned_scene_turns_its_motion(motion, scene, turn):
    c, s = np.cos(turn), np.sin(turn)
    back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = _poses(moved(scene, (0.0, 0.0), turn), motion)
    _same(_poses(scene, motion), {k: v @ back.T - [0, 0, turn] for k, v in turned.items()})


@pytest.mark.parametrize("motion", MOTIONS)
@given(scene=scenes())
@settings(max_examples=15)
def test_mirrored_scene_mirrors_its_motion(motion, scene):
    flipped = _poses(mirrored(scene), motion)
    _same(_poses(scene, motion), {k: v * [1.0, -1.0, -1.0] for k, v in flipped.items()})


@pytest.mark.parametrize("motion", MOTIONS)
@given(scene=scenes())
@settings(max_examples=15)
def test_order_of_bodies_and_fixels_does_not_matter(motion, scene):
    other = replace(scene, bodies=scene.bodies[::-1], fixels=scene.fixels[::-1])
    _same(_poses(scene, motion), _poses(other, motion))


@pytest.mark.parametrize("motion", MOTIONS)
@given(
    scene=scenes(),
    length=st.sampled_from([1e-3, 0.5, 39.37, 1e3]),
    mass=st.sampled_from([1e-6, 3.0, 1e3]),
    time=st.sampled_from([1e-3, 0.1, 60.0]),
)
@settings(max_examples=15)
def test_change_of_units_changes_nothing(motion, scene, length, mass, time):
    base = _poses(scene, motion)
    other = _poses(rescaled(scene, length, mass, time), motion, StewartTrinkle(step=0.005 * time))
    scaled = {k: v / [length, length, 1.0] for k, v in other.items()}
    # The kernels see the same numbers but for rounding.
    _same(base, scaled, close=1e-9)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("seed", range(6))
def test_a_push_on_a_table_turns_mirrors_and_scales_with_all_that_is_on_it(motion, seed):
    """Paths, force limits, springs, loads of feet, grain and maps of the table, by every step."""
    scene = table_push(seed)
    base = _poses(scene, motion)
    turned = replace(moved(scene, (0.0, 0.0), pi / 2), plane=quarter_turned(scene.plane))
    back = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    ends = _poses(turned, motion)
    _same(base, {k: v @ back.T - [0.0, 0.0, pi / 2] for k, v in ends.items()})
    flipped = _poses(mirrored(scene), motion)
    _same(base, {k: v * [1.0, -1.0, -1.0] for k, v in flipped.items()})
    large = _poses(rescaled(scene, 10.0, 7.0, 0.3), motion, StewartTrinkle(step=0.005 * 0.3))
    _same(base, {k: v / [10.0, 10.0, 1.0] for k, v in large.items()})


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_grasp_of_millimetres_is_a_grasp_of_centimetres(motion):
    """The 107 mm block at the size of the 1.6 mm part, with every force scaled along."""
    scene = grasp("slip")
    small = rescaled(scene, 1.6e-3 / 0.1075, 1e-7, 1.0)
    a = _poses(scene, motion, Adaptive())["object"]
    b = _poses(small, motion, Adaptive())["object"] / [1.6e-3 / 0.1075, 1.6e-3 / 0.1075, 1.0]
    # Rounding, ten events later: where a step ends decides where the next one does.
    assert np.abs(a - b).max() < 1e-8


def test_the_micro_part_at_the_size_of_a_brick():
    scene = micro_push(3)
    big = rescaled(scene, 100.0, 1e6, 10.0)
    a = _poses(scene, QuasiStatic(), Adaptive())["part"]
    b = _poses(big, QuasiStatic(), Adaptive())["part"] / [100.0, 100.0, 1.0]
    assert np.abs((a - b) * [1 / 1.6e-3, 1 / 1.6e-3, 1.0]).max() < 1e-9
