"""Code as users write it: mypy checks this file too, so the types of arguments must accept it."""

import fixel
from fixel.model import PairFriction, Trajectory
from fixel.units import mm


def test_one_thing_or_several_and_any_array() -> None:
    support = fixel.Tripod(radius=0.03, friction=0.25)
    shape = fixel.Polygon([(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)])
    part = fixel.Body("part", shape, mass=0.5, support=support, pose=[0.0, 0.0, 0.0])
    tip = fixel.Pusher("tip", fixel.Disk(5 * mm), friction=0.3, pose=(-6 * mm, 0.03, 0),
                       drive=fixel.LineDrive((1, 0), speed=20 * mm))  # fmt: skip
    peg = fixel.Fixel("peg", fixel.Disk(5 * mm), pose=(0.2, 0.0, 0.0), friction=0.2)
    friction = PairFriction(("part", "tip"), friction=0.2)

    scene = fixel.Scene(part, tip, peg, contact_friction=friction, duration=2.0)

    assert scene == fixel.Scene([part], (tip,), [peg], contact_friction=[friction], duration=2)
    first: fixel.Body = scene.bodies[0]
    assert float(first.pose[0]) == 0.0
    assert fixel.Scene(part, fixel.Pusher("tip", fixel.Disk(5 * mm), friction=0.3)).duration is None


def test_centres_and_paths_are_given_as_lists() -> None:
    support = fixel.Tripod(radius=0.02, friction=0.25)
    square = fixel.Polygon.rectangle(0.1, 0.1)
    part = fixel.Body("part", square, mass=0.5, support=support, centre_of_mass=(0.002, 0.0))
    path = fixel.PathDrive([(0.0, -0.06, 0.0, 0.0), (1.0, -0.05, 0.0, 0.0)])
    track = Trajectory(time=[0.0, 1.0], pose=[(0.0, 0.0, 0.0), (0.01, 0.0, 0.1)])
    assert part.centre_of_mass is not None
    assert float(path.waypoints[1, 0]) == float(track.time[1]) == 1.0
