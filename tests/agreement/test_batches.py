"""A batch is its rollouts, one by one, whatever the number of threads."""

import numpy as np
import pytest

from fixel.model import Parameters
from fixel.simulation import (
    Adaptive,
    Dynamic,
    FirstOrder,
    Midpoint,
    QuasiStatic,
    StewartTrinkle,
    simulate,
    simulate_batch,
)
from fixel.testing.scenes import grasp, heap, micro_push, sliding_block

N = 24
MOTIONS = [Dynamic(), QuasiStatic(), FirstOrder()]


def _parameters(n=N):
    rng = np.random.default_rng(5)
    return {
        "mu_support": rng.uniform(0.15, 0.35, n),
        "mu_pusher": rng.uniform(0.15, 0.3, n),
        "mu_fixel": rng.uniform(0.1, 0.25, n),
        "tripod_radius": rng.uniform(0.025, 0.06, n),
    }


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: m.name)
@pytest.mark.parametrize("scene", [grasp("slip"), heap(4)], ids=["grasp", "heap"])
def test_number_of_threads_changes_no_bit(motion, scene):
    times = np.linspace(0.0, scene.duration, 7)
    runs = [
        simulate_batch(scene, _parameters(), motion=motion, times=times, threads=n)
        for n in (1, 2, 5)
    ]
    for other in runs[1:]:
        for name in ("status", "pose", "stopped_at", "steps", "fallbacks", "max_residual", "force"):
            assert np.array_equal(getattr(runs[0], name), getattr(other, name)), name


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: m.name)
@pytest.mark.parametrize("stepper", [Adaptive(), StewartTrinkle(step=0.05), Midpoint(step=0.05)])
def test_rollout_k_is_the_single_simulation_of_its_parameters(motion, stepper):
    scene = grasp("seated")
    parameters = _parameters(6)
    batch = simulate_batch(
        scene, parameters, motion=motion, stepper=stepper, times=np.arange(0.0, 11.5, 0.5)
    )
    for k in range(6):
        own = Parameters({name: float(v[k]) for name, v in parameters.items()})
        single = simulate(scene, own, motion=motion, stepper=stepper, output_interval=0.5)
        assert single.status == batch.status[k]
        assert single.steps == batch.steps[k]
        assert single.max_residual == batch.max_residual[k]
        # One that stopped early has a last sample of its own, which the batch holds to the end.
        reached = len(single.time) - (0 if single.converged else 1)
        for name in ("object", "actuator"):
            assert np.array_equal(single.pose[name][:reached], batch[name].pose[k, :reached])
            assert np.array_equal(single.pose[name][-1], batch[name].pose[k, -1])
        assert single.pushers["actuator"].force[-1] == batch.force[k, 0]


def test_scenes_side_by_side_are_the_same_as_alone():
    scenes = [micro_push(3), grasp("slip"), sliding_block(), heap(3), micro_push(7, "p2")]
    results = simulate_batch(scenes, duration=0.8)
    for scene, result in zip(scenes, results, strict=True):
        alone = simulate(scene, duration=0.8, output_interval=0.8)
        for k, name in enumerate(alone.pose):
            assert np.array_equal(alone.pose[name][-1], result.final[0, k])
