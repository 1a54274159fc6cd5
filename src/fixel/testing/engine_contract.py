"""Contract of other engines, as a test suite to inherit from.

Subclass it, override its one fixture, and pytest runs the suite on your engine:

    class TestMine(EngineContract):
        @pytest.fixture
        def engine(self):
            return "./mine.py"

A known answer that the engine does not meet is listed in `misses`, with its error: the test is
then expected to fail, and fails if the engine meets it after all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, cast

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    LineDrive,
    Polygon,
    Pusher,
    Scene,
    Shape,
    Support,
    Tripod,
)
from fixel.model.parameters import engine_parameter
from fixel.simulation.engines import shared_program
from fixel.simulation.motion import AbstractMotionModel, Dynamic, OtherEngine, motion_model
from fixel.simulation.rollouts import EnsembleOutcome, RolloutCase, Rollouts, ensemble_of
from fixel.simulation.stepping import Adaptive
from fixel.testing.scenes import box, grasp, moved, row, sliding_block
from fixel.trust import permit
from fixel.typing import FloatArray

G = 9.81  # [m/s^2]
SIDE = 0.1  # [m] of the square that is pushed
FINGER = 0.005  # [m] radius
EXACT = Adaptive(tolerance=1e-8)
PUSHES = 20  # of the test of Mason's rule
SIDES = (1e-6, 1e-3, 1.0)  # [m] of other squares
MASSES = (1e-8, 10.0)  # [kg] of them

ELL = [(-0.05, -0.05), (0.05, -0.05), (0.05, 0.0), (0.0, 0.0), (0.0, 0.05), (-0.05, 0.05)]
TEE = [
    (-0.05, -0.05),
    (-0.01, -0.05),
    (-0.01, -0.015),
    (0.05, -0.015),
    (0.05, 0.015),
    (-0.01, 0.015),
    (-0.01, 0.05),
    (-0.05, 0.05),
]


def push(
    offset: float = 0.02,
    heading: float = 0.0,
    *,
    at: float = -0.055,
    speed: float = 0.02,
    travel: float = 0.03,
    friction: float = 0.3,
    shape: Shape | None = None,
    support: Support | None = None,
    force_limit: float | None = None,
) -> Scene:
    """Scene of a finger at (`at`, `offset`) that pushes a body of 150 g at the origin.

    A tripod is symmetric about the x axis, as the square is: pushes at opposite offsets with
    opposite headings are mirrored.
    """
    drive = LineDrive(
        direction=row(math.cos(heading), math.sin(heading)),
        speed=speed,
        travel=travel,
        force_limit=force_limit,
    )
    part = Body(
        "part",
        shape or box(SIDE, SIDE),
        mass=0.15,
        support=support or Tripod(radius=0.038, friction=0.25, angle=0.0),
    )
    finger = Pusher(
        "finger", Disk(FINGER), pose=row(at, offset, 0.0), friction=friction, drive=drive
    )
    return Scene((part,), (finger,), duration=travel / speed)


def _named(engine: AbstractMotionModel | str) -> AbstractMotionModel:
    permit(engine)
    return motion_model(engine)


def resized(scene: Scene, length: float, mass: float) -> Scene:
    """Scene with all lengths, and with all masses and forces, times a factor.

    Times have the root of the first factor, so that gravity is the same and motions are alike.
    Supports are tripods, drives lines.
    """
    time, pose = math.sqrt(length), row(length, length, 1.0)

    def shape(own: Shape) -> Shape:
        if isinstance(own, Disk):
            return Disk(length * own.radius)
        assert isinstance(own, Polygon)
        return Polygon(length * own.vertices)

    def body(own: Body) -> Body:
        assert isinstance(own.support, Tripod)
        return replace(
            own,
            shape=shape(own.shape),
            mass=mass * own.mass,
            inertia=None,
            pose=pose * own.pose,
            velocity=pose / time * own.velocity,
            support=replace(own.support, radius=length * own.support.radius),
        )

    def pusher(own: Pusher) -> Pusher:
        line = own.drive
        assert isinstance(line, LineDrive)
        drive = replace(
            line,
            speed=length / time * line.speed,
            travel=line.travel and length * line.travel,
            force_limit=line.force_limit and mass * line.force_limit,
        )
        return replace(own, shape=shape(own.shape), pose=pose * own.pose, drive=drive)

    return replace(
        scene,
        bodies=tuple(map(body, scene.bodies)),
        pushers=tuple(map(pusher, scene.pushers)),
        fixels=tuple(
            replace(own, shape=shape(own.shape), pose=pose * own.pose) for own in scene.fixels
        ),
        duration=time * scene.duration,
    )


def _rollouts(motion: AbstractMotionModel, cases: Sequence[RolloutCase]) -> Rollouts:
    if isinstance(motion, OtherEngine):
        # Imported here: it needs what other tests of this package do not.
        from fixel.simulation.engines.ensemble import EngineEnsemble

        shared: Any = EngineEnsemble(cases, motion, programs=[shared_program(motion.name)])
        return cast(Rollouts, shared)
    return ensemble_of(cases, motion, threads=1)


def _outcome(
    motion: AbstractMotionModel | str,
    scenes: Sequence[Scene],
    values: Mapping[str, FloatArray] | None = None,
    times: FloatArray | None = None,
) -> EnsembleOutcome:
    cases = [RolloutCase(s, row(s.duration) if times is None else times) for s in scenes]
    return _rollouts(_named(motion), cases).simulate(np.arange(len(cases)), values or {})


def _ends(motion: AbstractMotionModel | str, scenes: Sequence[Scene], **options: Any) -> FloatArray:
    """Return the poses (n, 3) at the end; fail where a simulation has none."""
    found = _outcome(motion, scenes, **options)
    assert found.converged.all(), found.reasons
    return found.pose[:, -1]


def _exact(scenes: Sequence[Scene], values: Mapping[str, FloatArray] | None = None) -> FloatArray:
    """Return the poses (n, 3) at the end by fixel, converged."""
    cases = [RolloutCase(scene, row(scene.duration)) for scene in scenes]
    found = ensemble_of(cases, Dynamic(), EXACT, threads=1)
    outcome = found.simulate(np.arange(len(cases)), values or {})
    assert outcome.converged.all()
    return outcome.pose[:, -1]


def _stop(body: Body, friction: float) -> FloatArray:
    """Return the pose at which a body on its tripod stops, by integrating Newton's law."""
    support = body.support
    assert isinstance(support, Tripod)
    angles = support.angle + np.arange(3) * 2.0 * math.pi / 3.0
    points = support.radius * np.column_stack((np.cos(angles), np.sin(angles)))

    def rate(_: float, state: FloatArray) -> FloatArray:
        c, s = math.cos(state[2]), math.sin(state[2])
        arm = points @ np.array([[c, s], [-s, c]])
        v = state[3:5] + state[5] * np.column_stack((-arm[:, 1], arm[:, 0]))
        force = -friction * body.mass * G / 3.0 * v / (np.hypot(*v.T)[:, None] + 1e-7)
        torque = (arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]).sum()
        total = force.sum(axis=0) / body.mass
        return np.array([*state[3:], *total, torque / body.moment_of_inertia])

    def still(_: float, state: FloatArray) -> float:
        return float(np.abs(state[3:] * (1.0, 1.0, support.radius)).sum()) - 1e-3

    still.terminal = True  # type: ignore[attr-defined]
    start = np.concatenate((body.pose, body.velocity))
    path = solve_ivp(rate, (0.0, 5.0), start, "LSODA", events=still, rtol=1e-8, atol=1e-10)
    assert path.status == 1
    return np.asarray(path.y[:3, -1])


