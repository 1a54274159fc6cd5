# RPI thesis, appendix C.6, `Iterative_Expansion_Domain_Of_Applicability_All_Dims`: a row of
# its 10 x 6 matrix of largest errors, and figure 6.5, the y axis with a domain of three samples.
# The numbers in the thesis are of experiments that are lost; what is held here is the procedure, on
# a simulated campaign of one shape and layout with quick calibrations, against plain simulations.
# Tolerance: the adaptive steps of a plain simulation end at other instants, where its tolerance
# allows poses to differ by some 1e-4 of their change.
"""The exploration of the thesis on a small campaign, recomputed by hand."""

from math import pi

import numpy as np
import pytest
from tests import calibrating as run
from tests.workflows.growing import comparer_of, explored, planned

from fixel import Parameters, QuasiStatic, SimulatedTestbed, simulate
from fixel.calibration.target import target_of

INTERVAL = 2e-3  # [s] between samples of the plain simulations
NAMES = ("mu_pusher", "tripod_radius")
JOINS = {1: ("x1", "y1", "y-1", "theta1"), 2: ("x2", "y2", "y-2", "theta2")}
PRINTED = {1: ("x1", "y1", "y-1", "y-5"), 2: ("x2", "y2", "y-2", "theta1")}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    experiments = SimulatedTestbed(seed=3).run(planned("pentagon", ("concave-tight",)))
    fit = ["mu_pusher", "tripod_radius_mm=10:60:40"]
    folder = tmp_path_factory.mktemp("campaign") / "lab"
    return run.calibrated(folder, experiments, fit, mode="each", motion="quasistatic")


@pytest.fixture(scope="module")
def samples(project):
    """Experiment, parameters and error of the single calibration, by place."""
    found = {}
    with project.store() as store:
        for record in store.calibration_summaries().values():
            if len(record.members) == 1:
                experiment = store.experiment(record.members[0].experiment_id)
                own = experiment.conditions
                place = "nominal" if own["axis"] == "nominal" else f"{own['axis']}{own['step']:g}"
                values = np.array([record.parameters[name] for name in NAMES])
                found[place] = (experiment, values, record.members[0].error_mm2)
    return found


def _error(experiment, values):
    """E of one simulation: mean squares of x, y in mm and of 35 times the angle."""
    target = target_of(experiment)
    simulation = simulate(
        target.case.scene, Parameters(dict(zip(NAMES, values, strict=True))), motion=QuasiStatic(),
        duration=float(target.case.times[-1]), output_interval=INTERVAL,
    )  # fmt: skip
    pose = simulation[experiment.object_name].at(target.case.times)
    difference = pose - target.pose
    turn = (difference[:, 2] + pi) % (2.0 * pi) - pi
    squares = (1e3 * difference[:, :2]) ** 2
    return float((squares.sum(axis=1) + (35.0 * turn) ** 2).mean())


def _largest(samples, places):
    """Largest error under the mean weighted with inverse errors."""
    weight = np.array([1.0 / samples[p][2] for p in places])
    values = np.array([samples[p][1] for p in places])
    mean = (weight[:, None] * values).sum(axis=0) / weight.sum()
    return max(_error(samples[p][0], mean) for p in places)


@pytest.mark.parametrize(("index", "joins"), [("corrected", JOINS), ("printed", PRINTED)])
def test_largest_errors_of_appendix_c6(project, samples, index, joins):
    with project.store() as store:
        (row,) = explored(store, index=index).growth.matrix
    assert row[0] == samples["nominal"][2]
    places = ["nominal"]
    for step in (1, 2):
        places += joins[step]
        assert row[step] == pytest.approx(_largest(samples, places), rel=1e-3)
    assert all(value is not None for value in row)


def test_figure_6_5_y_axis_with_a_domain_of_three(project, samples):
    with project.store() as store:
        study = next(s for s in explored(store).studies if (s.axis, s.size) == ("y", 3))
    assert study.interval == (-1, 1)
    inside = ["y-1", "nominal", "y1"]
    weight = np.array([1.0 / samples[p][2] for p in inside])
    mean = weight @ np.array([samples[p][1] for p in inside]) / weight.sum()
    for column, step in enumerate(study.steps.tolist()):
        place = f"y{step}" if step else "nominal"
        experiment, _, own = samples[place]
        alone = comparer_of([experiment]).errors(np.zeros(1, int), mean[None]).error[0]
        assert study.error[0, column] == pytest.approx(alone, rel=1e-12)
        assert study.own[0, column] == own
        assert study.average[column] == study.error[0, column]
        if abs(step) <= 1:  # farther out the path hangs on how each step ends
            assert alone == pytest.approx(_error(experiment, mean), rel=1e-2)
