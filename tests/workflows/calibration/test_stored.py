"""Stored calibrations as models to simulate with."""

import pytest
from tests.fixtures import calibration_record, project_of, refused

import fixel
from fixel.calibration.objective import Robust, RootMeanSquare
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.model import Parameters
from fixel.model.records import Estimate
from fixel.model.selection import ExperimentQuery
from fixel.model.space import split_label
from fixel.sampling.published import thesis_plan
from fixel.simulation import QuasiStatic
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.pushes import example_pushes
from fixel.workflows.calibration.stored import load_values, newest_calibration, searched_space
from fixel.workflows.compare import compare_stored


@pytest.fixture
def store(tmp_path):
    planned = thesis_plan().experiments[:2]
    with project_of(tmp_path / "lab", SimulatedTestbed.ideal().run(planned)).store() as store:
        yield store


def _record(members, **changes):
    return calibration_record(dict.fromkeys(members, 1.0), {"mu_pusher": 0.2}, **changes)


def test_values_of_an_experiment_are_those_shared_and_its_own(store):
    estimates = [
        Estimate(label=f"mu_fixel[shape={shape}]", unit="-", value=value)
        for shape, value in (("square", 0.3), ("pentagon", 0.4))
    ]
    number = store.add_calibration(_record([1, 2], estimates=estimates))
    one = load_values(store, number)
    assert one.values({"shape": "square"}) == {"mu_pusher": 0.2, "mu_fixel": 0.3}
    assert one.values({"shape": "disc"}) == {"mu_pusher": 0.2}
    assert one.members == {1, 2}


def test_loads_of_support_points_are_parameters_too(store):
    known = Parameters(mu_pusher=0.2, load_1=2.0)
    number = store.add_calibration(_record([1], parameters=known))
    found = load_values(store, number).values_for(store.experiment(1))
    assert found == {"mu_pusher": 0.2, "load_1": 2.0}


def test_the_method_is_that_of_the_calibration(store):
    method = {"motion": "quasistatic", "error": "root-mean-square", "error.angle_scale": 0.5}
    one = load_values(store, store.add_calibration(_record([1], method=method)))
    assert one.motion == QuasiStatic()
    assert one.error == RootMeanSquare(angle_scale=0.5)


def test_the_options_of_an_error_are_kept(store):
    method = {"error": "robust", "error.angle_scale": 0.5, "error.distance": 5e-4}
    one = load_values(store, store.add_calibration(_record([1], method=method)))
    assert one.error == Robust(angle_scale=0.5, distance=5e-4)


def test_the_newest_for_several_experiments_counts(store):
    joint = store.add_calibration(_record([1, 2], method={"how": "direct minimisation"}))
    alone = store.add_calibration(_record([2], method={"how": "alone"}))
    assert load_values(store).id == joint
    assert newest_calibration(store, experiment=2) == joint
    assert load_values(store, alone).id == alone


def test_means_that_a_growing_domain_made_count_only_by_their_id(store):
    alone = store.add_calibration(_record([2], method={"how": "alone"}))
    mean = store.add_calibration(_record([1, 2], method={"how": "domain growth"}))
    assert load_values(store).id == alone
    assert load_values(store, mean).id == mean


def test_without_any_the_next_command_is_named(store):
    refused(load_values, store, match="fixel calibrate")


def test_labels_come_apart():
    assert split_label("mu_pusher") == ("mu_pusher", {})
    assert split_label("mu[a=b, c=0.5]") == ("mu", {"a": "b", "c": "0.5"})


@pytest.mark.parametrize("verdicts", [True, False])
def test_a_stored_misfit_simulates_as_the_one_in_memory(tmp_path, verdicts):
    pushes = list(SimulatedTestbed(seed=4).run(thesis_plan().experiments[2:122:40]))
    space = {f"mu_pusher[experiment={own.key}]": (0, 1) for own in pushes}
    fit = fixel.calibrate(
        pushes,
        space | {"tripod_radius": (0.02, 0.075)},
        motion="quasistatic",
        verdicts=verdicts,
        store=project_of(tmp_path / "lab", pushes),
        progress=False,
        threads=1,
    )
    quoted = {label: own.value for label, own in fit.estimates.items()}
    assert verdicts == any(abs(quoted[label] - fit[label]) > 0.02 for label in space)
    project, (number,) = fixel.Project(tmp_path / "lab"), fit.run.ids
    with project.store() as store:
        one = load_values(store, number)
        members = {member.experiment_id: member.error_mm2 for member in one.record.members}
        stored = {k: store.experiment(k) for k in members}
        (summary,) = store.calibration_summaries().values()
    assert summary.estimates == one.record.estimates
    start = searched_space(project, one, [])
    assert start.values(start.nominal) == dict(fit)
    for k, error in members.items():
        assert one.values_for(stored[k]) == fit.values_for(stored[k])
        # The error that the search has minimised, simulated again from what the project has.
        run = compare_stored(project, str(k), calibration=number).run
        assert run.error_mm2 == pytest.approx(error, rel=1e-2)
        (row,) = fixel.compare([stored[k]], {"fit": fit}, progress=False).of("fit")
        assert run.error_mm2 == row.run.error_mm2


def test_a_project_opened_by_its_url_stores_calibrations_and_maps(tmp_path):
    """The project has no settings file: its media are elsewhere, as with a server."""
    lab = project_of(tmp_path / "lab", example_pushes(6, duration=0.2))
    own = Project(lab.url, media=tmp_path / "elsewhere" / "media")
    space, options = {"mu_pusher": (0, 1), "tripod_radius": 0.038}, {"progress": False}
    fit = fixel.calibrate(own.experiments(), space, store=own, verdicts=False, **options)
    assert fit.run.ids == (*lab.calibrations,) == (1,)
    found = own.map_domain(fit=1, axes=["side"], threshold=2e-3, folds=2, **options)
    assert [one.analysis.kind for one in own.analyses] == ["domain"]
    assert len(found.evidence) == 6


def test_a_simulation_of_another_scene_is_not_stored_as_one_of_the_experiment(tmp_path):
    """It would be listed as the error before a calibration, with nominal values."""
    lab, other = project_of(tmp_path / "lab", example_pushes(1, duration=0.2)), "bodies.0.mass"
    with pytest.raises(InvalidInput, match=f"save: found another scene .{other}=3.0"):
        compare_stored(lab, "1", parameters={other: 3.0}, save=True)
    assert compare_stored(lab, "1", parameters={other: 3.0}).simulation_id is None
    on_table = lab.seen_through(lambda experiment: experiment)
    refused(compare_stored, on_table, "1", save=True, match="on a mapped table")
    assert compare_stored(lab, "1", save=True).simulation_id == 1


def test_the_listed_nominal_error_is_that_of_the_default_motion_model(tmp_path):
    lab = project_of(tmp_path / "lab", example_pushes(1, duration=0.2))
    error, other = (
        compare_stored(lab, "1", motion=name, save=True).run.error_mm2
        for name in (None, "quasistatic")
    )
    with lab.store() as store:
        (found,) = store.experiments(ExperimentQuery(), details=True).details
    assert found.before_mm2 == error != other
