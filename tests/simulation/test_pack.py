"""Scenes as arrays: units of their own, parameters on the right entries, scenes end to end."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from fixel import Adaptive, Dynamic, FirstOrder, InvalidInput, QuasiStatic, StewartTrinkle, simulate
from fixel.kernels import arrays as at
from fixel.kernels.rollout import select_one
from fixel.model import Body, FrictionMap, NoSupport, PathDrive, Plane, Scene, SupportPoints
from fixel.simulation import AbstractMotionModel
from fixel.simulation.pack import DEFAULT_TOLERANCE, characteristic_units, pack, pusher_path, stack
from fixel.simulation.vary import Variation
from fixel.testing.scenes import box, grasp, heap, micro_push, sliding_block

NET = np.array([(0.04, 0.0), (0.0, 0.04), (-0.04, 0.0), (0.0, -0.04)])


DYNAMIC = Dynamic()


def _pack(scene, parameters=None, n=1, motion=DYNAMIC, start=None):
    values = {k: np.asarray(v, float) for k, v in (parameters or {}).items()}
    variation = Variation(values, start, None)
    return pack(scene, motion, Adaptive(), variation, n, 1.0)


def _one(packed, r):
    return select_one(packed.batch, r)


@pytest.mark.parametrize("scene", [grasp(), micro_push(3), heap(4), sliding_block()])
def test_characteristic_values_are_near_one(scene):
    model = _one(_pack(scene), 0)
    assert 0.1 < np.abs(model.vertex).max() < 10.0
    assert 1e-9 < model.mass[0] <= 1.0 + 1e-12


def test_a_micro_part_and_a_brick_of_the_same_form_give_the_same_numbers():
    part = micro_push(3)
    body = part.bodies[0]
    brick = replace(
        body,
        shape=type(body.shape)(100.0 * body.shape.vertices),
        pose=body.pose * [100.0, 100.0, 1.0],
        support=replace(body.support, points=100.0 * body.support.points),
    )
    probe = part.pushers[0]
    hand = replace(
        probe,
        shape=type(probe.shape)(100.0 * probe.shape.vertices),
        pose=probe.pose * [100.0, 100.0, 1.0],
        drive=replace(probe.drive, speed=100.0 * probe.drive.speed, travel=0.07),
    )
    a = _one(_pack(part), 0)
    b = _one(_pack(replace(part, bodies=(brick,), pushers=(hand,))), 0)
    for name in ("vertex", "element_point", "piece_bound", "inertia"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-12, abs=1e-15) or (
            name == "inertia"
        )


def test_units_of_a_scene_in_which_nothing_is_asked_to_move():
    units = characteristic_units(sliding_block(speed=0.0))
    assert units.speed > 0.0
    assert np.isfinite([units.length, units.time, units.mass]).all()
    assert units.force == pytest.approx(units.mass * units.length / units.time**2)


def test_mu_pusher_and_mu_fixel_set_their_own_pairs_only():
    packed = _pack(grasp(), {"mu_pusher": [0.11, 0.12], "mu_fixel": [0.31, 0.32]}, 2)
    for r in range(2):
        friction = _one(packed, r).friction
        assert friction[0, 1] == friction[1, 0] == 0.11 + 0.01 * r
        assert (friction[0, 2:] == 0.31 + 0.01 * r).all()
        assert (friction[2:, 0] == 0.31 + 0.01 * r).all()
    assert np.array_equal(_one(_pack(grasp()), 0).friction[0], [0.0, 0.25, 0.2, 0.2, 0.2])


def _on_net():
    """A square on four points along its axes, the load on them 1, 2, 3 and 4 parts of ten."""
    net = SupportPoints(points=NET, friction=0.5, loads=0.15 * 9.81 * np.arange(1.0, 5.0) / 10.0)
    body = replace(grasp().bodies[0], pose=(0.0, 0.0, 0.0), support=net)
    return Scene(bodies=(body,), duration=1.0)


def _loads(scene, parameters, n, start=None):
    packed = _pack(scene, parameters, n, start=start)
    limits = np.array([_one(packed, r).element_limit for r in range(n)])
    return limits * packed.units.force / 0.5


def test_a_table_is_met_at_the_angle_of_the_start():
    up, down = np.exp(0.4), np.exp(-0.4)
    share = np.arange(1.0, 5.0) * [[up, down, up, down], [down, up, down, up]]
    start = np.array([[[0.0, 0.0, 0.0]], [[0.3, 0.0, 0.5 * np.pi]]])
    loads = _loads(_on_net(), {"table_bend_xy": [0.8, 0.8]}, 2, start)
    turned = _loads(_on_net(), {"table_bend_xy": [0.8, 0.8], "start_theta": [0.0, 0.5 * np.pi]}, 2)
    weight = 0.15 * 9.81
    assert loads == pytest.approx(weight * share / share.sum(axis=1, keepdims=True), rel=1e-12)
    assert turned == pytest.approx(loads, rel=1e-12)


def test_a_table_multiplies_loads_that_vary_and_keeps_the_weight():
    values = {"table_slope_x": [0.5, -0.2], "load_1": [3.0, 0.0], "mass": [0.15, 0.45]}
    loads = _loads(_on_net(), values, 2)
    assert loads.sum(axis=1) == pytest.approx(np.array(values["mass"]) * 9.81, rel=1e-12)
    # The loads not named stay as they were to each other, but for the slope: 2, 3, 4 parts of ten.
    assert loads[:, 3] / loads[:, 1] == pytest.approx([2.0, 2.0], rel=1e-12)
    assert loads[:, 2] / loads[:, 1] == pytest.approx(1.5 * np.exp([-0.5, 0.2]), rel=1e-12)
    assert loads[1, 0] == 0.0


def test_a_shift_of_the_supports_does_not_change_what_the_table_says():
    shifted = _loads(_on_net(), {"table_bend": [0.4], "friction_centre_x": [0.01]}, 1)
    assert (shifted == _loads(_on_net(), {"table_bend": [0.4]}, 1)).all()


def test_without_gravity_a_table_has_nothing_to_spread():
    body = replace(_on_net().bodies[0], support=SupportPoints(points=NET, friction=0.5))
    scene = Scene(bodies=(body,), duration=1.0, gravity=0.0)
    assert (_loads(scene, {"table_bend": [0.4]}, 1) == 0.0).all()


@pytest.mark.parametrize("motion", [QuasiStatic(), FirstOrder()])
def test_motion_without_inertia_needs_support_friction(motion):
    loose = replace(sliding_block().bodies[0], support=NoSupport())
    with pytest.raises(InvalidInput, match=r"bodies\[0\]\.support.*'block'"):
        _pack(Scene(bodies=(loose,), duration=1.0), motion=motion)
    _pack(Scene(bodies=(loose,), duration=1.0))


def test_start_poses_are_those_of_the_shape_frame():
    body = Body(
        name="b", shape=box(0.1, 0.1), mass=1.0, pose=(0, 0, 0), centre_of_mass=(0.02, 0.01)
    )
    start = np.array([[[1.0, 2.0, np.pi / 2]]])
    packed = _pack(Scene(bodies=(body,), duration=1.0), start=start)
    centre = packed.batch.pose[0] * [packed.units.length, packed.units.length, 1.0]
    assert centre == pytest.approx([1.0 - 0.01, 2.0 + 0.02, np.pi / 2])


def test_path_of_a_line_ends_with_its_travel():
    drive = grasp().pushers[0]
    assert pusher_path(drive, 20.0)[-1] == pytest.approx([0.15 / 0.0135, 0.15, 0.0, 0.0])
    assert pusher_path(drive, 1.0)[-1] == pytest.approx([1.0, 0.0135, 0.0, 0.0])
    still = replace(drive, drive=replace(drive.drive, speed=0.0, force_limit=None))
    assert pusher_path(still, 1.0).shape == (1, 4)
    pushed = replace(drive, drive=replace(drive.drive, speed=0.0, force_limit=1.0))
    path = pusher_path(pushed, 1.0)  # rests for longer than the duration, on its line
    assert path[1, 0] > 1.0
    assert np.array_equal(path[0, 1:], path[1, 1:])
    assert path[2, 1:] - path[1, 1:] == pytest.approx([*drive.drive.direction, 0.0])
    rows = [[0.0, 0.1, 0.2, 0.3], [2.0, 0.2, 0.2, 0.4]]
    measured = replace(drive, pose=None, drive=PathDrive(waypoints=rows))
    assert np.array_equal(pusher_path(measured, 1.0), rows)


def test_stacked_scenes_are_themselves():
    scenes = [grasp(), micro_push(2), heap(5), sliding_block()]
    parts = [_pack(scene) for scene in scenes]
    batch = stack(parts)
    for r, part in enumerate(parts):
        together = select_one(batch, r)
        alone = select_one(part.batch, 0)
        for name in together._fields:
            assert np.array_equal(getattr(together, name), getattr(alone, name)), name
    assert stack(parts[:1]) is parts[0].batch


def test_kernels_compile_once_for_all_scenes():
    # An array that cannot be written to has a type of its own: half a minute of compiling.
    rough = FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[1.0, 2.0], [1.0, 1.0]])
    packed = _pack(replace(grasp(), plane=Plane(friction_map=rough)))
    for array in (*packed.batch.model[:-1], packed.batch.pose, packed.batch.velocity):
        assert array.flags.writeable
        assert array.flags.c_contiguous


def _arrays(value):
    """Yield all arrays in a scene."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _arrays(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _arrays(getattr(value, field.name))


