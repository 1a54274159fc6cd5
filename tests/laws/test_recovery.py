"""What made an experiment is found again from it: without noise, to a thousandth."""

from functools import partial

import numpy as np
import pytest

from fixel.calibration import NelderMead
from fixel.calibration.assess import Frames
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer, combined_errors
from fixel.calibration.study import box_of, calibrate_joint, run_study
from fixel.calibration.target import targets_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.sampling.published import thesis_plan
from fixel.simulation import Dynamic
from fixel.testbed.simulated import SimulatedTestbed

TRUTH = np.array([0.2, 0.2, 0.0409])
SPACE = ParameterSpace(
    unknowns=[
        Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.4),
        Unknown(name="mu_fixel", low=0.0, high=1.0, nominal=0.4),
        Unknown(name="tripod_radius", low=0.001, high=0.060, nominal=0.025),
    ]
)


@pytest.fixture(scope="module")
def comparer():
    planned = thesis_plan().experiments[:210:28]
    return Comparer(targets_of(SimulatedTestbed.ideal().run(planned)), SPACE, motion=Dynamic())


def test_by_least_squares(comparer):
    frames = Frames(comparer, np.arange(len(comparer.targets)))
    noise = Noise(position_m=1e-3, angle_rad=1 / 35, source="stated")
    found = fit(LeastSquares(starts=4).start(box_of(SPACE)), frames.residuals(noise))
    assert found.point == pytest.approx(TRUTH, rel=1e-3)


@pytest.mark.slow
def test_by_a_simplex(comparer):
    members = range(len(comparer.targets))
    search = NelderMead(restarts=1)
    trace, _ = run_study(
        calibrate_joint(members, box_of(SPACE), search, partial(combined_errors, combine="sum")),
        lambda ask: comparer.errors(ask.which, ask.points),
    )
    assert trace.point == pytest.approx(TRUTH, rel=1e-3)
