"""Pushes carried out many times are those of the simulated testbed, one after the other."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.model import LineDrive, PlannedExperiment
from fixel.simulation import simulate
from fixel.testbed.simulated import SimulatedTestbed, repeat_pushes
from fixel.testing.scenes import grasp, pushed_square

BENCH = SimulatedTestbed(seed=5, lead_in=0.0, position_noise=0.0, angle_noise=0.0)


def test_one_push_is_that_of_the_testbed():
    starts = grasp().bodies[0].pose + np.array([[0.0, 0.0, 0.0], [1e-3, -2e-3, 0.02]])

    found = repeat_pushes(BENCH, [grasp()], starts, name="run", threads=1)

    for r, start in enumerate(starts):
        scene = replace(grasp(), bodies=(replace(grasp().bodies[0], pose=start),))
        (run,) = BENCH.run([PlannedExperiment(name=f"run-{r}", scene=scene)], threads=1)
        truth = [run.conditions[f"truth_final_{n}"] for n in ("x_m", "y_m", "angle_rad")]
        # The two take other steps: 0.03 degrees.
        assert found.pose[r, -1] == pytest.approx(truth, abs=5e-4)
    assert found.stalled.all()
    assert found.force == pytest.approx(34.3)
    assert found.failure == ("", "")


def _pushes():
    """Push along x, and another by a finger on the other side, which may stand on the part."""
    first = pushed_square(1.0)
    finger = first.pushers[0]
    far = replace(
        finger, pose=(0.085, 0.0, 0.0), drive=LineDrive(direction=(-1.0, 0.0), speed=0.02)
    )
    return [first, replace(first, pushers=(far,))]


def test_later_pushes_begin_where_the_part_really_is_and_may_meet_it():
    starts = np.array([[0.0, 0.0, 0.0], [0.035, 0.0, 0.0], [0.002, 0.0, 0.0]])

    found = repeat_pushes(BENCH, _pushes(), starts, threads=2)

    assert found.failure[0] == found.failure[2] == ""
    assert "push 2 cannot begin" in found.failure[1]
    assert "overlap" in found.failure[1]
    assert (found.pose[1, 2] == found.pose[1, 1]).all()
    assert found.pose[0, 1, 0] > 0.005  # pushed away ...
    assert found.pose[0, 2, 0] < found.pose[0, 1, 0] - 0.001  # ... and back
    again = repeat_pushes(BENCH, _pushes(), starts, threads=1)
    assert (again.pose == found.pose).all()


def test_the_force_is_the_largest_of_all_pushes():
    first, second = _pushes()
    idle = replace(second, pushers=(replace(second.pushers[0], pose=(0.5, 0.0, 0.0)),))
    found = repeat_pushes(BENCH, [first, idle], np.zeros((1, 3)), samples=20, threads=1)

    true = BENCH.true_scene(PlannedExperiment(name="trial-0", scene=first))
    force = simulate(true).pushers["finger"].force
    assert found.force[0] >= 0.9 * np.median(force[-10:])  # nothing in the second push


def test_nothing_to_do_is_refused():
    with pytest.raises(InvalidInput, match="at least"):
        repeat_pushes(BENCH, [], np.zeros((1, 3)))
