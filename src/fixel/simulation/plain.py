"""Plain loop: one step at a time in Python, for plug-ins and as the reference of the compiled
loop."""

from __future__ import annotations

import math

import numpy as np

from fixel.kernels import arrays, arrays as at, codes, entries
from fixel.kernels.rollout import select_one
from fixel.kernels.solve import TOLERANCE
from fixel.kernels.step_control import AT_ONCE
from fixel.simulation import stepping
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.pack import PackedBatch
from fixel.typing import FloatArray


class _Loop:
    """State of one plain rollout, shared by its parts between calls."""

    def __init__(
        self,
        packed: PackedBatch,
        motion: AbstractMotionModel,
        stepper: stepping.AbstractStepper,
        solver: stepping.AbstractSolver,
        max_contacts: int,
    ) -> None:
        batch = packed.batch
        self.motion = motion
        self.solver = solver
        # A copy: plug-ins get the model, and batches of one scene share arrays.
        self.model = select_one(batch, 0)
        self.pose = np.array(batch.pose[: batch.count[0, at.BODY]])
        self.problem: arrays.Problem
        self.work: arrays.Workspace
        self.problem, self.work = entries.allocate(self.model, max_contacts)
        wide = self.problem.momentum.size
        n_driven = self.model.force_limit.size
        self.state = arrays.State(
            self.pose.copy(),
            np.zeros(wide),
            np.zeros(2 * n_driven),
            np.zeros(wide),
            np.zeros(1),
        )
        self.control = np.zeros(at.N_CONTROL)
        self.inertial = motion.kind == codes.DYNAMIC
        entries.begin_control(self.control, batch.settings[0], stepper.adaptive, self.inertial)
        self.fallbacks = 0
        step = float(batch.settings[0, at.STEP])
        entries.begin(self.model, self.state, batch.velocity, step, self.problem, self.work)

    def attempt(
        self,
        step: float,
        lead: float,
        guess: FloatArray,
        min_gap: float = math.inf,
        give_up_early: int = 0,
    ) -> stepping.StepTrial:
        """Try one step: contacts, the model's rows, the shared rows, the solver."""
        model, state, problem, work = self.model, self.state, self.problem, self.work
        control = self.control
        entries.start_trial(control, state, step, lead)
        if not entries.contacts(model, state, control, guess, self.pose, problem, work):
            return stepping.StepTrial(codes.CONTACT_OVERFLOW, math.inf)
        span = float(control[at.SPAN])
        n_support = self.motion.assemble(model, state, span, self.pose, problem)
        if self.motion.kind == codes.EXTERNAL:
            problem.size[arrays.N_POINT] = 0  # it may have changed the rows of built-in models
        entries.rows(model, state, control, guess, self.pose, problem, work, n_support)
        if min_gap < math.inf:
            closing = float(entries.event_time(problem, guess, step, lead, min_gap))
            if closing < math.inf:
                return stepping.StepTrial(codes.CONVERGED, math.inf, closing=closing)
        leaves = give_up_early == AT_ONCE
        give_up = int(AT_ONCE) if control[at.WEDGED] and not give_up_early else give_up_early
        while True:
            residual, fell_back = self.solver.solve(problem, work, guess, give_up)
            self.fallbacks += fell_back
            if residual <= TOLERANCE:
                if not entries.gains_energy(model, state, problem):
                    break
            elif not leaves and entries.leave_overlaps(model, control, problem, work):
                leaves = True
            elif give_up == give_up_early:
                break
            give_up = give_up_early
        control[at.WEDGED] = float(leaves and not give_up_early)
        if not residual <= TOLERANCE:
            if give_up_early != AT_ONCE and entries.may_jam(problem, work, give_up_early > 0):
                return stepping.StepTrial(codes.JAMMED, residual)
            failed = codes.NON_FINITE if math.isinf(residual) else codes.MAX_ITERATIONS
            return stepping.StepTrial(failed, residual)
        if entries.is_thrown(model, state, control, problem):
            return stepping.StepTrial(codes.THROWN, residual)
        bounces = entries.bounces(model, state, control, problem)
        parted = bool(entries.parts(control, problem, work))
        return stepping.StepTrial(codes.CONVERGED, residual, bounces, parted=parted)

    def past(self, before: arrays.State, older: arrays.State) -> stepping.StepHistory:
        """Return the last three steps."""
        state, control = self.state, self.control
        last, earlier, earliest = control[[at.LAST, at.EARLIER, at.EARLIEST]].tolist()
        middle, reached = state.middle.copy(), state.velocity.copy()
        return stepping.StepHistory(
            middle, before.middle, last, earlier, reached, older.middle, earliest
        )

    def limits(self) -> stepping.StepLimits:
        """Return the bounds on the next step."""
        control = self.control
        entries.limit_step(self.model, self.state, control)
        return stepping.StepLimits(
            left=float(control[at.LEFT]),
            tolerance=float(control[at.TOLERANCE]),
            smallest=float(control[at.SMALLEST]),
            largest=float(control[at.LARGEST]),
            inertial=self.inertial,
            eventful=control[at.EVENTFUL] == 1.0,
        )


