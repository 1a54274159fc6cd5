"""The plain loop: one step at a time in Python, for plug-ins and as the reference of the compiled
loop."""

from __future__ import annotations

import math

import numpy as np

from fixel.kernels import batch as kernel
from fixel.kernels import codes, single
from fixel.kernels.arrays import (
    BatchRecord,
    FloatArray,
    Method,
    Model,
    Problem,
    Record,
    State,
    Workspace,
)
from fixel.kernels.solve import TOLERANCE
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.pack import Packed
from fixel.simulation.solver import AbstractSolver
from fixel.simulation.stepper import AbstractStepper, Attempt, Limits, Past


class _Loop:
    """State of one plain rollout: what the seams share between calls."""

    def __init__(
        self,
        packed: Packed,
        motion: AbstractMotionModel,
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
        self.state = State(self.pose.copy(), np.zeros(wide), np.zeros(n_driven))
        self.last_step = 0.0
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
        if not single.contacts(
            model, state, self.time, step, ahead, guess, self.pose, problem, work, self.last_step
        ):
            return Attempt(codes.CONTACT_OVERFLOW, math.inf)
        n_support = self.motion.assemble(model, state, step, self.pose, problem)
        single.rows(
            model, state, kind, self.time, step, ahead, guess, self.pose, problem, n_support,
            self.last_step,
        )  # fmt: skip
        if least < math.inf:
            closing = float(single.closing_time(problem, guess, step, lead, least))
            if closing < math.inf:
                return Attempt(codes.CONVERGED, math.inf, closing=closing)
        residual, fell_back = self.solver.solve(problem, work, guess, hasty)
        self.fallbacks += fell_back
        solved = residual <= TOLERANCE
        self.last_step = step if solved else 0.0
        if solved and single.is_thrown(model, state, self.time, step, problem):
            return Attempt(codes.THROWN, residual)
        bounces = single.bounces(model, state, kind, self.time, step, problem)
        return Attempt(codes.CONVERGED if solved else codes.MAX_ITERATIONS, residual, bounces)


def roll_plainly(
    packed: Packed,
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    solver: AbstractSolver,
    method: Method,
    times: FloatArray | None,
) -> BatchRecord:
    """The record of one rollout, step by step; the same numbers as the compiled loop's."""
    loop = _Loop(packed, motion, solver, method.max_contacts)
    duration, step, tolerance, smallest, largest = (float(x) for x in packed.batch.pace[0])
    step = min(step, duration)
    scaled = None if times is None else times / packed.units.time
    samples = _Samples(loop, scaled, duration, step)
    status = codes.CONVERGED
    worst = 0.0
    steps = 0
    before = State(*(np.array(a) for a in loop.state))
    last_taken = earlier_taken = 0.0
    while loop.time < duration * (1.0 - 1e-12):
        if steps == method.max_steps:
            status = codes.MAX_STEPS
            break
        inertial = motion.kind == codes.DYNAMIC
        limits = Limits(duration - loop.time, tolerance, smallest, largest, inertial)
        past = Past(loop.state.velocity.copy(), before.velocity, last_taken, earlier_taken)
        advance = stepper.advance(loop.attempt, loop.problem, past, step, limits)
        if advance.status != codes.CONVERGED:
            status = _reason(loop, advance.status, advance.residual)
            break
        worst = max(worst, advance.residual)
        before = State(*(np.array(a) for a in loop.state))
        taken = advance.step
        glide = motion.kind == codes.DYNAMIC and stepper.adaptive
        motion.move(loop.model, loop.state, advance.step, loop.problem, glide)
        loop.time += advance.step
        steps += 1
        earlier_taken, last_taken = last_taken, taken
        step = advance.next_step
        samples.take(before, taken, taken)
    if status != codes.CONVERGED and steps and not samples.every_step:
        # Without contacts and forces: the problem holds what could not be solved.
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


class _Samples:
    """Collects samples as the compiled loop does."""

    def __init__(
        self, loop: _Loop, times: FloatArray | None, duration: float, first_step: float
    ) -> None:
        self.loop = loop
        self.times = np.zeros(0) if times is None else times
        self.every_step = times is None
        self.duration = duration
        self.n_driven = loop.model.force_limit.size
        self.shape = (loop.model.mass.size + self.n_driven, 3)
        self.rows: list[Record] = []
        self.done = 0
        self.take(loop.state, 0.0, first_step)

    def take(self, before: State, moved: float, step: float) -> None:
        """Write the samples that fall into the last `moved` of time, in a step that long or
        ahead."""
        loop = self.loop
        room = 1 if self.every_step else len(self.times) - self.done
        n_row = max(1, loop.problem.contact_key.size) * max(room, 1)
        record = Record(
            np.zeros(room) if self.every_step else self.times[self.done :].copy(),
            np.zeros((room, *self.shape)),
            np.zeros((room, *self.shape)),
            np.zeros((room, self.n_driven, 2)),
            np.zeros((n_row, 11)),
            np.zeros(4, np.int64),
            np.zeros(2),
        )
        written = single.sample(
            loop.model, before, loop.state, loop.time - moved, loop.time, step, loop.problem,
            record, self.every_step, self.duration,
        )  # fmt: skip
        if written:
            contact = record.contact[: record.count[1]]
            contact[:, 0] += self.done
            self.rows.append(
                Record(
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

    def stop_at(self, time: float) -> None:
        """Make `time` the last sample."""
        self.times = np.append(self.times[: self.done], time)

    def finish(self, status: int, steps: int, worst: float) -> BatchRecord:
        """All samples, as a batch of one."""
        joined = [np.concatenate([row[k] for row in self.rows])[None] for k in range(5)]
        count = np.array([[self.done, joined[4].shape[1], steps, self.loop.fallbacks]], np.int64)
        total = np.array([[self.loop.time, worst]])
        return BatchRecord._make([*joined, count, total, np.array([status], np.int64)])
