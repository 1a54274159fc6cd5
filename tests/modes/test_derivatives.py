"""Derivatives of ends, compared with differences of small fixed steps and of known motion."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.seated import free_push as any_push, seated_grasp

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    LineDrive,
    PathDrive,
    Plane,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
    Tripod,
)
from fixel.simulation import Adaptive, Midpoint, Simulator, simulate, simulate_batch
from fixel.testing.scenes import box, free_push, grasp, pushed_square, row

SUPPORT = Tripod(radius=0.03, friction=0.3)
NAMES = ("mu_pusher", "tripod_radius", "x", "y", "theta")


def _without_pegs(seed):
    """The push of a seated grasp over 60 mm, without pegs."""
    scene = seated_grasp(seed)
    push = scene.pushers[0]
    drive = replace(push.drive, travel=0.06)
    return replace(scene, fixels=(), pushers=(replace(push, drive=drive),), duration=5.0)


def _differences(scene, name, width):
    """Derivative of the end by fixed steps, from differences over `width`."""
    body = scene.bodies[0]
    simulator = Simulator(
        scene, motion="quasistatic", stepper=Midpoint(step=scene.duration / 20_000)
    )
    ends = []
    for sign in (1.0, -1.0):
        start = np.array(body.pose)
        values = {}
        if name in ("x", "y", "theta"):
            start[("x", "y", "theta").index(name)] += sign * width
        else:
            nominal = {
                "mu_pusher": scene.pushers[0].friction, "tripod_radius": body.support.radius
            }  # fmt: skip
            values[name] = nominal[name] + sign * width
        ends.append(np.array(simulator.run(values, start=start).final[body.name]))
    return (ends[0] - ends[1]) / (2.0 * width)


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_differences_of_fixed_steps(seed):
    scene = _without_pegs(seed)
    push = simulate(scene, motion="quasistatic", derivatives=NAMES)
    scale = np.array([1.0, 1.0, 0.05])  # [m/rad]
    for name in NAMES:
        width = 1e-3 if name in ("mu_pusher", "theta") else 1e-4
        numeric = scale * _differences(scene, name, width)
        # Below this, differences of fixed steps are noise.
        size = max(np.linalg.norm(numeric), 0.05 if name in ("x", "y", "tripod_radius") else 0.02)
        assert np.linalg.norm(scale * push.derivatives[name] - numeric) < 0.05 * size, name


def test_a_face_that_lies_flush_moves_with_the_head():
    """Friction, and where the part starts along the push, make no difference then."""
    head = Pusher(
        name="head",
        shape=box(0.04, 0.04),
        pose=row(0.0, 0.0, 0.0),
        drive=LineDrive(direction=row(1.0, 0.0), speed=0.01, travel=0.05),
        friction=0.5,
    )
    part = Body(
        name="part",
        shape=box(0.06, 0.06),
        mass=0.2,
        pose=row(0.055, 0.002, 0.0),
        support=Tripod(radius=0.01, friction=0.3),
    )
    scene = Scene(bodies=(part,), pushers=(head,), duration=6.0)
    slope = simulate(scene, motion="quasistatic", derivatives=NAMES).derivatives
    assert slope["x"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert slope["y"] == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
    assert slope["mu_pusher"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("drive", [
    LineDrive((1, 0), speed=0.02, travel=0.04),
    PathDrive([(0, 0, 0, 0), (1, 0.02, 0, 0), (2, 0.035, 0.004, -0.06), (3, 0.05, 0.001, 0.08)]),
])  # fmt: skip
def test_a_face_that_lands_flush_has_no_derivative_by_its_angle(drive):
    """One-sided differences by angles differ; by other names they agree with the derivative."""
    head = Pusher("head", box(0.03, 0.03), pose=(0, 0, 0), drive=drive, friction=0.5)
    support = Tripod(radius=0.012, friction=0.3)
    part = Body("part", box(0.06, 0.06), mass=0.2, pose=(0.048, 0.004, 0.0), support=support)
    scene = Scene(part, head, duration=3.0)
    angles = ("start_theta", "outline_theta", "registration_theta")
    kept = ("registration_y", "mu_pusher")
    names = (*angles, "theta", *kept)
    asked = {"motion": "quasistatic", "derivatives": names}
    push = simulate(scene, **asked)
    slope = push.derivatives
    assert tuple(slope) == kept
    assert f"no derivatives by {', '.join(names[:4])}: " in str(push)
    batch = simulate_batch(scene, {"mu_pusher": [0.5]}, **asked)
    assert [name for name in names if np.isnan(batch.derivatives[name]).all()] == list(names[:4])
    assert not batch.differentiable.any()
    exact = Simulator(scene, motion="quasistatic", stepper=Adaptive(tolerance=1e-11))
    for name in (*angles, *kept):
        below, above = _one_sided(exact, name, 0.5 if name == "mu_pusher" else 0.0)
        if name in angles:
            assert np.abs(above - below).max() > 5e-3
        else:
            assert slope[name] == pytest.approx(above, abs=1e-4)
            assert slope[name] == pytest.approx(below, abs=1e-4)


def _one_sided(simulator, name, value):
    """Derivatives of the end below and above the value of a parameter, by differences."""
    ends = [np.array(simulator.run({name: value + d}).final["part"]) for d in (-1e-5, 0.0, 1e-5)]
    return np.diff(ends, axis=0) / 1e-5


def _met_at_once(case):
    """A part that two contacts reach at the same time, and the names that have no derivative."""
    support = Tripod(radius=0.012, friction=0.3)
    drive = LineDrive((1, 0), speed=0.02, travel=0.05)
    head = Pusher("head", Disk(0.008), pose=(0.01, 0, 0), drive=drive, friction=0.3)
    part = Body("part", box(0.06, 0.06), mass=0.2, pose=(0.06, 0, 0), support=support)
    pegs = [Fixel(name, Disk(0.005), pose=(0.115, y, 0), friction=0.2)
            for name, y in (("left", -0.015), ("right", 0.015))]  # fmt: skip
    lacking = {"start_y", "start_theta", "registration_theta"}
    if case == "a face on two pegs":
        head = replace(head, drive=replace(drive, force_limit=2.0))
    elif case == "a face of which one corner stays on the head":
        head = replace(head, shape=box(0.024, 0.024), pose=(0, 0.02, 0))
        pegs, lacking = [], {"start_theta", "registration_theta"}
    elif case == "a disk in a notch of the head":
        notch = [(0, -0.03), (0.02, -0.03), (0.005, 0), (0.02, 0.03), (0, 0.03)]
        head = replace(head, shape=Polygon(notch), pose=(0, 0, 0))
        part, pegs = replace(part, shape=Disk(0.02)), []
        lacking = {"start_y", "registration_theta"}
    return Scene(part, head, fixels=pegs, duration=2.6), lacking


@pytest.mark.parametrize("case", [
    "a face on two pegs", "a face of which one corner stays on the head",
    "a disk in a notch of the head",
])  # fmt: skip
def test_two_contacts_that_close_at_once_have_no_derivative_by_what_parts_them(case):
    """Other names have the derivatives of both sides."""
    scene, lacking = _met_at_once(case)
    values = {"start_x": 0.0, "start_y": 0.0, "start_theta": 0.0, "registration_theta": 0.0,
              "mu_pusher": 0.3, "tripod_radius": 0.012, "mass": 0.2}  # fmt: skip
    slope = simulate(scene, motion="quasistatic", derivatives=tuple(values)).derivatives
    assert set(values) - set(slope) == lacking
    exact = Simulator(scene, motion="quasistatic", stepper=Adaptive(tolerance=1e-11))
    for name in slope:
        for side in _one_sided(exact, name, values[name]):
            assert slope[name] == pytest.approx(side, rel=0.01, abs=2e-3), name


def test_a_seated_part_does_not_depend_on_its_start():
    """Pegs and head hold the part where geometry alone says."""
    push = simulate(seated_grasp(0), motion="quasistatic", derivatives=NAMES)
    assert np.abs(list(push.derivatives.values())).max() < 1e-3


def test_a_batch_has_the_derivatives_of_its_runs():
    """Also the same bits for any number of threads, and none where modes alternate."""
    scene, friction = free_push(SUPPORT), np.linspace(0.1, 0.5, 70)
    names = ["mu_pusher", "theta", "tripod_radius"]
    batches = [
        simulate_batch(
            scene,
            {"mu_pusher": friction},
            motion="quasistatic",
            threads=threads,
            derivatives=names,
        )
        for threads in (1, 2)
    ]
    runs = batches[0]
    for name in names:
        assert np.array_equal(runs.derivatives[name], batches[1].derivatives[name])
    assert runs.differentiable.all()
    assert "derivatives of 70 runs" in str(runs)
    own = simulate(
        scene, {"mu_pusher": friction[40]}, motion="quasistatic", derivatives=names
    ).derivatives
    assert list(runs.derivatives) == names
    for name in names:
        assert runs[40].derivatives[name] == pytest.approx(own[name][None], rel=1e-6)
    alternate = simulate_batch(seated_grasp(578), motion="quasistatic", derivatives=["x"])
    assert not alternate.differentiable.any()
    assert np.isnan(alternate.derivatives["x"]).all()


def test_a_batch_is_differentiated_and_confirmed_where_its_last_times_end():
    """Derivatives at half the time, against differences over 2 % of friction."""
    scene, times, mu = pushed_square(), [0.5, 1.0], 0.25 + 0.005 * np.array([-1.0, 0.0, 1.0])
    tight = Adaptive(tolerance=1e-9)
    asked = {"motion": "quasistatic", "stepper": tight, "times": times, "accuracy": True}
    runs = simulate_batch(scene, {"mu_pusher": mu}, derivatives=["mu_pusher"], **asked)
    slope = (runs.final[2, 0] - runs.final[0, 0]) / 0.01
    assert runs.differentiable.all()
    assert runs.derivatives["mu_pusher"][1] == pytest.approx(slope, rel=0.01)
    assert list(runs.accuracy) == ["certified"] * 3


@pytest.mark.parametrize("scene", [pushed_square(), grasp(), seated_grasp(3)])
def test_modes_that_were_differentiated_confirm_the_end_to_the_same_bits(scene):
    friction = {"mu_pusher": np.linspace(0.1, 0.4, 5)}
    names = ("mu_support", "x", "theta")
    alone = simulate_batch(scene, friction, motion="quasistatic", accuracy=True)
    both = simulate_batch(scene, friction, motion="quasistatic", accuracy=True, derivatives=names)
    assert both.accuracy.tolist() == alone.accuracy.tolist()
    assert both.apart.tobytes() == alone.apart.tobytes()
    one = simulate(scene, {"mu_pusher": 0.1}, motion="quasistatic", accuracy=True)
    push = simulate(
        scene, {"mu_pusher": 0.1}, motion="quasistatic", accuracy=True, derivatives=names
    )
    assert push.accuracy.other.tobytes() == one.accuracy.other.tobytes()
    assert push.accuracy.verdict == one.accuracy.verdict == both.accuracy[0]


def test_shifts_of_the_start_and_of_the_path():
    """A shifted path and a start that is shifted the other way differ by a shift of all."""
    scene = free_push(SUPPORT)
    slope = simulate(
        scene,
        motion="quasistatic",
        derivatives=["x", "start_x", "y", "registration_y", "outline_x", "start_theta", "theta"],
    ).derivatives
    assert slope["start_x"] == pytest.approx(slope["x"], abs=1e-6)
    assert slope["start_theta"] == pytest.approx(slope["theta"], abs=1e-6)
    assert slope["y"] + slope["registration_y"] == pytest.approx([0.0, 1.0, 0.0], abs=1e-5)
    assert np.linalg.norm(slope["outline_x"] - slope["x"]) > 0.01


@pytest.mark.parametrize(("scene", "name"), [
    (free_push(SUPPORT), "anisotropy_xy"),  # friction that depends on the direction of slip
    (seated_grasp(578), "x"),  # whose modes alternate
])  # fmt: skip
def test_what_modes_do_not_describe_has_no_derivative(scene, name):
    push = simulate(scene, motion="quasistatic", derivatives=[name])
    assert push.derivatives == {}
    assert "no derivatives" in str(push)


def test_the_report_has_units():
    push = simulate(free_push(SUPPORT), motion="quasistatic", derivatives=["mu_pusher", "x"])
    assert list(push.derivatives) == ["mu_pusher", "x"]
    assert "m per unit" in str(push)
    assert push.summary()["derivatives"]["x"] == push.derivatives["x"].tolist()


def test_inertia_has_no_derivatives():
    with pytest.raises(InvalidInput, match="derivatives: found dynamic motion") as refused:
        simulate(grasp(), derivatives=["mu_pusher"])
    assert refused.value.hint == 'motion="quasistatic"'


def test_parameters_without_one_value_are_refused():
    with pytest.raises(InvalidInput, match="ellipsoid_force"):
        simulate(grasp(), motion="quasistatic", derivatives=["ellipsoid_force"])
    with pytest.raises(InvalidInput, match="mu_pushr"):
        simulate(grasp(), motion="quasistatic", derivatives=["mu_pushr"])


def _tight(scene, name, width):
    """Derivative of the end by differences of the stepper at a tolerance of 1e-11 m."""
    body = scene.bodies[0]
    simulator = Simulator(scene, motion="quasistatic", stepper=Adaptive(tolerance=1e-11))
    nominal = {
        "mu_pusher": scene.pushers[0].friction,
        "tripod_radius": getattr(body.support, "radius", 0.0),
    }.get(name, 0.0)
    ends = [
        simulator.run({name: nominal + step}, output_interval=scene.duration).final[body.name]
        for step in (width, -width)
    ]
    return (np.array(ends[0]) - np.array(ends[1])) / (2.0 * width)


def _errors(scene, names):
    """Relative errors of derivatives, a radian counted as five centimetres."""
    push = simulate(scene, motion="quasistatic", derivatives=names)
    scale = np.array([1.0, 1.0, 0.05])  # [m/rad]
    errors = {}
    for name in names:
        # Where the stepper sees an event earlier or later, wider differences are exact.
        is_length = name not in ("mu_pusher", "start_theta")
        widths = 1e-4 * np.array([1.0, 3.0, 10.0]) * (0.06 if is_length else 1.0)
        found = [scale * _tight(scene, name, width) for width in widths]
        gaps = [np.linalg.norm(a - b) for a, b in itertools.pairwise(found)]
        numeric = found[int(np.argmin(gaps)) + 1]
        size = max(np.linalg.norm(numeric), 1e-2 if is_length else 1e-3)
        if min(gaps) < 0.003 * size:
            errors[name] = np.linalg.norm(scale * push.derivatives[name] - numeric) / size
    return errors


PROVEN = ("mu_pusher", "tripod_radius", "start_x", "start_y", "start_theta")


@pytest.mark.parametrize("seed", range(20, 32))
def test_agrees_with_a_tight_stepper(seed):
    errors = _errors(_without_pegs(seed), PROVEN)
    assert len(errors) == 5
    assert max(errors.values()) < 0.01


@pytest.mark.parametrize("seed", range(200, 212))
def test_agrees_with_a_tight_stepper_for_every_tool_and_support(seed):
    """Each of three tools on each of four supports."""
    errors = _errors(any_push(seed), ("mu_pusher", "start_x", "start_y", "start_theta"))
    assert len(errors) >= 3
    assert max(errors.values()) < 0.01


def test_agrees_with_a_tight_stepper_where_the_pusher_turns():
    """A corner of the part slides along the head, and corners of the head along the part."""
    for offset, turn in ((0.0, 0.5), (0.02, -0.6), (-0.02, 0.3)):
        path = [(0.0, -0.06, offset, 0.1), (3.0, 0.0, offset, 0.1 + turn)]
        head = Pusher(
            "head", box(0.04, 0.03), pose=path[0][1:], friction=0.2, drive=PathDrive(path)
        )
        part = Body("part", box(0.06, 0.06), mass=0.2, pose=(0.0, 0.0, 0.2), support=SUPPORT)
        errors = _errors(Scene(part, head, duration=3.0), PROVEN)
        assert len(errors) >= 4
        assert max(errors.values()) < 0.01


def test_agrees_with_a_tight_stepper_where_pegs_seat_the_part():
    errors = [e for seed in range(60, 66) for e in _errors(seated_grasp(seed), PROVEN).values()]
    assert len(errors) >= 26
    assert max(errors) < 0.01


@pytest.mark.parametrize(("layout", "start", "radius", "angle", "frictions", "known"), [
    ("seated", (0.10395168901937467, -0.00296119810777981, 0.06400052599753381),
     0.020208661538774104, 4.687664734881332, (0.2710038627336632, 0.23411577999818295),
     {"y": (0.0, -83.590646), "mu_pusher": (0.0, 1.120898)}),
    ("slip", (0.10996780442700164, -0.01027957273037199, 0.27083859900845386), 0.04236896069294342,
     4.41086257594126, (0.08934793030213359, 0.11273223929012872),
     {"y": (0.28372332, 1.21105109), "theta": (-3.688421e-4, -1.574374e-3)}),
])  # fmt: skip
def test_starts_that_move_the_end_far(layout, start, radius, angle, frictions, known):
    """The known values are differences of an integration by DOP853 that enumerates modes."""
    scene = grasp(layout)
    head, peg = frictions
    support = Tripod(radius=radius, friction=0.15, angle=angle)
    scene = replace(
        scene,
        bodies=(replace(scene.bodies[0], pose=row(*start), support=support),),
        pushers=(replace(scene.pushers[0], friction=head),),
        fixels=tuple(replace(fixel, friction=peg) for fixel in scene.fixels),
    )
    found = simulate(scene, motion="quasistatic", derivatives=tuple(known)).derivatives
    for name, value in known.items():
        assert found[name][:2] == pytest.approx(value, rel=2e-3, abs=1e-6), name


def _finger(offset, angle):
    """A finger that touches a square, `offset` from its middle, and moves at an angle."""
    finger = Pusher(
        name="finger",
        shape=Disk(0.005),
        pose=row(-0.035, offset, 0.0),
        drive=LineDrive(direction=row(np.cos(angle), np.sin(angle)), speed=0.02, travel=0.06),
        friction=0.2,
    )
    part = Body(
        name="part", shape=box(0.06, 0.06), mass=0.2, pose=row(0.0, 0.0, 0.0), support=SUPPORT
    )
    return Scene(bodies=(part,), pushers=(finger,), duration=3.0)


@pytest.mark.parametrize(("offset", "angle"), [(0.01, 0.0), (-0.02, 0.0), (0.01, 1.2)])
def test_a_part_that_touches_the_pusher_at_the_start(offset, angle):
    """The last finger slides off, and the part comes to rest."""
    names = (*PROVEN, "registration_y", "contact_offset")
    errors = _errors(_finger(offset, angle), names)
    assert len(errors) == 7
    assert max(errors.values()) < 0.01


def _led(*way):
    """The square of `_finger`, and a finger that goes to places (time, x, y) from its start."""
    scene = _finger(0.01, 0.0)
    path = [(time, -0.035 + x, 0.01 + y, 0.0) for time, x, y in ((0.0, 0.0, 0.0), *way)]
    led = replace(scene.pushers[0], pose=path[0][1:], drive=PathDrive(path))
    return replace(scene, pushers=(led,), duration=path[-1][0])


@pytest.mark.parametrize("rest", [1.0, 5.0])
def test_a_rest_before_a_push_changes_no_derivative(rest):
    names = ("mu_pusher", "start_x", "start_y", "start_theta")
    at_once = simulate(_led((2.0, 0.04, 0.02)), motion="quasistatic", derivatives=names)
    waits = _led((rest, 0.0, 0.0), (rest + 2.0, 0.04, 0.02))
    later = simulate(waits, motion="quasistatic", derivatives=names)
    for name in names:
        assert later.derivatives[name] == pytest.approx(at_once.derivatives[name], rel=2e-3)


def test_a_pusher_that_slides_along_a_part_at_rest_leaves_no_derivative():
    """A start that is turned one way closes the contact earlier; the other way opens it."""
    scene = _led((1.0, 0.0, 0.008), (3.0, 0.04, 0.02))
    push = simulate(scene, motion="quasistatic", accuracy=True, derivatives=["start_theta"])
    assert push.accuracy.verdict == "certified"
    assert not push.derivatives


def test_derivatives_by_support_points_are_those_at_the_points_of_the_scene():
    feet = [(-0.03, -0.02), (0.03, -0.02), (0.0, 0.04)]
    support = SupportPoints(points=feet, friction=0.3)
    part = Body("part", box(0.1, 0.1), mass=1.0, support=support)
    drive = LineDrive(speed=0.02)
    tip = Pusher("tip", Disk(0.005), pose=(-0.055, 0.02, 0.0), friction=0.3, drive=drive)
    scene, tight = Scene(part, tip, duration=1.0), Adaptive(tolerance=1e-8)
    names = {"support_1_x": -0.03, "support_3_y": 0.04}
    found = simulate(scene, motion="quasistatic", derivatives=tuple(names)).derivatives
    for name, value in names.items():
        ends = [
            np.array(simulate(scene, {name: x}, motion="quasistatic", stepper=tight).final["part"])
            for x in (value - 1e-5, value + 1e-5)
        ]
        np.testing.assert_allclose(found[name], (ends[1] - ends[0]) / 2e-5, rtol=0.01)


def test_a_directed_plane_has_no_single_value_of_its_two_parameters():
    scene = replace(pushed_square(), plane=Plane(anisotropy=(1.2, 0.8), axis=0.3))
    with pytest.raises(InvalidInput, match="no single value"):
        simulate(scene, motion="quasistatic", derivatives=("anisotropy_xy",))


def test_a_part_that_lies_against_a_peg_while_the_pusher_comes_back():
    """Friction with the plane changes no end of a part that rests between two pushes.

    It rests against a peg while the pusher leaves and returns. The derivative was -1.3.
    """
    way = [
        (0.0, 0.0, 0.0237, 0.0), (0.49, 0.0061, 0.026, 0.0), (1.22, 0.027, 0.0301, 0.0),
        (2.26, 0.0529, 0.026, 0.0), (3.15, 0.0624, 0.0308, 0.0), (3.74, 0.0913, 0.0283, 0.0),
    ]  # fmt: skip
    points = [(0.0096, 0.001), (-0.0062, 0.0083), (-0.004, -0.0071)]
    part = Body(
        name="part", shape=Disk(0.0466), mass=0.2, pose=row(0.0745, 0.0, 0.0),
        support=SupportPoints(points=points, friction=0.5),
    )  # fmt: skip
    pegs = [
        Fixel(name="one", shape=Disk(0.0099), pose=row(0.1382, 0.0005, 0.0), friction=0.057),
        Fixel(name="two", shape=Disk(0.0077), pose=row(0.137, -0.0462, 0.0), friction=0.057),
        Fixel(name="three", shape=box(0.02, 0.02), pose=row(0.131, 0.0379, -0.057), friction=0.057),
    ]
    finger = Pusher(name="finger", shape=Disk(0.0123), drive=PathDrive(way), friction=0.0085)
    scene = Scene(bodies=(part,), pushers=(finger,), fixels=pegs, duration=3.74)
    push = simulate(scene, motion="quasistatic", derivatives=["mu_support"])
    assert push.derivatives["mu_support"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)


def test_a_flush_face_stays_in_touch_where_the_path_of_the_head_bends():
    """Whether the part rests first depends on the last digits. The derivative along x was 0.019."""
    turn = -0.1423788518254742
    way = [
        (0.0, 0.0, 0.005998053397571, turn),
        (0.8227514640545639, 0.006872198359442048, -0.001955956562580864, turn),
        (1.4459988102166967, 0.03325957643930339, -0.00500788843235294, turn),
        (1.977593904639345, 0.05990856186620466, -0.014999636175616438, turn),
        (2.948418688031613, 0.06673087755298104, -0.01962358899942576, turn),
        (3.403178957054735, 0.0827947611256578, -0.012622048983701104, turn),
        (4.316734522249071, 0.09995913663716528, -0.009277020866443423, turn),
    ]
    low, middle, high = -0.01637668410779117, -0.004767610094514364, 0.02947803139402411
    shelf = -0.00045522641561264525
    outline = [(low, low), (high, low), (high, shelf), (middle, shelf), (middle, high), (low, high)]
    part = Body(
        name="part",
        shape=Polygon(outline),
        mass=0.26016749642248566,
        pose=row(0.0662095355518806, -0.00253004744192503, -1.9159312604726086),
        support=Ellipsoid(force=0.3664562472276461, torque=0.004146670389469242),
        centre_of_mass=(0.0018429689112196886, -0.002951683471105041),
    )
    head = Pusher(
        name="head",
        shape=box(0.029, 0.029),
        drive=PathDrive(way, force_limit=2.086288222546096),
        friction=0.4516551761144289,
    )
    scene = Scene(bodies=(part,), pushers=(head,), duration=3.077960348150711)
    push = simulate(scene, motion="quasistatic", derivatives=["registration_theta"])
    exact = Simulator(scene, motion="quasistatic", stepper=Adaptive(tolerance=1e-11))
    ends = [np.array(exact.run({"registration_theta": d}).final["part"]) for d in (1e-5, -1e-5)]
    slope = (ends[0] - ends[1]) / 2e-5
    assert push.derivatives["registration_theta"] == pytest.approx(slope, abs=1e-4)


def test_the_axes_of_an_ellipsoid_are_values_of_the_scene():
    part = replace(pushed_square().bodies[0], support=Ellipsoid(force=0.5, torque=0.01))
    scene = replace(pushed_square(), bodies=(part,))
    names = ["ellipsoid_force", "ellipsoid_torque"]
    slope = simulate(scene, motion="quasistatic", derivatives=names).derivatives
    # Only their ratio matters.
    assert 0.5 * slope[names[0]] == pytest.approx(-0.01 * slope[names[1]], rel=1e-3)
