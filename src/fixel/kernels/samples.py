"""Samples of a rollout: poses, velocities, drives and contacts, written into its record."""

from fixel.kernels import arrays as at
from fixel.kernels.arrays import Model, Problem, RolloutRecord, State
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.path import path_direction
from fixel.kernels.step import ALONG, place_pusher
from fixel.typing import FloatArray

TOUCHING = 1e-5  # of the characteristic length: gap below which a pair counts as touching
SAMPLE_SLACK = 1e-12  # of the duration: sample times this close to a step's end belong to it


@kernel
def is_due(control: FloatArray, record: RolloutRecord, every_step: bool) -> bool:
    """Whether a sample is to be written at or before the present time."""
    sample = record.count[at.SAMPLES]
    due = control[at.TIME] + SAMPLE_SLACK * control[at.DURATION]
    return sample < record.time.size and (every_step or record.time[sample] <= due)


@large_kernel
def write_samples(
    model: Model,
    before: State,
    state: State,
    control: FloatArray,
    moved: float,
    span: float,
    problem: Problem,
    record: RolloutRecord,
    every_step: bool,
) -> None:
    """Write the samples of the last `moved` of time, linear between both states.

    `span` is the time over which the impulses of the step acted. With `every_step`, there is one
    sample at the end, while the record has room; else one for each time of the record. A record
    without room for velocities has the poses of the free bodies only.
    """
    n_free = model.mass.size
    only_poses = record.twist.shape[0] == 0
    to_time = control[at.TIME]
    from_time = to_time - moved
    solved = control[at.LAST] if to_time > from_time else span  # shorter than `moved` at rest
    while record.count[at.SAMPLES] < record.pose.shape[0]:
        sample = record.count[at.SAMPLES]
        share = 1.0
        if every_step:
            record.time[sample] = to_time
        else:
            if record.time[sample] > to_time + SAMPLE_SLACK * control[at.DURATION]:
                break
            if to_time > from_time:
                share = min(1.0, (record.time[sample] - from_time) / (to_time - from_time))
        for b in range(n_free):
            for k in range(3):
                old = before.pose[b, k]
                record.pose[sample, b, k] = old + share * (state.pose[b, k] - old)
                if not only_poses:
                    record.twist[sample, b, k] = state.velocity[3 * b + k]
        if not only_poses:
            for d in range(model.force_limit.size):
                _sample_driven(
                    model, before, state, from_time, to_time, solved, span, problem, record, d,
                    share,
                )  # fmt: skip
            if record.total[at.LAST_CONTACTS] > 0.0:
                record.count[at.CONTACT_ROWS] = 0
            if to_time > from_time:
                _sample_contacts(
                    before.velocity, problem, record, solved, to_time - from_time, span
                )
        record.count[at.SAMPLES] += 1
        if every_step:
            break


@kernel
def _sample_driven(
    model: Model,
    before: State,
    state: State,
    from_time: float,
    to_time: float,
    step: float,
    span: float,
    problem: Problem,
    record: RolloutRecord,
    d: int,
    share: float,
) -> None:
    sample = record.count[at.SAMPLES]
    row = model.mass.size + d
    own = from_time + share * (to_time - from_time)
    own_start = from_time
    limited = model.drive_dof[d] >= 0
    slip = 0.0
    if limited:
        own_start = before.path_time[d]
        own = own_start + share * (state.path_time[d] - own_start)
        k = model.force_limit.size + d
        slip = before.path_time[k] + share * (state.path_time[k] - before.path_time[k])
    pose = record.pose[sample, row]
    place_pusher(model, d, own, slip, pose)
    dx, dy, da, command = path_direction(model.path_start, model.path, d, own_start, step)
    speed = state.velocity[model.drive_dof[d]] if limited else command
    record.twist[sample, row, 0] = speed * dx
    record.twist[sample, row, 1] = speed * dy
    record.twist[sample, row, 2] = speed * da
    force = 0.0
    if to_time > from_time:
        for i in range(problem.size[at.N_CONTACT]):
            if problem.contact_body[i, 1] == row:
                nx = problem.contact_place[i, at.NORMAL_X]
                ny = problem.contact_place[i, at.NORMAL_Y]
                pn = problem.impulse[i, 0]
                pt = problem.impulse[i, 1]
                fx = pn * nx - pt * ny
                fy = pn * ny + pt * nx
                rx = problem.contact_place[i, at.POINT_X] - pose[0]
                ry = problem.contact_place[i, at.POINT_Y] - pose[1]
                force += (fx * dx + fy * dy + (rx * fy - ry * fx) * da) / span
    record.drive[sample, d, 0] = force
    stalled = limited and command > 0.0 and speed < 0.01 * command
    record.drive[sample, d, 1] = 1.0 if stalled else 0.0


@kernel
def _is_impact(velocity: FloatArray, problem: Problem, i: int, step: float) -> bool:
    """Whether a contact changed the velocities of its bodies suddenly, unlike forces."""
    along = 0.0
    size = 0.0
    for side in range(2):
        o = problem.contact_dof[i, side]
        if 0 <= o < problem.size[at.N_FREE_DOF]:
            changed = 0.0
            moving = 0.0
            for k in range(3):
                change = problem.velocity[o + k] - velocity[o + k]
                along += problem.normal[i, 3 * side + k] * change
                changed += abs(change)
                moving += abs(problem.velocity[o + k])
            size = max(size, changed, moving)
    return along * step > TOUCHING and along > ALONG * size


@kernel
def _sample_contacts(
    velocity: FloatArray,
    problem: Problem,
    record: RolloutRecord,
    step: float,
    moved: float,
    span: float,
) -> None:
    """Write the contacts of a step: force times `moved` is the impulse of that time.

    `velocity` is that at its start. Forces act on after `span`, also past the step where the bodies
    rest; an impact acts once.
    """
    for i in range(problem.size[at.N_CONTACT]):
        row = record.count[at.CONTACT_ROWS]
        if row == record.contact.shape[0]:
            return
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        gap = problem.bias[i, 0]
        for k in range(3):
            gap += problem.normal[i, k] * problem.velocity[a + k]
            if b >= 0:
                gap += problem.normal[i, 3 + k] * problem.velocity[b + k]
        gap *= step
        if problem.impulse[i, 0] <= 0.0 and gap > TOUCHING:
            continue
        acted = span
        if span < step and _is_impact(velocity, problem, i, step):
            acted = step
        record.contact[row, 0] = record.count[at.SAMPLES]
        record.contact[row, 1] = problem.contact_body[i, 0]
        record.contact[row, 2] = problem.contact_body[i, 1]
        record.contact[row, 3] = gap
        for k in range(4):
            record.contact[row, 4 + k] = problem.contact_place[i, 1 + k]
        record.contact[row, 8] = problem.impulse[i, 0] / acted
        record.contact[row, 9] = problem.impulse[i, 1] / acted
        record.contact[row, 10] = moved
        record.count[at.CONTACT_ROWS] += 1
