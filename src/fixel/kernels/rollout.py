"""Loop over the steps of one rollout, of fixed length or chosen to meet a tolerance.

The loop reads like docs/theory/stepping.md; its decisions are in `step_control.py`.
"""

import math

import numpy as np

from fixel.kernels import arrays as at
from fixel.kernels import codes
from fixel.kernels.allocate import allocate
from fixel.kernels.arrays import (
    CONTACT_ROWS,
    FALLBACKS,
    REACHED,
    SAMPLES,
    STEPS_TAKEN,
    WORST_RESIDUAL,
    Model,
    Problem,
    RolloutRecord,
    State,
    StepMethod,
    Workspace,
)
from fixel.kernels.contacts import place_bodies
from fixel.kernels.jit import kernel, large_kernel, spliced_kernel
from fixel.kernels.path import path_direction
from fixel.kernels.samples import is_due, write_samples
from fixel.kernels.solve import MAX_ATTEMPTS, MAX_ATTEMPTS_EARLY, TOLERANCE, may_jam, solve
from fixel.kernels.step import (
    creates_energy,
    keep_impulses,
    leave_overlaps,
    move,
    prepare_step,
)
from fixel.kernels.step_control import (
    AT_ONCE,
    begin_control,
    bounces,
    choose_trial,
    end_at_rest,
    end_step,
    event_time,
    extrapolation,
    is_thrown,
    judge_step,
    limit_step,
    parts,
    predict_velocity,
    rests,
    start_trial,
    take_back,
)
from fixel.typing import FloatArray


@spliced_kernel
def rollout(
    model: Model,
    start: FloatArray,
    velocity: FloatArray,
    method: StepMethod,
    settings: FloatArray,
    record: RolloutRecord,
    every_step: bool,
) -> int:
    """Simulate one scene; fills `record`, returns how it ended (codes.py).

    At time zero, bodies have the poses `start` (n_body, 3), and free ones the twists `velocity`
    (n_free, 3). `settings` are a row of `Batch.settings`. Samples are linear between step ends, as
    the motion within a step is. With `every_step` they are taken at each step's end, as far as
    there is room, instead of the times in `record.time`.
    """
    problem, work = allocate(model, method.max_contacts)
    wide = problem.momentum.size
    n_driven = model.force_limit.size
    state = State(start.copy(), np.zeros(wide), np.zeros(2 * n_driven), np.zeros(wide))
    before = State(start.copy(), np.zeros(wide), np.zeros(2 * n_driven), np.zeros(wide))
    older = State(start.copy(), np.zeros(wide), np.zeros(2 * n_driven), np.zeros(wide))
    rows = start.copy()
    guess = np.zeros(wide)
    control = np.zeros(at.N_CONTROL)
    begin(model, state, velocity, settings[at.STEP], problem, work)
    begin_control(control, settings, method.adaptive == 1, method.motion == codes.DYNAMIC)
    return _run(
        model, state, before, older, control, guess, rows, problem, work, method, record, every_step
    )


@kernel
def begin(
    model: Model, state: State, velocity: FloatArray, step: float, problem: Problem, work: Workspace
) -> None:
    """Write the constants of a rollout, and the velocities at time zero."""
    for b in range(model.mass.size):
        for k in range(3):
            state.velocity[3 * b + k] = velocity[b, k]
    for d in range(model.force_limit.size):
        if model.drive_dof[d] >= 0:
            state.velocity[model.drive_dof[d]] = path_direction(
                model.path_start, model.path, d, 0.0, 1e-3 * step
            )[3]
    for i in range(state.velocity.size):
        state.middle[i] = state.velocity[i]
    for i in range(model.piece_body.size):
        work.extent[i, 2] = model.piece_bound[i, 2]
    for e in range(model.element_body.size):
        problem.element_dof[e] = 3 * model.element_body[e]
        problem.element_sides[e] = model.sides if model.element_kind[e] == codes.POINT else 0
    place_bodies(model, state.pose, state.pose.shape[0], work)


