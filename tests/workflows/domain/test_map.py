"""Maps in memory against fits and fractions computed here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest
from tests.fixtures import project_of, refused

import fixel
from fixel.calibration.objective import Comparer, MeanSquare
from fixel.calibration.target import targets_of
from fixel.calibration.usual_parameters import search_space
from fixel.errors import InvalidInput, NotStored
from fixel.simulation import Dynamic
from fixel.testing.pushes import example_pushes
from fixel.workflows.analysis import load_analyses
from fixel.workflows.domain.evidence import ProjectRequest, load_evidence
from fixel.workflows.domain.run import DOMAIN, map_domain

SPACE = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
QUIET = {"progress": False, "threads": 1}


@pytest.fixture(scope="module")
def pushes():
    return example_pushes(10, duration=0.3)


@pytest.fixture(scope="module")
def found(pushes):
    return map_domain(
        pushes, SPACE, axes=["side"], threshold=2e-4, folds=2, confidence=0.9, **QUIET
    )


def test_held_out_errors_are_those_of_a_fit_without_the_fold(pushes, found):
    """The other fold's best friction, on a grid."""
    targets = targets_of(pushes)
    space = search_space(SPACE, targets)
    comparer = Comparer(targets, space, motion=Dynamic(), threads=1)
    grid = np.linspace(0.15, 0.35, 41)
    squares = np.array(
        [comparer.errors(np.full(41, k), grid[:, None]).error for k in range(len(targets))]
    )
    fold = found.evidence.fold
    for k in (0, 1):
        best = squares[fold != k].sum(axis=0).argmin()
        own = [found.held_out[targets[j].key] for j in np.flatnonzero(fold == k)]
        np.testing.assert_allclose(own, 1e-3 * np.sqrt(squares[fold == k, best]), rtol=0.05)


def test_a_push_has_the_share_of_its_cell(pushes, found):
    for side in ("left", "right"):
        errors = [found.held_out[p.key] for p in pushes if p.conditions["side"] == side]
        good = sum(error <= 2e-4 for error in errors)
        own = found.at(pushes[0].scene, side=side)
        exact = binomtest(good, len(errors)).proportion_ci(0.9, "exact")
        assert own.nearby == len(errors)
        assert own.probability == pytest.approx((good / own.nearby, *exact, own.nearby))
        assert own.verdict in ("trusted", "doubtful", "not trusted")
    assert found.at(pushes[0]).cell == "side = right"
    assert found.at(pushes[0].scene, side="below").verdict == "no data"
    assert found.at(pushes[0].scene, side="below").probability is None


def test_a_wider_threshold_trusts_more_without_new_fits(found):
    wide = found.within(0.1)
    assert wide.held_out == found.held_out
    assert {row[-1] for row in wide._summary().tables[0].rows} == {"trusted"}
    tight = found.within(1e-6)
    assert {row[-1] for row in tight._summary().tables[0].rows} <= {"not trusted", "doubtful"}


def test_a_map_says_what_it_rests_on(found):
    text = repr(found)
    assert "error <= 0.2 mm in 90 % of new pushes (held out, 2 folds, 10 experiments)" in text
    assert found.to_dict()["pushes"] == [5, 5]
    assert "; 1 rad counts as 35 mm" in text


def test_a_map_states_the_weight_of_angles_that_its_errors_have(pushes):
    error = MeanSquare(angle_scale=0.02)
    fit = fixel.calibrate(pushes, SPACE, error=error, verdicts=False, **QUIET)
    found = map_domain(pushes, fit, axes=["side"], folds=2, **QUIET)
    assert "; 1 rad counts as 20 mm" in repr(found)


def test_numbers_between_tried_ones_belong_to_the_nearest(pushes):
    one = map_domain(pushes, SPACE, axes=["offset_m"], folds=2, **QUIET)
    near = one.at(pushes[0].scene, offset_m=pushes[1].conditions["offset_m"] + 1e-4)
    assert near.cell == one.at(pushes[1]).cell
    assert one.at(pushes[0].scene, offset_m=0.2).verdict == "no data"


def test_a_stored_map_is_not_fitted_again(pushes, tmp_path, monkeypatch):
    known = map_domain(pushes[:6], SPACE, axes=["side"], folds=2, store=tmp_path, **QUIET)

    def never(self):
        raise AssertionError("fitted again")

    monkeypatch.setattr("fixel.domain.held_out._fold_answer", never)
    again = map_domain(pushes[:6], SPACE, axes=["side"], folds=2, store=tmp_path, **QUIET)
    assert again.held_out == known.held_out


