"""Loop over the steps of one rollout, of fixed length or chosen to meet a tolerance; and batches.

The loop reads like docs/theory/stepping.md; its decisions are in `step_control.py`. Problems and
workspaces are allocated before the first step, and only then.
"""

import math

import numpy as np

from fixel.kernels import arrays as at, codes
from fixel.kernels.arrays import Batch, Model, Problem, State, Workspace
from fixel.kernels.contacts import place_bodies
from fixel.kernels.islands import island_room
from fixel.kernels.jit import allocating_kernel, entry, kernel, large_kernel, spliced_kernel, view
from fixel.kernels.josephy import MAX_CONTACTS, MAX_DRIVES
from fixel.kernels.linear import DENSE_LIMIT
from fixel.kernels.path import path_direction
from fixel.kernels.residual import SCRATCH
from fixel.kernels.samples import is_due, write_samples
from fixel.kernels.solve import MAX_ATTEMPTS, MAX_ATTEMPTS_EARLY, TOLERANCE, may_jam, solve
from fixel.kernels.step import creates_energy, keep_impulses, leave_overlaps, move, prepare_step
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

SPARE = 2  # entries behind the last degree of freedom, so that every block may be read three wide


@allocating_kernel
def empty_problem(n_dof: int, n_contact: int, n_element: int) -> Problem:
    """Allocate a problem with room for these numbers of degrees of freedom, contacts and friction
    elements, none of them in use."""
    wide = n_dof + SPARE
    return Problem(
        size=np.zeros(at.N_SIZE, np.int64),
        inertia=np.zeros((wide, 3)),
        momentum=np.zeros(wide),
        velocity=np.zeros(wide),
        stiffness=np.zeros(wide),
        contact_dof=np.zeros((n_contact, 2), np.int64),
        contact_key=np.zeros(n_contact, np.int64),
        contact_body=np.zeros((n_contact, 2), np.int64),
        contact_place=np.zeros((n_contact, at.N_PLACE)),
        normal=np.zeros((n_contact, 6)),
        tangent=np.zeros((n_contact, 6)),
        bias=np.zeros((n_contact, 2)),
        friction=np.zeros(n_contact),
        impulse=np.zeros((n_contact, 2)),
        element_dof=np.zeros(n_element, np.int64),
        element_sides=np.zeros(n_element, np.int64),
        element_row=np.zeros((n_element, 3, 3)),
        element_bias=np.zeros((n_element, 3)),
        element_limit=np.zeros(n_element),
        element_impulse=np.zeros((n_element, 3)),
    )


@allocating_kernel
def empty_workspace(
    n_dof: int,
    n_contact: int,
    n_element: int,
    n_vertex: int,
    n_piece: int,
    n_body: int,
    n_pair: int,
) -> Workspace:
    """Allocate the workspace for a problem and a scene of these sizes."""
    wide = n_dof + SPARE
    n_row = 4 * min(n_contact, MAX_CONTACTS) + 2 * MAX_DRIVES
    # Islands are for large problems only.
    n_float = 0
    n_index = 0
    if n_dof > DENSE_LIMIT:
        n_float, n_index = island_room(wide, n_contact, n_element)
    return Workspace(
        matrix=np.zeros((wide, wide)),
        profile=np.zeros(wide, np.int64),
        active=np.zeros(wide, np.int64),
        right=np.zeros(wide + SCRATCH),
        contact_change=np.zeros((n_contact, 24)),
        element_change=np.zeros((n_element, 21)),
        lanes=np.zeros(at.LANE_FIELDS * n_element),
        world=np.zeros((n_vertex, 2)),
        is_placed=np.zeros(n_piece, np.int64),
        frame=np.zeros((n_body, 4)),
        old_key=np.zeros(n_contact, np.int64),
        old_impulse=np.zeros((n_contact, 4)),
        near=np.zeros((n_pair, 2), np.int64),
        order=np.arange(n_piece),
        extent=np.zeros((n_piece, 3)),
        anchor=np.zeros((n_body, 3)),
        reach=np.zeros(1),
        inverse=np.zeros((wide, 3)),
        pull=np.zeros(wide),
        centre=np.zeros(wide),
        search=np.zeros((wide, 5)),
        tableau=np.zeros((n_row, 2 * n_row + 2)),
        basis=np.zeros(n_row),
        island_floats=np.zeros(n_float),
        island_indices=np.zeros(n_index, np.int64),
        near_count=np.full(1, -1, np.int64),
    )


