"""Loop over the steps of one rollout, of fixed length or chosen to meet a tolerance."""

import math

import numpy as np

from fixel.kernels import codes
from fixel.kernels.allocate import empty_problem, empty_workspace
from fixel.kernels.arrays import (
    Model,
    Problem,
    RolloutRecord,
    State,
    StepMethod,
    TimeSettings,
    Workspace,
)
from fixel.kernels.contacts import place_bodies
from fixel.kernels.jit import allocating_kernel, kernel, large_kernel, spliced_kernel
from fixel.kernels.path import path_direction, path_pose, straight_time
from fixel.kernels.solve import HASTY, PATIENT, TOLERANCE, locked, solve
from fixel.kernels.step import ALONG, RECOVERY, creates_energy, move, prepare_step
from fixel.typing import FloatArray

GROWTH = 3.0  # the step grows at most so much from one step to the next
SHRINK = 0.3  # and shrinks at most so much after a rejection
CAUTION = 0.9  # aim at this part of the tolerance
EVENT = 10.0  # tolerances: where something happens, inside a step, need not be known better
JUMP = 0.1  # of the velocity: a change from step to step that is no smooth motion's
# Of the change from a velocity expected on a line, times half the step: what a second-order step is
# wrong by. A twelfth for equal steps; twice that to be safe.
SECOND_ORDER = 1.0 / 6.0
# Where the expected velocity of a trial comes from.
PREDICTED = 0  # the steps before
CUT = 1  # the same, for a step that ends where a gap closes
RENEWED = 2  # the solution of the same trial, which begins with a jump
INSIST = 3  # one of so many unsolved trials of a step is not given up early, jams not counted
EXPONENT = 0.4  # of the change of step with the error's: between second and third order
TOUCHING = 1e-5  # of the characteristic length: gap below which a pair counts as touching
BOUNCE = 1e-4  # of the characteristic speed: approaches slower than this need no step of their own
MAX_MOTION = (
    1.0  # characteristic length, or radian: a step that moves a body further is out of its depth
)
SUDDEN = 3.0  # times the fastest motion in sight, which a step looks ahead for; see step._margin
SAMPLE_SLACK = 1e-12  # of the duration: sample times this close to a step's end belong to it


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
    for i in range(n_piece):
        if model.piece_body[i] < n_free:
            n_pair += n_piece - i - 1
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
    method: StepMethod,
    pace: TimeSettings,
    record: RolloutRecord,
    every_step: bool,
) -> int:
    """Simulate one scene; fills `record`, returns how it ended (codes.py).

    Parameters
    ----------
    model : Model
    start : (n_body, 3) float64
        Pose of every body at time zero.
    velocity : (n_free, 3) float64
        Twist of every free body at time zero.
    method, pace
        How to step.
    record : RolloutRecord
        Filled. Samples are linear between step ends, as the motion within a step is.
    every_step : bool
        Sample at each step's end (as far as there is room) in place of the times in `record.time`.
    """
    problem, work = allocate(model, method.max_contacts)
    wide = problem.momentum.size
    n_driven = model.force_limit.size
    state = State(start.copy(), np.zeros(wide), np.zeros(n_driven), np.zeros(wide))
    before = State(start.copy(), np.zeros(wide), np.zeros(n_driven), np.zeros(wide))
    older = State(start.copy(), np.zeros(wide), np.zeros(n_driven), np.zeros(wide))
    rows = start.copy()
    guess = np.zeros(wide)
    begin(model, state, velocity, pace.step, problem, work)
    return _run(
        model, state, before, older, guess, rows, problem, work, method, pace, record, every_step
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
    guess: FloatArray,
    rows: FloatArray,
    problem: Problem,
    work: Workspace,
    method: StepMethod,
    pace: TimeSettings,
    record: RolloutRecord,
    every_step: bool,
) -> int:
    time = 0.0
    step = min(pace.step, pace.duration)
    staggered = method.adaptive == 1 and method.motion == codes.DYNAMIC
    jumped = False
    span = 0.0  # the time over which forces act before the velocity that is solved for
    last_span = 0.0  # of the impulses that the problem holds
    n_dof = problem.momentum.size - 2
    elastic = False
    for a in range(model.restitution.shape[0]):
        for b in range(model.restitution.shape[1]):
            elastic = elastic or model.restitution[a, b] > 0.0
    elastic = elastic and method.motion == codes.DYNAMIC
    worst = 0.0
    status = codes.CONVERGED
    taken = 0
    undone = 0
    last_taken = 0.0
    earlier_taken = 0.0
    earliest_taken = 0.0  # last three steps, so that two are known after one is undone
    eventful = True  # whether it is known that something happens where the step begins
    careful = math.inf  # longest step until `careful_until`, after a step was undone
    careful_until = 0.0
    time_before = 0.0
    sample_before = 0
    rows_before = 0
    sample = write_samples(
        model, before, state, time, time, step, problem, record, 0, every_step, pace.duration
    )
    while time < pace.duration * (1.0 - 1e-12):
        if taken + undone >= method.max_steps:
            status = codes.MAX_STEPS
            break
        if time < careful_until - pace.smallest:
            step = min(step, careful)
        left = pace.duration - time
        if method.adaptive == 1:
            left = time_to_corner(model, state, time, step, left, pace.tolerance)
        trial = min(step, left)
        if method.adaptive == 1 and trial < left < 1.5 * trial:
            trial = 0.5 * left
        elif trial > left * (1.0 - 1e-9):
            trial = left
        guessed = PREDICTED
        growth = GROWTH
        unsolved = 0  # trials of this step that no solver could solve, though there was no jam
        resumed = 0.0  # the step to go on with after a bounce or a closing gap
        off = 0.0
        rate = 0.0
        predicting = True
        undo = False
        while True:
            if predicting:
                rate = predict(
                    state.middle, before.middle, n_dof, trial, last_taken, earlier_taken, guess
                )
                predicting = False
            span = 0.5 * trial if staggered else trial
            ready = prepare_step(
                model, state, method.motion, time, trial, span, method.lead * trial, guess, rows,
                problem, work, last_span,
            )  # fmt: skip
            if not ready:
                status = codes.CONTACT_OVERFLOW
                break
            if method.adaptive == 1 and guessed == PREDICTED:
                closing = closing_time(problem, guess, trial, method.lead, pace.tolerance)
                if closing < math.inf:
                    # A gap closes inside the step: end the step there, and go on as planned.
                    resumed = max(resumed, trial)
                    trial = max(closing * (1.0 - 1e-6), pace.smallest)
                    guessed = CUT
                    continue
            trials = PATIENT
            if method.adaptive == 1 and trial > pace.smallest and unsolved % INSIST != INSIST - 1:
                trials = HASTY
            while True:
                off, fell_back = solve(problem, work, guess, method.solver, method.effort, trials)
                record.count[3] += fell_back
                if not (elastic and off <= TOLERANCE and creates_energy(model, state, problem)):
                    break
            last_span = span
            if not off <= TOLERANCE:
                last_span = 0.0
                if method.adaptive == 1 and trial > pace.smallest:
                    if not locked(problem, work, guess):
                        unsolved += 1
                    trial *= 0.25
                    guessed = PREDICTED
                    predicting = True
                    continue
                if math.isinf(off):
                    status = codes.NON_FINITE
                elif locked(problem, work, guess):
                    status = codes.JAMMED
                else:
                    status = codes.MAX_ITERATIONS
                break
            if is_thrown(model, state, time, trial, problem):
                if method.adaptive == 1 and trial > pace.smallest:
                    trial *= 0.25
                    guessed = PREDICTED
                    predicting = True
                    continue
                status = codes.THROWN
                break
            if method.adaptive == 0:
                break
            if (
                elastic
                and trial > pace.smallest
                and bounces(model, state, method.motion, time, trial, problem)
            ):
                # A bounce turns the velocity round: step up to it, and take it in the smallest
                # step.
                resumed = max(resumed, trial)
                trial = max(pace.smallest, 0.25 * trial)
                guessed = PREDICTED
                predicting = True
                continue
            change = largest_change(problem, guess)
            jumped = change > JUMP * largest_speed(problem)
            if (
                not eventful
                and guessed != RENEWED
                and min(last_taken, trial) > pace.smallest
                and 0.25 * last_taken * change > EVENT * pace.tolerance
            ):
                if trial <= last_taken:
                    undo = True
                    break
                trial = last_taken
                guessed = PREDICTED
                predicting = True
                continue
            error = 0.5 * trial * change
            if rate > 0.0 and not jumped:
                error *= SECOND_ORDER
            if staggered:
                # Over the whole step velocities change twice as much as up to its middle.
                error = max(error, trial * untouched_change(problem, state.velocity))
                if jumped or guessed == RENEWED:
                    forced = trial * forced_change(problem, state.velocity)
                    if forced > pace.tolerance and trial > pace.smallest:
                        growth = 1.0
                        trial = max(pace.smallest, trial * (CAUTION * pace.tolerance / forced))
                        guessed = PREDICTED
                        predicting = True
                        continue
                    error = max(error, forced)
            if error <= pace.tolerance or trial <= pace.smallest:
                growth = min(growth, CAUTION * (pace.tolerance / max(error, 1e-30)) ** EXPONENT)
                growth = max(growth, 0.5)
                break
            if jumped:
                rate = 0.0
                for i in range(n_dof):
                    guess[i] = problem.velocity[i]
                if guessed != RENEWED:
                    # It jumped at the step's start: take the new velocity as the guess, once.
                    guessed = RENEWED
                    continue
            growth = 1.0
            trial = max(
                pace.smallest,
                trial * max(SHRINK, CAUTION * (pace.tolerance / error) ** EXPONENT),
            )
            predicting = guessed != RENEWED
            guessed = PREDICTED
        if status != codes.CONVERGED:
            break
        if undo:
            # Something happened in the last step, or since: look for it in steps half as long.
            careful = 0.5 * last_taken
            careful_until = time + careful
            step = careful
            time = time_before
            _copy_state(before, state)
            _copy_state(older, before)
            last_taken = earlier_taken
            earlier_taken = earliest_taken
            earliest_taken = 0.0
            eventful = True
            sample = sample_before
            record.count[1] = rows_before
            taken -= 1
            undone += 1
            continue
        worst = max(worst, off)
        _copy_state(before, older)
        _copy_state(state, before)
        time_before = time
        sample_before = sample
        rows_before = record.count[1]
        ahead = 0
        if staggered:
            ahead = 2 if rate > 0.0 and not jumped else 1
        move(model, state, trial, problem, ahead)
        time += trial
        taken += 1
        if method.adaptive == 1:
            earliest_taken = earlier_taken
            earlier_taken = last_taken
            cut_short = trial < step and trial >= left
            eventful = guessed == CUT or cut_short
            step = min(max(trial * growth, step if cut_short else 0.0), pace.largest)
            if resumed > 0.0 and (trial <= pace.smallest or guessed == CUT):
                step = min(resumed, pace.largest)
        last_taken = trial
        due = time + SAMPLE_SLACK * pace.duration
        if sample < record.time.size and (every_step or record.time[sample] <= due):
            sample = write_samples(
                model, before, state, time - trial, time, span, problem, record, sample,
                every_step, pace.duration,
            )  # fmt: skip
    if status != codes.CONVERGED and not every_step and taken > 0 and sample < record.time.size:
        # Keep where it stopped as the last sample.
        # Without contacts and forces: the problem holds what could not be solved.
        record.time[sample] = time
        sample = write_samples(
            model, before, state, time, time, last_taken, problem, record, sample, every_step,
            pace.duration,
        )  # fmt: skip
    record.count[0] = sample
    record.count[2] = taken
    record.total[0] = time
    record.total[1] = worst
    return status


