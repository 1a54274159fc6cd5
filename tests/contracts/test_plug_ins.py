"""A user's own motion model, stepper and solver run in the plain loop and keep the contracts."""

import abc
import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.simulation import (
    AbstractMotionModel,
    AbstractSolver,
    AbstractStepper,
    Newton,
    StewartTrinkle,
    simulate,
    simulate_batch,
)
from fixel.simulation.stepping import StepResult
from fixel.testing.contracts import MotionModelContract, SolverContract, StepperContract
from fixel.testing.scenes import sliding_block


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ViscousPlane(AbstractMotionModel):
    """A film of oil in place of dry friction: ``M (v' - v) = -h m rate v' + impulses``."""

    name: ClassVar[str] = "viscous"
    rate: float = 50.0  # in units of the scene's own time

    def assemble(self, model, state, step, pose, problem):
        for b in range(model.mass.size):
            o = 3 * b
            inertia = np.array([model.mass[b], model.mass[b], model.inertia[b]])
            problem.inertia[o : o + 3] = np.diag(inertia * (1.0 + step * self.rate))
            problem.momentum[o : o + 3] = inertia * state.velocity[o : o + 3]
        return 0

    def move(self, model, state, step, problem, glide):
        for b in range(model.mass.size):
            state.pose[b] += step * problem.velocity[3 * b : 3 * b + 3]
        for d in range(model.force_limit.size):
            dof = model.drive_dof[d]
            if dof >= 0:
                state.path_time[d] += step * min(1.0, problem.velocity[dof])
        n = problem.size[0]
        state.velocity[:n] = problem.velocity[:n]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Growing(AbstractStepper):
    """Steps that grow by a tenth from one to the next, up to 10 ms."""

    name: ClassVar[str] = "growing"
    order: ClassVar[int] = 1
    first: float = 0.001

    @property
    def first_step(self):
        return self.first

    def advance(self, attempt, problem, past, step, limits):
        trial = min(step, limits.left)
        status, residual, *_ = attempt(trial, 0.0, past.velocity)
        return StepResult(status, trial, min(1.1 * step, 0.05), residual)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Counting(AbstractSolver):
    """Newton, with a count of its calls: wrap, do not subclass."""

    name: ClassVar[str] = "counting"
    calls: list

    def solve(self, problem, work, guess, give_up_early=False):
        self.calls.append(1)
        return Newton().solve(problem, work, guess)


class TestViscousPlane(MotionModelContract):
    @pytest.fixture
    def motion(self):
        return ViscousPlane()


class TestGrowing(StepperContract):
    @pytest.fixture
    def stepper(self):
        return Growing()


class TestCounting(SolverContract):
    @pytest.fixture
    def solver(self):
        return Counting(calls=[])


def test_viscous_block_slows_down_exponentially():
    scene = sliding_block(0.5, duration=0.3)
    length = math.sqrt(scene.bodies[0].moment_of_inertia / scene.bodies[0].mass)
    rate = 2.0 * 0.5 / length  # [1/s], two per characteristic time
    run = simulate(scene, motion=ViscousPlane(rate=2.0), stepper=StewartTrinkle(step=1e-4))
    # First order in the step: half of rate^2 h over the whole time, 0.9 %.
    assert run.twist["block"][-1, 0] == pytest.approx(0.5 * math.exp(-rate * 0.3), rel=1e-2)


def test_every_step_goes_through_the_plug_in():
    calls = []
    run = simulate(sliding_block(), solver=Counting(calls=calls), stepper=StewartTrinkle())
    assert len(calls) == run.steps == 100


def test_plug_ins_do_not_run_in_batches():
    error = refused(simulate_batch, sliding_block(), motion=ViscousPlane(), match="ViscousPlane")
    assert "call simulate" in error.hint


@pytest.mark.parametrize("family", [AbstractMotionModel, AbstractStepper, AbstractSolver])
def test_abstract_classes_are_never_built(family):
    assert issubclass(family, abc.ABC)
    with pytest.raises(TypeError, match="abstract"):
        family()
