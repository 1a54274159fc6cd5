"""Gaps of random pairs of shapes against Shapely (GEOS), which shares no code with ours.

Tolerances: coordinates are below a hundred, so rounding leaves some 1e-13; 1e-9 is the promise.
"""

from dataclasses import dataclass

import numba
import numpy as np
import pytest
import shapely
from shapely.affinity import translate

from fixel.kernels.gap import measure_gaps
from fixel.model.shape import Polygon
from fixel.simulation.geometry import PackedShapes, pack_shapes

N_SHAPE = 1200
# Plain Python is a thousand times slower than compiled code.
N_PAIR = 300 if numba.config.DISABLE_JIT else 8_000
PROMISE = 1e-9


@dataclass
class Fuzz:
    """Random pairs, what fixel says about them, and the same shapes as Shapely geometries."""

    packed: PackedShapes
    first: np.ndarray
    second: np.ndarray
    first_pose: np.ndarray
    second_pose: np.ndarray
    found: np.ndarray
    first_geometry: np.ndarray
    second_geometry: np.ndarray
    convex: np.ndarray  # both

    @property
    def gap(self):
        return self.found[:, 0]

    @property
    def normal(self):
        return self.found[:, 1:3]


def hull(random, size):
    points = size * random.normal(size=(random.integers(4, 12), 2)) * random.uniform(0.02, 1.0, 2)
    return np.array(shapely.convex_hull(shapely.MultiPoint(points)).exterior.coords)[:-1]


def star(random, size):
    n = random.integers(5, 12)
    angle = (np.arange(n) + random.uniform(-0.4, 0.4, n)) * 2.0 * np.pi / n
    radius = size * random.uniform(0.2, 1.0, n)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def regular(random, size):
    n = random.integers(3, 9)
    angle = np.arange(n) * 2.0 * np.pi / n
    return size * np.column_stack([np.cos(angle), np.sin(angle)])


def box(random, size):
    half = 0.5 * size * np.array([1.0, random.choice([1.0, 0.5, 1e-3])])
    return half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def comb(random, size):
    teeth = random.integers(1, 4)
    corners = [(0, 0), (2 * teeth + 1, 0)]
    for i in range(teeth, -1, -1):
        top = random.choice([1, 3])
        corners += [(2 * i + 1, 1), (2 * i + 1, top), (2 * i, top), (2 * i, 1)]
    distinct = [c for i, c in enumerate(corners) if c != corners[i - 1]]
    return 0.25 * size * np.array(distinct, dtype=float)


def plus(random, size):
    arm = [(3, -1), (3, 1), (1, 1), (1, 3), (-1, 3), (-1, 1)]
    return size / 3.0 * np.array([*arm, *((-x, -y) for x, y in arm)], dtype=float)


def random_shape(random):
    size = 10.0 ** random.uniform(-3.0, 1.0) if random.random() < 0.5 else 1.0
    make = (hull, star, regular, box, comb, plus)[random.integers(6)]
    return Polygon(make(random, size))


def random_poses(random, spread):
    """A share of them on a grid, in eighths of a turn: edges in line, corners that meet."""
    on_grid = random.random(N_PAIR) < 0.4
    place = random.normal(size=(N_PAIR, 2)) * spread[:, None]
    angle = random.uniform(-np.pi, np.pi, N_PAIR)
    eighth = random.integers(0, 8, N_PAIR) * (np.pi / 4.0)
    return np.column_stack([
        np.where(on_grid[:, None], np.round(4.0 * place) / 4.0, place),
        np.where(on_grid, eighth, angle),
    ])  # fmt: skip


def placed_geometries(shapes, which, poses):
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.moveaxis(np.array([[c, s], [-s, c]]), 2, 0)
    return np.array(
        [shapely.Polygon(shapes[k].vertices @ turn[i] + poses[i, :2]) for i, k in enumerate(which)]
    )


