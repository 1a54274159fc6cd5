"""Plain loop: one step at a time in Python, for plug-ins and as the reference of the compiled
loop."""

from __future__ import annotations

import math

import numpy as np

from fixel.kernels import batch as kernel
from fixel.kernels import codes, single
from fixel.kernels.arrays import (
    BatchRecord,
    Model,
    Problem,
    RolloutRecord,
    State,
    StepMethod,
    Workspace,
)
from fixel.kernels.solve import TOLERANCE
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.pack import PackedBatch
from fixel.simulation.solver import AbstractSolver
from fixel.simulation.stepper import AbstractStepper, Attempt, Past, StepLimits
from fixel.typing import FloatArray


class _Loop:
    """State of one plain rollout, shared by its parts between calls."""

    def __init__(
        self,
        packed: PackedBatch,
        motion: AbstractMotionModel,
        stepper: AbstractStepper,
        solver: AbstractSolver,
        max_contacts: int,
    ) -> None:
        batch = packed.batch
        self.motion = motion
        self.solver = solver
        self.model: Model = kernel.select_one(batch, 0)
        self.pose = np.array(batch.pose[: batch.count[0, kernel.BODY]])
        self.problem: Problem
        self.work: Workspace
        self.problem, self.work = single.allocate(self.model, max_contacts)
        wide = self.problem.momentum.size
        n_driven = self.model.force_limit.size
        self.state = State(self.pose.copy(), np.zeros(wide), np.zeros(n_driven), np.zeros(wide))
        self.last_span = 0.0  # of the impulses in the problem
        self.span = 0.0  # time over which forces acted up to the velocity of the last solve
        self.staggered = motion.kind == codes.DYNAMIC and stepper.adaptive
        self.time = 0.0
        self.fallbacks = 0
        pace = batch.pace[0]
        single.begin(
            self.model, self.state, batch.velocity, float(pace[1]), self.problem, self.work
        )

    def attempt(
        self,
        step: float,
        lead: float,
        guess: FloatArray,
        least: float = math.inf,
        hasty: bool = False,
    ) -> Attempt:
        """Try one step: contacts, the model's rows, the shared rows, the solver."""
        model, state, problem, work = self.model, self.state, self.problem, self.work
        ahead = lead * step
        kind = self.motion.kind
        self.span = span = 0.5 * step if self.staggered else step
        ratio = span / self.last_span if self.last_span > 0.0 else 0.0
        if not single.contacts(
            model, state, self.time, step, ahead, guess, self.pose, problem, work, ratio
        ):
            return Attempt(codes.CONTACT_OVERFLOW, math.inf)
        n_support = self.motion.assemble(model, state, span, self.pose, problem)
        single.rows(
            model, state, kind, self.time, step, span, ahead, guess, self.pose, problem, n_support,
            ratio,
        )  # fmt: skip
        if least < math.inf:
            closing = float(single.closing_time(problem, guess, step, lead, least))
            if closing < math.inf:
                return Attempt(codes.CONVERGED, math.inf, closing=closing)
        while True:
            residual, fell_back = self.solver.solve(problem, work, guess, hasty)
            self.fallbacks += fell_back
            solved = residual <= TOLERANCE
            if not (solved and single.gains_energy(model, state, problem)):
                break
        self.last_span = span if solved else 0.0
        if not solved:
            jams = single.has_no_solution(problem, work, guess)
            return Attempt(codes.MAX_ITERATIONS, residual, jams=jams)
        if single.is_thrown(model, state, self.time, step, problem):
            return Attempt(codes.THROWN, residual)
        bounces = single.bounces(model, state, kind, self.time, step, problem)
        return Attempt(codes.CONVERGED, residual, bounces)