class EngineContract:
    """Tests of an engine: known answers, refusals, and the same answer again."""

    # Stated accuracy of the end of a push [m], [rad].
    position: ClassVar[float] = 1e-4
    angle: ClassVar[float] = math.radians(0.1)
    # Stated accuracy of the time at which a sliding body stops [s], half a step for engines whose
    # steps are of first order.
    stop: ClassVar[float] = 0.0
    # Bounds of the engine's own parameters, for those without usual ones.
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {}
    misses: ClassVar[Mapping[str, str]] = {}  # tests that the engine fails, each with its error

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in cls.misses:
            assert hasattr(cls, name.partition("[")[0]), f"{cls.__name__}: no test {name}"

    @pytest.fixture
    def engine(self) -> AbstractMotionModel | str:
        """Engine under test, or its name."""
        raise NotImplementedError

    @pytest.fixture(autouse=True)
    def _miss(self, request: pytest.FixtureRequest) -> None:
        for name in (request.node.name, request.node.originalname):
            if name in self.misses:
                reason = self.misses[name]
                request.node.add_marker(pytest.mark.xfail(reason=reason, strict=True))

    def near(self, found: FloatArray, expected: FloatArray, factor: float = 1.0) -> None:
        """Fail where poses (n, 3) differ by more than the stated accuracy."""
        off = np.asarray(found - expected).reshape(-1, 3)
        self.within(float(np.hypot(*off.T[:2]).max()), factor * self.position, "m")
        self.within(float(np.abs(off[:, 2]).max()), factor * self.angle, "rad")

    def within(self, error: float, allowed: float, unit: str) -> None:
        """Fail where an error exceeds what is allowed."""
        assert error <= allowed, f"off by {error:.3g} {unit}, allowed {allowed:.3g} {unit}"

    # --- alone on the plane -----------------------------------------------------------------------

    def test_rests(self, engine: AbstractMotionModel | str) -> None:
        end = _ends(engine, [sliding_block(0.0, duration=5.0)])[0]
        self.within(float(np.hypot(*end[:2])), 1e-6, "m")
        self.within(abs(float(end[2])), 1e-5, "rad")

    def test_slides_to_rest(self, engine: AbstractMotionModel | str) -> None:
        speed, friction = 0.5, 0.25
        end = _ends(engine, [sliding_block(speed, friction)])[0]
        allowed = self.position + self.stop * speed
        self.within(abs(float(end[0]) - speed**2 / (2.0 * friction * G)), allowed, "m")
        self.within(abs(float(end[1])), self.position, "m")

    def test_slides_to_rest_on_the_moon(self, engine: AbstractMotionModel | str) -> None:
        speed, friction, gravity = 0.2, 0.25, 1.62
        end = _ends(engine, [replace(sliding_block(speed, friction), gravity=gravity)])[0]
        off = abs(float(end[0]) - speed**2 / (2.0 * friction * gravity))
        self.within(off, self.position + self.stop * speed, "m")

    def test_spins_to_rest(self, engine: AbstractMotionModel | str) -> None:
        block = sliding_block(0.0).bodies[0]
        rate, friction, radius = 5.0, 0.25, 0.03
        scene = Scene((_moving(block, 0.0, 0.0, rate),), duration=1.0)
        turned = block.moment_of_inertia * rate**2 / (2.0 * friction * block.mass * G * radius)
        end = _ends(engine, [scene])[0]
        self.within(abs(float(end[2]) - turned), self.angle + self.stop * rate, "rad")
        self.within(float(np.hypot(*end[:2])), self.position, "m")

    @pytest.mark.parametrize("rate", [-8.0, 2.0, 15.0])
    def test_slides_and_spins_to_rest(self, engine: AbstractMotionModel | str, rate: float) -> None:
        """Friction force and torque decrease together, as the limit surface of three points."""
        body = _moving(sliding_block(0.0).bodies[0], 0.3, 0.2, rate)
        end = _ends(engine, [Scene((body,), duration=1.0)])[0]
        off = end - _stop(body, 0.25)
        allowed = self.position + self.stop * 0.4
        self.within(float(np.hypot(*off[:2])), allowed, "m")
        self.within(abs(float(off[2])), self.angle + self.stop * abs(rate), "rad")

    # --- pushes -----------------------------------------------------------------------------------

    def test_central_push_is_straight(self, engine: AbstractMotionModel | str) -> None:
        end = _ends(engine, [push(0.0)])[0]
        self.near(end, row(0.03, 0.0, 0.0))

    def test_turns_to_the_side_of_masons_rule(self, engine: AbstractMotionModel | str) -> None:
        """Two of three rays decide: the push and both edges of the friction cone."""
        rng, friction = np.random.default_rng(4), 0.3
        scenes: list[Scene] = []
        expected: list[float] = []
        while len(scenes) < PUSHES:
            offset, heading = rng.uniform((-0.04, -0.7), (0.04, 0.7)).tolist()
            rays = np.array([heading, math.atan(friction), -math.atan(friction)])
            arm = float(np.median(-0.5 * SIDE * np.sin(rays) - offset * np.cos(rays)))
            if abs(arm) > 0.004:  # [m]: a clear case
                scenes.append(push(offset, heading, travel=0.005, friction=friction))
                expected.append(float(np.sign(arm)))
        assert np.sign(_ends(engine, scenes)[:, 2]).tolist() == expected

    def test_mirrored_pushes_agree(self, engine: AbstractMotionModel | str) -> None:
        one, other = _ends(engine, [push(0.02, 0.1), push(-0.02, -0.1)])
        self.near(other * (1.0, -1.0, -1.0), one)

    def test_pushes_in_all_directions_agree(self, engine: AbstractMotionModel | str) -> None:
        turns = np.arange(6) * math.pi / 3.0
        ends = _ends(engine, [moved(push(), (0.2, -0.1), turn) for turn in turns.tolist()])
        c, s = np.cos(turns), np.sin(turns)
        x, y = ends[:, 0] - 0.2, ends[:, 1] + 0.1
        back = np.column_stack((c * x + s * y, -s * x + c * y, ends[:, 2] - turns))
        self.near(back, back[[0]])

    def test_speed_of_slow_pushes_does_not_matter(self, engine: AbstractMotionModel | str) -> None:
        """At 10 mm/s the body coasts 20 um, so that inertia has no part in the motion."""
        slow, fast = _ends(engine, [push(speed=v, travel=0.015) for v in (0.005, 0.01)])
        self.near(slow, fast)

    @pytest.mark.parametrize(("offset", "heading"), [(0.02, 0.0), (0.03, 0.4), (-0.01, 0.6)])
    def test_free_push(
        self, engine: AbstractMotionModel | str, offset: float, heading: float
    ) -> None:
        """The finger sticks, or slides along the side: fixel's converged answer."""
        scenes = [push(offset, heading)]
        self.near(_ends(engine, scenes), _exact(scenes))

    @pytest.mark.parametrize("shape", ["disc", "L", "T"])
    def test_other_shapes(self, engine: AbstractMotionModel | str, shape: str) -> None:
        scene = {
            "disc": push(0.02, at=-math.sqrt(0.055**2 - 0.02**2), shape=Disk(0.05)),
            "L": push(0.02, shape=Polygon(np.array(ELL))),
            # Into the corner between bar and stem.
            "T": push(0.025, math.pi, at=-0.004, shape=Polygon(np.array(TEE))),
        }[shape]
        self.near(_ends(engine, [scene]), _exact([scene]))

    def test_slip_grasp(self, engine: AbstractMotionModel | str) -> None:
        """A flat head and three fixels; four times the accuracy of a push, for four contacts."""
        scene = grasp("slip", force_limit=None)
        self.near(_ends(engine, [scene]), _exact([scene]), factor=4.0)

    def test_two_coefficients_in_one_scene(self, engine: AbstractMotionModel | str) -> None:
        scenes = [grasp("slip", force_limit=None)] * 2
        values = {"mu_pusher": row(0.1, 0.4), "mu_fixel": row(0.4, 0.1)}
        expected = _exact(scenes, values)
        assert np.hypot(*(expected[1] - expected[0])[:2]) > 10.0 * self.position
        self.near(_ends(engine, scenes, values=values), expected, factor=4.0)

    def test_irregular_times(self, engine: AbstractMotionModel | str) -> None:
        times = row(0.0137, 0.1, 0.10001, 0.77, 1.5)
        track = _outcome(engine, [push()], times=times).pose[0]
        exact = ensemble_of([RolloutCase(push(), times)], Dynamic(), EXACT, threads=1)
        self.near(track, exact.simulate(np.zeros(1, np.int64), {}).pose[0])

    # --- sizes and masses -------------------------------------------------------------------------

    @pytest.mark.parametrize("mass", MASSES)
    @pytest.mark.parametrize("side", SIDES)
    def test_pushes_of_all_sizes_are_alike(
        self, engine: AbstractMotionModel | str, side: float, mass: float
    ) -> None:
        """The motion of a square of 100 mm and 150 g, whose known answers are tested above."""
        scenes = [push(0.0), push(0.02, 0.1), grasp("slip", force_limit=None)]
        other = [resized(own, side / SIDE, mass / own.bodies[0].mass) for own in scenes]
        back = _ends(engine, other) / (side / SIDE, side / SIDE, 1.0)
        self.near(back, _ends(engine, scenes), factor=4.0)

    @pytest.mark.parametrize("mass", MASSES)
    @pytest.mark.parametrize("side", SIDES)
    def test_blocks_of_all_sizes_slide_to_rest(
        self, engine: AbstractMotionModel | str, side: float, mass: float
    ) -> None:
        speed, friction, ratio = 0.5 * math.sqrt(side / SIDE), 0.25, side / SIDE
        block = sliding_block(0.5, friction)
        end = _ends(engine, [resized(block, ratio, mass / block.bodies[0].mass)])[0]
        off = abs(float(end[0]) - speed**2 / (2.0 * friction * G)) / ratio
        self.within(off, 4.0 * self.position + self.stop * 0.5, "m for a side of 100 mm")

    def test_a_small_part_may_be_far_from_the_origin(
        self, engine: AbstractMotionModel | str
    ) -> None:
        small = resized(push(0.02, 0.1), 1e-3, 1e-6)
        near, far = _ends(engine, [small, moved(small, (0.3, -0.2), 0.0)])
        self.near((far - (0.3, -0.2, 0.0)) / (1e-3, 1e-3, 1.0), near / (1e-3, 1e-3, 1.0))

    @pytest.mark.parametrize("side", SIDES)
    def test_jam_of_any_size_is_a_failure(
        self, engine: AbstractMotionModel | str, side: float
    ) -> None:
        scene = resized(grasp("seated", force_limit=None), side / SIDE, 1.0)
        found = _outcome(engine, [scene], times=scene.duration * np.linspace(0.1, 1.0, 10))
        assert not found.converged.any()

    # --- what an engine must not hide -------------------------------------------------------------

    def test_jam_is_a_failure(self, engine: AbstractMotionModel | str) -> None:
        """An engine may press the square through a fixel, but not report that as its motion."""
        scene = grasp("seated", force_limit=None)
        found = _outcome(engine, [scene], times=np.arange(0.25, scene.duration, 0.25))
        assert not found.converged.any()
        assert found.reasons[0]

    def test_force_limited_drive_stalls_or_is_refused(
        self, engine: AbstractMotionModel | str
    ) -> None:
        """The square comes to rest between head and fixels, and the drive stalls."""
        self._represents(engine, grasp("seated"), 4.0)

    def test_ellipsoid_is_exact_or_refused(self, engine: AbstractMotionModel | str) -> None:
        self._represents(engine, push(support=Ellipsoid(force=0.37, torque=0.011)), 1.0)

    def _represents(self, engine: AbstractMotionModel | str, scene: Scene, factor: float) -> None:
        try:
            end = _ends(engine, [scene])
        except InvalidInput as refusal:
            _assert_sentence(refusal)
        else:
            self.near(end, _exact([scene]), factor)

    def test_refuses_two_bodies(self, engine: AbstractMotionModel | str) -> None:
        scene = push()
        other = replace(scene.bodies[0], name="other", pose=row(0.5, 0.0, 0.0))
        with pytest.raises(InvalidInput) as refusal:
            _outcome(engine, [Scene((*scene.bodies, other), scene.pushers, duration=1.0)])
        _assert_sentence(refusal.value)

    def test_refuses_an_unknown_parameter(self, engine: AbstractMotionModel | str) -> None:
        with pytest.raises(InvalidInput) as refusal:
            _outcome(engine, [push()], {"nowhere.nothing": row(1.0)})
        _assert_sentence(refusal.value)

    # --- parameters and repetition ----------------------------------------------------------------

    def test_every_parameter_changes_the_answer(self, engine: AbstractMotionModel | str) -> None:
        motion = _named(engine)
        bounds = {"mu_pusher": (0.05, 0.5), "tripod_radius": (0.02, 0.06)}
        if isinstance(motion, OtherEngine):
            info = shared_program(motion.name).info()
            for name in info.parameters:
                own = f"{info.name}.{name}"
                usual = engine_parameter(own).usual
                assert name in self.bounds or usual, f"no bounds of {own}"
                bounds[own] = self.bounds.get(name) or (usual[0], usual[2])  # type: ignore[index]
        same = []
        for name, pair in bounds.items():
            found = _outcome(engine, [push(0.02, 0.4)] * 2, {name: np.array(pair)})
            assert found.converged.any(), found.reasons
            if np.array_equal(*found.pose[:, -1]):
                same.append(name)
        assert not same, f"without effect: {', '.join(same)}"

    def test_same_bits_again(self, engine: AbstractMotionModel | str) -> None:
        """The same again after other simulations, in another order, and in a new process."""
        motion = _named(engine)
        cases = [RolloutCase(scene, row(0.5, 1.5)) for scene in (push(), push(0.03, 0.4))]
        shared, new = _rollouts(motion, cases), ensemble_of(cases, motion, threads=1)
        one = shared.simulate(np.array([0, 1]), {}).pose
        again = shared.simulate(np.array([1, 0, 1]), {}).pose
        other = new.simulate(np.array([0, 1]), {}).pose
        assert np.array_equal(again, one[[1, 0, 1]])
        assert np.array_equal(other, one)


def _moving(body: Body, *velocity: float) -> Body:
    return replace(body, velocity=row(*velocity))


def _assert_sentence(refusal: InvalidInput) -> None:
    text = str(refusal)
    assert "\n" not in text
    assert 20 < len(text) < 400
