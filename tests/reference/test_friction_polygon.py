# Known answer A13: elementary geometry of the polygon inscribed in the friction circle.
"""How much friction a polygon of directions loses against the disc."""

from dataclasses import replace
from math import cos, pi

import numpy as np
import pytest

from fixel import Body, Scene, StewartTrinkle, SupportPoints, simulate_batch
from fixel.testing.scenes import box

H = 1e-6  # [s]


def _friction(directions, headings):
    """Friction along the motion over mu N, for a body sliding along each heading."""
    body = Body(
        name="block", shape=box(0.1, 0.1), mass=1.0, pose=(0, 0, 0),
        support=SupportPoints(points=[[0.01, 0.0], [-0.01, 0.0]], friction=0.5),
    )  # fmt: skip
    scenes = [
        Scene(
            bodies=(replace(body, velocity=(np.cos(a), np.sin(a), 0.0)),),
            duration=H,
            support_directions=directions,
        )
        for a in headings
    ]
    runs = simulate_batch(scenes, stepper=StewartTrinkle(step=H))
    along = np.column_stack((np.cos(headings), np.sin(headings)))
    moved = np.array([run.final[0, 0, :2] for run in runs])
    slower = 1.0 - (moved * along).sum(axis=1) / H
    return slower / (H * 0.5 * 9.81)


# A slow-down of 5e-6 of a velocity near 1 keeps ten digits; the residual 1e-9 over it leaves about
# three.
ROUNDING = 3e-4


@pytest.mark.parametrize("n", [4, 8, 16, 64])
def test_A13_friction_lies_between_cos_pi_over_n_and_one(n):
    # Turned by a little, so that no heading is normal to a side, where friction is not unique.
    headings = np.linspace(0.0, 2 * pi, 8 * n, endpoint=False) + 1e-3 / n
    share = _friction(n, headings)
    assert share.min() == pytest.approx(cos(pi / n), abs=ROUNDING + 1e-3 / n)
    assert share.max() == pytest.approx(1.0, abs=ROUNDING)


def test_A13_the_disc_loses_nothing():
    assert _friction(None, np.linspace(0, 6, 50)) == pytest.approx(1.0, abs=ROUNDING)
