"""The ASME paper's eight pushes as a plan: counted by hand, and simulated as the plain scenes."""

import numpy as np
import pytest

from fixel.model import SupportPoints
from fixel.sampling import eight_push_plan, thesis_plan
from fixel.simulation import QuasiStatic, simulate
from fixel.testing.scenes import micro_push

LONG, SHORT = 1621e-6, 842e-6  # [m], of the paper's figure 2


def test_five_pushes_on_the_long_side_and_three_on_the_short():
    plan = eight_push_plan()
    assert (plan.total, plan.repetitions) == (24, 3)
    assert plan.check() == ()
    first = plan.experiments[::3]
    places = []
    for experiment in first:
        (body,), (probe,) = experiment.scene.bodies, experiment.scene.pushers
        assert experiment.scene.fixels == ()
        assert isinstance(body.support, SupportPoints)
        assert len(body.support.points) == 3
        assert np.all(np.abs(body.support.points) <= (SHORT / 2, LONG / 2))
        assert probe.drive.travel == pytest.approx(700e-6)
        depth = SHORT if abs(body.pose[2]) < 0.1 else LONG
        # The probe, 25 um wide, touches the near side.
        assert body.pose[0] - probe.pose[0] == pytest.approx(depth / 2 + 12.5e-6)
        places.append((depth == SHORT, probe.pose[1] - body.pose[1]))
    long = sorted(place for on_long, place in places if on_long)
    short = sorted(place for on_long, place in places if not on_long)
    corner = 12.5e-6  # flush with it
    assert long == pytest.approx(
        [-LONG / 2 + corner, -LONG / 4, 0.0, LONG / 4, LONG / 2 - corner], abs=1e-12
    )
    assert short == pytest.approx([-SHORT / 2 + corner, 0.0, SHORT / 2 - corner], abs=1e-12)


@pytest.mark.parametrize("test", [3, 7])
def test_the_plan_pushes_as_the_plain_scene_does(test):
    planned = eight_push_plan().experiments[3 * (test - 1)].scene
    plain = micro_push(test, "p1")
    ends = []
    for scene in (planned, plain):
        body = scene.bodies[0].name
        moved = simulate(scene, motion=QuasiStatic()).pose[body][-1] - scene.bodies[0].pose
        ends.append(moved)
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_the_thesis_layouts_have_their_numbers():
    plan = thesis_plan()
    assert [layout.number for layout in plan.layouts] == list(range(1, 11))
    assert all(("collinear" in x.name) == (x.number <= 4) for x in plan.layouts)
