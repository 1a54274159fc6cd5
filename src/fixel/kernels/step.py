"""One step: find the contacts, write the problem, solve it; and, apart from that, move the
bodies."""

import math

from fixel.kernels import arrays as at
from fixel.kernels.arrays import Model, Problem, State, Workspace
from fixel.kernels.assembly import (
    assemble_bodies,
    assemble_contact,
    assemble_elements,
    set_stiffness,
)
from fixel.kernels.contacts import find_contacts, find_near_pairs, moved, place_bodies, warm_start
from fixel.kernels.jit import kernel, large_kernel, spliced_kernel
from fixel.kernels.path import path_direction, path_pose
from fixel.typing import FloatArray

LIST_REACH = 0.2  # of the characteristic length: how far ahead near pairs are listed
NO_OVERLAP = 1e-9  # of the characteristic length: an overlap that is none
ALONG = 0.2  # of a body's change of velocity, or velocity: more of it along a normal is an impact
OLD_ELEMENT = 18  # column of `Workspace.element_change`: impulse of the last step taken
RUBBED = 1.0  # marks of a body: friction may stop it
PRESSED = 2.0  # and: by that of a contact
BLOCKED = 3.0  # and: it jumped
# Bodies up to which the largest error counts, and all forces act at last; of more, four times the
# root mean square: in a crowd some body always jumps, and most others hardly notice.
CROWD = 16
SWEEPS = 20  # at most, when overlaps are taken back
FAR = 3.0  # characteristic lengths: a body that reaches farther from its centre is long
STILL = 1e-9  # velocity of a drive below which it does not slip, change of one that counts as none
# Columns of `contact_place` in which `_separate` stores how far a contact yields to an impulse, and
# its inverse.
WEIGHT = at.HALVINGS
STIFFNESS = at.DRIVEN_NORMAL
SMALL_OVERLAP = 4.0  # tolerances: overlaps that remain where nothing else solves a step
GENTLY = 0.01  # of the characteristic time: an overlap with a pusher is taken back no faster
RECOVERY = 1.0  # of the characteristic speed: how fast an overlap is taken back, at most


@kernel
def place_rows(
    model: Model, state: State, control: FloatArray, velocity: FloatArray, pose: FloatArray
) -> None:
    """Write into `pose` the configuration at which a step's rows are taken."""
    time = control[at.TIME]
    lead = control[at.LEAD]
    n_free = model.mass.size
    n_driven = model.force_limit.size
    for b in range(n_free):
        for k in range(3):
            pose[b, k] = state.pose[b, k] + lead * velocity[3 * b + k]
    dof = 3 * n_free
    for d in range(n_driven):
        own = time + lead
        slip = 0.0
        if model.drive_dof[d] >= 0:
            own, slip = advanced(model, state, d, lead, velocity[dof], 1.0)
            dof += 1
        place_pusher(model, d, own, slip, pose[n_free + d])


@kernel
def advanced(
    model: Model, state: State, d: int, step: float, velocity: float, most: float
) -> tuple[float, float]:
    """Clock and slip of a force-limited pusher after a step, with at most `most` times its speed.

    A drive that stalls or is pushed back falls behind. Behind its start, past its end, and where
    its command is to rest and its clock goes on, it slips along its line instead.
    """
    clock = state.path_time[d]
    slip = state.path_time[model.force_limit.size + d]
    ahead = step if step > 0.0 else 1e-6
    speed = path_direction(model.path_start, model.path, d, clock, ahead)[3]
    last = model.path[model.path_start[d + 1] - 1, 0]
    if not speed > 0.0:
        return min(last, clock + step), slip + (step * velocity if abs(velocity) > STILL else 0.0)
    if clock <= 0.0:
        clock += slip / speed
        slip = 0.0
    own = step * min(most, velocity / speed)
    beyond = max(0.0, own - max(step, last - clock))  # of a drive that is dragged past its end
    clock = min(last, clock + own)
    if clock < 0.0:
        return 0.0, clock * speed
    return clock, slip + beyond * speed