def test_wrong_input_is_refused_before_any_fit(pushes, monkeypatch):
    def never(*_, **__):
        raise AssertionError("held out before the refusal")

    monkeypatch.setattr("fixel.workflows.domain.evidence.held_out", never)
    for options, match in (
        ({"axes": ["surface"]}, "surface"),
        ({"axes": "side"}, "a list"),
        ({"threshold": -1.0}, "threshold"),
        ({"threshold": 1e-3, "relative": 1.0}, "one of them"),
        ({"level": 1.5}, "level"),
        ({"facets": ["surface"]}, "surface"),
    ):
        refused(map_domain, pushes, SPACE, match=match, **options, **QUIET)
    refused(map_domain, [replace(pushes[0], scene=None)], SPACE, match="no scene", **QUIET)
    with pytest.raises(InvalidInput, match="needs experiments that differ in a condition"):
        map_domain(pushes[:1], SPACE, **QUIET)
    refused(fixel.map_domain, pushes, ["mu_pushr"], match="mu_pusher", **QUIET)


def test_a_project_stores_a_map_with_its_evidence(pushes, found, tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.analysis.write_picture", lambda *_: [])
    lab = project_of(tmp_path / "lab", pushes)
    kept = lab.add(found)
    (stored,) = load_analyses(lab)
    assert kept.folder == stored.folder
    assert stored.analysis.numbers["threshold"] == pytest.approx(0.2)
    asked = DOMAIN.request(stored.analysis.request)
    with lab.store() as store:
        again = load_evidence(
            ProjectRequest(lab, store, asked), stored.analysis.numbers["evidence"]
        )
        keys = {number: store.experiment(number).key for number in again.errors.ids}
    assert [keys[k] for k in again.errors.ids] == list(found.held_out)
    np.testing.assert_array_equal(again.errors.error_mm2, found.evidence.error_mm2)
    with pytest.raises(NotStored):
        project_of(tmp_path / "empty", pushes[:1]).add(found)


def test_another_call_on_the_same_folder_is_refused_with_the_difference(pushes, tmp_path):
    call = {"axes": ["side"], "folds": 2, "store": tmp_path / "fits", **QUIET}
    map_domain(pushes[:6], SPACE, **call)
    map_domain(pushes[:6], SPACE, **{**call, "axes": ["offset_m"]}, threshold=1e-3)

    others = (
        ((pushes[:7], SPACE), {}, "other experiments"),
        ((pushes[:6], {**SPACE, "mu_pusher": (0, 0.5)}), {}, "another fit: mu_pusher 0 to 1"),
        ((pushes[:6], SPACE), {"seed": 1}, "another seed: 0, but fixel needs the same .* 1 now"),
        ((pushes[:6], SPACE), {"folds": 3}, "another folds: 2"),
        ((pushes[:6], SPACE), {"motion": "quasistatic"}, "another motion: dynamic"),
    )
    for given, options, match in others:
        refused(map_domain, *given, match=match, **{**call, **options})
    with pytest.raises(InvalidInput, match="other experiments"):
        fixel.error_bound(pushes, SPACE, folds=2, store=tmp_path / "fits", **QUIET)


def test_a_folder_of_a_calibration_is_refused(pushes, tmp_path):
    (tmp_path / "job.json").write_text("{}")
    with pytest.raises(InvalidInput, match="belongs to a job"):
        map_domain(pushes[:6], SPACE, axes=["side"], folds=2, store=tmp_path, **QUIET)


def test_a_push_without_a_condition_is_refused_with_the_call_that_works(pushes, found):
    problem = str(refused(found.at, pushes[0].scene))
    assert "a push without side" in problem
    call = problem.split("as in ")[1]
    assert call == ".at(scene, side='right')"
    assert eval("found" + call, {"found": found, "scene": pushes[0].scene}).nearby == 5


def test_the_call_that_works_keeps_what_was_given(pushes):
    one = map_domain(pushes, SPACE, axes=["offset_m"], facets=["side"], folds=2, **QUIET)
    with pytest.raises(InvalidInput, match=r"\.at\(scene, side='left', offset_m=[-0-9.]+\)"):
        one.at(pushes[0].scene, side="left")


def test_an_experiment_counts_once_and_names_differ(pushes):
    """Five experiments of a cell are no ten, and namesakes are no repetitions."""
    asked = {"axes": ["side"], "threshold": 2e-4, "folds": 2, **QUIET}
    refused(map_domain, [*pushes, *pushes], SPACE, **asked, match="twice.* different names")
    second = replace(pushes[1], dataset=pushes[0].dataset, name=pushes[0].name)
    refused(map_domain, [*pushes[:1], second, *pushes[2:]], SPACE, **asked, match="twice")


@pytest.mark.parametrize("number", [np.float32(0.5), np.int64(1), np.float64(0.25)])
def test_numbers_of_numpy_fix_a_parameter(pushes, number):
    space = search_space({"mu_pusher": (0, 1), "mu_support": number}, targets_of(pushes))
    assert [u.nominal for u in space.unknowns if u.frozen] == [float(number)]


def test_a_table_of_bounds_is_no_list_of_names(pushes):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"mu_pusher": [0.1, 0.6]})
    for wrong in (table, {"mu_pusher": np.bool_(True)}, {"mu_pusher": np.array([0.1, 0.6])}):
        problem = refused(search_space, wrong, targets_of(pushes), match=r"be \(low, high\)")
        assert problem.where == "mu_pusher"