@kernel
def time_to_corner(
    model: Model, state: State, time: float, step: float, left: float, slack: float
) -> float:
    """Return the time until a pusher's command changes, at most `left`.

    Looks half a step further than `step`, so that no sliver of a step is left over.
    """
    for d in range(model.force_limit.size):
        own = time if model.drive_dof[d] < 0 else state.path_time[d]
        ahead = min(left, 1.5 * step)
        straight = straight_time(model.path_start, model.path, d, own, ahead, slack)
        if straight < ahead:
            left = straight
    return left


@kernel
def _copy_state(source: State, target: State) -> None:
    for i in range(source.pose.shape[0]):
        for k in range(3):
            target.pose[i, k] = source.pose[i, k]
    for i in range(source.velocity.size):
        target.velocity[i] = source.velocity[i]
        target.middle[i] = source.middle[i]
    for i in range(source.path_time.size):
        target.path_time[i] = source.path_time[i]


@large_kernel
def bounces(
    model: Model, state: State, motion: int, time: float, step: float, problem: Problem
) -> bool:
    """Whether a contact with restitution is loaded in this step, and was approached."""
    if motion != codes.DYNAMIC:
        return False
    n_free = model.mass.size
    for i in range(problem.size[1]):
        a = problem.contact_body[i, 0]
        b = problem.contact_body[i, 1]
        if problem.impulse[i, 0] <= 0.0 or model.restitution[a, b] == 0.0:
            continue
        before = 0.0
        second = problem.contact_dof[i, 1]
        for k in range(3):
            before += problem.normal[i, k] * state.velocity[problem.contact_dof[i, 0] + k]
            if second >= 0:
                before += problem.normal[i, 3 + k] * state.velocity[second + k]
        d = b - n_free
        if second < 0 and d < model.force_limit.size:
            dx, dy, da, speed = path_direction(model.path_start, model.path, d, time, step)
            x, y, _ = path_pose(model.path_start, model.path, d, time)
            rx = problem.contact_place[i, 3] - x
            ry = problem.contact_place[i, 4] - y
            nx = problem.contact_place[i, 1]
            ny = problem.contact_place[i, 2]
            before -= speed * (nx * (dx - ry * da) + ny * (dy + rx * da))
        if before < -BOUNCE:
            return True
    return False


