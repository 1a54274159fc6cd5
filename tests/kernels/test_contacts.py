"""The Verlet list against brute force, warm starts, and what happens where the room runs out."""

import math
from typing import NamedTuple

import numba
import numpy as np
import pytest
from tests.kernels.entries import measure_contacts

from fixel.kernels import entries
from fixel.kernels.arrays import Model, Problem, Workspace
from fixel.kernels.contacts import find_contacts, find_near_pairs, moved, place_bodies, warm_start
from fixel.kernels.gap import FEATURES
from fixel.kernels.jit import entry

N_BODY = 40
N_FREE = 25
N_MOVING = 32  # the rest is fixed
SEEDS = range(1 if numba.config.DISABLE_JIT else 5)

# Python cannot call a kernel, only what is compiled around it.
place_bodies_ = entry(lambda model, pose, n, work: place_bodies(model, pose, n, work))
moved_ = entry(lambda model, pose, anchor, n: moved(model, pose, anchor, n))
near_pairs_ = entry(
    lambda model, pose, n_free, n_moving, reach, work: find_near_pairs(
        model, pose, n_free, n_moving, reach, work
    )
)
contacts_ = entry(
    lambda model, n, margin, problem, work: find_contacts(model, n, margin, problem, work)
)
warm_start_ = entry(
    lambda problem, n, key, impulse, n_old, ratio: warm_start(
        problem, n, key, impulse, n_old, ratio
    )
)


class Scene(NamedTuple):
    model: Model
    pose: np.ndarray
    problem: Problem
    work: Workspace


def regular(n, radius):
    angle = np.arange(n) * 2.0 * np.pi / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def model_of(pieces):
    """Model of (body, vertices, radius) pieces; only what contacts look at."""
    empty = np.zeros(0)
    sizes = [len(vertices) for _, vertices, _ in pieces]
    middle = [vertices.mean(axis=0) for _, vertices, _ in pieces]
    bound = [
        [*m, np.hypot(*(v - m).T).max() + r] for m, (_, v, r) in zip(middle, pieces, strict=True)
    ]
    fields = dict.fromkeys(Model._fields, empty)
    fields.update(
        wrench=np.zeros((0, 3)), spring=np.zeros((0, 3)), drag=np.zeros((0, 3, 3)),
        piece_body=np.array([body for body, _, _ in pieces], np.int64),
        piece_start=np.cumsum([0, *sizes]).astype(np.int64), piece_bound=np.array(bound, float),
        piece_radius=np.array([r for *_, r in pieces], float),
        vertex=np.concatenate([v for _, v, _ in pieces]).astype(float),
        edge_real=np.ones(sum(sizes), np.int64), friction=np.zeros((0, 0)),
        restitution=np.zeros((0, 0)), element_body=np.zeros(0, np.int64),
        element_kind=np.zeros(0, np.int64), element_point=np.zeros((0, 2)),
        path_start=np.zeros(1, np.int64), path=np.zeros((0, 4)), drive_dof=np.zeros(0, np.int64),
        map_factor=np.zeros((0, 0)), sides=0,
    )  # fmt: skip
    return Model(**fields)


def scene_of(pieces, pose, *, n_pair=2000, n_contact=2000):
    model = model_of(pieces)
    n_piece = len(pieces)
    problem, work = entries.empty(3, n_contact, 0, len(model.vertex), n_piece, len(pose), n_pair)
    work.extent[:, 2] = model.piece_bound[:, 2]
    place_bodies_(model, pose, len(pose), work)
    return Scene(model, pose, problem, work)


def random_scene(random, **room):
    pieces = []
    for body in range(N_BODY):
        for _ in range(random.integers(1, 4)):
            at = random.uniform(-0.4, 0.4, 2)
            if random.random() < 0.3:
                pieces.append((body, at[None, :], random.uniform(0.05, 0.4)))
            else:
                size = random.uniform(0.05, 0.5)
                pieces.append((body, regular(random.integers(3, 7), size) + at, 0.0))
    pose = np.column_stack([random.uniform(0, 7, (N_BODY, 2)), random.uniform(-3, 3, N_BODY)])
    return scene_of(pieces, pose, **room)


def world_of(scene):
    """World coordinates of all vertices, without the kernels, in the order of their operations."""
    model = scene.model
    body = np.repeat(model.piece_body, np.diff(model.piece_start))
    (px, py), angle = scene.pose[body, :2].T, scene.pose[body, 2]
    x, y = model.vertex.T
    c = np.array([math.cos(a) for a in angle])
    s = np.array([math.sin(a) for a in angle])
    return np.column_stack((px + c * x - s * y, py + s * x + c * y))


def brute_force(scene, margin):
    """Keys, bodies and places of all contacts, from every pair of pieces."""
    model, world = scene.model, world_of(scene)
    n_piece = len(model.piece_body)
    owner = model.piece_body
    pairs = [
        (i, j)
        for i in range(n_piece)
        for j in range(i + 1, n_piece)
        if owner[i] != owner[j] and owner[i] < N_FREE
    ]
    spans = [[np.arange(*model.piece_start[[k, k + 1]]) for k in pair] for pair in pairs]
    sizes = np.array([[len(span) for span in both] for both in spans])
    first = np.cumsum(np.concatenate(([0], sizes.sum(axis=1)[:-1])))
    start = np.column_stack((first, first + sizes[:, 0], first + sizes.sum(axis=1)))
    points = world[np.concatenate([span for both in spans for span in both])]
    count, place, key = measure_contacts(
        points, np.ones(len(points), np.int64), start, model.piece_radius[np.array(pairs)], margin
    )
    return [
        ((i * n_piece + j) * FEATURES + key[k, c], owner[i], owner[j], *place[k, c])
        for k, (i, j) in enumerate(pairs)
        for c in range(count[k])
    ]


