"""Predictions of `fixel.predict` with the distribution of a part's support."""

from dataclasses import replace

import numpy as np
import pytest

from fixel import Disk, Fixel, InvalidInput, Seated, predict, push_candidates
from fixel.model import placed
from fixel.testing.pushes import example_parts
from fixel.testing.scenes import grasp


def test_what_is_unseen_comes_first(model):
    push = example_parts(1, 1, seed=9)[0]
    found = predict(push.scene, model, samples=30, progress=False)
    assert repr(found).startswith("Unseen: ")
    assert any("part" in text for text in found.unseen)
    assert found.motion == "quasistatic"


def test_parameters_and_ends_are_those_of_the_distribution(model):
    push = example_parts(1, 1, seed=9)[0]
    found = predict(push.scene, model, samples=200, model_error=False, seed=3, progress=False)
    prior = model.distribution("", "")
    assert np.mean(found.parameters["mu_pusher"]) == pytest.approx(prior.mean[0], abs=0.03)
    exact = model.at(push.scene).pose
    np.testing.assert_allclose(found.nominal[-1][:2], exact[:2], atol=0.5e-3)
    assert len(np.unique(found.ends[:, 0])) > 100


def test_the_error_of_left_out_parts_is_added_unless_it_is_switched_off(model):
    push = example_parts(1, 1, seed=9)[0]
    wide = predict(push.scene, model, samples=400, progress=False)
    narrow = predict(push.scene, model, samples=200, model_error=False, progress=False)
    assert narrow.drift is None
    # The typical error is the median distance of ends, not their deviation along an axis.
    away = np.hypot(*wide.drift[:, -1, :2].T)
    assert np.median(away) == pytest.approx(model.typical_error, rel=0.1)


def test_own_pushes_narrow_the_ends_and_stay_named(model):
    own = example_parts(1, 12, seed=9)
    before = predict(own[11].scene, model, samples=100, model_error=False, progress=False)
    after = predict(
        own[11].scene, model.after(own[:8]), samples=100, model_error=False, progress=False
    )
    assert "only 8 pushes of it" in after.unseen[0]
    spread = [np.linalg.norm(np.std(one.ends[:, :2], axis=0)) for one in (before, after)]
    assert spread[1] < spread[0]


def test_a_goal_has_a_probability(model):
    scene = push_candidates(example_parts(1, 1, seed=9)[0].scene, travel=0.04)[1]
    outline = placed(scene.bodies[0].shape.outline, scene.bodies[0].pose)
    at = (0.0, float(outline[:, 1].max()) + 0.02, 0.0)
    fixel = Fixel("peg", Disk(0.005), pose=at, friction=0.3)
    found = predict(replace(scene, fixels=(fixel,)), model, samples=20, progress=False)
    assert 0.0 <= found.probability(Seated("peg")).value <= 1.0


def test_a_pusher_that_is_not_round_is_refused(model):
    with pytest.raises(InvalidInput, match="not round"):
        predict(grasp("seated"), model, samples=5, progress=False)


def test_predictions_repeat_bit_for_bit_for_any_number_of_threads(model):
    push = example_parts(1, 1, seed=9)[0]
    one, two = (predict(push.scene, model, samples=20, threads=n, progress=False) for n in (1, 2))
    assert one.ends.tobytes() == two.ends.tobytes()