@large_kernel
def predict(
    velocity: FloatArray,
    before: FloatArray,
    n_dof: int,
    step: float,
    last: float,
    earlier: float,
    guess: FloatArray,
) -> float:
    """Write the velocity expected over the next `step`.

    On the line through the velocities of the last two steps, which lasted `last` and `earlier`;
    where they differ by a jump, or there are no two, that of the last. Returns how far along that
    line, zero for not at all.
    """
    change = 0.0
    size = 0.0
    for i in range(n_dof):
        change = max(change, abs(velocity[i] - before[i]))
        size = max(size, abs(velocity[i]), abs(before[i]))
    rate = 0.0
    if earlier > 0.0 and change < JUMP * size:
        rate = (step + last) / (last + earlier)
    for i in range(n_dof):
        guess[i] = velocity[i] + rate * (velocity[i] - before[i])
    return rate


@kernel
def largest_change(problem: Problem, guess: FloatArray) -> float:
    """Largest difference between solved and guessed velocity, over bodies and drives."""
    largest = 0.0
    v = problem.velocity
    for o in range(0, problem.size[3], 3):
        dx = v[o] - guess[o]
        dy = v[o + 1] - guess[o + 1]
        largest = max(largest, math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - guess[o + 2]))
    for o in range(problem.size[3], problem.size[0]):
        largest = max(largest, abs(v[o] - guess[o]))
    return largest


