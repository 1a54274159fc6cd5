"""Every built-in motion model, stepper and solver keeps the contract of its family."""

import pytest

from fixel.simulation.motion import MOTION_MODELS
from fixel.simulation.stepping import SOLVERS, STEPPERS
from fixel.testing.contracts import MotionModelContract, SolverContract, StepperContract


class TestMotionModels(MotionModelContract):
    @pytest.fixture(params=MOTION_MODELS, ids=lambda member: member.name)
    def motion(self, request):
        return request.param()


class TestSteppers(StepperContract):
    @pytest.fixture(params=STEPPERS, ids=lambda member: member.name)
    def stepper(self, request):
        return request.param()


class TestSolvers(SolverContract):
    @pytest.fixture(params=SOLVERS, ids=lambda member: member.name)
    def solver(self, request):
        return request.param()
