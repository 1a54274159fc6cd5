"""Domains grown from stored calibrations, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused
from tests.laboratories import campaign
from tests.web.bench import Bench
from tests.workflows.growing import (
    NAMES,
    comparer_of,
    explored,
    made_up_points,
    performed,
    planned,
    project_with,
    record,
)

from fixel.calibration.result import FitKind
from fixel.database.project import Project
from fixel.domain.growth import ROWS, STORED, domain
from fixel.errors import InvalidInput, StoreRefused
from fixel.web.views.calibration_views import list_calibrations
from fixel.workflows.analysis import load_analyses
from fixel.workflows.calibration.stored import load_values, stored_calibration
from fixel.workflows.capabilities import run
from fixel.workflows.growth import report
from fixel.workflows.growth.explore import explore, threshold_in
from fixel.workflows.growth.run import GROWTH


@pytest.fixture(scope="module")
def experiments():
    return performed(planned())


@pytest.fixture(scope="module")
def comparer(experiments):
    return comparer_of(experiments)


@pytest.fixture(scope="module")
def points():
    return made_up_points(21)


@pytest.fixture(scope="module")
def errors(comparer, points):
    return comparer.errors(np.arange(21), points).error


@pytest.fixture
def lab(tmp_path):
    return Project(campaign(tmp_path / "lab")), list(range(1, 22))


def _place(experiments):
    """Row of each place of the plan among the experiments."""
    found = {}
    for k, experiment in enumerate(experiments):
        own = experiment.conditions
        name = own["axis"] if own["axis"] == "nominal" else f"{own['axis']}{own['step']:g}"
        found[name] = k
    return found


def test_means_are_kept_once_with_weights_and_errors(lab, experiments, points, errors):
    project, ids = lab
    with project.store() as store:
        first = explored(store)
        assert len(first.added) == 5
        assert explored(store).added == []
        step = store.calibration(first.added[0])
    at = _place(experiments)
    rows = [at[place.name] for place in domain(1)]
    share = (1.0 / errors[rows]) / (1.0 / errors[rows]).sum()
    assert [m.experiment_id for m in step.members] == [ids[k] for k in rows]
    np.testing.assert_allclose([m.weight for m in step.members], share)
    np.testing.assert_allclose([step.parameters[name] for name in NAMES], share @ points[rows])
    assert step.max_error_mm2 == first.growth.matrix[0][1]
    assert step.method["how"] == FitKind.GROWTH
    with project.store() as store:
        named = {own.id: own.name for own in list_calibrations(store) if own.id in first.added}
    assert sorted(named) == sorted(first.added)
    assert all(f"step {k}" in named[number] for k, number in enumerate(first.added, start=1))
    with pytest.raises(StoreRefused, match=r"a mean of others.*fixel compare"):
        stored_calibration(project, first.added[0])
    # A mean has no intervals, of any level.
    bench = Bench(project.folder)
    page = bench.client.get(f"/calibrations/{first.added[0]}")
    bench.close()
    assert page.status_code == 200
    assert "interval" in page.text
    assert "unknown level" not in page.text
    # Means on the way are no answer to "the calibration of this project".
    with project.store() as store:
        assert load_values(store).id not in first.added


def test_a_stored_joint_calibration_counts_before_the_mean(lab, experiments):
    project, ids = lab
    at = _place(experiments)
    members = [ids[at[place.name]] for place in domain(1)]
    values = {"mu_pusher": 0.2, "tripod_radius": 0.04}
    other = {"mu_pusher": 0.9, "tripod_radius": 0.04}
    with project.store() as store:
        number = store.add_calibration(record(members, values, [1.0] * 5, how="direct"))
        store.add_calibration(record(members, other, [2.0] * 5, how="direct"))
        store.add_calibration(record(members, other, [0.1] * 5, how="direct", motion="dynamic"))
        found = explored(store)
    step = found.growth.steps[0][1]
    assert (step.used.source, step.used.calibration) == (STORED, number)
    np.testing.assert_array_equal(step.used.point, [0.2, 0.04])
    assert len(found.added) == 4


def test_the_best_of_several_single_calibrations_counts(lab, points, errors):
    project, ids = lab
    worse, better = made_up_points(2, seed=9)
    with project.store() as store:
        store.add_calibration(
            record([ids[0]], dict(zip(NAMES, worse, strict=True)), [errors[0] + 1])
        )
        number = store.add_calibration(
            record([ids[1]], dict(zip(NAMES, better, strict=True)), [errors[1] / 2])
        )
        found = explored(store)
    np.testing.assert_array_equal(found.stored.singles.points[0], points[0])
    assert found.stored.best[1].id == number


def test_an_experiment_that_was_not_performed_leaves_cells_empty(
    tmp_path, experiments, points, errors
):
    at = _place(experiments)
    rows = [k for k in range(21) if k != at["theta3"]]
    project, _ = project_with(
        tmp_path / "lab", [experiments[k] for k in rows], points[rows], errors[rows]
    )
    with project.store() as store:
        found = explored(store)
    assert [x is None for x in found.growth.matrix[0]] == [False] * 3 + [True] * 3
    assert any("not performed: theta3" in sentence for sentence in found.warnings)
    table = report.matrix_table(found)
    assert (table.rows[0][4], table.cells[0][4]) == (None, "-")
    assert table.rows[0][1] == found.growth.matrix[0][0]  # not rounded
    assert report.numbers(found)["groups"][0]["largest_error"][3:] == [None] * 3
    assert "at step 2" in report.report_of(found).analysis.headline[0]


def test_of_repetitions_the_first_counts(lab, experiments):
    project, ids = lab
    again = replace(
        experiments[0], name="again", conditions={**experiments[0].conditions, "repetition": 2.0}
    )
    with project.store() as store:
        store.add_experiment(again)
        found = explored(store)
    assert found.samples.ids == ids
    assert any("1 repetition skipped" in sentence for sentence in found.warnings)


def test_stored_errors_that_are_not_met_again_are_reported(tmp_path, experiments, points, errors):
    project, _ = project_with(tmp_path / "lab", experiments, points, 2.0 * errors)
    with project.store() as store:
        warnings = explored(store).warnings
    assert any("does not reproduce" in sentence for sentence in warnings)


def test_searches_that_got_stuck_are_reported(tmp_path, experiments, points, errors, comparer):
    # Two experiments with one set; the first has a poor one of its own, the second its neighbour's.
    at = _place(experiments)
    stuck, good = at["x1"], at["nominal"]
    own = points.copy()
    own[[stuck, good]] = [0.9, 0.02], [0.2, 0.04]
    less = comparer.errors(np.arange(21), own).error
    less[good] = 1e-9  # it rules every mean
    project, _ = project_with(tmp_path / "lab", experiments, own, less)
    with project.store() as store:
        (values,) = (w for w in explored(store).warnings if "--mode campaign" in w)
    under = comparer.errors(np.array([stuck]), np.array([[0.2, 0.04]])).error[0]
    assert under < 0.5 * less[stuck]
    assert "experiments have less than half" in values


@pytest.mark.system
def test_the_analysis_is_kept_with_pictures_and_the_banner(lab):
    project, _ = lab
    asked = GROWTH.request({"limit": "2.0", "sizes": ("y=3",)})
    run(GROWTH, asked, project.folder, progress=False)
    (done,) = load_analyses(project, "growth")
    with project.store() as store:
        found = explore(store, asked)
    assert {shown.name for shown in done.analysis.pictures} == {
        "growth_matrix", "growth_steps", "axis_square_x", "axis_square_y", "axis_square_theta",
    }  # fmt: skip
    assert found.samples.banner.startswith("SIMULATED by")
    assert any("simulated, not recorded" in sentence for sentence in done.analysis.warnings)
    assert done.analysis.numbers["groups"][0]["largest_error"] == found.growth.matrix[0]
    assert [a["size"] for a in done.analysis.numbers["axes"] if a["axis"] == "y"] == [3]
    np.testing.assert_array_equal(done.arrays["largest_error"], found.growth.matrix)


# --- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("changes", "message"), [
    ({}, r"(?s)21 of 21.*fixel calibrate --mode each"),
    ({"conditions": {}}, "fixel testbed run"),
])  # fmt: skip
def test_experiments_that_are_no_calibrated_campaign_are_refused(
    tmp_path, experiments, changes, message
):
    chosen = [replace(experiments[0], **changes)] if changes else experiments
    project, _ = project_with(tmp_path / "lab", chosen)
    with project.store() as store, pytest.raises(InvalidInput, match=message):
        explored(store)


def test_experiments_that_lack_one_are_named(tmp_path, experiments, points, errors):
    project, _ = project_with(tmp_path / "lab", experiments[:20], points[:20], errors[:20])
    with project.store() as store:
        store.add_experiment(experiments[20])
        refused(explored, store, match=f"1 of 21 experiments: {experiments[20].key}")


@pytest.mark.parametrize(
    "change",
    [{"motion": "dynamic"}, {"error": "robust"}, {"error.angle_scale": 0.05}, {"error_unit": "mm"}],
)
def test_members_of_another_method_are_named(tmp_path, experiments, points, errors, change):
    project, _ = project_with(tmp_path / "lab", experiments[:20], points[:20], errors[:20])
    with project.store() as store:
        number = store.add_experiment(experiments[20]).id
        values = dict(zip(NAMES, points[20].tolist(), strict=True))
        store.add_calibration(record([number], values, [1.0], **change))
        refused(explored, store, match=rf"(?s)20 of 21.*1 of 21.*{experiments[20].key}")


def test_of_two_whole_methods_the_newest_or_the_one_asked_for(lab, points, errors):
    project, ids = lab
    with project.store() as store:
        for number, point, error in zip(ids, points.tolist(), errors.tolist(), strict=True):
            values = dict(zip(NAMES, point, strict=True))
            store.add_calibration(record([number], values, [error], motion="first-order"))
        newest = explored(store)
        asked = explored(store, motion="quasistatic")
    assert newest.stored.method.motion == "first-order"
    assert any("--motion" in sentence for sentence in newest.warnings)
    assert asked.stored.method.motion == "quasistatic"
    assert asked.stored.warnings == []


def test_a_group_without_its_nominal_experiment_is_refused(tmp_path, experiments, points, errors):
    rows = [k for k in range(21) if k != _place(experiments)["nominal"]]
    project, _ = project_with(
        tmp_path / "lab", [experiments[k] for k in rows], points[rows], errors[rows]
    )
    with project.store() as store, pytest.raises(InvalidInput, match="no nominal experiment"):
        explored(store)


def test_two_data_sets_at_one_place_are_refused(lab, experiments):
    project, _ = lab
    with project.store() as store:
        store.add_experiment(replace(experiments[3], dataset="other"))
        refused(explored, store, match="--dataset other")


@pytest.mark.parametrize(("text", "unit", "value"), [
    ("", "mm^2", 5.0),
    ("", "mm", np.sqrt(5.0)),
    ("4", "mm", 4.0),
    ("2.2mm", "mm^2", 4.84),
    ("4 mm2", "mm", 2.0),
    ("3mm^2", "mm^2", 3.0),
])  # fmt: skip
def test_thresholds_are_errors_or_distances(text, unit, value):
    assert threshold_in(text, unit) == pytest.approx(value)


@pytest.mark.parametrize("text", ["much", "-1", "nan", "2 cm", "1e999"])
def test_what_is_no_threshold_is_refused(text):
    refused(threshold_in, text, "mm^2", match="limit")


def test_places_cover_the_plan(experiments):
    assert set(_place(experiments)) == {place.name for place in ROWS}
