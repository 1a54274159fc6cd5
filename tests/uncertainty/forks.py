"""A push that parts ways: a puck swept against one fixel, without friction."""

import numpy as np

from fixel.model import Body, Disk, Fixel, LineDrive, Pusher, Scene, Tripod
from fixel.testing.scenes import box, row


def fork(aside=0.0):
    """The puck passes on the left or on the right; `aside` moves the fixel [m]."""
    puck = Body(
        name="puck", shape=Disk(0.02), mass=0.1, pose=row(0.05, 0.0, 0.0),
        support=Tripod(radius=0.012, friction=0.3),
    )  # fmt: skip
    plate = Pusher(
        name="plate", shape=box(0.02, 0.2), pose=row(0.019, 0.0, 0.0),
        drive=LineDrive(direction=row(1.0, 0.0), speed=0.02), friction=0.0,
    )  # fmt: skip
    fixel = Fixel(name="fixel-1", shape=Disk(0.005), pose=row(0.1, aside, 0.0), friction=0.0)
    return Scene(bodies=(puck,), pushers=(plate,), fixels=(fixel,), duration=2.2)


def grid(n, width):
    """(n, 3) even points about zero."""
    return np.linspace(-width, width, 3 * n).reshape(3, n).T