@kernel
def largest_speed(problem: Problem) -> float:
    """Largest speed of the solved velocity, over bodies and drives."""
    largest = 0.0
    v = problem.velocity
    for o in range(0, problem.size[3], 3):
        speed = math.sqrt(v[o] * v[o] + v[o + 1] * v[o + 1])
        largest = max(largest, speed + abs(v[o + 2]))
    for o in range(problem.size[3], problem.size[0]):
        largest = max(largest, abs(v[o]))
    return largest


@kernel
def is_thrown(model: Model, state: State, time: float, step: float, problem: Problem) -> bool:
    """Whether a body would move further than the step's rows are valid, without a visible cause.

    Where surfaces almost oppose each other, a body that is squeezed between them finds room only
    by turning about a lever of no length: a million times as fast as it was asked to.
    """
    fastest = largest_speed(problem)
    return step * fastest > MAX_MOTION and fastest > SUDDEN * fastest_in_sight(
        model, state, time, step, problem
    )


@large_kernel
def fastest_in_sight(
    model: Model, state: State, time: float, step: float, problem: Problem
) -> float:
    """Largest speed that bodies had, that forces give them over the step, that pushers prescribe,
    or at which overlaps are taken back."""
    fastest = RECOVERY
    for i in range(problem.size[3]):
        own = abs(state.velocity[i])
        inertia = problem.inertia[i, i % 3]
        if inertia > 0.0:
            own = max(own, abs(problem.momentum[i]) / inertia)
        fastest = max(fastest, own)
    for d in range(model.force_limit.size):
        own_time = time if model.drive_dof[d] < 0 else state.path_time[d]
        fastest = max(fastest, path_direction(model.path_start, model.path, d, own_time, step)[3])
    return fastest