def test_no_array_of_a_scene_can_be_written_to():
    # Its packed arrays are stored for the scene itself, not for its values.
    rough = FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[1.0, 2.0], [1.0, 1.0]])
    net = SupportPoints(points=NET, friction=np.full(4, 0.2), loads=np.ones(4))
    part = replace(grasp().bodies[0], support=net, centre_of_mass=(1e-3, 0.0))
    rows = [[0.0, 0.1, 0.2, 0.3], [2.0, 0.2, 0.2, 0.4]]
    head = replace(grasp().pushers[0], pose=None, drive=PathDrive(waypoints=rows))
    scene = Scene(part, head, grasp().fixels, duration=1.0, plane=Plane(friction_map=rough))
    arrays = list(_arrays(scene))
    assert len(arrays) > 20
    assert not any(array.flags.writeable for array in arrays)


def _bytes(batch):
    return [np.asarray(array).tobytes() for array in (*batch.model, *batch[3:])]


@pytest.mark.parametrize("plain", [False, True])
def test_simulations_leave_shared_arrays_unchanged(plain):
    scene = grasp("slip", force_limit=None)
    before = _pack(scene).batch
    saved = _bytes(before)
    values = {name: [0.01] for name in ("start_x", "mu_fixel", "mass", "tripod_radius")}
    simulate(scene, {name: value[0] for name, value in values.items()}, duration=0.3, plain=plain)
    _pack(scene, values)
    after = _pack(scene).batch
    assert after.model.vertex is before.model.vertex
    assert _bytes(after) == _bytes(before) == saved


