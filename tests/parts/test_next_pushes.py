"""Proposed pushes: what is unseen, both bounds, and what is expected of them."""

import numpy as np
import pytest
import shapely

from fixel.parts.next_pushes import push_candidates
from fixel.testing.pushes import example_parts


@pytest.fixture(scope="module")
def part():
    return example_parts(1, 16, seed=9)


@pytest.fixture(scope="module")
def candidates(part):
    return push_candidates(part[0].scene, contacts=6, travel=0.04)


@pytest.fixture(scope="module")
def found(model, candidates):
    return model.next_pushes(candidates, n=4, part="new", surface="board")


def test_what_is_unseen_comes_first_and_both_bounds_follow(found):
    lines = repr(found).splitlines()
    assert lines[0].startswith("Unseen: part 'new': no experiment with it")
    assert (found.position > 0.0).all()
    assert found.position[0] <= found.position[1]
    assert found.angle[0] <= found.angle[1]
    assert all(line.count(" / ") == 2 for line in lines[3:7])


def test_expected_bounds_fall_but_not_below_the_misfit(found):
    ratio = found.shrinking
    assert (np.diff(np.concatenate(([1.0], ratio))) <= 1e-12).all()
    assert ratio[-1] >= found.misfit / found.error - 1e-12
    assert len(found.to_dict()["typical_mm"]) == 4


def test_places_are_next_to_the_outline_in_its_frame(found, candidates):
    outline = shapely.Polygon(found.outline)
    for place, end in zip(found.start, found.end, strict=True):
        assert shapely.distance(outline, shapely.Point(place)) == pytest.approx(0.0051, abs=2e-4)
        assert np.hypot(*(end - place)) == pytest.approx(0.04)


def test_bits_are_equal_for_any_number_of_threads(model, candidates, found):
    from dataclasses import replace

    two = replace(model, threads=2).next_pushes(candidates, n=4, part="new", surface="board")
    assert two.order == found.order
    assert two.variance.tobytes() == found.variance.tobytes()
    assert two.position.tobytes() == found.position.tobytes()


def test_intended_pushes_change_what_is_worth_most(model, candidates):
    few = model.next_pushes(candidates, candidates[:2], n=1, part="new", surface="board")
    assert few.bounded[1] == 2
    every = model.next_pushes(candidates, n=1, part="new", surface="board")
    assert every.bounded[1] == len(candidates)


def test_pushes_of_the_part_lower_what_more_of_them_are_worth(model, part, candidates, found):
    after = model.after(part[:8]).next_pushes(candidates, n=4, part="new", surface="board")
    assert after.unseen[0] == "part 'new': only 8 pushes of it"
    assert after.variance[0] < found.variance[0]


def test_the_part_may_lie_anywhere_on_the_table(model, part, found):
    from dataclasses import replace

    scene = part[0].scene
    body = replace(scene.bodies[0], pose=(0.3, -0.2, 2.0))
    moved = push_candidates(replace(scene, bodies=(body,), pushers=()), contacts=6, travel=0.04)
    other = model.next_pushes(moved, n=4, part="new", surface="board")
    places = {tuple(np.round(1e3 * own, 1).tolist()) for own in other.start}
    assert len(places & {tuple(np.round(1e3 * own, 1).tolist()) for own in found.start}) >= 3
