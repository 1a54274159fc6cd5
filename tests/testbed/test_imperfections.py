"""A rough plate: as rough and as grainy as it says, and in its place."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Ellipsoid,
    FrictionMap,
    NoSupport,
    Plane,
    PlannedExperiment,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.model.probability import stream
from fixel.testbed.imperfections import (
    NODES_PER_GRAIN,
    nominal_friction,
    planned_support,
    rough_plane,
    uneven_support,
    uneven_table,
)
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import box, pushed_square

GRAIN = 0.06  # [m]


def logs(seed, shift=0.0):
    """Logarithms of the multiplier at places 0.2 m apart, too far to know of each other."""
    plane = rough_plane(Plane(), seed, 0.1, GRAIN)
    place = np.stack(np.meshgrid(np.arange(-0.15, 0.5, 0.2), np.arange(-0.3, 0.35, 0.2)), axis=-1)
    return np.log(plane.friction_map.at(place + np.array([shift, 0.0]))).ravel()


def test_roughness_and_grain_are_as_stated():
    here = np.concatenate([logs(seed) for seed in range(100)])
    assert abs(here.mean()) < 0.015
    assert np.std(here) == pytest.approx(0.1, rel=0.1)
    for distance in (0.5 * GRAIN, GRAIN, 2.0 * GRAIN):
        there = np.concatenate([logs(seed, distance) for seed in range(100)])
        expected = np.exp(-0.5 * (distance / GRAIN) ** 2)
        assert np.corrcoef(here, there)[0, 1] == pytest.approx(expected, abs=0.1)


def test_a_map_of_the_plans_own_stays_as_a_factor():
    own = FrictionMap(origin=[0.0, 0.0], cell=[1.0, 1.0], factor=[[2.0]])
    planned = Plane(anisotropy=[1.0, 1.2], axis=0.3, friction_map=own)
    rough, even = rough_plane(planned, 1, 0.1, GRAIN), rough_plane(Plane(), 1, 0.1, GRAIN)
    np.testing.assert_allclose(rough.friction_map.factor, 2.0 * even.friction_map.factor)
    assert replace(rough, friction_map=own) == planned
    assert rough_plane(planned, 1, 0.0, GRAIN) == planned


def body(support):
    return Body(name="object", shape=box(0.1, 0.1), mass=0.2, pose=np.zeros(3), support=support)


def test_friction_is_read_from_any_support():
    limit = Ellipsoid(force=0.5 * 0.2 * 9.81, torque=0.01)
    points = [[-0.04, -0.04], [0.04, -0.04], [0.04, 0.04], [-0.04, 0.04]]
    mixed = SupportPoints(points=points, friction=[0.1, 0.1, 0.3, 0.3])
    assert nominal_friction(body(Tripod(radius=0.04, friction=0.25)), 9.81) == pytest.approx(0.25)
    assert nominal_friction(body(limit), 9.81) == pytest.approx(0.5)
    assert nominal_friction(body(mixed), 9.81) == pytest.approx(0.2)
    assert nominal_friction(body(NoSupport()), 9.81) is None


@pytest.mark.parametrize("support", [
    Tripod(radius=0.04, friction=0.25),
    SupportPoints(points=[[0.0, 0.0], [0.01, 0.0]], friction=[0.1, 0.3]),
    UniformPressure(friction=0.2),
    Ellipsoid(force=0.5, torque=0.01),
], ids=lambda support: type(support).__name__)  # fmt: skip
def test_a_support_as_planned_has_its_true_friction(support):
    rougher = planned_support(support, 1.5)
    before, after = (nominal_friction(body(x), 9.81) for x in (support, rougher))
    assert after == pytest.approx(1.5 * before)
    assert planned_support(support, 1.0) == support
    assert planned_support(NoSupport(), 1.5) == NoSupport()


def test_an_underside_belongs_to_a_shape_and_not_to_a_run():
    tripod = body(Tripod(radius=0.04, friction=0.25))
    options = {"friction_ratio": 1.0, "n_cells": 24, "unevenness": 0.3, "centre": (0.002, 0.0)}
    first, again = (uneven_support(tripod, 9.81, 1, **options) for _ in range(2))
    other = uneven_support(replace(tripod, shape=box(0.1, 0.1001)), 9.81, 1, **options)
    slippery = uneven_support(body(NoSupport()), 9.81, 1, **options)
    assert first == again
    assert np.abs(first.loads - other.loads).max() > 0.01 * first.loads.mean()
    assert slippery == NoSupport()


def test_streams_differ_by_purpose_alone():
    assert stream(1, "run", "a").random() == stream(1, "run", "a").random()
    different = [(1, "run", "a"), (2, "run", "a"), (1, "run", "b"), (1, "ru", "na"), (1, "runa")]
    assert len({stream(*purpose).random() for purpose in different}) == len(different)


def test_an_uneven_table_has_the_stated_deviation_and_length():
    nodes = np.array([uneven_table(Plane(), k, 0.8, GRAIN).load_map.log_load for k in range(40)])
    along = uneven_table(Plane(), 3, 0.8, GRAIN).load_map

    assert nodes.std() == pytest.approx(0.8, rel=0.03)
    steps = NODES_PER_GRAIN  # one length: correlation exp(-1/2)
    near = np.mean(nodes[:, :, steps:] * nodes[:, :, :-steps]) / nodes.var()
    assert near == pytest.approx(np.exp(-0.5), abs=0.05)
    assert along.cell == pytest.approx(GRAIN / steps)


def test_a_table_is_flat_by_default_and_has_a_seed_of_its_own():
    planned = PlannedExperiment(name="push", scene=pushed_square())

    def table(**fields):
        return SimulatedTestbed(**fields).true_scene(planned).plane.load_map

    assert table() is None
    assert table(seed=1, uneven_table=1.0) == table(seed=2, uneven_table=1.0)
    assert table(uneven_table=1.0, table_seed=2) != table(uneven_table=1.0)
    rough = SimulatedTestbed(uneven_table=1.0).true_scene(planned).plane.friction_map
    assert rough == SimulatedTestbed().true_scene(planned).plane.friction_map
    for wrong in ({"table_seed": -1}, {"uneven_table": -1.0}, {"table_length": 0.0}):
        with pytest.raises(InvalidInput, match=next(iter(wrong))):
            SimulatedTestbed(**wrong)
