"""Held-out errors, what fits start from, own bests, the noise of the measurement."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import calibration_record, project_of, refused

from fixel.calibration.objective import Comparer, Evaluation, MeanSquare, RootMeanSquare
from fixel.calibration.target import targets_of
from fixel.calibration.usual_parameters import searched_unknowns
from fixel.domain.cells import coordinates_of, label_of
from fixel.domain.held_out import Apart, CalibrationModel, held_out, noise_floor, stepper_for
from fixel.errors import InvalidInput
from fixel.io.array_bytes import ResultCache
from fixel.model.space import ParameterSpace
from fixel.sampling.published import thesis_plan
from fixel.simulation import Dynamic
from fixel.simulation.stepping import Adaptive
from fixel.testbed.simulated import SimulatedTestbed
from fixel.workflows.domain.evidence import ProjectRequest, own_best, stored_model
from fixel.workflows.domain.run import DOMAIN, map_stored

METHOD = {"how": "alone", "error": "mean-square", "error.angle_scale": 0.035, "motion": "dynamic"}


def planned(n=4):
    return thesis_plan().experiments[:n]


def model(targets, names=("mu_pusher",), error=None):
    space = ParameterSpace(
        unknowns=tuple(searched_unknowns(names, [t.case.scene for t in targets]))
    )
    return CalibrationModel(space=space, motion=Dynamic(), error=error or MeanSquare())


def test_on_a_perfect_bench_held_out_errors_are_none_and_the_truth_is_found(tmp_path):
    targets = targets_of(SimulatedTestbed.ideal().run(planned()))
    values = []
    one = model(targets, ["mu_pusher=0:1:0.3"])
    found = held_out(
        targets, one, Apart(folds=2), ResultCache(tmp_path).get, lambda *done: values.append(done)
    )
    assert values == [(1, 2), (2, 2)]
    assert np.sqrt(found.error).max() < 0.02  # [mm]
    assert sorted(np.bincount(found.fold).tolist()) == [2, 2]
    for point in found.points.values():
        assert point == pytest.approx([0.2], abs=2e-3)
    again = held_out(targets, one, Apart(folds=2), ResultCache(tmp_path).get)
    np.testing.assert_array_equal(found.error, again.error)


def test_parameters_of_an_experiment_are_found_without_it():
    """A bench on which one experiment is wild: it must not lower its own error."""
    targets = targets_of(SimulatedTestbed.ideal().run(planned()))
    wild = targets[1]._replace(pose=targets[1].pose + np.array([0.02, 0.0, 0.0]))
    changed = [targets[0], wild, *targets[2:]]
    plain = held_out(targets, model(targets), Apart(folds=4), ResultCache(None).get)
    found = held_out(changed, model(changed), Apart(folds=4), ResultCache(None).get)
    own = f"all, fold {plain.fold[1] + 1}"
    assert found.points[own] == plain.points[own]
    assert np.sqrt(found.error[1]) == pytest.approx(20.0, rel=0.05)


def test_a_calibration_in_other_units_is_refused():
    targets = targets_of(SimulatedTestbed.ideal().run(planned(1)))
    refused(model, targets, error=RootMeanSquare(), match="mean-square or end-pose")


def test_a_start_that_some_group_cannot_have_is_refused_before_any_fit(tmp_path, monkeypatch):
    """Fits of the other groups took minutes before."""
    mixed = [
        target._replace(conditions={**target.conditions, "kind": "even" if k > 1 else "tripod"})
        for k, target in enumerate(targets_of(SimulatedTestbed.ideal().run(planned(5))))
    ]
    one = model(mixed)
    simulated = Comparer.errors

    def jammed(self, which, points):
        found = simulated(self, which, points)
        error = np.where(which > 1, np.inf, found.error)
        reasons = ("", "", "jammed", "too late", "jammed")
        return Evaluation(error, [reasons[k] for k in which.tolist()])

    monkeypatch.setattr(Comparer, "errors", jammed)

    def never(self):
        raise AssertionError("a fit before the refusal")

    monkeypatch.setattr("fixel.domain.held_out._fold_answer", never)
    with pytest.raises(InvalidInput, match="it: even: 2 x jammed; 1 x too late"):
        held_out(mixed, one, Apart(("kind",), "", 2, 0), ResultCache(tmp_path).get)


def test_errors_relative_to_own_bests_are_refused_before_any_fit(tmp_path, monkeypatch):
    project = project_of(tmp_path / "lab", SimulatedTestbed.ideal().run(planned(3)))

    def never(*_):
        raise AssertionError("held out before the refusal")

    monkeypatch.setattr("fixel.workflows.domain.evidence.held_out", never)
    refused(map_stored, project, relative=1.0, match="calibrate them first")


def test_own_bests_under_another_model_say_nothing(tmp_path):
    project = project_of(tmp_path / "lab", SimulatedTestbed.ideal().run(planned(3)))
    with project.store() as store:
        targets = targets_of(store.experiment(k) for k in (1, 2, 3))
        refused(own_best, store, [1, 2, 3], model(targets), match="calibrate them first")
        for k, change in enumerate(({}, {"motion": "quasistatic"}, {"error.angle_scale": 0.05})):
            own = calibration_record({k + 1: 0.5}, {"mu_pusher": 0.2}, method=METHOD | change)
            store.add_calibration(own)
        best, notes = own_best(store, [1, 2, 3], model(targets))
    assert best[0] == 0.5
    assert np.isnan(best[1:]).all()
    assert notes[0] == ""
    assert "motion model (quasistatic)" in notes[1]
    assert "50 mm/rad" in notes[2]


def test_fits_start_at_the_stored_calibration(tmp_path):
    project = project_of(tmp_path / "lab", SimulatedTestbed.ideal().run(planned(2)))
    with project.store() as store:
        targets = targets_of(store.experiment(k) for k in (1, 2))
        request = ProjectRequest(project, store, DOMAIN.request({}))
        assert stored_model(request, targets).calibration is None
        method = METHOD | {"how": "direct minimisation", "motion": "quasistatic"}
        record = calibration_record({1: 1.0, 2: 1.0}, {"mu_pusher": 0.37}, method=method)
        number = store.add_calibration(record)
        started = stored_model(request, targets)
    assert started.calibration == number
    space = started.model.space
    assert dict(zip(space.labels, space.nominal, strict=True))["mu_pusher"] == 0.37
    assert started.model.motion.name == "quasistatic"


def test_the_noise_of_the_measurement_bounds_thresholds():
    bench = replace(SimulatedTestbed.ideal(), position_noise=1e-3, angle_noise=0.01)
    repeated = [
        replace(planned(1)[0], name=f"run {r}", conditions={"axis": "x", "repetition": float(r)})
        for r in range(4)
    ]
    targets = targets_of(bench.run(repeated))
    truth = np.sqrt(2.0 * 1.0**2 + 0.35**2)
    floor, source = noise_floor(targets, 0.035)
    assert source == "repetitions"
    assert floor == pytest.approx(truth, rel=0.1)
    floor, source = noise_floor(targets[:1], 0.035)
    assert source == "scatter from frame to frame"
    assert floor == pytest.approx(truth, rel=0.15)
    assert noise_floor([t._replace(pose=t.pose[-1:]) for t in targets[:1]], 0.035) == (None, "")


def test_axes_are_conditions_and_geometry_but_nothing_a_laboratory_cannot_know():
    targets = targets_of(SimulatedTestbed().run(planned(2)))
    rows = [coordinates_of(target) for target in targets]
    assert rows[0]["travel_m"] == pytest.approx(0.15, rel=2e-3)
    assert rows[0]["push_angle_rad"] == pytest.approx(0.0, abs=1e-9)
    assert not any(name.startswith("truth_") or name == "repetition" for name in rows[0])
    assert label_of({"a": "x", "b": 2.0}, ("a", "b")) == "x 2"


def test_few_or_long_recordings_are_simulated_with_adaptive_steps():
    targets = targets_of(SimulatedTestbed.ideal().run(planned(1)))
    assert stepper_for(targets) == Adaptive()
    assert stepper_for(targets * 1001) == Adaptive()
    scene = replace(targets[0].case.scene, fixels=())
    end = targets[0].case._replace(scene=scene, times=np.array([5.0]))
    short = targets[0]._replace(case=end, pose=targets[0].pose[-1:])
    assert stepper_for([short] * 1001).first_step == pytest.approx(0.1)
