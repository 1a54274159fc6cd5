"""Scenes: names, overlaps, friction of pairs."""

from math import pi
from time import process_time

import pytest
from tests.fixtures import refused

from fixel import Body, Disk, Fixel, LineDrive, PairFriction, Polygon, Pusher, Scene

SQUARE = Polygon([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
ELL = Polygon([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])


def free(name, *pose, shape=SQUARE):
    return Body(name=name, shape=shape, mass=1.0, pose=pose)


def fixel(name, *pose, shape=SQUARE, friction=0.2):
    return Fixel(name=name, shape=shape, pose=pose, friction=friction, restitution=0.4)


def scene(*bodies, **fields):
    return Scene(bodies=bodies, **{"duration": 1.0, **fields})


ANY_PAIR = [PairFriction(pair=("*", "*"), friction=0.3)]


def test_the_names_come_in_order():
    push = Pusher(
        name="p", shape=SQUARE, pose=(-5, 0, 0), drive=LineDrive(direction=(1, 0), speed=1),
        friction=0.5,
    )  # fmt: skip
    made = scene(free("a", 0, 0, 0), pushers=[push], fixels=[fixel("f", 5, 0, 0)])
    assert made.names == ("a", "p", "f")
    assert made.friction("a", "p") == made.friction("p", "a") == 0.5
    assert made.friction("a", "f") == 0.2
    assert made.restitution("f", "a") == 0.4


@pytest.mark.parametrize(("a", "b", "depth"), [
    (free("a", 0, 0, 0), fixel("b", 0.9, 0.2, 0), "100 mm"),
    (free("a", 0, 0, 0), fixel("b", 0.6, 0, pi / 4), "607.1 mm"),
    (free("a", 0, 0, 0, shape=Disk(1.0)), fixel("b", 0, 1.9, 0, shape=Disk(1.0)), "100 mm"),
    (free("a", 0, 0, 0, shape=Disk(0.25)), fixel("b", 0.7, 0, 0), "50 mm"),
    (free("a", 0, 0, 0), fixel("b", 0.1, 0, 0, shape=Disk(0.01)), "410 mm"),
    (free("a", 0, 0, 0, shape=ELL), fixel("b", 1.4, 1.55, 0, shape=SQUARE), "100 mm"),
])  # fmt: skip
def test_bodies_that_overlap_are_refused_with_their_names_and_the_depth(a, b, depth):
    refused(scene, a, fixels=[b], match=f"'a' and 'b': found an overlap of {depth}")


@pytest.mark.parametrize(("shape", "fixels"), [
    (SQUARE, [fixel("b", 1, 0, 0)]),
    (SQUARE, [fixel("b", 1 - 1e-7, 0.9, 0)]),
    (SQUARE, [fixel("b", 0.5 + 0.5**0.5, 0, pi / 4)]),
    (SQUARE, [fixel("b", 0, 0.51, 0, shape=Disk(0.01))]),
    (ELL, [fixel("b", 1.6, 1.6, 0)]),  # in the notch
    (SQUARE, [fixel("b", 5, 0, 0), fixel("c", 5, 0, 0)]),  # obstacles over each other
])  # fmt: skip
def test_bodies_that_touch_and_obstacles_that_overlap_are_fine(shape, fixels):
    made = scene(free("a", 0, 0, 0, shape=shape), fixels=fixels)
    assert made.names == ("a", "b", "c")[: 1 + len(fixels)]


@pytest.mark.parametrize(("make", "words"), [
    (lambda: scene(), "no free body"),
    (lambda: scene(free("a", 0, 0, 0), fixels=[fixel("a", 5, 0, 0)]), "the name 'a' twice"),
    (lambda: scene(free("a", 0, 0, 0), duration=0), "duration"),
    (lambda: scene(free("a", 0, 0, 0), duration=float("inf")), "duration"),
    (lambda: scene(free("a", 0, 0, 0), gravity=-1), "gravity"),
    (lambda: scene(free("a", 0, 0, 0), support_directions=3), "support_directions"),
    (lambda: scene(free("a", 0, 0, 0), support_directions=True), "support_directions"),
    (lambda: scene(free("a", 0, 0, 0), fixels=[3]), r"fixels\[0\]"),
    (lambda: scene(free("a", 0, 0, 0), plane=None), "plane"),
    (
        lambda: scene(
            free("box", 0, 0, 0),
            fixels=[fixel("f", 5, 0, 0)],
            contact_friction=[PairFriction(pair=("bxo", "f"), friction=0.1)],
        ),
        r"contact_friction\[0\].pair is 'bxo', but must be one of box, f; did you mean 'box'",
    ),
    (lambda: PairFriction(pair=("a", "a"), friction=0.1), "twice"),
    (lambda: PairFriction(pair="ab", friction=0.1), "two names"),
    (lambda: PairFriction(pair=("a", "b"), friction=-0.1), "at least 0"),
])  # fmt: skip
def test_a_scene_that_cannot_be_is_refused(make, words):
    refused(make, match=words)


def test_free_bodies_need_a_friction_for_their_contact():
    bodies = [free("a", 0, 0, 0), free("b", 2, 0, 0), free("c", 4, 0, 0)]
    refused(scene, *bodies, match=r"free bodies 'a' and 'b'.*add \{pair: \[a, b\]")
    one = PairFriction(pair=("b", "a"), friction=0.1)
    refused(scene, *bodies, contact_friction=[one], match="free bodies 'a' and 'c'")
    made = scene(*bodies, contact_friction=[*ANY_PAIR, one])
    assert made.friction("a", "b") == 0.1  # a name counts more than a pattern
    assert made.friction("c", "b") == 0.3
    assert made.restitution("a", "b") == 0.0


def test_an_entry_replaces_what_the_obstacle_says():
    entry = PairFriction(pair=("f*", "a"), friction=0.9)
    made = scene(free("a", 0, 0, 0), fixels=[fixel("f1", 5, 0, 0)], contact_friction=[entry])
    assert made.friction("a", "f1") == 0.9
    assert made.restitution("a", "f1") == 0.4


def test_a_pair_that_cannot_touch_or_is_unknown_is_refused():
    made = scene(free("a", 0, 0, 0), fixels=[fixel("f", 5, 0, 0), fixel("g", 5, 0, 0)])
    refused(made.friction, "f", "g", match="one free body")
    refused(made.friction, "a", "h", match="must be one of a, f, g")


def test_two_hundred_touching_bodies_are_checked_quickly():
    bodies = [free(f"b{k}", k % 15, k // 15, 0) for k in range(200)]
    start = process_time()
    scene(*bodies, contact_friction=ANY_PAIR)
    assert process_time() - start < 1.0  # 0.03 s where this was written; room for a busy machine
