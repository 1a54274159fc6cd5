"""Shapes and pushes outside what part models are made for: a reason and no bound, or a refusal."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused
from tests.parts.test_candidates import polygon_pusher, two_bodies

from fixel import Body, Disk, InvalidInput, LineDrive, Polygon, Scene, UniformPressure, part_model
from fixel.domain.push_bound import NO_DATA
from fixel.parts.fit import PartPushes
from fixel.parts.model import distinct
from fixel.parts.next_pushes import push_candidates
from fixel.testing.pushes import example_parts
from fixel.testing.scenes import box


def _scene(shape, **body):
    one = Body("part", shape, mass=0.8, support=UniformPressure(friction=0.25), **body)
    return push_candidates(one, contacts=4, travel=0.04)


def _named_first(answer):
    """A prediction says what is unseen before all else, and has wide bounds or none."""
    assert repr(answer).startswith("unseen: ")
    numbers = [x for x in (*answer.pose, *answer.bound[:2], *answer.bound[5:7]) if x is not None]
    assert np.isfinite(numbers).all()
    return answer.bound


@pytest.mark.system
def test_a_concave_part_is_bounded_as_a_new_part(model):
    arrow = Polygon([(-0.05, -0.05), (0.05, -0.05), (0.0, 0.0), (0.05, 0.05), (-0.05, 0.05)])
    bound = _named_first(model.at(_scene(arrow)[0], part="arrow", surface="board"))
    assert bound.position is None or bound.position >= model.misfit


def test_a_part_of_thousands_of_vertices_is_predicted(model):
    turn = np.linspace(0.0, 2.0 * np.pi, 2001)[:-1]
    wavy = (0.05 + 2e-4 * np.cos(9 * turn))[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
    _named_first(model.at(_scene(Polygon(wavy))[0], part="gear", surface="board"))


@pytest.mark.parametrize("size", [0.01, 0.5])
def test_a_part_of_another_size_has_no_bound(model, size):
    bound = _named_first(model.at(_scene(box(size, size))[0], part="new", surface="board"))
    assert bound.verdict == NO_DATA
    assert "size" in bound.reason


def test_a_travel_never_pushed_has_no_bound(model):
    body = Body("part", box(0.1, 0.1), mass=0.8, support=UniformPressure(friction=0.25))
    far = push_candidates(body, contacts=4, travel=0.3)[0]
    bound = _named_first(model.at(far, part="new", surface="board"))
    assert bound.verdict == NO_DATA
    assert "travel" in bound.reason


def test_a_centre_of_mass_outside_the_support_is_refused():
    refused(_scene, box(0.1, 0.1), centre_of_mass=(0.3, 0.0), match="closer to the centroid")


def test_an_unknown_surface_and_no_surface_are_named(model):
    scene = _scene(box(0.1, 0.1))[0]
    other = model.at(scene, part="new", surface="ice").bound
    assert any("ice" in text for text in other.unseen)
    bare = model.at(scene).bound
    assert any("surface" in text and "not given" in text for text in bare.unseen)


def _two_pushers():
    scene = _scene(box(0.1, 0.1))[0]
    second = replace(scene.pushers[0], name="second", pose=(1.0, 1.0, 0.0))
    return replace(scene, pushers=(*scene.pushers, second))


@pytest.mark.parametrize("make", [two_bodies, _two_pushers, polygon_pusher])
def test_other_scenes_are_refused_by_predictions_and_proposals(model, make):
    for call in (lambda s: model.at(s), lambda s: model.next_pushes([s])):
        assert refused(call, make()).expected


def test_no_candidates_and_no_number_are_refused(model):
    for candidates, n, where in (([], 5, "candidates"), (_scene(box(0.1, 0.1)), 0, "n")):
        assert refused(model.next_pushes, candidates, n=n).where == where


def _away(scene):
    """The same push, but away from the part."""
    tip = scene.pushers[0]
    drive = LineDrive(direction=-tip.drive.direction, speed=tip.drive.speed, travel=0.04)
    return replace(scene, pushers=(replace(tip, drive=drive),))


def test_candidates_that_never_touch_are_left_out_and_refused_where_all_are(model):
    scenes = _scene(box(0.1, 0.1))
    mixed = model.next_pushes([*map(_away, scenes[:3]), *scenes[3:]], part="new", surface="board")
    assert mixed.idle == 3
    assert min(mixed.order) >= 3
    assert any("left out: 3" in text for text in mixed.gaps)
    refused(model.next_pushes, [_away(own) for own in scenes], match="do not move")


def test_simulations_that_all_fail_are_refused(model, monkeypatch):
    from fixel.parts import next_pushes

    def failed(pushes, which, values):
        ends = np.tile(pushes.start[which], (len(values), 1, 1))
        return ends, np.zeros((len(values), len(which)), bool)

    monkeypatch.setattr(next_pushes.fit, "simulated", failed)
    refused(model.next_pushes, _scene(box(0.1, 0.1)), match="fail")


def test_candidates_of_two_parts_are_refused(model):
    scenes = [_scene(box(0.1, 0.1))[0], _scene(box(0.12, 0.1))[0]]
    refused(model.next_pushes, scenes, match="outlines")
    pushes = example_parts(2, 3, seed=9)
    refused(model.next_pushes, [pushes[0], pushes[5]], match="part-1")
    refused(model.after, pushes, match="one part on one surface")


def test_repeated_pushes_count_once(model):
    one = example_parts(1, 1, seed=9)[0]
    again = [one] * 6
    targets = model.after(again)
    assert targets.left_out.pushes == 1
    from fixel.calibration.target import target_of

    assert distinct(PartPushes([target_of(own) for own in again])) == 1
    found, once = targets.distribution("board"), model.after([one]).distribution("board")
    np.testing.assert_allclose(found.covariance, once.covariance, rtol=1e-6, atol=1e-12)


def test_one_part_and_one_experiment_have_no_bound():
    for pushes in (example_parts(1, 8), example_parts(1, 1), example_parts(2, 4)):
        model = part_model(pushes, progress=False, threads=1)
        bound = _named_first(model.at(_scene(box(0.1, 0.1))[0], part="new", surface="board"))
        assert bound.verdict == NO_DATA
        assert "needs 3" in bound.reason
        found = model.next_pushes(_scene(box(0.1, 0.1)), n=2, part="new", surface="board")
        assert np.isinf(found.position).all()
        assert not np.isnan(found.shrinking).any()
        assert "inf" not in repr(found)
        assert "nan" not in repr(found)


def test_experiments_without_scenes_or_names_are_refused():
    pushes = example_parts(2, 2)
    for bad in ([], [replace(own, scene=None) for own in pushes]):
        refused(part_model, bad, progress=False)
    with pytest.raises(InvalidInput, match="names the part"):
        part_model([replace(own, conditions={}) for own in pushes], progress=False)


def test_a_disk_is_a_part_like_others(model):
    scenes = _scene(Disk(0.05))
    found = model.next_pushes(scenes, n=2, part="disk", surface="board")
    assert np.isfinite(found.shrinking).all()
    assert isinstance(found.order[0], int)


def test_a_scene_without_a_pusher_is_refused(model):
    body = Body("part", box(0.1, 0.1), mass=0.8, support=UniformPressure(friction=0.25))
    refused(model.at, Scene(bodies=(body,), duration=1.0))
