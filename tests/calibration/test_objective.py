"""Errors of simulations of experiments: by hand, by kind, and whatever else is in the call."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import Dynamic, InvalidInput, Parameters, SupportPoints, Trajectory, simulate
from fixel.calibration.objective import (
    Comparer,
    EndPose,
    MeanSquare,
    Robust,
    RootMeanSquare,
    combined_errors,
)
from fixel.calibration.study import at_points, run_study
from fixel.calibration.target import target_of, targets_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed

PLANNED = thesis_plan().experiments


@pytest.fixture(scope="module")
def experiments():
    chosen = [PLANNED[k] for k in (0, 1, 7, 230)]
    return list(SimulatedTestbed.ideal().run(chosen))


def _space(*names, **changes):
    bounds = {
        "mu_pusher": (0.0, 1.0, 0.2),
        "mu_fixel": (0.0, 1.0, 0.2),
        "tripod_radius": (0.001, 0.06, 0.03),
    }
    return ParameterSpace(
        unknowns=[
            Unknown(name=n, low=bounds[n][0], high=bounds[n][1], nominal=bounds[n][2], **changes)
            for n in names or bounds
        ]
    )


def members_at(comparer, points):
    """Return errors (k, n_member) at points (k, n_free), and reasons of failures."""
    study = at_points(range(len(comparer.targets)), points)
    return run_study(study, lambda ask: comparer.errors(ask.which, ask.points))


DIFFERENCE = np.array([[[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.1]], [[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]]])


@pytest.mark.parametrize(("error", "expected"), [
    (MeanSquare(), [(25.0 + 3.5**2) / 2, 0.5]),
    (MeanSquare(angle_scale=0.01), [(25.0 + 1.0) / 2, 0.5]),
    (RootMeanSquare(), [math.sqrt((25.0 + 3.5**2) / 2), math.sqrt(0.5)]),
    (EndPose(), [3.5**2, 1.0]),
    (Robust(distance=1e-3),
     [(math.sqrt(26.0) - 1.0) + (math.sqrt(1 + 3.5**2) - 1.0), math.sqrt(2.0) - 1.0]),
], ids=lambda x: getattr(x, "name", ""))  # fmt: skip
def test_errors_by_hand(error, expected):
    assert error.of(DIFFERENCE) == pytest.approx(expected, rel=1e-12)


def test_the_truth_has_no_error_and_others_have(experiments):
    comparer = Comparer(targets_of(experiments), _space(), motion=Dynamic())
    truth = np.array([0.2, 0.2, 0.0409])
    which = np.arange(3)
    at_truth = comparer.errors(which, np.tile(truth, (3, 1)))
    elsewhere = comparer.errors(which, np.tile([0.6, 0.2, 0.02], (3, 1)))
    assert (at_truth.error < 1e-3).all()
    assert (elsewhere.error > 1.0).any()
    assert at_truth.reasons == [""] * 3


def test_as_a_single_simulation(experiments):
    experiment = experiments[1]
    values = {"mu_pusher": 0.4, "mu_fixel": 0.1, "tripod_radius": 0.05}
    target = target_of(experiment)
    comparer = Comparer([target], _space(), motion=Dynamic())
    error = comparer.errors(np.zeros(1, int), np.array([list(values.values())])).error[0]
    run = simulate(
        experiment.scene,
        Parameters(values),
        duration=float(target.case.times[-1]),
        output_interval=float(target.case.times[0]) / 2,
    )
    difference = run[experiment.object_name].at(target.case.times) - target.pose
    assert error == pytest.approx(MeanSquare().of(difference[None])[0], rel=2e-2)


def test_bits_depend_on_neither_company_nor_threads(experiments):
    targets = targets_of(experiments)
    points = np.array([[0.1, 0.3, 0.05], [0.3, 0.1, 0.02]])
    together = members_at(Comparer(targets, _space(), threads=2), points)[0]
    for k, target in enumerate(targets):
        alone = members_at(Comparer([target], _space(), threads=1), points)[0]
        assert (alone[:, 0] == together[:, k]).all()


def test_a_value_shared_by_some_experiments_changes_only_these(experiments):
    targets = targets_of(experiments)
    shape = Unknown(name="tripod_radius", low=0.001, high=0.06, nominal=0.03)
    shared = ParameterSpace(
        unknowns=[
            *_space("mu_pusher").unknowns,
            *(replace(shape, where={"shape": name}) for name in ("square", "pentagon")),
        ]
    )
    assert shared.labels[1:] == ("tripod_radius[shape=square]", "tripod_radius[shape=pentagon]")
    comparer = Comparer(targets, shared)
    point = np.array([[0.2, 0.03, 0.03], [0.2, 0.03, 0.05]])
    found, _ = members_at(comparer, point)
    assert (found[0, :3] == found[1, :3]).all()
    assert found[0, 3] != found[1, 3]
    frozen = shared.with_frozen({"tripod_radius[shape=pentagon]": 0.05})
    again, _ = members_at(Comparer(targets, frozen), point[:1, :2])
    assert (again[0] == found[1]).all()


@pytest.mark.parametrize(
    ("combine", "of"), [("sum", np.sum), ("mean", np.mean), ("largest", np.max)]
)
def test_errors_of_several_experiments_become_one(experiments, combine, of):
    comparer = Comparer(targets_of(experiments), _space())
    members, _ = members_at(comparer, np.array([[0.1, 0.3, 0.05]]))
    assert combined_errors(members, combine)[0] == pytest.approx(of(members[0]), rel=1e-12)


def test_what_cannot_be_simulated_is_inf_with_its_reason(experiments):
    experiment = experiments[0]
    scene = experiment.scene
    points = SupportPoints(points=[(0.03, 0.0), (-0.02, 0.03), (-0.02, -0.03)], friction=0.3)
    scene = replace(scene, bodies=(replace(scene.bodies[0], support=points),))
    target = target_of(replace(experiment, scene=scene))
    space = ParameterSpace(
        unknowns=[Unknown(name="support_1_x", low=-0.05, high=0.05, nominal=0.03)]
    )
    comparer = Comparer([target], space)
    errors, reasons = members_at(comparer, np.array([[0.03], [-0.04]]))
    assert np.isfinite(errors[0, 0])
    assert errors[1, 0] == math.inf
    assert reasons[0] == ""
    assert "triangle" in reasons[1]
    assert comparer.feasible(np.array([[0.03], [-0.04]])).tolist() == [True, False]


def test_frames_after_the_effective_end_do_not_count(experiments):
    experiment = experiments[0]
    time = experiment.trajectory.time
    short = replace(experiment, effective=(float(time[0]), float(time[99])))
    wild = experiment.trajectory.pose.copy()
    wild[100:] += 1.0
    changed = replace(short, trajectory=Trajectory(time=time, pose=wild))
    a, b = target_of(short), target_of(changed)
    assert (a.pose == b.pose).all()
    assert len(a.pose) <= 99


def test_angles_are_compared_the_short_way(experiments):
    experiment = experiments[1]
    turned = experiment.trajectory.pose + np.array([0.0, 0.0, 2.0 * math.pi])
    around = replace(
        experiment, trajectory=Trajectory(time=experiment.trajectory.time, pose=turned)
    )
    points = np.array([[0.1, 0.3, 0.05]])
    errors = [
        members_at(Comparer([target_of(e)], _space()), points)[0][0, 0]
        for e in (experiment, around)
    ]
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)


def test_what_cannot_be_compared_is_refused(experiments):
    experiment = experiments[0]
    refused(target_of, replace(experiment, scene=None), match="no scene")
    one = Trajectory(time=[0.0], pose=experiment.trajectory.pose[:1])
    bare = replace(experiment, trajectory=one, channels=(), effective=None)
    refused(target_of, bare, match=r"no measured pose .* at least one pose after the first")
    refused(targets_of, [], match="experiments")
    strange = ParameterSpace(
        unknowns=[
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.2, where={"surface": "ice"})
        ]
    )
    with pytest.raises(InvalidInput, match=r"mu_pusher\[surface=ice\].*no experiment"):
        Comparer([target_of(experiment)], strange)