@kernel
def place_pusher(model: Model, d: int, clock: float, slip: float, pose: FloatArray) -> None:
    """Write the pose (3,) of a pusher at a time of its clock."""
    pose[0], pose[1], pose[2] = path_pose(model.path_start, model.path, d, clock)
    if slip != 0.0:
        along = path_direction(model.path_start, model.path, d, clock, 1e-6)
        for k in range(3):
            pose[k] += slip * along[k]


@spliced_kernel
def prepare_step(
    model: Model,
    state: State,
    control: FloatArray,
    motion: int,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
) -> bool:
    """Write the problem of the trial of a step; False where contacts overflow.

    `guess` is the velocity expected over the step. Rows are taken at the configuration left in
    `pose`.
    """
    if not prepare_contacts(model, state, control, guess, pose, problem, work):
        return False
    n_support = prepare_bodies(model, state, motion, control[at.SPAN], pose, problem)
    prepare_rows(model, state, control, guess, pose, problem, work, n_support)
    return True


@spliced_kernel
def prepare_contacts(
    model: Model,
    state: State,
    control: FloatArray,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
) -> bool:
    """Write the contacts of the bodies, with their impulses expected; False on overflow."""
    n_free = model.mass.size
    n_moving = n_free + model.force_limit.size
    ratio = control[at.RATIO]
    place_rows(model, state, control, guess, pose)
    place_bodies(model, pose, n_moving, work)
    margin = _margin(model, state, control[at.TIME], control[at.TRIAL], guess)
    travelled = moved(model, pose, work.anchor, n_moving)
    if work.near_count[0] < 0 or margin + 2.0 * travelled > work.reach[0]:
        work.reach[0] = max(LIST_REACH, 2.0 * margin)
        work.near_count[0] = find_near_pairs(model, pose, n_free, n_moving, work.reach[0], work)
        if work.near_count[0] < 0:
            return False
    n_contact = find_contacts(model, work.near_count[0], margin, problem, work)
    if n_contact < 0:
        return False
    n_old = int(control[at.TAKEN_CONTACTS]) if ratio > 0.0 else 0
    warm_start(problem, n_contact, work.old_key, work.old_impulse, n_old, ratio)
    problem.size[at.N_CONTACT] = n_contact
    problem.size[at.N_FREE_DOF] = 3 * n_free
    return True


@spliced_kernel
def prepare_bodies(
    model: Model, state: State, motion: int, span: float, pose: FloatArray, problem: Problem
) -> int:
    """Write the rows of the motion model; returns the number of support friction elements."""
    assemble_bodies(model, state, motion, span, pose, problem)
    return assemble_elements(model, motion, span, pose, problem)


@spliced_kernel
def prepare_rows(
    model: Model,
    state: State,
    control: FloatArray,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
    n_support: int,
) -> None:
    """Write the drives, the stiffness of every block, the contact rows and the guess."""
    ratio = control[at.RATIO]
    dof = 3 * model.mass.size
    n_element = n_support
    for d in range(model.force_limit.size):
        if model.drive_dof[d] >= 0:
            _prepare_drive(model, state, control, d, problem, n_element, dof)
            n_element += 1
            dof += 1
    problem.size[at.N_DOF] = dof
    problem.size[at.N_ELEMENT] = n_element
    _expect_element_impulses(ratio, problem, work)
    set_stiffness(problem, n_support)
    for i in range(dof):
        problem.velocity[i] = guess[i]
    last = -1
    motion = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(problem.size[at.N_CONTACT]):
        d = problem.contact_body[i, 1] - model.mass.size
        if d != last and 0 <= d < model.force_limit.size:
            motion = _pusher_motion(model, state, control, d)
            last = d
        _prepare_contact(model, state, control, guess, pose, problem, i, motion)


@spliced_kernel
def _prepare_drive(
    model: Model, state: State, control: FloatArray, d: int, problem: Problem, e: int, dof: int
) -> None:
    """A force-limited drive is friction in one dimension: it holds its commanded speed up to its
    limit."""
    problem.element_dof[e] = dof
    problem.element_sides[e] = 0
    problem.element_row[e, 0, 0] = 1.0
    problem.element_bias[e, 0] = -path_direction(
        model.path_start, model.path, d, state.path_time[d], control[at.TRIAL]
    )[3]
    problem.element_limit[e] = control[at.SPAN] * model.force_limit[d]
    problem.inertia[dof, 0] = 0.0
    problem.momentum[dof] = 0.0