@large_kernel
def _run(
    model: Model,
    state: State,
    before: State,
    older: State,
    control: FloatArray,
    guess: FloatArray,
    rows: FloatArray,
    problem: Problem,
    work: Workspace,
    method: StepMethod,
    record: RolloutRecord,
    every_step: bool,
) -> int:
    control[at.ELASTIC] = 1.0 if is_elastic(model) and method.motion == codes.DYNAMIC else 0.0
    status = codes.CONVERGED
    samples = contact_rows = 0  # in the record before the last step
    write_samples(model, before, state, control, 0.0, control[at.STEP], problem, record, every_step)
    while control[at.TIME] < control[at.DURATION] * (1.0 - 1e-12):
        status = _early_end(control, record, method.max_steps)
        if status != codes.CONVERGED:
            break
        limit_step(model, state, control)
        choose_trial(control)
        status = codes.RETRY
        residual = 0.0
        while status == codes.RETRY:
            predict_velocity(control, state.middle, before.middle, older.middle, guess)
            solved, residual = _solve_trial(
                model, state, control, guess, rows, problem, work, method, record
            )
            status = judge_step(control, problem, guess, state.velocity, solved, residual)
        if status == codes.UNDO:
            take_back(control)
            _copy_state(before, state, model.mass.size)
            _copy_state(older, before, model.mass.size)
            record.count[SAMPLES] = samples
            record.count[CONTACT_ROWS] = contact_rows
            continue
        if status != codes.CONVERGED:
            break
        record.total[WORST_RESIDUAL] = max(record.total[WORST_RESIDUAL], residual)
        _copy_state(before, older, model.mass.size)
        _copy_state(state, before, model.mass.size)
        samples = record.count[SAMPLES]
        contact_rows = record.count[CONTACT_ROWS]
        keep_impulses(control, problem, work)
        move(model, state, control[at.TRIAL], problem, extrapolation(control))
        end_step(control)
        still = rests(model, before, state, control, problem)
        moved = control[at.LAST]
        while True:
            if is_due(control, record, every_step):
                write_samples(
                    model, before, state, control, moved, control[at.SPAN], problem, record,
                    every_step,
                )  # fmt: skip
            if not still:
                break
            still = False
            moved = end_at_rest(control)
            _copy_state(state, before, model.mass.size)
    if status != codes.CONVERGED and not every_step and control[at.STEPS] > 0.0:
        _sample_stop(model, before, state, control, problem, record)
    record.count[STEPS_TAKEN] = control[at.STEPS]
    record.total[REACHED] = control[at.TIME]
    return status


@kernel
def _early_end(control: FloatArray, record: RolloutRecord, max_steps: int) -> int:
    """Status of a rollout that ends before its next step: stopped, or out of steps."""
    if record.total[at.STOP] > 0.0:
        return codes.INTERRUPTED
    if control[at.STEPS] + control[at.UNDONE] >= max_steps:
        return codes.MAX_STEPS
    return codes.CONVERGED


@spliced_kernel
def _solve_trial(
    model: Model,
    state: State,
    control: FloatArray,
    guess: FloatArray,
    rows: FloatArray,
    problem: Problem,
    work: Workspace,
    method: StepMethod,
    record: RolloutRecord,
) -> tuple[int, float]:
    """Write and solve the problem of a trial; returns the status and residual for `judge_step`."""
    trial = control[at.TRIAL]
    elastic = control[at.ELASTIC] == 1.0
    start_trial(control, trial, method.lead)
    ready = prepare_step(model, state, control, method.motion, guess, rows, problem, work)
    if not ready:
        return codes.CONTACT_OVERFLOW, math.inf
    if control[at.MIN_GAP] < math.inf:
        control[at.CLOSING] = event_time(problem, guess, trial, method.lead, control[at.MIN_GAP])
        if control[at.CLOSING] < math.inf:
            return codes.CONVERGED, math.inf
    early = control[at.GIVE_UP_EARLY] > 0.0
    at_once = control[at.GIVE_UP_EARLY] == AT_ONCE
    max_attempts = MAX_ATTEMPTS_EARLY if early else MAX_ATTEMPTS
    if at_once:
        max_attempts = 0
    leaves = at_once
    while True:
        residual, fell_back = solve(
            problem, work, guess, method.solver, method.effort, max_attempts
        )
        record.count[FALLBACKS] += fell_back
        if residual <= TOLERANCE:
            if not (elastic and creates_energy(model, state, problem)):
                break
        elif leaves or not leave_overlaps(model, control, problem, work):
            break
        else:
            leaves = True
    if not residual <= TOLERANCE:
        if not at_once and may_jam(problem, work, early):
            return codes.JAMMED, residual
        return codes.NON_FINITE if math.isinf(residual) else codes.MAX_ITERATIONS, residual
    if is_thrown(model, state, control, problem):
        return codes.THROWN, residual
    if elastic and bounces(model, state, control, problem):
        control[at.BOUNCES] = 1.0
    if control[at.ADAPTIVE] == 1.0 and parts(control, problem, work):
        control[at.PARTED] = 1.0
    return codes.CONVERGED, residual


@kernel
def is_elastic(model: Model) -> bool:
    """Whether any pair of bodies has restitution."""
    for a in range(model.restitution.shape[0]):
        for b in range(model.restitution.shape[1]):
            if model.restitution[a, b] > 0.0:
                return True
    return False


@kernel
def _sample_stop(
    model: Model,
    before: State,
    state: State,
    control: FloatArray,
    problem: Problem,
    record: RolloutRecord,
) -> None:
    """Write where a rollout stopped early as its last sample.

    Without contacts and forces: the problem holds what could not be solved.
    """
    sample = record.count[SAMPLES]
    if sample < record.time.size:
        record.time[sample] = control[at.TIME]
        write_samples(model, before, state, control, 0.0, control[at.LAST], problem, record, False)


@kernel
def _copy_state(source: State, target: State, n_free: int) -> None:
    """Copy what steps change: all but the poses of driven and fixed bodies."""
    for i in range(n_free):
        for k in range(3):
            target.pose[i, k] = source.pose[i, k]
    for i in range(source.velocity.size):
        target.velocity[i] = source.velocity[i]
        target.middle[i] = source.middle[i]
    for i in range(source.path_time.size):
        target.path_time[i] = source.path_time[i]