def rollout_in_python(
    packed: PackedBatch,
    motion: AbstractMotionModel,
    stepper: stepping.AbstractStepper,
    solver: stepping.AbstractSolver,
    method: arrays.StepMethod,
    times: FloatArray | None,
) -> arrays.BatchRecord:
    """Simulate one rollout step by step; results equal those of the compiled loop."""
    loop = _Loop(packed, motion, stepper, solver, method.max_contacts)
    control = loop.control
    samples = _SampleCollector(loop, None if times is None else times / packed.units.time)
    status = codes.CONVERGED
    worst = 0.0
    before = older = _copied(loop.state)
    while control[at.TIME] < control[at.DURATION] * (1.0 - 1e-12):
        if control[at.STEPS] + control[at.UNDONE] >= method.max_steps:
            status = codes.MAX_STEPS
            break
        limits, past = loop.limits(), loop.past(before, older)
        step = float(control[at.STEP])
        advance = stepper.advance(loop.attempt, loop.problem, past, step, limits)
        status = advance.status
        if status == codes.UNDO:
            entries.take_back(control)
            loop.state, before = _copied(before), older
            samples.undo()
            continue
        if status != codes.CONVERGED:
            break
        worst = max(worst, advance.residual)
        older, before = before, _copied(loop.state)
        control[at.TRIAL], control[at.STEP] = advance.step, advance.next_step
        control[at.EVENTFUL], control[at.SMOOTH] = advance.event, advance.smooth
        entries.keep_impulses(control, loop.problem, loop.work)
        motion.move(
            loop.model, loop.state, advance.step, loop.problem, int(entries.extrapolation(control))
        )
        n_dof = loop.problem.size[arrays.N_DOF]
        loop.state.middle[:n_dof] = loop.problem.velocity[:n_dof]  # since a plug-in may not set it
        entries.end_step(control)
        samples.take(before, advance.step, float(control[at.SPAN]))
        if entries.rests(loop.model, before, loop.state, control, loop.problem):
            moved = float(entries.end_at_rest(control))
            samples.take(loop.state, moved, float(control[at.SPAN]))
    if status != codes.CONVERGED and control[at.STEPS] and not samples.every_step:
        # Without contacts and forces, since the problem was not solved.
        samples.stop_at(float(control[at.TIME]))
        samples.take(before, 0.0, float(control[at.LAST]))
    return samples.finish(status, worst)


def _copied(state: arrays.State) -> arrays.State:
    return arrays.State(*(np.array(a) for a in state))


class _SampleCollector:
    """Collector of samples, as in the compiled loop."""

    def __init__(self, loop: _Loop, times: FloatArray | None) -> None:
        self.loop = loop
        self.times = np.zeros(0) if times is None else times
        self.every_step = times is None
        self.n_driven = loop.model.force_limit.size
        self.shape = (loop.model.mass.size + self.n_driven, 3)
        self.rows: list[arrays.RolloutRecord] = []
        self.done = 0
        self.counts: list[int] = []
        self.take(loop.state, 0.0, float(loop.control[at.STEP]))

    def take(self, before: arrays.State, moved: float, span: float) -> None:
        """Write the samples in the last `moved` of time; forces acted for `span`."""
        loop = self.loop
        room = 1 if self.every_step else len(self.times) - self.done
        n_row = max(1, loop.problem.contact_key.size) * max(room, 1)
        record = arrays.RolloutRecord(
            np.zeros(room) if self.every_step else self.times[self.done :].copy(),
            np.zeros((room, *self.shape)),
            np.zeros((room, *self.shape)),
            np.zeros((room, self.n_driven, 2)),
            np.zeros((n_row, 11)),
            np.zeros(4, np.int64),
            np.zeros(at.N_TOTAL),
        )
        entries.write_samples(
            loop.model, before, loop.state, loop.control, moved, span, loop.problem, record,
            self.every_step,
        )  # fmt: skip
        written = int(record.count[arrays.SAMPLES])
        self.counts.append(written)
        if written:
            contact = record.contact[: record.count[arrays.CONTACT_ROWS]]
            contact[:, 0] += self.done
            kept = record._replace(
                time=record.time[:written], pose=record.pose[:written],
                twist=record.twist[:written], drive=record.drive[:written], contact=contact,
            )  # fmt: skip
            self.rows.append(kept)
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

    def finish(self, status: int, worst: float) -> arrays.BatchRecord:
        """Return all samples as a batch of one."""
        joined = [np.concatenate([row[k] for row in self.rows])[None] for k in range(5)]
        control = self.loop.control
        counts = [self.done, joined[4].shape[1], int(control[at.STEPS]), self.loop.fallbacks]
        count = np.array([counts], np.int64)
        total = np.array([[control[at.TIME], worst, 0.0, 0.0]])
        return arrays.BatchRecord._make([*joined, count, total, np.array([status], np.int64)])
