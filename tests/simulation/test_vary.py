"""Each named parameter changes the scene as a scene with that value built in."""

from dataclasses import replace

import numpy as np
import pytest

from fixel import InvalidInput, QuasiStatic, simulate
from fixel.model import (
    Disk,
    Ellipsoid,
    Parameters,
    PathDrive,
    Plane,
    Polygon,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.simulation.load_profile import TABLE_NAMES
from fixel.simulation.pack import supports_of
from fixel.simulation.vary import (
    composed,
    infeasible,
    inverted,
    pressure_shares,
    varied_elements,
)
from fixel.testing.scenes import grasp

POINTS = np.array([(0.03, 0.0), (-0.02, 0.03), (-0.02, -0.025)])
GRAIN = np.array([(1.2, 0.15), (0.15, 1.0)])  # of mean 1.1
NET = np.array([(0.04, 0.0), (0.0, 0.04), (-0.04, 0.0), (0.0, -0.04)])


def _scene(support=None, round_pusher=False):
    scene = grasp()
    body = scene.bodies[0]
    if support is not None:
        body = replace(body, support=support)
    pushers = scene.pushers
    if round_pusher:
        pushers = (replace(pushers[0], shape=Disk(0.0143)),)
    return replace(scene, bodies=(body,), pushers=pushers, duration=5.0)


def _pushed_by_hand():
    """Fast enough, and against weak a drive, for the mass to matter."""
    scene = _scene(Tripod(radius=0.04, friction=0.3))
    pusher = scene.pushers[0]
    weak = replace(pusher, drive=replace(pusher.drive, force_limit=0.6))
    return replace(scene, pushers=(weak,), duration=4.0)


def _on_grain(scene, tensor):
    """A plane whose friction by direction is this tensor, by its principal axes."""
    factors, axes = np.linalg.eigh(tensor)
    axis = float(np.arctan2(axes[1, 1], axes[0, 1]))
    return replace(scene, plane=Plane(anisotropy=factors[::-1], axis=axis))


def _end(scene, **values):
    done = simulate(scene, Parameters(values), motion=QuasiStatic())
    assert done.converged, done.status
    return done.pose[scene.bodies[0].name][-1]


def _on_warped_table(scene, turn, bend_xy, slope_y):
    """Supports that press as the table tells them to, the body turned by so much."""
    body = scene.bodies[0]
    x, y = _in_world(NET / 0.04, body.pose[2] + turn).T
    loads = np.exp(0.5 * bend_xy * (x**2 - y**2) + slope_y * y)
    loads *= body.mass * scene.gravity / loads.sum()
    pose = body.pose + np.array([0.0, 0.0, turn])
    return _with_body(scene, pose=pose, support=replace(body.support, loads=loads))


def _in_world(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _with_body(scene, **changes):
    return replace(scene, bodies=(replace(scene.bodies[0], **changes),))


def _moved_path(scene, registration):
    pusher = scene.pushers[0]
    drive = pusher.drive
    start = np.array([0.0, *pusher.pose])
    end = start.copy()
    end[0] = scene.duration
    end[1:3] += drive.speed * scene.duration * np.asarray(drive.direction)
    track = np.stack((start, end))
    track[:, 1:] = composed(np.array(registration), track[:, 1:])
    moved = replace(pusher, pose=track[0, 1:], drive=PathDrive(waypoints=track))
    return replace(scene, pushers=(moved,))


@pytest.mark.parametrize(("scene", "values", "same"), [
    (
        _scene(SupportPoints(points=POINTS, friction=0.3)),
        {"support_1_x": 0.035, "support_1_y": 0.004, "support_3_y": -0.03},
        lambda s: _with_body(
            s,
            support=SupportPoints(
                points=[(0.035, 0.004), (-0.02, 0.03), (-0.02, -0.03)], friction=0.3
            ),
        ),
    ),
    (
        _scene(SupportPoints(points=NET, friction=0.3)),
        {"load_1": 3.0, "load_4": 0.5},
        lambda s: _with_body(
            s, support=SupportPoints(points=NET, friction=0.3, loads=[3.0, 1.0, 1.0, 0.5])
        ),
    ),
    (_scene(SupportPoints(points=NET, friction=0.3)),
     {"table_bend_xy": 0.9, "table_slope_y": -0.4, "start_theta": 0.02},
     lambda s: _on_warped_table(s, 0.02, 0.9, -0.4)),
    (
        _scene(SupportPoints(points=NET, friction=0.3)),
        {"friction_centre_x": 0.004, "friction_centre_y": -0.003},
        lambda s: _with_body(
            s, support=SupportPoints(points=NET + np.array([0.004, -0.003]), friction=0.3)
        ),
    ),
    (_scene(Ellipsoid(force=0.8, torque=0.02)), {"ellipsoid_force": 0.7, "ellipsoid_torque": 0.03},
     lambda s: _with_body(s, support=Ellipsoid(force=0.7, torque=0.03))),
    (_scene(Tripod(radius=0.04, friction=0.3)), {"tripod_radius": 0.05, "mu_support": 0.2},
     lambda s: _with_body(s, support=Tripod(radius=0.05, friction=0.2))),
    (_scene(Tripod(radius=0.04, friction=0.3)), {"pressure_spread": 0.0},
     lambda s: _with_body(s, support=UniformPressure(friction=0.3, n_points=24))),
    (_scene(Ellipsoid(force=0.8, torque=0.02)), {"pressure_spread": 0.0, "mu_support": 0.2},
     lambda s: _with_body(s, support=UniformPressure(friction=0.2, n_points=24))),
    (_pushed_by_hand(), {"mass": 0.4}, lambda s: _with_body(s, mass=0.4)),
    (_scene(), {"anisotropy_xy": 0.06, "anisotropy_diagonal": 0.08},
     lambda s: replace(s, plane=Plane(anisotropy=(1.1, 0.9), axis=0.5 * np.arctan2(0.08, 0.06)))),
    (_on_grain(_scene(), GRAIN), {"anisotropy_xy": -0.1},
     lambda s: _on_grain(s, GRAIN + np.diag((-1, 1)) * (0.5 * (GRAIN[0, 0] - GRAIN[1, 1]) + 0.11))),
    (_scene(), {"registration_x": -0.002, "registration_y": 0.003, "registration_theta": 0.01},
     lambda s: _moved_path(s, (-0.002, 0.003, 0.01))),
    (_scene(), {"start_x": 0.002, "start_y": -0.001, "start_theta": 0.02},
     lambda s: _with_body(s, pose=s.bodies[0].pose + np.array([0.002, -0.001, 0.02]))),
    (_scene(round_pusher=True), {"contact_offset": 0.001},
     lambda s: replace(s, pushers=(replace(s.pushers[0], shape=Disk(0.0153)),))),
], ids=lambda x: "-".join(x) if isinstance(x, dict) else "")  # fmt: skip
def test_a_parameter_is_the_scene_with_that_value(scene, values, same):
    nominal, varied, built = _end(scene), _end(scene, **values), _end(same(scene))
    assert varied == pytest.approx(built, abs=2e-5)
    assert np.abs(varied - nominal).max() > 1e-5


def test_an_outline_elsewhere_in_the_tracked_frame_is_a_shifted_polygon():
    scene = _scene()
    body = scene.bodies[0]
    outline = np.array([0.003, -0.002, 0.1])
    placed = composed(
        outline, np.column_stack((body.shape.vertices, np.zeros(len(body.shape.vertices))))
    )
    com = composed(outline, np.array([*body.com, 0.0]))[:2]
    moved = _with_body(
        scene,
        shape=Polygon(placed[:, :2]),
        centre_of_mass=com,
        support=replace(body.support, angle=getattr(body.support, "angle", 0.0) + 0.1),
    )
    values = {"outline_x": 0.003, "outline_y": -0.002, "outline_theta": 0.1}
    assert _end(scene, **values) == pytest.approx(_end(moved), abs=2e-5)


@pytest.mark.parametrize(("support", "values", "found"), [
    (Ellipsoid(force=1.0, torque=0.1), {"mu_support": 0.2}, "ellipsoidal"),
    (Ellipsoid(force=1.0, torque=0.1), {"tripod_radius": 0.2}, "no body on a tripod"),
    (None, {"support_1_x": 0.01}, "no body on three support points"),
    (SupportPoints(points=POINTS, friction=0.3), {"load_1": 2.0}, "support points"),
    (SupportPoints(points=NET, friction=0.3), {"load_5": 2.0}, "4 support points"),
    (None, {"table_bend": 0.1}, "support points"),
    (SupportPoints(points=POINTS, friction=0.3), {"table_slope_x": 0.1}, "support points"),
    (Ellipsoid(force=1.0, torque=0.1), {"table_bend_xy": 0.1}, "support points"),
    (None, {"ellipsoid_force": 1.0}, "no body on an ellipsoidal"),
    (None, {"contact_offset": 1e-3}, "not round"),
    (SupportPoints(points=POINTS, friction=0.3), {"support_1_x": -0.04}, "outside"),
    (None, {"pressure_spread": 0.0, "tripod_radius": 0.03}, "tripod_radius in addition"),
])  # fmt: skip
def test_a_parameter_without_a_meaning_is_refused(support, values, found):
    with pytest.raises(InvalidInput, match=found):
        _end(_scene(support), **values)


def test_a_flat_table_changes_no_bit():
    scene = _scene(SupportPoints(points=NET, friction=0.3))
    assert (_end(scene, **dict.fromkeys(TABLE_NAMES, 0.0)) == _end(scene)).all()


def test_a_table_spreads_even_pressure_too():
    scene = _scene(UniformPressure(friction=0.3))
    assert np.abs(_end(scene, table_bend=1.5) - _end(scene)).max() > 1e-4


@pytest.mark.parametrize("spread", [-1.2, 0.0, 1.2])
def test_pressure_spreads_over_a_disc_as_the_integral_says(spread):
    """The torque of a disc that turns on the spot, by integration over rings, and no centre but its
    own where the centre of mass is elsewhere."""
    radius, weight = 0.05, 3.0
    ring = (np.arange(20000) + 0.5) / 20000
    share = np.exp(0.5 * spread * (2.0 * ring**2 - 1.0)) * ring
    arm = radius * (share * ring).sum() / share.sum()
    scene = _scene()
    body = replace(scene.bodies[0], shape=Disk(radius), centre_of_mass=(0.0, 0.0))
    disc = replace(scene, bodies=(body,))
    points, loads = pressure_shares(disc, np.array([spread]))
    assert weight * loads[0] @ np.hypot(*points.T) == pytest.approx(weight * arm, rel=0.02)
    off = replace(disc, bodies=(replace(body, centre_of_mass=(0.006, -0.004)),))
    points, loads = pressure_shares(off, np.array([spread]))
    assert loads.sum() == pytest.approx(1.0)
    assert loads[0] @ points == pytest.approx([0.0, 0.0], abs=1e-12)


def test_pressure_that_would_have_to_pull_has_no_simulation():
    scene = _scene()
    far = _with_body(scene, centre_of_mass=scene.bodies[0].shape.centroid + 0.03)
    values = {"pressure_spread": np.array([0.0, 1.0])}
    assert infeasible(scene, values) == ["", ""]
    assert "too far from the centroid" in infeasible(far, values)[0]


@pytest.mark.parametrize("name", ["pressure_spread", "pressure_rim", "table_bend"])
def test_no_bit_of_a_load_depends_on_other_rollouts(name):
    scene = _scene(UniformPressure(friction=0.3))
    centre = scene.bodies[0].shape.centroid + np.array([0.003, -0.002])
    scene = _with_body(scene, centre_of_mass=centre)
    values = np.linspace(-0.9, 0.7, 40)
    elements = supports_of(scene)
    together = varied_elements(scene, elements, {name: values}).load
    for k in range(len(values)):
        alone = varied_elements(scene, elements, {name: values[k : k + 1]}).load
        assert np.array_equal(alone[0], together[k])


def test_infeasible_sets_have_their_reasons():
    scene = _scene(SupportPoints(points=POINTS, friction=0.3))
    values = {
        "support_1_x": np.array([0.03, -0.04, 0.2, -0.02]),
        "anisotropy_xy": np.array([0.0, 0.0, 0.0, 0.96]),
    }
    reasons = infeasible(scene, values)
    assert reasons[0] == ""
    assert "outside the support triangle" in reasons[1]
    assert "outside the outline" in reasons[2]
    assert reasons[3]


def test_what_is_below_its_range_has_no_simulation():
    values = {"tripod_radius": np.array([0.0, 0.01]), "mu_pusher": np.array([0.1, -0.1])}
    reasons = infeasible(_scene(), values)
    assert "tripod_radius" in reasons[0]
    assert "mu_pusher" in reasons[1]


def test_a_pose_and_its_inverse_cancel():
    pose = np.array([[0.3, -0.2, 2.0], [1.0, 2.0, -3.0]])
    assert composed(pose, inverted(pose)) == pytest.approx(np.zeros((2, 3)), abs=1e-15)
