"""Predictions for new parts, on simulated parts and on real plates."""

import gzip
import shutil
from dataclasses import replace

import numpy as np
import pytest

import fixel
from fixel.calibration.target import target_of
from fixel.parts.fit import PartPushes
from fixel.parts.left_out import leave_parts_out
from fixel.testing.pushes import example_parts


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


def test_saved_and_loaded_it_predicts_the_same(model, new, tmp_path):
    again = fixel.load(model.save(tmp_path / "parts.fixel"))
    assert again == model
    assert again.at(new[0]) == model.at(new[0])


def test_the_store_continues_and_gives_the_same(tmp_path):
    parts = example_parts(3, 6)
    first = fixel.part_model(parts, store=tmp_path, progress=False)
    assert len(sorted(path.name for path in tmp_path.iterdir())) == 3
    assert fixel.part_model(parts, store=tmp_path, progress=False) == first


def test_real_plates_never_seen_are_predicted_better_than_with_even_pressure(data_root, tmp_path):
    """Three plates on one surface; the benchmark has all (docs/reproductions/new-parts.md)."""
    source, rows = data_root / "mit_push_endpoints", ("push_id", "plywood_rect", "plywood_tri")
    with gzip.open(source / "pushes.csv.gz", "rt") as table:
        some = "".join(line for line in table if line.startswith(rows))
    (tmp_path / "pushes.csv.gz").write_bytes(gzip.compress(some.encode()))
    shutil.copy(source / "shapes.json", tmp_path)
    by = {}
    for own in fixel.read_experiments(tmp_path, format="mit-push"):
        if own.scene is not None and not own.flags:
            by.setdefault(str(own.conditions["shape"]), []).append(own)
    plates = [name for name in ("rect1", "rect3", "tri1", "tri3") if len(by.get(name, ())) > 40]
    known = [own for name in plates if name != "tri3" for own in by[name][:40]]
    model = fixel.part_model(known, progress=False)
    held = by["tri3"][:60]
    ends = np.array([tuple(own.pose) for own in model.predict(held)])
    pushes = PartPushes([target_of(own) for own in held])
    every = np.arange(len(held))
    even = pushes.simulate(every, {"mu_pusher": np.full(len(held), 0.25)})[0]
    assert pushes.errors(every, ends)[:, 0].mean() < pushes.errors(every, even)[:, 0].mean()
