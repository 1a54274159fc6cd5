"""Calibrations of parts of any size, by the law of similarity: lengths only set a unit."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import fixel
from fixel import Body, Disk, LineDrive, Polygon, Pusher, Scene, Tripod

NAMES = ("time_s", "x_m", "y_m", "theta_rad", "pusher_x_m", "pusher_y_m", "pusher_theta_rad")


def pushes(size, file):
    """Six pushes of a part of this size, whose tripod has 0.3 of it and whose friction is 0.25."""
    rng, found = np.random.default_rng(0), []
    outline = size * np.array([(-0.5, -0.35), (0.5, -0.35), (0.5, 0.35), (-0.5, 0.35)])
    for k in range(6):
        pose = 0.0, 0.15 * size * rng.uniform(-1, 1), rng.uniform(-0.3, 0.3)
        body = Body("part", Polygon(outline), mass=0.1, pose=pose,
                    support=Tripod(radius=0.3 * size, friction=0.3))  # fmt: skip
        drive = LineDrive((1.0, 0.0), speed=0.2 * size, travel=0.6 * size)
        at = -0.75 * size, 0.0, 0.0
        tip = Pusher("tip", Disk(0.05 * size), pose=at, friction=0.25, drive=drive)
        run = fixel.simulate(
            Scene(body, tip, duration=3.0), motion="quasistatic", output_interval=0.1
        )
        noise = rng.standard_normal((len(run.time), 3)) * (1e-3 * size, 1e-3 * size, 2e-3)
        with file.open("w", newline="") as stream:
            rows = np.column_stack((run.time, run["part"].pose + noise, run["tip"].pose))
            csv.writer(stream).writerows([NAMES, *rows.tolist()])
        body = replace(body, support=Tripod(radius=0.25 * size, friction=0.3))
        scene = Scene(body, replace(tip, drive=None, friction=0.4))
        (push,) = fixel.read_experiments(file, scene=scene)
        found.append(replace(push, name=f"push-{k}"))
    return found


@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_a_part_of_any_size_has_the_same_friction_and_support(size, tmp_path):
    def estimates(size):
        bounds = {"mu_pusher": (0, 1), "tripod_radius": (0.1 * size, 0.6 * size)}
        fit = fixel.calibrate(
            pushes(size, tmp_path / "push.csv"), bounds, motion="quasistatic", progress=False
        )
        unit = {"mu_pusher": 1.0, "tripod_radius": size}
        return {
            k: np.array((e.value, e.low, e.high), float) / unit[k] for k, e in fit.estimates.items()
        }

    found, usual = estimates(size), estimates(0.1)
    for name, truth in (("mu_pusher", 0.25), ("tripod_radius", 0.3)):
        np.testing.assert_allclose(found[name], usual[name], rtol=0.01)
        assert found[name][0] == pytest.approx(truth, rel=0.1)
