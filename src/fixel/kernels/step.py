"""One step: find the contacts, write the problem, solve it; and, apart from that, move the
bodies."""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import FloatArray, Model, Problem, State, Workspace
from fixel.kernels.assembly import (
    assemble_bodies,
    assemble_contact,
    assemble_elements,
    set_stiffness,
)
from fixel.kernels.contacts import find_contacts, find_near_pairs, moved, place_bodies, warm_start
from fixel.kernels.jit import kernel, spliced_kernel
from fixel.kernels.path import path_direction, path_pose

REACH = 0.2  # of the characteristic length: how far ahead near pairs are listed
RECOVERY = 1.0  # of the characteristic speed: how fast an overlap is taken back, at most


@kernel
def place_rows(
    model: Model, state: State, time: float, lead: float, velocity: FloatArray, pose: FloatArray
) -> None:
    """Write into `pose` the configuration at which a step's rows are taken, `lead` after its
    start."""
    n_free = model.mass.size
    n_driven = model.force_limit.size
    for b in range(n_free):
        for k in range(3):
            pose[b, k] = state.pose[b, k] + lead * velocity[3 * b + k]
    dof = 3 * n_free
    for d in range(n_driven):
        own = time + lead
        if model.drive_dof[d] >= 0:
            speed = path_direction(
                model.path_start, model.path, d, state.path_time[d], max(lead, 1e-6)
            )[3]
            own = state.path_time[d]
            if speed > 0.0:
                own += lead * min(1.0, velocity[dof] / speed)
            dof += 1
        x, y, a = path_pose(model.path_start, model.path, d, own)
        pose[n_free + d, 0] = x
        pose[n_free + d, 1] = y
        pose[n_free + d, 2] = a


@spliced_kernel
def prepare_step(
    model: Model,
    state: State,
    motion: int,
    time: float,
    step: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
    last_step: float,
) -> bool:
    """Write the problem of the step from `time` to ``time + step``; False where contacts overflow.

    `guess` is the velocity expected over the step; rows are taken `lead` after its start, at the
    configuration left in `pose`. `last_step` is the step whose impulses the problem still holds,
    zero for none.
    """
    if not prepare_contacts(model, state, time, step, lead, guess, pose, problem, work, last_step):
        return False
    n_support = prepare_bodies(model, state, motion, step, pose, problem)
    prepare_rows(model, state, motion, time, step, lead, guess, pose, problem, n_support, last_step)
    return True


@spliced_kernel
def prepare_contacts(
    model: Model,
    state: State,
    time: float,
    step: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
    last_step: float,
) -> bool:
    """First part: where the bodies meet, with the impulses they met with before; False on
    overflow."""
    n_free = model.mass.size
    n_moving = n_free + model.force_limit.size
    place_rows(model, state, time, lead, guess, pose)
    place_bodies(model, pose, n_moving, work)
    margin = _margin(model, state, time, step, guess)
    travelled = moved(model, pose, work.anchor, n_moving)
    if work.near_count[0] < 0 or margin + 2.0 * travelled > work.reach[0]:
        work.reach[0] = max(REACH, 2.0 * margin)
        work.near_count[0] = find_near_pairs(model, pose, n_free, n_moving, work.reach[0], work)
        if work.near_count[0] < 0:
            return False
    n_old = problem.size[1] if last_step > 0.0 else 0
    for i in range(n_old):
        work.old_key[i] = problem.contact_key[i]
        work.old_impulse[i, 0] = problem.impulse[i, 0]
        work.old_impulse[i, 1] = problem.impulse[i, 1]
    n_contact = find_contacts(model, work.near_count[0], margin, problem, work)
    if n_contact < 0:
        return False
    ratio = step / last_step if last_step > 0.0 else 0.0
    warm_start(problem, n_contact, work.old_key, work.old_impulse, n_old, ratio)
    problem.size[1] = n_contact
    problem.size[3] = 3 * n_free
    return True


@spliced_kernel
def prepare_bodies(
    model: Model, state: State, motion: int, step: float, pose: FloatArray, problem: Problem
) -> int:
    """Second part: the motion model's own rows; returns the number of support friction elements."""
    assemble_bodies(model, state, motion, step, pose, problem)
    return assemble_elements(model, motion, step, pose, problem)


@spliced_kernel
def prepare_rows(
    model: Model,
    state: State,
    motion: int,
    time: float,
    step: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    n_support: int,
    last_step: float,
) -> None:
    """Third part: the drives, the stiffness of every block, the contact rows, the guess."""
    dof = 3 * model.mass.size
    n_element = n_support
    for d in range(model.force_limit.size):
        if model.drive_dof[d] >= 0:
            _prepare_drive(model, state, d, step, problem, n_element, dof)
            n_element += 1
            dof += 1
    problem.size[0] = dof
    problem.size[2] = n_element
    ratio = step / last_step if last_step > 0.0 else 0.0
    for e in range(n_element):
        for k in range(3):
            # After a failed solve there may be no number to multiply.
            problem.element_impulse[e, k] = (
                ratio * problem.element_impulse[e, k] if ratio > 0.0 else 0.0
            )
    set_stiffness(problem, n_support)
    for i in range(dof):
        problem.velocity[i] = guess[i]
    for i in range(problem.size[1]):
        _prepare_contact(model, state, motion, time, step, lead, guess, pose, problem, i)