@spliced_kernel
def _margin(model: Model, state: State, time: float, step: float, guess: FloatArray) -> float:
    """Gap below which a contact may close within the step: three times the fastest motion in
    sight, or what the ends of long bodies sweep."""
    fastest = 0.0
    for b in range(model.mass.size):
        for v in (state.velocity, guess):
            vx = v[3 * b]
            vy = v[3 * b + 1]
            fastest = max(fastest, math.sqrt(vx * vx + vy * vy) + abs(v[3 * b + 2]))
    for d in range(model.force_limit.size):
        own = time if model.drive_dof[d] < 0 else state.path_time[d]
        fastest = max(fastest, path_direction(model.path_start, model.path, d, own, step)[3])
    swept = fastest + sweep_speed(model, state, time, step)
    return max(3.0 * step * fastest, step * swept) + 1e-3


@large_kernel
def sweep_speed(model: Model, state: State, time: float, step: float) -> float:
    """Largest speed that turning gives to points of bodies that reach farther than FAR."""
    fastest = 0.0
    n_free = model.mass.size
    for piece in range(model.piece_body.size):
        b = model.piece_body[piece]
        d = b - n_free
        if d >= model.force_limit.size:
            break
        x, y, radius = model.piece_bound[piece]
        reach = math.sqrt(x * x + y * y) + radius
        if reach <= FAR:
            continue
        if d < 0:
            turning = abs(state.velocity[3 * b + 2])
        else:
            own = time if model.drive_dof[d] < 0 else state.path_time[d]
            _, _, turn, speed = path_direction(model.path_start, model.path, d, own, step)
            turning = abs(turn) * speed
        fastest = max(fastest, reach * turning)
    return fastest


@kernel
def _pusher_motion(
    model: Model, state: State, control: FloatArray, d: int
) -> tuple[float, float, float, float, float, float]:
    """Return the direction of a force-limited pusher, or the motion of a rigid one over the step;
    and the pose of a rigid one at its start."""
    step = control[at.TRIAL]
    if model.drive_dof[d] >= 0:
        x, y, a, _ = path_direction(model.path_start, model.path, d, state.path_time[d], step)
        return x, y, a, 0.0, 0.0, 0.0
    x0, y0, a0 = path_pose(model.path_start, model.path, d, control[at.TIME])
    x1, y1, a1 = path_pose(model.path_start, model.path, d, control[at.TIME] + step)
    return x1 - x0, y1 - y0, a1 - a0, x0, y0, a0


@kernel
def _bend(
    problem: Problem, i: int, lead: float, spin_a: float, spin_b: float, lever: float, slip: float
) -> float:
    """Return how far the gap of contact i bends away from a line between a step's start and where
    its rows are taken, `lead` later, for bodies that move uniformly.

    `lever` is the normal coordinate of the contact point from the second body's centre, `slip` the
    relative tangential velocity there.
    """
    gap = problem.contact_place[i, at.GAP]
    round_a = problem.contact_place[i, at.ROUND_A]
    round_b = problem.contact_place[i, at.ROUND_B]
    # Centripetal acceleration of both points; below, that of their centres of curvature.
    bend = spin_b * spin_b * lever - spin_a * spin_a * problem.tangent[i, 2]
    turning = spin_a - spin_b
    if math.isinf(round_a):
        bend += 2.0 * spin_a * slip - (round_b + 0.5 * gap) * turning * turning
    elif math.isinf(round_b):
        bend += 2.0 * spin_b * slip - (round_a + 0.5 * gap) * turning * turning
    else:
        round_a += 0.5 * gap
        round_b += 0.5 * gap
        distance = round_a + round_b
        slip += spin_a * round_a + spin_b * round_b
        if not abs(slip * lead) < 0.5 * distance:
            return 0.0  # two corners pass each other
        bend += slip * slip / distance - spin_a * spin_a * round_a - spin_b * spin_b * round_b
    return 0.5 * lead * lead * bend


