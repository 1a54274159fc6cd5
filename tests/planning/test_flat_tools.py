"""Errors of the ends of pushes where a flat tool lies on the part: its face fixes angle and normal.

The scale of the error, its growth with the motion and the place of the tool are written out here;
gaps between part and tool are computed by Shapely.
"""

import numpy as np
import pytest
import shapely

from fixel import PoseRegion
from fixel.model import Body, Disk, Polygon, Scene, Tripod, placed
from fixel.planning.belief import Belief
from fixel.planning.corrections import CorrectionTable
from fixel.planning.plan import simulator_of
from fixel.planning.pushes import FreePushes
from fixel.planning.rollout import spreads
from fixel.uncertainty.error_terms import StartError
from fixel.uncertainty.predictive import EndError
from fixel.units import deg, mm

ARM = 0.1 / np.sqrt(6.0)  # radius of gyration of a square of 0.1 m
SCALE, USUAL = 1.0 * mm, 20.0 * mm  # error after a motion of 20 mm
FACE, CORNER = 0.875, 0.752  # of the outline: middle and lower end of the face towards -x
GOAL = PoseRegion((0.02, 0.0, 0.0), position=5 * mm, angle=5 * deg)
FLAT, ROUND = Polygon.rectangle(10 * mm, 40 * mm), Disk(5 * mm)
# Errors of scale 1 along x, along y and in rotation, and all of them.
MISFIT = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1 / ARM], [-1, 2, -1 / ARM]])


class Push:
    """One push of a square at a pose, in worlds that differ by the error of the end alone."""

    def __init__(self, tool, push, pose=(0.0, 0.0, 0.0), threads=1):
        body = Body(
            "part",
            Polygon.rectangle(0.1, 0.1),
            mass=0.15,
            support=Tripod(radius=0.038, friction=0.25),
            pose=pose,
        )
        choose = FreePushes(tool=tool, length=(1 * mm, 150 * mm))
        self.scene = choose.prepared(Scene(bodies=(body,), duration=1.0))
        self.simulator = simulator_of(self.scene, GOAL, choose, Belief(), None, None, threads)
        self.planned = self.simulator.planned(np.array(push, float)[None, None])
        self.end = self.planned.nominal.pose[0, -1]
        off = self.end - np.asarray(pose)
        self.motion = np.hypot(*off[:2]) + ARM * abs(off[2])

    @property
    def gap(self):
        """Gap between part and tool before the tool goes back."""
        tool = placed(self.scene.pushers[0].shape.outline, self.planned.path[0, 0, -2, 1:])
        part = placed(self.scene.bodies[0].shape.outline, self.end)
        return shapely.distance(shapely.Polygon(tool), shapely.Polygon(part))

    def errors(self, misfit=MISFIT):
        """Return ends (n, 3) less the end without an error."""
        drawn = Belief().scenarios(self.scene, worlds=len(misfit), runs=1)
        drawn = drawn._replace(misfit=misfit, end_error=EndError(SCALE, USUAL))
        runs = self.simulator.run(self.planned, np.zeros(len(misfit), int), drawn)
        assert (runs.failure == 0).all()
        return runs.pose[:, -1] - self.end


