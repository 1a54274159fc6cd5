"""A part on a table that is not flat, against loads that another method has computed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import fixel
from fixel.model import (
    Body,
    Disk,
    LineDrive,
    LoadMap,
    Plane,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.model.support import support_points

RNG = np.random.default_rng(3)
HILLS = LoadMap(origin=(-0.3, -0.3), cell=(0.03, 0.04), log_load=RNG.normal(0, 0.7, (16, 21)))
POSE = np.array([0.02, -0.05, 0.6])


def push(support, load_map=None, pose=POSE):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    body = Body("part", Polygon.rectangle(0.1, 0.08), mass=0.4, support=support, pose=pose)
    at = pose[:2] + np.array([[c, -s], [s, c]]) @ (-0.0601, 0.02)
    finger = Pusher(
        "finger", Disk(0.01), pose=(*at, 0.0), friction=0.2,
        drive=LineDrive(speed=0.02, direction=(c, s)),
    )  # fmt: skip
    return Scene(body, finger, duration=2.0, plane=Plane(load_map=load_map))


def end(scene):
    return np.array(fixel.simulate(scene, motion="quasistatic").final["part"])


def nearest_loads(wanted, points, centre):
    """Shares nearest to those wanted in relative entropy, with their centre at a place."""
    found = minimize(
        lambda n: float(n @ np.log(n / wanted)),
        wanted,
        jac=lambda n: np.log(n / wanted) + 1.0,
        method="SLSQP",
        bounds=[(1e-9, 1.0)] * len(wanted),
        constraints=[
            {"type": "eq", "fun": lambda n: n.sum() - 1.0},
            {"type": "eq", "fun": lambda n: 100.0 * (n @ points - centre)},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return found.x


@pytest.mark.parametrize("support", [
    UniformPressure(friction=0.3, n_points=9),
    SupportPoints(
        points=[(-0.04, -0.03), (0.04, -0.03), (0.04, 0.03), (-0.04, 0.03), (0, 0)],
        friction=0.3,
    ),
])  # fmt: skip
def test_loads_are_those_of_another_optimiser(support):
    scene = push(support, HILLS)
    body = scene.bodies[0]
    points, loads, friction = support_points(support, body.shape, body.com, body.mass, 9.81)
    c, s = np.cos(POSE[2]), np.sin(POSE[2])
    world = (points + body.com) @ np.array([[c, s], [-s, c]]) + POSE[:2]
    wanted = loads * np.exp(HILLS.at(world))
    share = nearest_loads(wanted / wanted.sum(), points, loads @ points / loads.sum())
    same = SupportPoints(points=points + body.com, friction=friction, loads=loads.sum() * share)
    np.testing.assert_allclose(end(scene), end(push(same)), atol=2e-7)
    assert np.abs(end(scene) - end(push(support))).max() > 1e-4


def test_a_constant_an_incline_and_three_points_change_nothing():
    x = np.linspace(-0.3, 0.3, 4)
    incline = LoadMap(origin=(-0.3, -0.3), cell=(0.2, 0.2), log_load=0.4 + np.add.outer(3 * x, -x))
    even = UniformPressure(friction=0.3, n_points=12)
    np.testing.assert_allclose(end(push(even, incline)), end(push(even)), atol=1e-9)
    feet = Tripod(radius=0.03, friction=0.3)
    np.testing.assert_array_equal(end(push(feet, HILLS)), end(push(feet)))


def test_the_map_belongs_to_the_world_and_not_to_the_part():
    even = UniformPressure(friction=0.3)
    here = end(push(even, HILLS)) - POSE
    for pose in (POSE + np.array([0.06, 0.0, 0.0]), POSE + np.array([0.0, 0.0, np.pi])):
        there = end(push(even, HILLS, pose)) - pose
        turn = pose[2] - POSE[2]
        c, s = np.cos(turn), np.sin(turn)
        back = np.array([c * there[0] + s * there[1], c * there[1] - s * there[0], there[2]])
        assert np.abs(back - here).max() > 1e-4


def test_batches_agree_with_single_runs():
    scene = push(UniformPressure(friction=0.3), HILLS)
    starts = POSE + np.array([[0.0, 0.0, 0.0], [1e-3, 1e-3, 0.0], [2e-3, 0.0, 0.01]])
    mu = np.array([0.1, 0.2, 0.3])
    batch = fixel.simulate_batch(scene, {"mu_pusher": mu}, start=starts, motion="quasistatic")
    for k, start in enumerate(starts):
        own = replace(scene, bodies=(replace(scene.bodies[0], pose=start),))
        one = fixel.simulate(own, {"mu_pusher": mu[k]}, motion="quasistatic")
        assert np.array_equal(batch.final[k, 0], one.final["part"])


def test_derivatives_by_the_start_include_the_change_of_loads():
    scene = push(UniformPressure(friction=0.3), HILLS)
    names = ["x", "y", "theta"]
    run = fixel.simulate(scene, motion="quasistatic", derivatives=names)
    width = np.array([2e-5, 2e-5, 2e-4])
    starts = POSE + np.concatenate((np.diag(width), -np.diag(width)))
    ends = fixel.simulate_batch(
        scene, start=starts, motion="quasistatic", stepper=fixel.Adaptive(tolerance=1e-10)
    ).final[:, 0]
    slope = ((ends[:3] - ends[3:]) / (2.0 * width[:, None])).T
    found = np.column_stack([run.derivatives[name] for name in names])
    np.testing.assert_allclose(found, slope, rtol=0.02, atol=2e-3)
    flat = fixel.simulate(replace(scene, plane=Plane()), motion="quasistatic", derivatives=names)
    assert np.abs(flat.derivatives["y"] - found[:, 1]).max() > 0.02