@kernel
def untouched_change(problem: Problem, guess: FloatArray) -> float:
    """Largest difference as in `largest_change`, over bodies without loaded contacts only."""
    largest = 0.0
    v = problem.velocity
    for o in range(0, problem.size[3], 3):
        touched = False
        for i in range(problem.size[1]):
            if problem.impulse[i, 0] > 0.0 and (
                problem.contact_dof[i, 0] == o or problem.contact_dof[i, 1] == o
            ):
                touched = True
        if not touched:
            dx = v[o] - guess[o]
            dy = v[o + 1] - guess[o + 1]
            largest = max(largest, math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - guess[o + 2]))
    return largest


@large_kernel
def forced_change(problem: Problem, before: FloatArray) -> float:
    """Largest change of velocity over the step that forces can explain.

    A jump is over at once, and no reason for short steps. What the wrenches and the friction of
    supports may have done took time, and a step that begins with a jump has nothing to be compared
    with that would show how much.
    """
    largest = 0.0
    v = problem.velocity
    for o in range(0, problem.size[3], 3):
        dx = v[o] - before[o]
        dy = v[o + 1] - before[o + 1]
        change = math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - before[o + 2])
        if change <= largest:
            continue
        impulse = 0.0
        for k in range(o, o + 3):
            impulse += abs(problem.momentum[k] - problem.inertia[k, k - o] * before[k])
        for e in range(problem.size[2]):
            if problem.element_dof[e] == o:
                impulse += problem.element_limit[e]
        largest = max(largest, min(change, 2.0 * impulse / problem.inertia[o, 0]))
    return largest


@kernel
def closing_time(
    problem: Problem, guess: FloatArray, step: float, lead: float, least: float
) -> float:
    """When the first gap wider than `least` closes at the guessed velocity; infinite where that is
    not inside the step, or next to one of its ends."""
    earliest = math.inf
    for i in range(problem.size[1]):
        motion = 0.0
        slide = 0.0
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        spin = abs(guess[a + 2])
        arm = math.hypot(problem.normal[i, 2], problem.tangent[i, 2])
        for k in range(3):
            motion += problem.normal[i, k] * guess[a + k]
            slide += problem.tangent[i, k] * guess[a + k]
            if b >= 0:
                motion += problem.normal[i, 3 + k] * guess[b + k]
                slide += problem.tangent[i, 3 + k] * guess[b + k]
        if 0 <= b < problem.size[3]:
            spin += abs(guess[b + 2])
            arm += math.hypot(problem.normal[i, 5], problem.tangent[i, 5])
        # bias is the gap at the step's end, over the step, were the bodies to stand still.
        end = step * (motion + problem.bias[i, 0])
        gap = problem.contact_place[i, 0]
        rate = (gap - end) / ((1.0 - lead) * step)
        start = gap + lead * step * rate
        # Of the way from the start to the rows, what bends away from a line.
        bent = 0.5 * (lead * step) ** 2 * spin * (spin * arm + 2.0 * abs(slide))
        if rate > 0.0 and start > least + bent:
            earliest = min(earliest, start / rate)
    return earliest if 0.02 * step < earliest < 0.98 * step else math.inf