class Heavier(AbstractMotionModel):
    """Motion model that writes to what it should only read."""

    name = "heavier"

    def assemble(self, model, state, step, pose, problem):
        model.mass[:] *= 1.5
        return Dynamic().assemble(model, state, step, pose, problem)

    def move(self, model, state, step, problem, extrapolation):
        Dynamic().move(model, state, step, problem, extrapolation)


def test_a_plug_in_cannot_change_later_simulations():
    scene = sliding_block(0.5, 0.25, duration=0.05)
    runs = [simulate(scene, motion=Heavier(), stepper=StewartTrinkle(step=0.01)) for _ in range(2)]
    assert runs[0].final == runs[1].final


@pytest.mark.parametrize(("n", "tolerance"), [(1, DEFAULT_TOLERANCE), (40, 1.6e-4), (200, 1e-3)])
def test_the_default_tolerance_depends_on_the_number_of_bodies(n, tolerance):
    packed = pack(heap(n), DYNAMIC, Adaptive(), Variation({}), 1, 1.0)
    assert packed.batch.settings[0, at.TOLERANCE] == pytest.approx(tolerance)
    fine = pack(heap(n), DYNAMIC, Adaptive(tolerance=1e-9), Variation({}), 1, 1.0)
    assert fine.batch.settings[0, at.TOLERANCE] == pytest.approx(1e-9 / fine.units.length)