@spliced_kernel
def _prepare_drive(
    model: Model, state: State, d: int, step: float, problem: Problem, e: int, dof: int
) -> None:
    """A force-limited drive is friction in one dimension: it holds its commanded speed up to its
    limit."""
    problem.element_dof[e] = dof
    problem.element_sides[e] = 0
    problem.element_row[e, 0, 0] = 1.0
    problem.element_bias[e, 0] = -path_direction(
        model.path_start, model.path, d, state.path_time[d], step
    )[3]
    problem.element_limit[e] = step * model.force_limit[d]
    problem.inertia[dof, 0] = 0.0
    problem.momentum[dof] = 0.0


@spliced_kernel
def _margin(model: Model, state: State, time: float, step: float, guess: FloatArray) -> float:
    """Gap below which a contact may close within the step: three times the fastest motion in
    sight."""
    fastest = 0.0
    for b in range(model.mass.size):
        for v in (state.velocity, guess):
            vx = v[3 * b]
            vy = v[3 * b + 1]
            fastest = max(fastest, math.sqrt(vx * vx + vy * vy) + abs(v[3 * b + 2]))
    for d in range(model.force_limit.size):
        own = time if model.drive_dof[d] < 0 else state.path_time[d]
        fastest = max(fastest, path_direction(model.path_start, model.path, d, own, step)[3])
    return 3.0 * step * fastest + 1e-3


@kernel
def _prepare_contact(
    model: Model,
    state: State,
    motion: int,
    time: float,
    step: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    i: int,
) -> None:
    n_free = model.mass.size
    a = problem.contact_body[i, 0]
    b = problem.contact_body[i, 1]
    problem.friction[i] = model.friction[a, b]
    d = b - n_free
    driven = 0 <= d < model.force_limit.size
    dof = -1
    dx = 0.0
    dy = 0.0
    da = 0.0
    if driven and model.drive_dof[d] >= 0:
        dof = model.drive_dof[d]
        dx, dy, da, _ = path_direction(model.path_start, model.path, d, state.path_time[d], step)
    assemble_contact(problem, i, pose, n_free, dof, dx, dy, da)
    nx = problem.contact_place[i, 1]
    ny = problem.contact_place[i, 2]
    ahead = 0.0  # normal motion expected from the step's start to where the rows are taken
    before = 0.0  # normal velocity before the step
    first = problem.contact_dof[i, 0]
    second = problem.contact_dof[i, 1]
    for k in range(3):
        ahead += problem.normal[i, k] * guess[first + k]
        before += problem.normal[i, k] * state.velocity[first + k]
        if second >= 0:
            ahead += problem.normal[i, 3 + k] * guess[second + k]
            before += problem.normal[i, 3 + k] * state.velocity[second + k]
    gap = problem.contact_place[i, 0] - lead * ahead  # at the step's start
    driven_n = 0.0  # normal and tangential motion of a rigid pusher over the step
    driven_t = 0.0
    if driven and dof < 0:
        rx = problem.contact_place[i, 3] - pose[b, 0]
        ry = problem.contact_place[i, 4] - pose[b, 1]
        x0, y0, a0 = path_pose(model.path_start, model.path, d, time)
        x1, y1, a1 = path_pose(model.path_start, model.path, d, time + step)
        mx = x1 - x0 - ry * (a1 - a0)
        my = y1 - y0 + rx * (a1 - a0)
        driven_n = nx * mx + ny * my
        driven_t = nx * my - ny * mx
        mx = pose[b, 0] - x0 - ry * (pose[b, 2] - a0)
        my = pose[b, 1] - y0 + rx * (pose[b, 2] - a0)
        gap += nx * mx + ny * my
    # A deep overlap (a measured start, say) is taken back at no more than the characteristic speed,
    # or a dynamic body would be shot away.
    bias_n = max(gap / step, -RECOVERY) - driven_n / step
    bounce = model.restitution[a, b]
    approach = before - driven_n / step
    if bounce > 0.0 and motion == codes.DYNAMIC and approach < 0.0 and gap + step * approach < 0.0:
        # Newton's law of impact in place of the gap: leave with `bounce` times the approach.
        bias_n = bounce * approach - driven_n / step
    problem.bias[i, 0] = bias_n
    problem.bias[i, 1] = -driven_t / step


@kernel
def move(model: Model, state: State, step: float, problem: Problem, glide: bool) -> None:
    """Take the step: the velocity becomes the problem's, the poses follow it.

    With `glide`, a body without any contact follows the mean of the velocities before and after,
    which is exact for a body that slides to rest under constant friction.
    """
    n_free = model.mass.size
    v = problem.velocity
    for b in range(n_free):
        free = glide
        if glide:
            for i in range(problem.size[1]):
                if problem.contact_body[i, 0] == b or problem.contact_body[i, 1] == b:
                    free = False
                    break
        for k in range(3):
            mean = 0.5 * (v[3 * b + k] + state.velocity[3 * b + k])
            state.pose[b, k] += step * (mean if free else v[3 * b + k])
    for d in range(model.force_limit.size):
        if model.drive_dof[d] >= 0:
            dof = model.drive_dof[d]
            speed = path_direction(model.path_start, model.path, d, state.path_time[d], step)[3]
            last = model.path[model.path_start[d + 1] - 1, 0]
            # A drive that stalls falls behind; while it is told to rest, its clock goes on.
            share = v[dof] / speed if speed > 0.0 else 1.0
            state.path_time[d] = min(last, state.path_time[d] + step * share)
    for i in range(problem.size[0]):
        state.velocity[i] = v[i]
