"""Contracts of motion models, steppers and solvers, as test suites to inherit from.

Subclass one, override its one fixture, and pytest runs the suite on your plug-in:

    class TestMySolver(SolverContract):
        @pytest.fixture
        def solver(self):
            return MySolver()
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from fixel.kernels import codes, entries
from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.solve import TOLERANCE
from fixel.model import Scene
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.result import Simulation
from fixel.simulation.simulate import simulate
from fixel.simulation.stepping import (
    AbstractSolver,
    AbstractStepper,
    StepHistory,
    StepLimits,
    StepTrial,
    StewartTrinkle,
)
from fixel.testing.scenes import free_push, grasp, row, sliding_block, touching_pose
from fixel.typing import FloatArray

G = 9.81
SIDES = 16  # directions of support friction in the problems below, for linear solvers


def step_problem(
    momentum: tuple[float, float, float],
    contacts: tuple[tuple[float, float, float], ...] = (),
    limit: float | None = None,
) -> tuple[Problem, Workspace]:
    """Step problem of one body of unit mass and inertia, in scaled units.

    `momentum` (3,) is that before the step. Each contact has the direction of the normal [rad], the
    bias of the normal velocity and the friction; all act through the centre of mass. `limit` is the
    largest impulse of one support point there.
    """
    n, n_element = len(contacts), 0 if limit is None else 1
    problem, work = entries.empty(3, n, n_element, 1, 1, 1, 1)
    problem.size[:4] = (3, n, n_element, 3)
    problem.inertia[:3, :3] = np.eye(3)
    problem.momentum[:3] = momentum
    for i, (angle, bias, friction) in enumerate(contacts):
        c, s = math.cos(angle), math.sin(angle)
        problem.contact_dof[i] = (0, -1)
        problem.contact_key[i] = i
        problem.contact_place[i, :5] = (0.0, c, s, 0.0, 0.0)
        problem.normal[i, :2] = (c, s)
        problem.tangent[i, :2] = (-s, c)
        problem.bias[i, 0] = bias
        problem.friction[i] = friction
    if limit is not None:
        problem.element_sides[0] = SIDES
        problem.element_row[0, 0, 0] = problem.element_row[0, 1, 1] = 1.0
        problem.element_limit[0] = limit
    entries.set_stiffness(problem, n_element)
    return problem, work


class SolverContract:
    """Tests of a solver: known solutions, and a true residual with and without a solution."""

    @pytest.fixture
    def solver(self) -> AbstractSolver:
        """Solver under test."""
        raise NotImplementedError

    def _solved(
        self, solver: AbstractSolver, problem: Problem, work: Workspace
    ) -> tuple[FloatArray, float]:
        residual, fell_back = solver.solve(problem, work, np.zeros(5))
        assert residual <= TOLERANCE
        assert fell_back in (0, 1)
        return problem.velocity[:3], residual

    def test_body_without_contacts_keeps_its_momentum(self, solver: AbstractSolver) -> None:
        velocity, _ = self._solved(solver, *step_problem((0.3, -0.2, 0.7)))
        assert velocity == pytest.approx([0.3, -0.2, 0.7], abs=1e-9)

    def test_wall_stops_what_runs_into_it(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((0.4, -1.0, 0.2), ((math.pi / 2, 0.0, 0.0),))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.4, 0.0, 0.2], abs=1e-9)
        assert problem.impulse[0] == pytest.approx([1.0, 0.0], abs=1e-9)

    def test_wall_does_not_pull(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((0.0, 1.0, 0.0), ((math.pi / 2, 0.0, 0.5),))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
        assert problem.impulse[0] == pytest.approx([0.0, 0.0], abs=1e-9)

    def test_gap_may_close_within_the_step(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((0.0, -1.0, 0.0), ((math.pi / 2, 0.25, 0.0),))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.0, -0.25, 0.0], abs=1e-9)

    def test_friction_slides_at_its_limit(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((1.0, -1.0, 0.0), ((math.pi / 2, 0.0, 0.3),))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.7, 0.0, 0.0], abs=1e-9)

    def test_friction_sticks_below_it(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((0.2, -1.0, 0.0), ((math.pi / 2, 0.0, 0.3),))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
        assert problem.impulse[0, 1] == pytest.approx(0.2, abs=1e-9)

    @pytest.mark.parametrize(("limit", "left"), [(0.4, 0.6), (1.0, 0.0), (3.0, 0.0), (0.0, 1.0)])
    def test_support_friction(self, solver: AbstractSolver, limit: float, left: float) -> None:
        velocity, _ = self._solved(solver, *step_problem((1.0, 0.0, 0.0), (), limit))
        assert velocity == pytest.approx([left, 0.0, 0.0], abs=1e-9)

    def test_contact_written_twice_changes_no_velocity(self, solver: AbstractSolver) -> None:
        wall = (math.pi / 2, 0.0, 0.3)
        problem, work = step_problem((1.0, -1.0, 0.0), (wall, wall))
        velocity, _ = self._solved(solver, problem, work)
        assert velocity == pytest.approx([0.7, 0.0, 0.0], abs=1e-9)
        assert problem.impulse[:2, 0].sum() == pytest.approx(1.0, abs=1e-9)

    def test_corner_of_two_walls(self, solver: AbstractSolver) -> None:
        walls = ((math.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0))
        velocity, _ = self._solved(solver, *step_problem((-1.0, -2.0, 0.5), walls))
        assert velocity == pytest.approx([0.0, 0.0, 0.5], abs=1e-9)

    def test_problem_of_no_size(self, solver: AbstractSolver) -> None:
        problem, work = entries.empty(0, 0, 0, 0, 0, 0, 0)
        residual, _ = solver.solve(problem, work, np.zeros(2))
        assert residual == 0.0

    def test_no_solution_is_reported(self, solver: AbstractSolver) -> None:
        # Two walls that close on the body from both sides.
        walls = ((0.0, -1.0, 0.0), (math.pi, -1.0, 0.0))
        residual, _ = solver.solve(*step_problem((0.0, 0.0, 0.0), walls), np.zeros(5))
        assert not residual <= TOLERANCE

    def test_not_a_number_is_reported(self, solver: AbstractSolver) -> None:
        problem, work = step_problem((math.nan, -1.0, 0.0), ((math.pi / 2, 0.0, 0.3),))
        residual, _ = solver.solve(problem, work, np.zeros(5))
        assert not residual <= TOLERANCE

    @pytest.mark.parametrize("seed", range(12))
    def test_residual_is_the_judges(self, solver: AbstractSolver, seed: int) -> None:
        rng = np.random.default_rng(seed)
        x, y, w = rng.normal(size=3)
        contacts = tuple(
            (float(rng.uniform(0.0, 2.5)), float(rng.uniform(0.0, 0.3)), float(rng.uniform(0, 1)))
            for _ in range(3)
        )
        problem, work = step_problem((x, y, w), contacts, float(rng.uniform(0.0, 0.5)))
        residual, _ = solver.solve(problem, work, np.zeros(5))
        judged = entries.judge(problem, work.right)
        assert (residual <= TOLERANCE) == (judged <= TOLERANCE)
        assert judged <= TOLERANCE

    def test_whole_grasp(self, solver: AbstractSolver) -> None:
        scene = grasp("slip", support_directions=SIDES)
        run = simulate(scene, stepper=StewartTrinkle(step=0.1), solver=solver, duration=3.0)
        assert run.converged
        assert run.max_residual <= TOLERANCE


class StepperContract:
    """Tests of a stepper: time advances to the end, and failures stop it."""

    @pytest.fixture
    def stepper(self) -> AbstractStepper:
        """Stepper under test."""
        raise NotImplementedError

    def test_declares_its_order(self, stepper: AbstractStepper) -> None:
        assert stepper.order >= 1
        assert 0.0 <= stepper.lead <= 1.0
        assert stepper.name
        first = stepper.first_step
        assert first is None or first > 0.0

    @pytest.mark.parametrize("duration", [1e-4, 0.123, 1.0])
    def test_ends_at_the_end(self, stepper: AbstractStepper, duration: float) -> None:
        run = simulate(sliding_block(duration=duration), stepper=stepper)
        assert run.converged
        assert run.time[0] == 0.0
        assert run.time[-1] == pytest.approx(duration, rel=1e-9)
        assert (np.diff(run.time) > 0.0).all()
        assert run.steps == len(run.time) - 1

    def test_block_slides_to_rest(self, stepper: AbstractStepper) -> None:
        run = simulate(sliding_block(0.5, 0.25, duration=0.5), stepper=stepper)
        # A first-order step of 10 ms has an error of half a step at 0.5 m/s.
        assert run.pose["block"][-1][0] == pytest.approx(0.25 / (0.5 * G), abs=0.0026)
        assert np.abs(run.twist["block"][-1]).max() < 1e-9

    def test_body_without_forces_goes_straight(self, stepper: AbstractStepper) -> None:
        run = simulate(sliding_block(0.3, 0.0, 0.7, duration=2.0), stepper=stepper)
        expected = [0.6 * math.cos(0.7), 0.6 * math.sin(0.7), 0.0]
        assert run.pose["block"][-1] == pytest.approx(expected, abs=1e-9)

    def test_samples_are_where_they_were_asked_for(self, stepper: AbstractStepper) -> None:
        run = simulate(sliding_block(duration=1.0), stepper=stepper, output_interval=0.3)
        assert run.time == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0], abs=1e-12)

    def test_jam_is_reported(self, stepper: AbstractStepper) -> None:
        run = simulate(grasp("seated", force_limit=None), stepper=stepper)
        assert run.status == codes.STATUS_NAMES[codes.JAMMED]
        assert run.stopped_at is not None
        assert run.time[-1] == pytest.approx(run.stopped_at)

    def test_same_bits_again(self, stepper: AbstractStepper) -> None:
        a, b = (simulate(grasp("slip"), stepper=stepper, duration=3.0) for _ in range(2))
        assert np.array_equal(a.time, b.time)
        assert np.array_equal(a.pose["object"], b.pose["object"])

    @pytest.mark.parametrize("status", [codes.MAX_ITERATIONS, codes.CONTACT_OVERFLOW])
    def test_gives_up_in_the_end(self, stepper: AbstractStepper, status: int) -> None:
        problem, _ = step_problem((1.0, 0.0, 0.0))
        tries = []

        def attempt(step: float, lead: float, guess: FloatArray, *rest: object) -> StepTrial:
            tries.append(step)
            assert len(tries) < 1000, "a stepper must stop"
            return StepTrial(status, math.inf)

        past = _no_history()
        limits = StepLimits(1.0, 1e-3, 1e-7, 0.2, True)
        advance = stepper.advance(attempt, problem, past, 0.1, limits)
        assert advance.status == status

    def test_never_goes_beyond_what_is_left(self, stepper: AbstractStepper) -> None:
        problem, _ = step_problem((0.0, 0.0, 0.0))

        def attempt(step: float, lead: float, guess: FloatArray, *rest: object) -> StepTrial:
            assert step <= 0.05 * (1 + 1e-12)
            return StepTrial(codes.CONVERGED, 0.0)

        past = _no_history()
        limits = StepLimits(0.05, 1e-3, 1e-7, 0.2, True)
        advance = stepper.advance(attempt, problem, past, 0.1, limits)
        assert advance.status == codes.CONVERGED
        assert 0.0 < advance.step <= 0.05 * (1 + 1e-12)
        assert advance.next_step > 0.0


def _no_history() -> StepHistory:
    """Return the history of a scene at rest, before its first step."""
    rest = np.zeros(5)
    return StepHistory(rest, rest, 0.0, 0.0, rest, rest, 0.0)


class MotionModelContract:
    """Tests of a motion model: solvable problems, poses from velocities, and contact laws."""

    @pytest.fixture
    def motion(self) -> AbstractMotionModel:
        """Motion model under test."""
        raise NotImplementedError

    def _run(self, motion: AbstractMotionModel, scene: Scene, **more: Any) -> Simulation:
        run = simulate(scene, motion=motion, stepper=StewartTrinkle(step=0.02), **more)
        assert run.converged
        assert run.max_residual <= TOLERANCE
        return run

    def test_body_that_nothing_moves_rests(self, motion: AbstractMotionModel) -> None:
        run = self._run(motion, sliding_block(speed=0.0, duration=1.0))
        assert np.abs(run.pose["block"][-1]).max() == 0.0

    def test_poses_follow_velocities(self, motion: AbstractMotionModel) -> None:
        run = self._run(motion, grasp("slip"), duration=6.0)
        step = np.diff(run.time)[:, None]
        moved = np.diff(run.pose["object"], axis=0)
        assert moved == pytest.approx(step * run.twist["object"][1:], abs=1e-12)

    def test_finger_pushes_the_body_ahead_of_it(self, motion: AbstractMotionModel) -> None:
        scene = free_push(sliding_block().bodies[0].support, friction=0.2, step=2.0)
        pose = touching_pose([0.01, -0.05], -math.pi / 2, 0.0)
        body = scene.bodies[0]
        moved = type(body)(
            name="body", shape=body.shape, mass=body.mass, pose=pose, support=body.support
        )
        run = self._run(
            motion, Scene(bodies=(moved,), pushers=scene.pushers, duration=scene.duration)
        )
        # The finger moves 20 mm; the body moves along and turns, since it is pushed off centre.
        assert run.pose["body"][-1][0] - pose[0] > 0.01
        assert abs(run.pose["body"][-1][2] - pose[2]) > 0.01

    def test_contacts_are_lawful(self, motion: AbstractMotionModel) -> None:
        run = self._run(motion, grasp("slip"))
        contacts = run.contacts
        names = run.names
        mu = np.array([run.scene.friction(names[c["body"]], names[c["other"]]) for c in contacts])
        assert len(contacts) > 0
        assert (contacts["normal_force"] >= -1e-6).all()
        assert (np.abs(contacts["tangential_force"]) <= mu * contacts["normal_force"] + 1e-6).all()
        assert (contacts["gap"] >= -1e-9).all()

    def test_turned_scene_turns_its_motion(self, motion: AbstractMotionModel) -> None:
        from fixel.testing.scenes import moved

        turn = 0.7
        a = self._run(motion, grasp("slip"), duration=4.0)
        b = self._run(motion, moved(grasp("slip"), (0.3, -0.1), turn), duration=4.0)
        c, s = math.cos(turn), math.sin(turn)
        there = b.pose["object"] - row(0.3, -0.1, turn)
        back = there @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        assert a.pose["object"] == pytest.approx(back, abs=1e-7)

    def test_plain_loop_makes_the_same_bits(self, motion: AbstractMotionModel) -> None:
        a = self._run(motion, grasp("slip"), duration=3.0)
        b = self._run(motion, grasp("slip"), duration=3.0, plain=True)
        assert np.array_equal(a.pose["object"], b.pose["object"])