@allocating_kernel
def allocate(model: Model, max_contacts: int) -> tuple[Problem, Workspace]:
    """Allocate a problem and a workspace large enough for every step of a rollout."""
    n_free = model.mass.size
    n_driven = model.force_limit.size
    n_body = model.friction.shape[0]
    n_piece = model.piece_body.size
    n_dof = 3 * n_free
    for d in range(n_driven):
        if model.drive_dof[d] >= 0:
            n_dof += 1
    n_pair = 0
    others = 0  # pieces of later bodies
    for i in range(n_piece - 1, -1, -1):
        if i + 1 < n_piece and model.piece_body[i + 1] != model.piece_body[i]:
            others = n_piece - i - 1
        if model.piece_body[i] < n_free:
            n_pair += others
    n_pair = min(n_pair, 32 * n_piece)
    n_contact = min(2 * n_pair, max_contacts)
    n_element = model.element_body.size + n_driven
    problem = empty_problem(n_dof, n_contact, n_element)
    work = empty_workspace(
        n_dof, n_contact, n_element, model.vertex.shape[0], n_piece, n_body, n_pair
    )
    return problem, work


@spliced_kernel
def rollout(
    model: Model,
    start: FloatArray,
    velocity: FloatArray,
    method: at.StepMethod,
    settings: FloatArray,
    record: at.RolloutRecord,
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
    clocks = 2 * model.force_limit.size
    state = State(start.copy(), np.zeros(wide), np.zeros(clocks), np.zeros(wide), np.zeros(1))
    before = State(start.copy(), np.zeros(wide), np.zeros(clocks), np.zeros(wide), np.zeros(1))
    older = State(start.copy(), np.zeros(wide), np.zeros(clocks), np.zeros(wide), np.zeros(1))
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
    method: at.StepMethod,
    record: at.RolloutRecord,
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
            record.count[at.SAMPLES] = samples
            record.count[at.CONTACT_ROWS] = contact_rows
            continue
        if status != codes.CONVERGED:
            break
        record.total[at.WORST_RESIDUAL] = max(record.total[at.WORST_RESIDUAL], residual)
        _copy_state(before, older, model.mass.size)
        _copy_state(state, before, model.mass.size)
        samples = record.count[at.SAMPLES]
        contact_rows = record.count[at.CONTACT_ROWS]
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
    record.count[at.STEPS_TAKEN] = control[at.STEPS]
    record.total[at.REACHED] = control[at.TIME]
    return status


@kernel
def _early_end(control: FloatArray, record: at.RolloutRecord, max_steps: int) -> int:
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
    method: at.StepMethod,
    record: at.RolloutRecord,
) -> tuple[int, float]:
    """Write and solve the problem of a trial; returns the status and residual for `judge_step`."""
    trial = control[at.TRIAL]
    elastic = control[at.ELASTIC] == 1.0
    start_trial(control, state, trial, method.lead)
    ready = prepare_step(model, state, control, method.motion, guess, rows, problem, work)
    if not ready:
        return codes.CONTACT_OVERFLOW, math.inf
    if control[at.MIN_GAP] < math.inf:
        control[at.CLOSING] = event_time(problem, guess, trial, method.lead, control[at.MIN_GAP])
        if control[at.CLOSING] < math.inf:
            return codes.CONVERGED, math.inf
    early = control[at.GIVE_UP_EARLY] > 0.0
    at_once = control[at.GIVE_UP_EARLY] == AT_ONCE
    most = 0 if at_once else MAX_ATTEMPTS_EARLY if early else MAX_ATTEMPTS
    leaves = at_once
    max_attempts = 0 if control[at.WEDGED] == 1.0 and not early else most
    while True:
        residual, fell_back = solve(
            problem, work, guess, method.solver, method.effort, max_attempts
        )
        record.count[at.FALLBACKS] += fell_back
        if residual <= TOLERANCE:
            if not (elastic and creates_energy(model, state, problem)):
                break
        elif not leaves and leave_overlaps(model, control, problem, work):
            leaves = True
        elif max_attempts == most:
            break
        max_attempts = most
    control[at.WEDGED] = 1.0 if leaves and not early else 0.0
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
    record: at.RolloutRecord,
) -> None:
    """Write where a rollout stopped early as its last sample.

    Without contacts and forces: the problem holds what could not be solved.
    """
    sample = record.count[at.SAMPLES]
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
    target.owed[0] = source.owed[0]


