"""Whatever goes wrong in a rollout ends it: no poses from nowhere, no work without end."""

import numpy as np
import pytest

from fixel.kernels.codes import STATUS_NAMES
from fixel.simulation import (
    Adaptive,
    FirstOrder,
    Midpoint,
    Newton,
    QuasiStatic,
    StewartTrinkle,
    simulate,
    simulate_batch,
)
from fixel.simulation.pack import pack
from fixel.simulation.plain import rollout_in_python
from fixel.simulation.simulate import method_of
from fixel.simulation.vary import Variation
from fixel.testing.scenes import grasp

# Steps in which Newton ran off to velocities of 1e240 whose squares are no numbers, [m, m, rad].
RUN_OFF = np.array([
    [0.09781570538460245, -0.025918080699116386, 1.598402732193387],
    [0.08692634237960108, 0.03479998242687088, 1.1470372764991446],
    [0.10946456293560905, 0.014557993388513296, -2.149212667764508],
])  # fmt: skip

# A square noise has put between the head and a peg, whose normals almost oppose each other.
SQUEEZED = np.array([0.15680226602473762, -0.011936724143890213, -0.34719733645717044])
HEAD = np.array([
    [0.0, 0.14300813160249243, -0.00031677464563250446, -4.911022154593051e-05],
    [1 / 30, 0.14339467827598884, 0.00015149661169162453, -0.0001836949634845526],
])  # fmt: skip
FRICTION = {"mu_pusher": [0.3741], "mu_fixel": [0.474], "tripod_radius": [0.0366]}


@pytest.mark.parametrize("step", [0.01, 1 / 30])
def test_a_velocity_without_a_square_is_no_answer(step):
    stepper = StewartTrinkle(step=step)
    runs = simulate_batch(
        grasp("seated"), start=RUN_OFF, motion=QuasiStatic(), stepper=stepper, duration=2.2
    )
    travelled = 2.2 * 0.0135
    assert np.abs(runs.final[:, 0] - RUN_OFF)[:, :2].max() < 2.0 * travelled


def squeezed(stepper):
    return simulate_batch(
        grasp("seated"), FRICTION, start=SQUEEZED[None], waypoints=HEAD[None], motion=FirstOrder(),
        stepper=stepper, duration=1 / 30,
    )  # fmt: skip


@pytest.mark.parametrize("stepper", [StewartTrinkle(step=1 / 30), Midpoint(step=1 / 30)])
def test_a_body_squeezed_out_in_one_step_is_thrown(stepper):
    run = squeezed(stepper)
    assert run.status[0] == "thrown"
    assert run.stopped_at[0] == 0.0


def test_short_steps_do_not_throw_it():
    run = squeezed(Adaptive())
    assert run.status[0] in ("converged", "jammed")
    assert np.abs(run.final[0, 0] - SQUEEZED).max() < 1.0


@pytest.mark.parametrize("stepper", [StewartTrinkle(step=1 / 30), Adaptive()])
def test_both_loops_end_alike(stepper):
    motion, solver = FirstOrder(), Newton()
    values = {name: np.array(value) for name, value in FRICTION.items()}
    variation = Variation(values, SQUEEZED[None, None], HEAD[None])
    packed = pack(grasp("seated"), motion, stepper, variation, 1, 1 / 30)
    method = method_of(motion, stepper, solver, 4096)
    times = np.array([0.0, 1 / 30])
    plain = rollout_in_python(packed, motion, stepper, solver, method, times)
    compiled = squeezed(stepper)
    assert STATUS_NAMES[plain.status[0]] == compiled.status[0]
    assert plain.count[0, 2] == compiled.steps[0]
    assert plain.total[0, 0] * packed.units.time == compiled.stopped_at[0]


@pytest.mark.parametrize("plain", [False, True])
def test_an_adaptive_rollout_ends_when_its_steps_are_used_up(plain):
    run = simulate(grasp(), stepper=Adaptive(max_steps=5), plain=plain)
    assert (run.status, run.steps) == ("max_steps", 5)
    assert "max_steps" in run.advice
