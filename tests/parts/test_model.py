"""Predictions for new parts, on simulated parts and on real plates."""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fixel
from fixel.domain.error_bound import min_experiments
from fixel.parts.fit import PartPushes
from fixel.parts.left_out import leave_parts_out
from fixel.testing.pushes import example_parts

DATA = Path(os.environ.get("FIXEL_DATA", "no data")) / "mit_push_endpoints"


@pytest.fixture(scope="module")
def model():
    return fixel.part_model(example_parts(4, 14), progress=False)


@pytest.fixture(scope="module")
def new():
    return [
        replace(own, conditions={**own.conditions, "part": "new"})
        for own in example_parts(1, 14, seed=7)
    ]


def test_the_part_is_named_as_unseen_before_anything_else(model, new):
    found = model.at(new[0])
    assert found.bound.unseen[0].startswith("part 'new': no experiment with it")
    assert repr(found).startswith("unseen: part 'new'")
    assert found.bound.verdict == "unseen"


def test_both_bounds_are_shown_and_the_cautious_one_is_not_narrower(model, new):
    for found in model.predict(new):
        bound = found.bound
        assert 0.0 < bound.position <= bound.cautious_position
        assert 0.0 < bound.angle <= bound.cautious_angle
        assert bound.proved == pytest.approx(0.8)


def test_a_surface_never_pushed_gets_the_cautious_bound_alone(model, new):
    scene = new[0].scene
    known, other = (model.at(scene, part="new", surface=own).bound for own in ("board", "ice"))
    assert any("surface 'ice': no experiment with it" in text for text in other.unseen)
    assert other.position == other.cautious_position == known.cautious_position
    assert other.angle == other.cautious_angle > known.angle
    assert "no surface was left out" in other.reason


def test_pushes_of_the_part_improve_its_predictions(model, new):
    def error(own):
        ends = np.array([tuple(found.pose) for found in own.predict(new[7:])])
        true = np.array([push.trajectory.pose[-1] for push in new[7:]])
        return np.hypot(*(ends - true)[:, :2].T).mean()

    after = model.after(new[:7])
    assert error(after) < error(model)
    assert after.at(new[8]).bound.unseen[0] == "part 'new': only 7 pushes of it"
    assert after.left_out.pushes == 5


def test_one_by_one_is_as_all_together(model, new):
    together = model.predict(new[:4])
    for own, found in zip(new[:4], together, strict=True):
        assert model.at(own).pose == pytest.approx(found.pose, abs=1e-12)


def test_the_left_out_part_has_no_influence_on_its_own_prediction(model):
    """Absurd values of a part leave its own prediction as it is, and change those of others."""
    wild = [
        own._replace(values=own.values + 5.0) if own.part == "part-2" else own for own in model.fits
    ]
    before, after = (leave_parts_out(model._groups, fits, 1.0) for fits in (model.fits, wild))
    own = np.array([part == "part-2" for part in before.part])
    np.testing.assert_array_equal(before.errors[own], after.errors[own])
    assert (before.errors[~own] != after.errors[~own]).any()


def fixel_target(own):
    from fixel.calibration.target import target_of

    return target_of(own)


def test_saved_and_loaded_it_predicts_the_same(model, new, tmp_path):
    again = fixel.load(model.save(tmp_path / "parts.fixel"))
    assert again == model
    assert again.at(new[0]) == model.at(new[0])


@pytest.mark.parametrize(("level", "n"), [(0.9, 9), (0.95, 19), (0.8, 4), (0.5, 1)])
def test_parts_that_prove_a_level(level, n):
    """n parts prove n / (n + 1) at most."""
    assert min_experiments(level) == n
    assert n / (n + 1) >= level - 1e-12 > (n - 1) / n - 1e-9 or math.isclose(n / (n + 1), level)


def test_the_store_continues_and_gives_the_same(tmp_path):
    parts = example_parts(3, 6)
    first = fixel.part_model(parts, store=tmp_path, progress=False)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert len(kept) == 3
    assert fixel.part_model(parts, store=tmp_path, progress=False) == first


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the MIT push data")
def test_real_plates_never_seen_are_predicted_better_than_with_even_pressure():
    """Three plates on one surface; the benchmark has all (docs/reproductions/new-parts.md)."""
    found = fixel.read_experiments(DATA)
    some = [
        own
        for own in found
        if own.conditions["surface"] == "plywood" and own.scene is not None and not own.flags
    ]
    by = {}
    for own in some:
        by.setdefault(str(own.conditions["shape"]), []).append(own)
    plates = [name for name in ("rect1", "rect3", "tri1", "tri3") if len(by.get(name, ())) > 40]
    known = [own for name in plates if name != "tri3" for own in by[name][:40]]
    model = fixel.part_model(known, progress=False)
    held = by["tri3"][:60]
    ends = np.array([tuple(own.pose) for own in model.predict(held)])
    pushes = PartPushes([fixel_target(own) for own in held])
    every = np.arange(len(held))
    even = pushes.simulate(every, {"mu_pusher": np.full(len(held), 0.25)}).pose
    assert pushes.errors(every, ends)[:, 0].mean() < pushes.errors(every, even)[:, 0].mean()