@kernel
def select(batch: Batch, r: int) -> Model:
    """Return the model of rollout r, as views of the batch's arrays, which must outlive it."""
    a = batch.begin[r]
    n = batch.count[r]
    m = batch.model
    free, piece, vertex, body = n[at.FREE], n[at.PIECE], n[at.VERTEX], n[at.BODY]
    element, driven, cells, e = n[at.ELEMENT], n[at.DRIVEN], batch.map_shape[r], a[at.ELEMENT]
    return Model(
        view(m.mass, a[at.FREE], (free,)), view(m.inertia, a[at.FREE], (free,)),
        view(m.wrench, 3 * a[at.FREE], (free, 3)), view(m.spring, 3 * a[at.FREE], (free, 3)),
        view(m.drag, 9 * a[at.FREE], (free, 3, 3)), view(m.piece_body, a[at.PIECE], (piece,)),
        view(m.piece_start, a[at.PIECE_START], (n[at.PIECE_START],)),
        view(m.piece_bound, 3 * a[at.PIECE], (piece, 3)),
        view(m.piece_radius, a[at.PIECE], (piece,)),
        view(m.vertex, 2 * a[at.VERTEX], (vertex, 2)), view(m.edge_real, a[at.VERTEX], (vertex,)),
        view(m.friction, a[at.PAIR], (body, body)), view(m.restitution, a[at.PAIR], (body, body)),
        view(m.element_body, e, (element,)), view(m.element_kind, e, (element,)),
        view(m.element_point, 2 * e, (element, 2)), view(m.element_limit, e, (element,)),
        view(m.element_ratio, e, (element,)),
        view(m.path_start, a[at.PATH_START], (n[at.PATH_START],)),
        view(m.path, 4 * a[at.PATH], (n[at.PATH], 4)),
        view(m.force_limit, a[at.DRIVEN], (driven,)), view(m.drive_dof, a[at.DRIVEN], (driven,)),
        view(m.plane, 3 * r, (3,)), view(m.map_frame, 4 * r, (4,)),
        view(m.map_factor, a[at.MAP], (cells[0], cells[1])), batch.sides[r],
    )  # fmt: skip


@spliced_kernel
def _rollout_one(
    batch: Batch, method: at.StepMethod, record: at.BatchRecord, every_step: bool, r: int
) -> None:
    a = batch.begin[r]
    z = a + batch.count[r]
    own = at.RolloutRecord(
        record.time[r],
        record.pose[r],
        record.twist[r],
        record.drive[r],
        record.contact[r],
        record.count[r],
        record.total[r],
    )
    record.status[r] = rollout(
        select(batch, r),
        batch.pose[a[at.BODY] : z[at.BODY]],
        batch.velocity[a[at.FREE] : z[at.FREE]],
        method,
        batch.settings[r],
        own,
        every_step,
    )


@entry
def _select_one(batch: Batch, r: int) -> Model:
    return select(batch, r)


def select_one(batch: Batch, r: int) -> Model:
    """Return a copy of the model of rollout r."""
    shared = _select_one(batch, r)
    return Model._make([*map(np.array, shared[:-1]), shared.sides])


@entry
def rollout_batch(
    batch: Batch, method: at.StepMethod, record: at.BatchRecord, every_step: bool,
    first: int, last: int,
) -> None:  # fmt: skip
    """Simulate rollouts `first` to ``last - 1`` without Python's lock, for use in threads."""
    for r in range(first, last):
        _rollout_one(batch, method, record, every_step, r)
