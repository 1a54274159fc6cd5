"""Promises for the cells of a map."""

import numpy as np
import pytest
from tests.domain.worlds import evidence_of

from fixel.domain.cells import axis_of, cells_of
from fixel.domain.claim import Claim
from fixel.domain.domain import domain_map
from fixel.domain.next_experiment import predicted_cells


def _evidence(n, groups=("",), seed=0):
    """Errors that grow along an axis from 1 to 3 mm, by a tenth more or less."""
    random = np.random.default_rng(seed)
    place = np.tile(np.arange(5), n * len(groups))
    error = (1.0 + 0.5 * place) * np.exp(0.1 * random.normal(size=len(place)))
    group = tuple(np.repeat(groups, 5 * n).tolist())
    return evidence_of(error, {"offset_y_m": 1e-3 * place}, group=group)


def _cells(evidence):
    return cells_of(evidence, ["offset_y_m"], {}, {})


def test_bounds_follow_the_errors_and_hold():
    evidence = _evidence(40)
    cells = _cells(evidence)
    (bound,) = predicted_cells(evidence, cells, 0.9)
    assert bound[0] < 0.6 * bound[-1]
    new = _evidence(400, seed=1)
    inside = np.sqrt(new.error_mm2) <= bound[cells.find(new)]
    assert 0.86 < inside.mean() < 0.96


def test_each_map_has_bounds_of_its_own():
    evidence = _evidence(30, ("a", "b"))
    bounds = predicted_cells(evidence, _cells(evidence), 0.9)
    assert bounds.shape == (2, 5)
    assert np.isfinite(bounds).all()


@pytest.mark.parametrize(("level", "n", "some"), [(0.9, 2, True), (0.95, 2, False)])
def test_too_few_experiments_promise_nothing(level, n, some):
    evidence = _evidence(n)
    assert (predicted_cells(evidence, _cells(evidence), level) is not None) == some


def test_experiments_without_evidence_say_nothing():
    evidence = _evidence(40)
    error = np.sqrt(evidence.error_mm2)
    error[evidence.column("offset_y_m").index(0.0)] = np.nan
    kept = evidence_of(error, evidence.coordinates)
    assert np.isfinite(predicted_cells(kept, _cells(kept), 0.9)).all()


@pytest.mark.parametrize("repetitions", [1, pytest.param(3, marks=pytest.mark.system)])
def test_an_untried_cell_is_predicted_from_cells_and_not_from_repetitions(repetitions):
    """Each cell has an error of its own, which repetitions meet again and neighbours do not."""
    held = []
    for seed in range(15):
        random = np.random.default_rng(seed)
        places = np.arange(41)
        own = np.exp(0.5 * random.normal(size=41))
        tried = np.sort(random.permutation(41)[:25])
        at = np.repeat(tried, repetitions)
        error = own[at] * np.exp(0.05 * random.normal(size=len(at)))
        evidence = evidence_of(error, {"offset_y_m": 1e-3 * at})
        cells = cells_of(evidence, ["offset_y_m"], steps={"offset_y_m": 1e-3})
        (bound,) = predicted_cells(evidence, cells, 0.9, seed)
        number = {round(1e3 * c): k for k, c in enumerate(cells.axes[0].centres)}
        new = [p for p in places if p not in set(tried.tolist()) and p in number]
        promised = bound[[number[p] for p in new]]
        assert np.isfinite(promised).any()
        held.append((own[new] <= promised)[np.isfinite(promised)])
    assert np.concatenate(held).mean() == pytest.approx(0.91, abs=0.04)


def test_of_few_cells_repeated_nothing_follows_for_another():
    evidence = _evidence(2)  # five cells: too few to say anything of a sixth
    cells = cells_of(evidence, ["offset_y_m"], steps={"offset_y_m": 0.5e-3})
    (bound,) = predicted_cells(evidence, cells, 0.9)
    tried = np.unique(cells.find(evidence))
    assert np.isfinite(bound[tried]).all()
    assert np.isinf(np.delete(bound, tried)).all()


def test_a_side_that_was_pushed_on_another_part_only_has_no_data():
    rng = np.random.default_rng(0)
    angles = np.radians(np.arange(-165.0, 180.0, 30.0))
    at = np.concatenate((angles, angles[:9]))
    errors, group = rng.uniform(0.7, 1.0, len(at)), ("a",) * 12 + ("b",) * 9
    evidence = evidence_of(errors, {"contact_angle_rad": at}, group=group)
    cells = cells_of(evidence, ["contact_angle_rad"])
    bounds = predicted_cells(evidence, cells, 0.9)
    assert np.isfinite(bounds[0]).all()
    assert np.isfinite(bounds[1]).tolist() == 9 * [True] + 3 * [False]
    domain = domain_map(evidence, cells, "absolute", 0, bounds)
    claim = Claim(threshold=5.0, measure="absolute", level=0.9, confidence=0.9)
    verdict = domain.verdicts(claim)[1][11]
    assert verdict.colour == "no data"
    assert verdict.reason == "never tried: contact_angle 165 deg"


def test_contact_angles_on_both_sides_of_a_half_turn_are_neighbours():
    degrees = np.concatenate((np.linspace(158.0, 180.0, 20), np.linspace(-179.0, -155.0, 20)))
    axis = axis_of("contact_angle_rad", np.radians(degrees).tolist())
    assert np.degrees(axis.edges[0]) == pytest.approx(158.0)
    assert np.degrees(axis.edges[-1]) == pytest.approx(205.0)
    assert np.bincount(axis.find(np.radians(degrees).tolist())).tolist() == 8 * [5]
    assert axis.find(np.radians([0.0, 150.0, -150.0]).tolist()).tolist() == 3 * [-1]


def test_a_contact_angle_between_tried_ones_is_in_the_nearest_cell():
    axis = axis_of("contact_angle_rad", np.radians([170.0, 180.0, -170.0, -160.0]).tolist())
    asked = np.radians([172.0, 178.0, -178.0, -172.0, -163.0, -150.0, 160.0])
    assert [axis.nearest(angle) for angle in asked.tolist()] == [0, 1, 1, 2, 3, -1, -1]
