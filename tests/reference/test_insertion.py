# Known answers K11 and K12: S. Simunovic (1975), D. E. Whitney (1982) on jamming and wedging; the
# ASME 2006 paper on meso-scale manipulation for the part and its slot.
"""Insertion of a peg into a slot: when it jams, and how success depends on the clearance."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from fixel import Body, Disk, Ellipsoid, Fixel, LineDrive, Polygon, Pusher, Scene, UniformPressure
from fixel.simulation import simulate, simulate_batch

CLEARANCE = 2e-6  # [m] of the peg of 20 mm


def _slot(width, friction, mouth=0.0, depth=0.1):
    """Two walls along x with square corners; the slot begins at x = `mouth`."""
    return [
        Fixel(name, Polygon.rectangle(depth, width), friction=friction,
              pose=(mouth + depth / 2, side * width, 0))
        for name, side in (("upper", 1.0), ("lower", -1.0))
    ]  # fmt: skip


@pytest.mark.parametrize("friction", [0.2, 0.5])
@pytest.mark.parametrize("offset", [0.006, 0.009])
def test_K11_a_peg_jams_only_where_the_cones_of_both_contacts_see_each_other(friction, offset):
    """A push along x at an offset e from the middle, without friction of the probe, jams a peg in
    the slot only up to an insertion of 2 mu e; for every e, that is mu w at most.

    It slides on by a tenth of that until the clearance is taken up and both sides touch.
    """
    width, length = 0.02, 0.06
    limit = 2.0 * friction * offset
    for inside, jams in ((0.85 * limit, True), (1.05 * limit, False)):
        peg = Body(
            "peg", Polygon.rectangle(length, width), mass=0.1, pose=(inside - length / 2, 0, 0),
            support=Ellipsoid(force=0.01, torque=1e-4),
        )  # fmt: skip
        probe = Pusher(
            "probe", Disk(1e-4), friction=0.0, pose=(inside - length - 1e-4, offset, 0),
            drive=LineDrive(speed=0.01, travel=0.002),
        )  # fmt: skip
        walls = _slot(width + CLEARANCE, friction)
        walls = [replace(own, shape=Polygon.rectangle(0.1, width)) for own in walls]
        run = simulate(Scene(peg, probe, walls, duration=0.2), motion="quasistatic")
        assert (run.status == "jammed") == jams
        if jams:
            assert run.final["peg"].x + length / 2 < 1.01 * limit <= 1.01 * friction * width


# --- K12 ----------------------------------------------------------------------------------------

UM = 1e-6
WIDTH, LENGTH = 842 * UM, 1621 * UM
DEEP = 300 * UM  # insertion that counts as assembled


def _inserted(clearance, ahead, tool, draws):
    """Whether each draw (n, 4) of start y, start angle, friction and pressure centre ends inside
    the slot, after a push along it at the middle of the short side."""
    y, theta, friction, centre = draws.T
    radius = tool.radius if isinstance(tool, Disk) else 0.5 * np.ptp(tool.outline[:, 0])
    travel = ahead + DEEP + 50 * UM
    walls = [
        Fixel(name, Polygon.rectangle(3 * LENGTH, WIDTH), friction=0.3,
              pose=(1.5 * LENGTH, side * (WIDTH + 0.5 * clearance), 0))
        for name, side in (("upper", 1.0), ("lower", -1.0))
    ]  # fmt: skip
    scene = Scene(
        Body("part", Polygon.rectangle(LENGTH, WIDTH), mass=1e-6,
             pose=(-ahead - LENGTH / 2, 0, 0), support=UniformPressure(friction=0.3)),
        Pusher("tool", tool, friction=0.5, pose=(-ahead - LENGTH - radius - 20 * UM, 0, 0),
               drive=LineDrive(speed=100 * UM, travel=travel, force_limit=1.0)),
        walls,
        duration=travel / (100 * UM),
    )  # fmt: skip
    values = {
        "start_y": y,
        "start_theta": theta,
        "mu_pusher": friction,
        "friction_centre_y": centre,
    }
    run = simulate_batch(scene, values, motion="quasistatic")
    return run.final[:, 0, 0] + 0.5 * LENGTH > DEEP - 30 * UM


def _draws(n, rng):
    return np.column_stack((
        rng.uniform(-5 * UM, 5 * UM, n), rng.uniform(-0.5, 0.5, n) * pi / 180,
        rng.uniform(0.5, 0.75, n), rng.normal(0.0, 20 * UM, n),
    ))  # fmt: skip


@pytest.mark.parametrize("ahead", [50, 300])
def test_K12_success_rises_with_the_clearance(ahead):
    draws = _draws(24, np.random.default_rng(12))
    probe = Disk(12.5 * UM)
    rates = [_inserted(c * UM, ahead * UM, probe, draws).mean() for c in (13, 40, 80, 130, 158)]
    # Common random numbers; one draw of 24 may change sides by roughness.
    assert np.all(np.diff(rates) >= -1 / 24)
    assert rates[-2:] == [1.0, 1.0]
    assert rates[0] < 0.9


@pytest.mark.parametrize("clearance", [13, 40])
def test_K12_a_flush_wide_pusher_inserts_every_part_that_starts_inside_the_mouth(clearance):
    draws = _draws(24, np.random.default_rng(13))
    draws[:, 0] *= 0.09 * clearance
    draws[:, 1] = 0.0
    wide = Polygon.rectangle(25 * UM, WIDTH)
    assert _inserted(clearance * UM, 300 * UM, wide, draws).all()
    draws[:, 0] = np.sign(draws[:, 0]) * 0.6 * clearance * UM  # outside the mouth
    assert not _inserted(clearance * UM, 300 * UM, wide, draws).any()