@kernel
def _prepare_contact(
    model: Model,
    state: State,
    control: FloatArray,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    i: int,
    motion: tuple[float, float, float, float, float, float],
) -> None:
    """Write the rows of contact i. `motion` is that of its pusher, if it has one."""
    n_free = model.mass.size
    step = control[at.TRIAL]
    inertial = control[at.INERTIAL] == 1.0
    a = problem.contact_body[i, 0]
    b = problem.contact_body[i, 1]
    problem.friction[i] = model.friction[a, b]
    d = b - n_free
    driven = 0 <= d < model.force_limit.size
    dof = model.drive_dof[d] if driven else -1
    dx, dy, da, x0, y0, a0 = motion
    assemble_contact(problem, i, pose, n_free, dof, dx, dy, da)
    nx = problem.contact_place[i, at.NORMAL_X]
    ny = problem.contact_place[i, at.NORMAL_Y]
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
    gap = problem.contact_place[i, at.GAP] - control[at.LEAD] * ahead  # at the step's start
    driven_n = 0.0  # normal and tangential motion of a rigid pusher over the step
    driven_t = 0.0
    spin = 0.0  # of the second body, and its lever of the normal
    lever = 0.0
    slip = 0.0  # relative tangential velocity expected
    for k in range(3):
        slip += problem.tangent[i, k] * guess[first + k]
        if second >= 0:
            slip += problem.tangent[i, 3 + k] * guess[second + k]
    if driven and dof < 0:
        rx = problem.contact_place[i, at.POINT_X] - pose[b, 0]
        ry = problem.contact_place[i, at.POINT_Y] - pose[b, 1]
        mx = dx - ry * da
        my = dy + rx * da
        driven_n = nx * mx + ny * my
        driven_t = nx * my - ny * mx
        mx = pose[b, 0] - x0 - ry * (pose[b, 2] - a0)
        my = pose[b, 1] - y0 + rx * (pose[b, 2] - a0)
        gap += nx * mx + ny * my
        spin = da / step
        lever = nx * rx + ny * ry
    elif driven:
        spin = da * guess[dof]
        lever = nx * (problem.contact_place[i, at.POINT_X] - pose[b, 0]) + ny * (
            problem.contact_place[i, at.POINT_Y] - pose[b, 1]
        )
    elif second >= 0:
        spin = guess[second + 2]
        lever = -problem.tangent[i, 5]
    driven_n /= step
    driven_t /= step
    gap += _bend(problem, i, control[at.LEAD], guess[first + 2], spin, lever, slip - driven_t)
    if -NO_OVERLAP < gap < 0.0:
        gap = 0.0  # a wedged body has no room to take a rounding error back, least in short steps
    overlap = 0.0
    room = step  # time in which the gap is to be closed, or an overlap taken back
    if inertial and driven and gap < 0.0:
        # A pusher may have to give way, at a velocity of its own. A short step must not turn the
        # error of a long one into a blow.
        room = max(step, GENTLY)
    elif inertial and gap < 0.0:
        # Velocities that take it back would stay as kinetic energy: `_separate` moves the bodies.
        overlap = min(-gap, RECOVERY * step)
        gap = 0.0
    # A deep overlap (a measured start, say) is taken back at no more than the characteristic speed,
    # or a body would be shot away.
    bias_n = max(gap / room, -RECOVERY) - driven_n
    bounce = model.restitution[a, b]
    approach = before - driven_n
    given_back = 0.0
    if bounce > 0.0 and inertial and approach < 0.0 and gap + step * approach < 0.0:
        # Newton's law of impact in place of the gap: leave with `bounce` times the approach.
        given_back = (bounce * approach - driven_n) - bias_n
        bias_n += given_back
    problem.contact_place[i, at.OVERLAP] = overlap
    problem.contact_place[i, at.GIVEN_BACK] = given_back
    problem.contact_place[i, at.DRIVEN_NORMAL] = -driven_n
    problem.contact_place[i, at.HALVINGS] = 0.0
    problem.bias[i, 0] = bias_n
    problem.bias[i, 1] = -driven_t


@kernel
def keep_impulses(control: FloatArray, problem: Problem, work: Workspace) -> None:
    """Store the impulses of a step that is taken, from which the trials of the next one start."""
    control[at.LAST_SPAN] = control[at.SPAN]
    control[at.TAKEN_CONTACTS] = problem.size[at.N_CONTACT]
    for i in range(problem.size[at.N_CONTACT]):
        work.old_key[i] = problem.contact_key[i]
        for k in range(2):
            work.old_impulse[i, k] = problem.impulse[i, k]
    for e in range(problem.size[at.N_ELEMENT]):
        for k in range(3):
            work.element_change[e, OLD_ELEMENT + k] = problem.element_impulse[e, k]