def make_fuzz(seed):
    random = np.random.default_rng(seed)
    shapes = [random_shape(random) for _ in range(N_SHAPE)]
    packed = pack_shapes(shapes)
    first, second = random.integers(0, N_SHAPE, (2, N_PAIR))
    radius = np.array([shape.radius for shape in shapes])
    # Spread so that about a third of the pairs overlap, from barely to one within the other.
    share = random.choice([0.2, 0.7], N_PAIR)
    first_pose = random_poses(random, share * (radius[first] + radius[second]))
    second_pose = random_poses(random, share * radius[second])
    convex = np.array([shape.is_convex for shape in shapes])
    return Fuzz(
        packed=packed, first=first, second=second, first_pose=first_pose, second_pose=second_pose,
        found=measure_gaps(*packed, first, second, first_pose, second_pose),
        first_geometry=placed_geometries(shapes, first, first_pose),
        second_geometry=placed_geometries(shapes, second, second_pose),
        convex=convex[first] & convex[second],
    )  # fmt: skip


MORE = [pytest.param(seed, marks=pytest.mark.soak) for seed in range(10, 30)]


@pytest.fixture(scope="module", params=[1, *MORE])
def fuzz(request):
    return make_fuzz(request.param)


def test_distance_of_apart_pairs_is_exact(fuzz):
    distance = shapely.distance(fuzz.first_geometry, fuzz.second_geometry)
    apart = distance > 0.0
    assert 0.3 < apart.mean() < 0.8
    assert np.abs(fuzz.gap - distance)[apart].max() < PROMISE


def test_sign_tells_overlap(fuzz):
    distance = shapely.distance(fuzz.first_geometry, fuzz.second_geometry)
    overlap = shapely.area(shapely.intersection(fuzz.first_geometry, fuzz.second_geometry))
    assert (fuzz.gap[overlap > 1e-12] < 0.0).all()
    assert (fuzz.gap[distance > 1e-12] > 0.0).all()
    touching = (distance == 0.0) & (overlap < 1e-15)
    assert touching.any() or N_PAIR < 1000
    assert (np.abs(fuzz.gap[touching]) < PROMISE).all()


def test_normals_are_unit_vectors(fuzz):
    assert np.abs(np.hypot(*fuzz.normal.T) - 1.0).max() < 1e-12


def test_witnesses_lie_on_the_outlines(fuzz):
    apart = fuzz.gap > 0.0
    half = 0.5 * fuzz.gap[:, None] * fuzz.normal
    for middle, geometry in (
        (fuzz.found[:, 3:] + half, fuzz.first_geometry),
        (fuzz.found[:, 3:] - half, fuzz.second_geometry),
    ):
        off = shapely.distance(shapely.points(middle), shapely.boundary(geometry))
        assert off[apart].max() < PROMISE


def test_convex_pairs_part_by_their_gap_and_not_by_less(fuzz):
    chosen = np.flatnonzero(fuzz.convex & (fuzz.gap < -1e-12))  # more than rounding
    assert len(chosen) > 0.05 * N_PAIR
    depth = -fuzz.gap[chosen]
    way = fuzz.normal[chosen]
    first, second = fuzz.first_geometry[chosen], fuzz.second_geometry[chosen]

    def moved(lengths, directions):
        shifts = lengths[:, None] * directions
        return np.array([translate(g, x, y) for g, (x, y) in zip(first, shifts, strict=True)])

    parted = moved(depth * (1.0 + PROMISE), way)
    size = np.sqrt(np.minimum(shapely.area(first), shapely.area(second)))
    assert (shapely.area(shapely.intersection(parted, second)) / size).max() < PROMISE
    assert shapely.distance(parted, second).max() < 1e-7  # and no farther than needed
    random = np.random.default_rng(2)
    angle = random.uniform(-np.pi, np.pi, len(chosen))
    elsewhere = moved(0.999 * depth, np.column_stack([np.cos(angle), np.sin(angle)]))
    assert shapely.intersects(elsewhere, second).all()


def test_gap_is_symmetric(fuzz):
    back = measure_gaps(*fuzz.packed, fuzz.second, fuzz.first, fuzz.second_pose, fuzz.first_pose)
    assert np.abs(back[:, 0] - fuzz.gap).max() < 1e-12
    # Where two directions are equally good, either may be returned: a handful, of the aligned ones.
    turned = np.abs(back[:, 1:3] + fuzz.normal).max(axis=1) > 1e-6
    assert turned.mean() < 0.01
