"""Balanced loads on a net of points, against a general optimiser and against given loads."""

import numpy as np
import pytest
from tests.fixtures import refused
from tests.simulation.test_load_map import nearest_loads

from fixel import Body, Disk, LineDrive, Polygon, Pusher, Scene, SupportPoints, UniformPressure
from fixel.simulation import QuasiStatic, StewartTrinkle, simulate
from fixel.simulation.load_profile import PROFILE_NAMES, LoadNet, balance
from fixel.simulation.vary import infeasible

TRIANGLE = Polygon([(0.0, 0.0), (0.12, 0.0), (0.0, 0.09)])
CONCAVE = Polygon([(0, 0), (0.1, 0), (0.1, 0.03), (0.03, 0.03), (0.03, 0.1), (0, 0.1)])


def shares(shape, centre_of_mass, **values):
    n = len(next(iter(values.values()))) if values else 1
    net = LoadNet.of(shape)
    given = {name: np.asarray(x, np.float64) for name, x in values.items()}
    centre = np.asarray(shape.centroid)
    return net.points, net.shares(given, np.asarray(centre_of_mass), np.zeros(n), centre)


@pytest.mark.parametrize("shape", [Disk(0.05), TRIANGLE, CONCAVE], ids=["disk", "triangle", "L"])
def test_any_profile_is_balanced(shape):
    rng = np.random.default_rng(0)
    values = {name: rng.normal(0.0, 2.0, 200) for name in PROFILE_NAMES[:4]}
    com = np.add(shape.centroid, (2e-3, -1e-3))
    points, load = shares(shape, com, **values)
    assert np.abs(load @ points - com).max() < 1e-9
    np.testing.assert_allclose(load.sum(axis=1), 1.0)
    assert load.min() > 0.0


def test_equal_loads_without_values_on_a_symmetric_plate():
    square = Polygon([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    points, load = shares(square, (0.0, 0.0), pressure_rim=[0.0])
    np.testing.assert_allclose(load, 1.0 / len(points), rtol=1e-9)


def test_balance_changes_the_loads_as_little_as_a_general_optimiser_finds():
    points = LoadNet.of(TRIANGLE).points - TRIANGLE.centroid - [4e-3, 2e-3]
    log_load = np.random.default_rng(1).normal(size=(1, len(points)))
    before = np.exp(log_load[0]) / np.exp(log_load[0]).sum()
    tilt = balance(log_load, points / 0.1)
    ours = before * np.exp(points / 0.1 @ tilt[0])
    ours /= ours.sum()
    np.testing.assert_allclose(ours, nearest_loads(before, points, np.zeros(2)), atol=1e-5)


def test_tilt_moves_the_centre_of_pressure_its_way():
    points, load = shares(TRIANGLE, TRIANGLE.centroid, pressure_tilt_x=[0.3, 0.0])
    x = load @ points[:, 0] - TRIANGLE.centroid[0]
    assert x[0] > 2e-3
    assert abs(x[1]) < 1e-9


def test_parameters_simulate_like_the_loads_they_stand_for():
    values = {
        "pressure_rim": 1.2,
        "pressure_corner": -0.7,
        "pressure_xy": 0.5,
        "table_bend_xy": 0.8,
    }
    points, load = shares(TRIANGLE, TRIANGLE.centroid, **{name: [x] for name, x in values.items()})

    def pushed(support):
        body = Body("part", TRIANGLE, mass=0.8, support=support)
        drive = LineDrive(speed=0.02, direction=(0.0, 1.0))
        tip = Pusher("tip", Disk(5e-3), pose=(0.02, -5e-3, 0.0), drive=drive, friction=0.25)
        return Scene(bodies=(body,), pushers=(tip,), duration=1.0)

    method = {"motion": QuasiStatic(), "stepper": StewartTrinkle(step=0.02)}
    given = pushed(SupportPoints(points=points, friction=0.3, loads=load[0] * 0.8 * 9.81))
    even = pushed(UniformPressure(friction=0.3))
    expected = simulate(given, **method).final["part"]
    answer = simulate(even, values, **method).final["part"]
    np.testing.assert_allclose(list(answer), list(expected), atol=2e-6)


def test_centre_of_mass_outside_the_points_is_refused():
    com = (0.115, 0.0)
    refused(shares, TRIANGLE, com, pressure_rim=[0.0], match="not above the support points")
    feet = SupportPoints(points=[(0.0, 0.0), (0.12, 0.0), (0.0, 0.02)], friction=0.3)
    body = Body("part", TRIANGLE, mass=0.8, centre_of_mass=com, support=feet)
    reasons = infeasible(Scene(bodies=(body,), duration=1.0), {"pressure_rim": np.zeros(2)})
    assert reasons == ["the centre of mass is not above the support points"] * 2


@pytest.mark.parametrize("other", ["pressure_spread", "tripod_radius", "load_1"])
def test_two_supports_at_once_are_refused(other):
    from fixel.model.parameters import check_supports

    refused(check_supports, ["pressure_rim", other], match="in addition to it")