@kernel
def _expect_element_impulses(ratio: float, problem: Problem, work: Workspace) -> None:
    """Set the impulses of supports and drives to those of the last step taken, times `ratio`."""
    for e in range(problem.size[at.N_ELEMENT]):
        for k in range(3):
            problem.element_impulse[e, k] = ratio * work.element_change[e, OLD_ELEMENT + k]


@large_kernel
def leave_overlaps(model: Model, control: FloatArray, problem: Problem, work: Workspace) -> bool:
    """Prepare a second solution of a trial, from rest, that leaves overlaps below a few tolerances.

    Between surfaces that wedge a body by friction it has no room to take them back. Returns False,
    without a change, where there are none, and where a rigid pusher would creep through a jam: not
    where it is all that bodies touch.
    """
    for d in range(model.force_limit.size):
        for i in range(problem.size[at.N_CONTACT]):
            if model.drive_dof[d] < 0 and problem.contact_body[i, 1] != model.mass.size + d:
                return False
    trial = control[at.TRIAL]
    room = max(trial, GENTLY) if control[at.INERTIAL] == 1.0 else trial
    found = False
    for i in range(problem.size[at.N_CONTACT]):
        # Part of the bias that takes the overlap back.
        back = problem.bias[i, 0] - problem.contact_place[i, at.DRIVEN_NORMAL]
        if back < 0.0 and -back * room < SMALL_OVERLAP * control[at.TOLERANCE]:
            problem.bias[i, 0] -= back
            found = True
    if not found:
        return False
    for i in range(problem.size[at.N_DOF]):
        problem.velocity[i] = 0.0
    warm_start(
        problem, problem.size[at.N_CONTACT], work.old_key, work.old_impulse,
        int(control[at.TAKEN_CONTACTS]), control[at.RATIO],
    )  # fmt: skip
    _expect_element_impulses(control[at.RATIO], problem, work)
    return True


