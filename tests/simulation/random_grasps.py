"""Random grasps: a square or a pentagon that a flat head pushes between three pegs."""

import math
import random

import numpy as np

from fixel.model import Body, Disk, Fixel, LineDrive, Polygon, Pusher, Scene, Tripod

PEGS = (
    ((0, -0.035), (0, 0), (0, 0.035)),
    ((0, -0.07), (0, 0), (0, 0.07)),
    ((-0.03, -0.03), (0, 0), (0.03, 0.03)),
    ((0.03, -0.03), (0, 0), (-0.03, 0.03)),
    ((-0.03, -0.05), (0.01, 0), (-0.03, 0.05)),
    ((-0.05, -0.08), (0.02, 0), (-0.05, 0.08)),
    ((-0.06, -0.02), (0.02, 0.01), (0, 0.07)),
    ((-0.06, 0.02), (0.02, -0.01), (0, -0.07)),
    ((-0.06, -0.05), (0.01, 0), (-0.02, 0.05)),
    ((-0.02, -0.05), (0.01, 0), (-0.06, 0.05)),
)


def random_grasp(seed):
    """Return the grasp of a seed; it may overlap, and is then refused by `simulate`."""
    rng = random.Random(seed)
    n = rng.choice([4, 5])
    radius = {4: 0.1075, 5: 0.07}[n] / (2 * math.sin(math.pi / n))
    outline = radius * np.array([_unit(math.pi / n + 2 * math.pi * k / n) for k in range(n)])
    pegs = rng.choice(PEGS)
    theta, y = rng.uniform(0, 2 * math.pi / n), rng.uniform(-0.03, 0.03)
    back = float(min(outline @ (math.cos(theta), -math.sin(theta))))
    x = 0.0145 + rng.uniform(0.002, 0.02) - back
    part = Body(
        name="part", shape=Polygon(outline), mass=0.15, pose=(x, y, theta),
        support=Tripod(radius=rng.uniform(0.01, 0.06), friction=rng.uniform(0.1, 0.6)),
    )  # fmt: skip
    head = 0.0145 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    drive = LineDrive(direction=(1, 0), speed=0.0135, travel=0.15, force_limit=34.3)
    pusher = Pusher(
        name="head", shape=Polygon(head), pose=(0, 0, 0), drive=drive, friction=rng.uniform(0, 0.6)
    )
    friction = rng.uniform(0, 0.6)
    fixels = [
        Fixel(name=f"peg-{k}", shape=Disk(0.00476), pose=(0.2 + a, b, 0), friction=friction)
        for k, (a, b) in enumerate(pegs)
    ]
    return Scene(bodies=(part,), pushers=(pusher,), fixels=tuple(fixels), duration=11.0)


def _unit(angle):
    return math.cos(angle), math.sin(angle)