@pytest.mark.parametrize("seed", SEEDS)
def test_no_contact_is_missed_while_bodies_move_below_the_reach(seed):
    random = np.random.default_rng(seed)
    scene = random_scene(random)
    model, pose, problem, work = scene
    reach, margin = 0.2, 0.02
    n_near = near_pairs_(model, pose, N_FREE, N_MOVING, reach, work)
    found = 0
    while True:
        n = contacts_(model, n_near, margin, problem, work)
        expected = brute_force(scene, margin)
        assert n == len(expected)
        assert problem.contact_key[:n].tolist() == [row[0] for row in expected]
        assert problem.contact_body[:n].tolist() == [list(row[1:3]) for row in expected]
        np.testing.assert_array_equal(problem.contact_place[:n, :5], [row[3:] for row in expected])
        found += n
        pose[:N_MOVING] += random.normal(size=(N_MOVING, 3)) * (0.005, 0.005, 0.01)
        place_bodies_(model, pose, N_MOVING, work)
        if margin + 2.0 * moved_(model, pose, work.anchor, N_MOVING) > reach:
            break
    assert found > 50


def test_moved_is_a_bound_on_every_vertex():
    random = np.random.default_rng(3)
    scene = random_scene(random)
    model, pose, _, work = scene
    near_pairs_(model, pose, N_FREE, N_MOVING, 0.2, work)
    before = world_of(scene)
    pose[:N_MOVING] += random.normal(size=(N_MOVING, 3)) * 0.1
    place_bodies_(model, pose, N_MOVING, work)
    travelled = np.hypot(*(world_of(scene) - before).T).max()
    assert 0.0 < travelled <= moved_(model, pose, work.anchor, N_MOVING)


def test_near_pairs_are_sorted_and_hold_a_free_body_each():
    model, pose, _, work = random_scene(np.random.default_rng(4))
    n = near_pairs_(model, pose, N_FREE, N_MOVING, 0.2, work)
    pairs = work.near[:n].tolist()
    assert pairs == sorted(pairs)
    assert len({tuple(pair) for pair in pairs}) == n
    bodies = model.piece_body[work.near[:n]]
    assert (bodies[:, 0] < N_FREE).all()
    assert (bodies[:, 0] != bodies[:, 1]).all()
    # The second call starts from the order of the first.
    assert near_pairs_(model, pose, N_FREE, N_MOVING, 0.2, work) == n
    assert work.near[:n].tolist() == pairs


def test_list_that_is_just_long_enough_and_one_too_short():
    n = near_pairs_(*_near_arguments(2000))
    assert near_pairs_(*_near_arguments(n)) == n
    assert near_pairs_(*_near_arguments(n - 1)) == -1
    assert near_pairs_(*_near_arguments(0)) == -1


def _near_arguments(n_pair):
    model, pose, _, work = random_scene(np.random.default_rng(5), n_pair=n_pair)
    return model, pose, N_FREE, N_MOVING, 0.2, work


@pytest.mark.parametrize("room", [0, 1, 2, 7])
def test_contacts_that_do_not_fit_are_reported(room):
    scene = random_scene(np.random.default_rng(6), n_contact=room)
    model, pose, problem, work = scene
    n_near = near_pairs_(model, pose, N_FREE, N_MOVING, 0.2, work)
    assert contacts_(model, n_near, 0.02, problem, work) == -1


BOX = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
FLOOR = np.array([[-5.0, -1.0], [5.0, -1.0], [5.0, 0.0], [-5.0, 0.0]])


def two_boxes_on_a_floor():
    pose = np.array([[-1.0, 0.5, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    return scene_of([(0, BOX, 0.0), (1, BOX, 0.0), (2, FLOOR, 0.0)], pose)


def find(scene):
    model, pose, problem, work = scene
    place_bodies_(model, pose, len(pose), work)
    n_near = near_pairs_(model, pose, 2, 2, 0.2, work)
    return contacts_(model, n_near, 0.01, problem, work)


def test_warm_start_keeps_impulses_with_their_features():
    scene = two_boxes_on_a_floor()
    problem = scene.problem
    assert find(scene) == 4
    old = dict(zip(problem.contact_key[:4].tolist(), [3.0, 4.0, 5.0, 6.0], strict=True))
    key = problem.contact_key[:4].copy()
    impulse = np.array([[value, -value] for value in old.values()])
    # The first box slides and tips on one corner, the second slides.
    scene.pose[0] += (0.01, 0.001, 0.02)
    scene.pose[1] += (0.02, 1e-4, 0.0)
    n = find(scene)
    assert n == 3
    warm_start_(problem, n, key, impulse, 4, 0.5)
    for k, (normal, tangential) in zip(problem.contact_key[:n], problem.impulse[:n], strict=True):
        assert normal == 0.5 * old[int(k)]
        assert tangential == -normal


def test_warm_start_of_a_new_contact_is_zero():
    scene = two_boxes_on_a_floor()
    scene.pose[0, 1] = 2.0
    assert find(scene) == 2
    key = scene.problem.contact_key[:2].copy()
    scene.pose[0, 1] = 0.5
    n = find(scene)
    assert n == 4
    scene.problem.impulse[:] = 9.0
    warm_start_(scene.problem, n, key, np.full((2, 2), 2.0), 2, 1.0)
    assert scene.problem.impulse[:n].tolist() == [[0.0, 0.0]] * 2 + [[2.0, 2.0]] * 2