@large_kernel
def creates_energy(model: Model, state: State, problem: Problem) -> bool:
    """Whether the contacts give the bodies more kinetic energy than they took.

    Newton's law of restitution may, in several contacts at once or with friction. Where it does,
    this gives back half as much, after three times nothing, and the problem has to be solved again.
    Without restitution every step dissipates: impulses times velocities after it are not positive.
    """
    elastic = False
    energy = 0.0
    scale = 0.0
    for i in range(problem.size[at.N_CONTACT]):
        p_n = problem.impulse[i, 0]
        p_t = problem.impulse[i, 1]
        if p_n <= 0.0:
            continue
        elastic = elastic or problem.contact_place[i, at.GIVEN_BACK] != 0.0
        slip = problem.bias[i, 1]
        for side in range(2):
            dof = problem.contact_dof[i, side]
            if dof >= 0:
                for k in range(3):
                    slip += problem.tangent[i, 3 * side + k] * problem.velocity[dof + k]
        leaving = problem.contact_place[i, at.DRIVEN_NORMAL] - problem.bias[i, 0]
        energy += p_n * leaving + p_t * slip
        scale += p_n * (1e-7 * abs(leaving) + 1e-9)
    if not elastic:
        return False
    n_free_dof = problem.size[at.N_FREE_DOF]
    for e in range(problem.size[at.N_ELEMENT]):
        dof = problem.element_dof[e]
        if dof < n_free_dof:
            for j in range(3):
                slip = 0.0
                for k in range(3):
                    slip += problem.element_row[e, j, k] * problem.velocity[dof + k]
                energy += problem.element_impulse[e, j] * slip
    for o in range(n_free_dof):
        change = problem.velocity[o] - state.velocity[o]
        inertia = model.inertia[o // 3] if o % 3 == 2 else model.mass[o // 3]
        force = problem.momentum[o] - inertia * state.velocity[o]
        energy += 0.5 * change * (force - inertia * change)
    if energy <= scale:
        return False
    for i in range(problem.size[at.N_CONTACT]):
        kept = problem.contact_place[i, at.GIVEN_BACK]
        approach = kept if problem.contact_place[i, at.HALVINGS] >= 2.0 else 0.5 * kept
        problem.contact_place[i, at.HALVINGS] += 1.0
        problem.contact_place[i, at.GIVEN_BACK] = kept - approach
        problem.bias[i, 0] -= approach
    return True


@large_kernel
def _separate(model: Model, state: State, step: float, problem: Problem) -> None:
    """Move overlapping bodies apart, by the shortest way in the metric of their inertia.

    Gauss-Seidel over the contacts, at the end of the step, on positions alone. Prescribed and
    driven bodies stay where they are.

    Source: Cline & Pai (2003), post-stabilisation.
    """
    overlapping = False
    for i in range(problem.size[at.N_CONTACT]):
        overlapping = overlapping or problem.contact_place[i, at.OVERLAP] > 0.0
        problem.contact_place[i, at.GIVEN_BACK] = 0.0
    if not overlapping:
        return
    n_dof = problem.size[at.N_FREE_DOF]
    shift = problem.momentum  # of this step; no longer needed
    mobility = problem.stiffness  # likewise
    place = problem.contact_place
    normal = problem.normal
    for o in range(0, n_dof, 3):
        for k in range(3):
            shift[o + k] = 0.0
            mobility[o + k] = 1.0 / (model.inertia[o // 3] if k == 2 else model.mass[o // 3])
    for i in range(problem.size[at.N_CONTACT]):
        weight = 0.0
        missing = place[i, at.OVERLAP] - step * problem.bias[i, 0]
        for side in range(2):
            dof = problem.contact_dof[i, side]
            if dof >= 0:
                for k in range(3):
                    n = normal[i, 3 * side + k]
                    missing -= step * n * problem.velocity[dof + k]
                    if dof < n_dof:
                        weight += n * n * mobility[dof + k]
        place[i, at.OVERLAP] = missing
        place[i, WEIGHT] = weight
        place[i, STIFFNESS] = 1.0 / weight if weight > 0.0 else 0.0
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(problem.size[at.N_CONTACT]):
            weight = place[i, WEIGHT]
            if weight == 0.0:
                continue
            missing = place[i, at.OVERLAP]
            for side in range(2):
                dof = problem.contact_dof[i, side]
                if 0 <= dof < n_dof:
                    for k in range(3):
                        missing -= normal[i, 3 * side + k] * shift[dof + k]
            push = max(0.0, place[i, at.GIVEN_BACK] + missing * place[i, STIFFNESS])
            more = push - place[i, at.GIVEN_BACK]
            if more == 0.0:
                continue
            place[i, at.GIVEN_BACK] = push
            largest = max(largest, abs(more) * weight)
            for side in range(2):
                dof = problem.contact_dof[i, side]
                if 0 <= dof < n_dof:
                    for k in range(3):
                        shift[dof + k] += more * normal[i, 3 * side + k] * mobility[dof + k]
        if largest <= 0.1 * NO_OVERLAP:
            break
    for o in range(n_dof):
        state.pose[o // 3, o % 3] += shift[o]


@large_kernel
def _extrapolate(state: State, step: float, problem: Problem, smooth: bool) -> None:
    """Carry the velocities of bodies from the middle of a step, where they were solved for, to its
    end.

    The implicit midpoint rule: second order, and never more kinetic energy. Not where a body jumped
    or came to rest: of several, all go on with what they had in the middle, and owe half a step of
    forces. In a crowd only those that touch it do, and these forces are lost, as for a body alone.
    A body jumped that changed its velocity along the normal of a contact, by a large part of the
    change or, if `smooth`, of the velocity; or by more than forces explain, unless `smooth`. Nor
    where a body on a contact changed its velocity back: errors would alternate from step to step.
    """
    n_dof = problem.size[at.N_FREE_DOF]
    reach = 1.0 + 0.5 * step / (state.owed[0] + 0.5 * step)
    v = problem.velocity
    scratch = problem.stiffness  # of this step; no longer needed. Size, impulse, mark.
    for o in range(0, n_dof, 3):
        dx = v[o] - state.velocity[o]
        dy = v[o + 1] - state.velocity[o + 1]
        limits = problem.stiffness[o] - problem.inertia[o, 0]  # of the supports
        scratch[o] = math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - state.velocity[o + 2])
        scratch[o + 1] = limits
        for k in range(o, o + 3):
            scratch[o + 1] += abs(
                problem.momentum[k] - problem.inertia[k, k - o] * state.velocity[k]
            )
        scratch[o + 2] = RUBBED if limits > 0.0 else 0.0
    if not smooth:
        for o in range(0, n_dof, 3):
            if scratch[o] > 2.0 * scratch[o + 1] / problem.inertia[o, 0]:
                scratch[o + 2] = BLOCKED
    for i in range(problem.size[at.N_CONTACT]):
        if problem.impulse[i, 0] <= 0.0:
            continue
        along = math.inf if problem.contact_place[i, at.GIVEN_BACK] != 0.0 else 0.0
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    along += problem.normal[i, 3 * side + k] * (v[o + k] - state.velocity[o + k])
        for side in range(2):
            o = problem.contact_dof[i, side]
            if 0 <= o < n_dof:
                size = scratch[o]
                if smooth:
                    size = max(size, math.sqrt(v[o] * v[o] + v[o + 1] * v[o + 1]) + abs(v[o + 2]))
                if along > ALONG * size:
                    scratch[o + 2] = BLOCKED
                scratch[o + 2] = max(scratch[o + 2], PRESSED)
    for o in range(0, n_dof, 3):
        forward = swing = 0.0
        for k in range(o, o + 3):
            forward += v[k] * (state.velocity[k] + reach * (v[k] - state.velocity[k]))
            swing += (v[k] - state.velocity[k]) * (state.velocity[k] - state.middle[k])
        mark = scratch[o + 2]
        if (forward <= 0.0 and mark >= RUBBED) or (swing < 0.0 and mark == PRESSED):
            scratch[o + 2] = BLOCKED
    spreading = n_dof > 3 * CROWD
    while spreading:  # from body to body: only together do they keep from gaining energy
        spreading = False
        for i in range(problem.size[at.N_CONTACT]):
            o = problem.contact_dof[i, 0]
            other = problem.contact_dof[i, 1]
            if problem.impulse[i, 0] <= 0.0 or not 0 <= other < n_dof:
                continue
            blocked = o if scratch[o + 2] == BLOCKED else other
            alone = (scratch[o + 2] == BLOCKED) != (scratch[other + 2] == BLOCKED)
            if alone and scratch[blocked] > STILL:  # others slide along one that stays at rest
                scratch[o + 2] = scratch[other + 2] = BLOCKED
                spreading = True
    state.owed[0] = 0.0
    for o in range(0, n_dof if 3 < n_dof <= 3 * CROWD else 0, 3):
        if scratch[o + 2] == BLOCKED and scratch[o] > STILL:
            state.owed[0] = 0.5 * step
    for o in range(0, n_dof, 3):
        far = 1.0 if state.owed[0] > 0.0 or scratch[o + 2] == BLOCKED else reach
        for k in range(o, o + 3):
            state.velocity[k] += far * (v[k] - state.velocity[k])


@kernel
def move(model: Model, state: State, step: float, problem: Problem, extrapolation: int) -> None:
    """Take the step: update poses and velocities from the problem's velocity.

    `extrapolation`: 0 where the problem's velocity is that of the step's end; where it is that of
    its middle, 2 if velocities changed smoothly, else 1.
    """
    n_free = model.mass.size
    v = problem.velocity
    for b in range(n_free):
        for k in range(3):
            state.pose[b, k] += step * v[3 * b + k]
    for d in range(model.force_limit.size):
        if model.drive_dof[d] >= 0:
            dof = model.drive_dof[d]
            state.path_time[d], state.path_time[model.force_limit.size + d] = advanced(
                model, state, d, step, v[dof], math.inf
            )
    first = 0
    if extrapolation > 0:
        _extrapolate(state, step, problem, extrapolation == 2)
        first = problem.size[at.N_FREE_DOF]
    for i in range(problem.size[at.N_DOF]):
        state.middle[i] = v[i]
        if i >= first:
            state.velocity[i] = v[i]
    _separate(model, state, step, problem)