def roll_plainly(
    packed: PackedBatch,
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    solver: AbstractSolver,
    method: StepMethod,
    times: FloatArray | None,
) -> BatchRecord:
    """Simulate one rollout step by step; results equal those of the compiled loop."""
    loop = _Loop(packed, motion, stepper, solver, method.max_contacts)
    duration, step, tolerance, smallest, largest = (float(x) for x in packed.batch.pace[0])
    step = min(step, duration)
    scaled = None if times is None else times / packed.units.time
    samples = _SampleCollector(loop, scaled, duration, step)
    status = codes.CONVERGED
    worst = 0.0
    steps = 0
    before = State(*(np.array(a) for a in loop.state))
    last_taken = earlier_taken = earliest_taken = 0.0
    undone = 0
    eventful = True  # as in the compiled loop
    careful_until = careful = 0.0
    time_before = 0.0
    older = before
    while loop.time < duration * (1.0 - 1e-12):
        if steps + undone >= method.max_steps:
            status = codes.MAX_STEPS
            break
        inertial = motion.kind == codes.DYNAMIC
        left = duration - loop.time
        if loop.time < careful_until - smallest:
            step = min(step, careful)
        if stepper.adaptive:
            left = single.time_to_corner(loop.model, loop.state, loop.time, step, left, tolerance)
        limits = StepLimits(left, tolerance, smallest, largest, inertial, eventful)
        past = Past(
            loop.state.middle.copy(),
            before.middle,
            last_taken,
            earlier_taken,
            loop.state.velocity.copy(),
        )
        advance = stepper.advance(loop.attempt, loop.problem, past, step, limits)
        if advance.status == codes.UNDO:
            careful_until = loop.time + 0.5 * last_taken
            careful = step = advance.next_step
            loop.time = time_before
            loop.state = State(*(np.array(a) for a in before))
            before = older
            last_taken, earlier_taken, earliest_taken = earlier_taken, earliest_taken, 0.0
            eventful = True
            samples.undo()
            steps -= 1
            undone += 1
            continue
        if advance.status != codes.CONVERGED:
            status = _reason(loop, advance.status, advance.residual)
            break
        worst = max(worst, advance.residual)
        older = before
        before = State(*(np.array(a) for a in loop.state))
        time_before = loop.time
        eventful = advance.event
        taken = advance.step
        ahead = 0 if not loop.staggered else 2 if advance.smooth else 1
        motion.move(loop.model, loop.state, advance.step, loop.problem, ahead)
        n_dof = loop.problem.size[0]
        loop.state.middle[:n_dof] = loop.problem.velocity[:n_dof]  # since a plug-in may not set it
        loop.time += advance.step
        steps += 1
        earliest_taken, earlier_taken, last_taken = earlier_taken, last_taken, taken
        step = advance.next_step
        samples.take(before, taken, loop.span)
    if status != codes.CONVERGED and steps and not samples.every_step:
        # Without contacts and forces, since the problem was not solved.
        samples.stop_at(loop.time)
        samples.take(before, 0.0, taken)
    return samples.finish(status, steps, worst)


def _reason(loop: _Loop, status: int, residual: float) -> int:
    if status != codes.MAX_ITERATIONS:
        return status
    if math.isinf(residual):
        return codes.NON_FINITE
    locked = single.has_no_solution(loop.problem, loop.work, loop.state.velocity)
    return codes.JAMMED if locked else codes.MAX_ITERATIONS


class _SampleCollector:
    """Collector of samples, as in the compiled loop."""

    def __init__(
        self, loop: _Loop, times: FloatArray | None, duration: float, first_step: float
    ) -> None:
        self.loop = loop
        self.times = np.zeros(0) if times is None else times
        self.every_step = times is None
        self.duration = duration
        self.n_driven = loop.model.force_limit.size
        self.shape = (loop.model.mass.size + self.n_driven, 3)
        self.rows: list[RolloutRecord] = []
        self.done = 0
        self.counts: list[int] = []
        self.take(loop.state, 0.0, first_step)

    def take(self, before: State, moved: float, span: float) -> None:
        """Write the samples in the last `moved` of time; forces acted for `span`."""
        loop = self.loop
        room = 1 if self.every_step else len(self.times) - self.done
        n_row = max(1, loop.problem.contact_key.size) * max(room, 1)
        record = RolloutRecord(
            np.zeros(room) if self.every_step else self.times[self.done :].copy(),
            np.zeros((room, *self.shape)),
            np.zeros((room, *self.shape)),
            np.zeros((room, self.n_driven, 2)),
            np.zeros((n_row, 11)),
            np.zeros(4, np.int64),
            np.zeros(2),
        )
        written = single.sample(
            loop.model, before, loop.state, loop.time - moved, loop.time, span, loop.problem,
            record, self.every_step, self.duration,
        )  # fmt: skip
        self.counts.append(written)
        if written:
            contact = record.contact[: record.count[1]]
            contact[:, 0] += self.done
            self.rows.append(
                RolloutRecord(
                    record.time[:written],
                    record.pose[:written],
                    record.twist[:written],
                    record.drive[:written],
                    contact,
                    record.count,
                    record.total,
                )
            )
            self.done += written

    def undo(self) -> None:
        """Discard the samples of the last step."""
        n = self.counts.pop()
        if n:
            self.rows.pop()
            self.done -= n

    def stop_at(self, time: float) -> None:
        """Set `time` as the last sample."""
        self.times = np.append(self.times[: self.done], time)

    def finish(self, status: int, steps: int, worst: float) -> BatchRecord:
        """Return all samples as a batch of one."""
        joined = [np.concatenate([row[k] for row in self.rows])[None] for k in range(5)]
        count = np.array([[self.done, joined[4].shape[1], steps, self.loop.fallbacks]], np.int64)
        total = np.array([[self.loop.time, worst]])
        return BatchRecord._make([*joined, count, total, np.array([status], np.int64)])
