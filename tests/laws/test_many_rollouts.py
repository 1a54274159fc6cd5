"""Ten thousand grasps: every one is solved, stays finite and keeps its certificate (T2, T4)."""

import numpy as np
import pytest

from fixel.simulation import Dynamic, QuasiStatic, simulate_batch
from fixel.testing.scenes import grasp


@pytest.mark.slow
@pytest.mark.parametrize(("motion", "layout"), [
    (Dynamic(), "slip"),
    (Dynamic(), "seated"),
    (QuasiStatic(), "slip"),
    (QuasiStatic(), "seated"),
])  # fmt: skip
def test_ten_thousand_grasps(motion, layout):
    rng = np.random.default_rng(7)
    n = 10_000
    # The ranges in which the thesis's calibrations lie.
    parameters = {
        "mu_support": rng.uniform(0.15, 0.35, n),
        "mu_pusher": rng.uniform(0.15, 0.3, n),
        "mu_fixel": rng.uniform(0.1, 0.25, n),
        "tripod_radius": rng.uniform(0.025, 0.06, n),
    }
    centre = np.array(grasp(layout).bodies[0].pose)
    start = centre + rng.uniform(0.0, 1.0, (n, 3)) * [0.02, 0.04, 1.2] - [0.0, 0.02, 0.6]
    # Clear of the head: the corner of the square reaches 76 mm.
    start[:, 0] = np.maximum(start[:, 0], 0.0145 + 0.0761)
    run = simulate_batch(grasp(layout), parameters, start=start, motion=motion)
    assert np.isfinite(run.pose).all()
    assert run.converged.all(), run
    assert run.max_residual.max() <= 1e-9
    assert (np.abs(run.force) <= 34.3 * (1 + 1e-6)).all()