@large_kernel
def write_samples(
    model: Model,
    before: State,
    state: State,
    from_time: float,
    to_time: float,
    span: float,
    problem: Problem,
    record: RolloutRecord,
    sample: int,
    every_step: bool,
    duration: float,
) -> int:
    """Write the samples that fall in (from_time, to_time]; returns the next one to write.

    `span` is the time over which the impulses of the step acted.
    """
    n_free = model.mass.size
    n_driven = model.force_limit.size
    while sample < record.pose.shape[0]:
        if every_step:
            record.time[sample] = to_time
            share = 1.0
        else:
            if record.time[sample] > to_time + SAMPLE_SLACK * duration:
                break
            share = 1.0
            if to_time > from_time:
                share = min(1.0, (record.time[sample] - from_time) / (to_time - from_time))
        for b in range(n_free):
            for k in range(3):
                old = before.pose[b, k]
                record.pose[sample, b, k] = old + share * (state.pose[b, k] - old)
                record.twist[sample, b, k] = state.velocity[3 * b + k]
        for d in range(n_driven):
            _sample_driven(
                model, before, state, from_time, to_time, span, problem, record, sample, d, share
            )
        if to_time > from_time:
            _sample_contacts(before.velocity, problem, record, sample, to_time - from_time, span)
        sample += 1
        if every_step:
            break
    return sample


@kernel
def _sample_driven(
    model: Model,
    before: State,
    state: State,
    from_time: float,
    to_time: float,
    span: float,
    problem: Problem,
    record: RolloutRecord,
    sample: int,
    d: int,
    share: float,
) -> None:
    n_free = model.mass.size
    row = n_free + d
    own = from_time + share * (to_time - from_time)
    own_start = from_time
    step = to_time - from_time if to_time > from_time else span
    limited = model.drive_dof[d] >= 0
    if limited:
        own = before.path_time[d] + share * (state.path_time[d] - before.path_time[d])
        own_start = before.path_time[d]
    x, y, a = path_pose(model.path_start, model.path, d, own)
    record.pose[sample, row, 0] = x
    record.pose[sample, row, 1] = y
    record.pose[sample, row, 2] = a
    dx, dy, da, command = path_direction(model.path_start, model.path, d, own_start, step)
    speed = state.velocity[model.drive_dof[d]] if limited else command
    record.twist[sample, row, 0] = speed * dx
    record.twist[sample, row, 1] = speed * dy
    record.twist[sample, row, 2] = speed * da
    force = 0.0
    if to_time > from_time:
        for i in range(problem.size[1]):
            if problem.contact_body[i, 1] == row:
                nx = problem.contact_place[i, 1]
                ny = problem.contact_place[i, 2]
                pn = problem.impulse[i, 0]
                pt = problem.impulse[i, 1]
                fx = pn * nx - pt * ny
                fy = pn * ny + pt * nx
                rx = problem.contact_place[i, 3] - x
                ry = problem.contact_place[i, 4] - y
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
        if 0 <= o < problem.size[3]:
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
    sample: int,
    step: float,
    span: float,
) -> None:
    """Write the contacts of a step: force times step is the impulse of the whole step.

    `velocity` is that at its start. Forces act on after `span`; an impact acts once.
    """
    for i in range(problem.size[1]):
        row = record.count[1]
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
        record.contact[row, 0] = sample
        record.contact[row, 1] = problem.contact_body[i, 0]
        record.contact[row, 2] = problem.contact_body[i, 1]
        record.contact[row, 3] = gap
        for k in range(4):
            record.contact[row, 4 + k] = problem.contact_place[i, 1 + k]
        record.contact[row, 8] = problem.impulse[i, 0] / acted
        record.contact[row, 9] = problem.impulse[i, 1] / acted
        record.contact[row, 10] = step
        record.count[1] += 1