@pytest.mark.parametrize("turned", [0.0, 0.5, -2.0])
def test_a_flat_tool_fixes_the_angle_and_the_normal_but_not_the_place_along_its_face(turned):
    push = Push(FLAT, (FACE, 0.0, 40 * mm), (0.01, -0.02, turned))
    assert push.gap < 1e-6
    assert push.motion == pytest.approx(40 * mm, rel=1e-3)  # twice the usual one
    c, s = np.cos(turned), np.sin(turned)
    along_normal, along_face = np.array([c, s]), np.array([-s, c])
    found, drawn = push.errors(), SCALE * MISFIT
    np.testing.assert_allclose(
        found[:, :2] @ along_face, 2.0 * drawn[:, :2] @ along_face, rtol=1e-3, atol=1e-9
    )
    least = drawn[:, :2] @ along_normal
    np.testing.assert_allclose(found[:, :2] @ along_normal, 0.4 * least, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(found[:, 2], 0.4 * drawn[:, 2], rtol=1e-3, atol=1e-9)


def test_after_a_short_way_the_error_is_no_larger_than_without_a_face():
    """After a quarter of the usual motion all of the error is smaller than the least on faces."""
    push = Push(FLAT, (FACE, 0.0, 5 * mm))
    np.testing.assert_allclose(push.errors(), 0.25 * SCALE * MISFIT, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("contact", [FACE, 0.82])
def test_errors_after_pushes_by_a_round_tool_keep_their_bits(contact):
    push = Push(ROUND, (contact, 0.1, 40 * mm))
    error = (SCALE * np.clip(push.motion / USUAL, 0.2, 3.0)) * MISFIT
    found = push.errors() + push.end
    np.testing.assert_allclose(found - push.end, error, rtol=1e-12, atol=1e-16)
    drawn = Belief().scenarios(push.scene, worlds=4, runs=1)
    drawn = drawn._replace(misfit=MISFIT, end_error=EndError(SCALE, USUAL))
    which = np.zeros(4, int)
    exact = push.simulator.run(push.planned, which, drawn._replace(misfit=np.zeros((4, 3))))
    some = push.simulator.run(push.planned, which, drawn)
    size = EndError(SCALE, USUAL).deviation(np.full(4, push.motion))
    np.testing.assert_array_equal(some.pose[:, -1], exact.pose[:, -1] + size[:, None] * MISFIT)


@pytest.mark.parametrize(
    ("contact", "angle", "length"),
    [(CORNER, 0.0, 120 * mm), (FACE, 25 * deg, 2 * mm)],
    ids=["it has slipped past the part", "its corner touches"],
)
def test_ends_without_faces_on_each_other_have_the_full_error(contact, angle, length):
    push = Push(Polygon.rectangle(10 * mm, 10 * mm), (contact, angle, length))
    assert (push.gap > 1 * mm) == (contact == CORNER)
    error = SCALE * np.clip(push.motion / USUAL, 0.2, 3.0) * MISFIT
    np.testing.assert_allclose(push.errors(), error, rtol=1e-9, atol=1e-15)


def test_threads_do_not_change_the_bits():
    misfit = EndError.draws(np.random.default_rng(0), (64,))
    one, two = (Push(FLAT, (0.86, 0.2, 40 * mm), threads=n).errors(misfit) for n in (1, 2))
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("friction", [(0.3, 0.3), (0.05, 0.6)])
def test_corrections_expect_the_error_that_plans_have(friction):
    """Ends of pushes of the table, compared with the same pushes carried out as plans."""
    own = Push(FLAT, (FACE, 0.0, 40 * mm)).simulator
    error = EndError(SCALE, USUAL, 0.0 if friction[0] == friction[1] else SCALE)

    class Known(Belief):
        def scenarios(self, scene, **options):
            drawn = Belief(parameters={"mu_pusher": friction}).scenarios(scene, **options)
            return drawn._replace(end_error=error)

    table = CorrectionTable.of(own, Known(), 4_000, 3)
    lies = table.normal.any(axis=2).all(axis=1)
    flush = np.flatnonzero(lies & (table.numbers[:, 2] > 30 * mm))
    free = np.flatnonzero(~table.normal.any(axis=(1, 2)) & (table.numbers[:, 2] > 30 * mm))
    start = np.tile([10 * mm, -5 * mm, 0.7], (1, 32, 1))
    worlds = table.worlds._replace(misfit=table.draws[1] / (1.0, 1.0, table.arm))
    for row in (*flush[:: len(flush) // 4], *free[:: len(free) // 2]):
        planned = own.planned(table.numbers[row][None, None], start[:, 0])
        runs = own.run(planned, np.zeros(32, int), worlds)
        found = table.after(np.array([row]), start)[0]
        assert (np.abs(found - runs.pose[:, -1]) < (3e-5, 3e-5, 5e-4)).all()
        scale = table.deviation(np.array([row]), start, found[None])[0]
        assert (scale[:, 2] * ARM <= 0.4 * SCALE + 1e-12).all() == (row in flush)
    assert len(flush) > 100


def test_faces_that_are_apart_or_tilted_do_not_lie_on_each_other():
    """A part 0.2 mm off, or tilted by 4 mrad about a corner that touches, has no normal."""
    push = Push(FLAT, (FACE, 0.0, 40 * mm))
    path = push.planned.path[:, 0]
    drawn = Belief().scenarios(push.scene, worlds=4, runs=1)
    drawn = drawn._replace(end_error=EndError(SCALE, USUAL))
    corner = path[0, -2, 1:3] + (5 * mm, 20 * mm)
    arm = push.end[:2] - corner
    tilted = np.array([*(4e-3 * np.array([-arm[1], arm[0]])), 4e-3])
    off = np.array([[0, 0, 0], [0.2 * mm, 0, 0], tilted, [0, 5 * mm, 0]])
    normal = push.simulator.normals(push.end + off, np.tile(path, (4, 1, 1)), drawn)
    assert normal.any(axis=1).tolist() == [True, False, False, True]
    np.testing.assert_allclose(normal[0], [1.0, 0.0], atol=1e-9)


def test_errors_of_starts_hardly_change_the_spread_of_ends_over_friction():
    """The spread of ends is their standard deviation where all parts start as planned."""
    push = Push(ROUND, (0.86, 0.1, 40 * mm))
    start = StartError(x=0.3 * mm, y=0.3 * mm, theta=0.3 * deg, kind="normal")
    found = []
    for error in (None, start):
        belief = Belief(parameters={"mu_pusher": (0.05, 0.6)}, start=error)
        drawn = belief.scenarios(push.scene, worlds=256, runs=1)
        runs = push.simulator.run(push.planned, np.zeros(256, int), drawn)
        begun, good = push.planned.start[0, 0] + drawn.start, runs.failure == 0
        own = spreads(np.zeros(256, int), begun, runs.pose[:, -1], good, ARM)
        assert np.ptp(own) == 0.0
        deviation = np.std(runs.pose[:, -1] * (1.0, 1.0, ARM), axis=0)
        found.append((own[0], np.sqrt(np.mean(deviation**2))))
    (exact, plain), (other, wider) = found
    assert exact == pytest.approx(plain, rel=1e-6)
    assert other == pytest.approx(exact, rel=0.15)
    assert wider > 1.2 * exact
    few = spreads(np.arange(256) // 16, begun, runs.pose[:, -1], good, ARM)
    assert np.isnan(few).all()
