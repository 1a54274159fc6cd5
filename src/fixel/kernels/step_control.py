"""Control of the steps: how long a step is, the velocity expected over it, whether it is taken.

The compiled loop (`rollout.py`) and the plain one (`simulation/plain.py`) call these functions, so
that nothing is decided twice. docs/theory/stepping.md explains the rules.
"""

import math

from fixel.kernels import arrays as at, codes
from fixel.kernels.arrays import Model, Problem, State, Workspace
from fixel.kernels.gap import FEATURES
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.path import path_direction, path_pose, straight_time
from fixel.kernels.solve import STILL_VELOCITY
from fixel.kernels.step import CROWD, RECOVERY, sweep_speed
from fixel.typing import FloatArray

GROWTH_LIMIT = 10.0  # the step grows at most so much from one step to the next
SHRINK = 0.3  # and shrinks at most so much after a rejection
CAUTION = 0.8  # aim at this part of the tolerance
EVENT = 4.0  # tolerances: where something happens, inside a step, need not be known better
JUMP = 0.1  # of the velocity: a change from step to step that is no smooth motion's
ON_LINE = 0.5  # of a change: one that a line through the velocities before misses by less is smooth
# Of the change from a velocity expected on a line, times half the step: what a second-order step is
# wrong by. A twelfth for equal steps; twice that to be safe.
SECOND_ORDER = 1.0 / 6.0
# Where the expected velocity of a trial comes from.
PREDICTED = 0  # the steps before
CUT = 1  # the same, for a step that ends where contacts change
RENEWED = 2  # the solution of the same trial, which begins with a jump
APPROACH = 3  # as for CUT, for a step that ends shortly before
INSIST = 3  # every third unsolved trial of a step is not given up early; jams are not counted
AT_ONCE = 2.0  # of GIVE_UP_EARLY: where Newton does not converge from the step before
HASTY = 5e-3  # of the longest step: shorter trials are not given up at once
EXPONENT = 0.35  # of the change of step with the error's: nearly third order
# Of the time in which forces move a body by the tolerance: the first step with a closed gap.
CLOSED = 0.7
FIRST = 30.0  # tolerances that bodies move, at most, in the first step after contacts change
AFTER_IMPACT = 4.0  # the step grows at most so much after one where a contact closed
FEW = 12  # unknowns up to which that is done: in heaps contacts change all the time, mostly unfelt
AIM = 0.1  # of the tolerance: gap left where a step of bodies with inertia ends at its closing
BOUNCE = 1e-4  # of the characteristic speed: approaches slower than this need no step of their own
MAX_MOTION = (
    1.0  # characteristic length, or radian: a step that moves a body further is out of its depth
)
LONG = 0.1  # of the longest step: a step after which nothing will move, if nothing has
SUDDEN = 3.0  # times the fastest motion in sight, which a step looks ahead for; see step._margin


@kernel
def begin_control(
    control: FloatArray, settings: FloatArray, adaptive: bool, inertial: bool
) -> None:
    """Write the control of a rollout at time zero into zeros."""
    for i in range(at.N_SETTING):
        control[i] = settings[i]
    control[at.STEP] = min(control[at.STEP], control[at.DURATION])
    control[at.ADAPTIVE] = 1.0 if adaptive else 0.0
    control[at.INERTIAL] = 1.0 if inertial else 0.0
    control[at.STAGGERED] = 1.0 if adaptive and inertial else 0.0
    control[at.EVENTFUL] = 1.0


@kernel
def limit_step(model: Model, state: State, control: FloatArray) -> None:
    """Begin a step: how long it may be, at most."""
    if control[at.TIME] < control[at.CAREFUL_UNTIL] - control[at.SMALLEST]:
        control[at.STEP] = min(control[at.STEP], control[at.CAREFUL])
    control[at.LEFT] = control[at.DURATION] - control[at.TIME]
    if control[at.ADAPTIVE] == 1.0:
        control[at.LEFT] = time_to_corner(model, state, control)
        ahead = min(control[at.STEP], control[at.LEFT])
        swept = sweep_speed(model, state, control[at.TIME], ahead)
        if swept > 0.0:
            longest = max(MAX_MOTION / swept, control[at.SMALLEST])
            control[at.STEP] = min(control[at.STEP], longest)


@kernel
def choose_trial(control: FloatArray) -> None:
    """Choose the first trial of a step, from the proposed length and the time that is left."""
    left = control[at.LEFT]
    trial = min(control[at.STEP], left)
    if control[at.ADAPTIVE] == 1.0 and trial < left < 1.5 * trial:
        trial = 0.5 * left
    elif trial > left * (1.0 - 1e-9):
        trial = left
    control[at.RATE] = 0.0
    control[at.UNSOLVED] = 0.0
    control[at.GROWTH] = GROWTH_LIMIT
    control[at.RESUMED] = 0.0
    control[at.SMOOTH] = 0.0
    _try_next(control, trial, PREDICTED, True)


@kernel
def _try_next(control: FloatArray, trial: float, guessed: int, predicting: bool) -> int:
    """Set the next trial; returns RETRY."""
    adaptive = control[at.ADAPTIVE] == 1.0
    control[at.TRIAL] = trial
    control[at.GUESSED] = guessed
    control[at.PREDICTING] = 1.0 if predicting else 0.0
    control[at.CLOSING] = math.inf
    control[at.BOUNCES] = 0.0
    control[at.PARTED] = 0.0
    looks = adaptive and guessed != CUT and guessed != RENEWED
    control[at.MIN_GAP] = (
        control[at.TOLERANCE] if looks and trial > control[at.SMALLEST] else math.inf
    )
    insisting = control[at.UNSOLVED] % INSIST == INSIST - 1
    control[at.GIVE_UP_EARLY] = (
        1.0 if adaptive and trial > control[at.SMALLEST] and not insisting else 0.0
    )
    return codes.RETRY


@kernel
def start_trial(control: FloatArray, state: State, step: float, lead: float) -> None:
    """Set how a trial of this length is prepared: rows taken `lead` of it after its start."""
    span = state.owed[0] + 0.5 * step if control[at.STAGGERED] == 1.0 else step
    control[at.TRIAL] = step
    control[at.LEAD] = lead * step
    control[at.SPAN] = span
    control[at.RATIO] = span / control[at.LAST_SPAN] if control[at.LAST_SPAN] > 0.0 else 0.0


@kernel
def predict_velocity(
    control: FloatArray,
    velocity: FloatArray,
    before: FloatArray,
    older: FloatArray,
    guess: FloatArray,
) -> None:
    """Write the velocity expected over the trial, unless the guess is to stay.

    On the line through the velocities of the last two steps; where they differ by a jump, or there
    are no two, that of the last. A large change is no jump if the line through the two velocities
    before led to it, as it does when a drive stalls.
    """
    n_dof = guess.size - 2
    if (
        control[at.STAGGERED] == 1.0
        and control[at.GIVE_UP_EARLY] > 0.0
        and control[at.UNSOLVED] == 0.0
        and control[at.EVENTFUL] == 0.0
        and control[at.GUESSED] != RENEWED
        and control[at.TRIAL] > HASTY * control[at.LARGEST]
        and n_dof <= FEW
    ):
        # Nothing is known to happen. If Newton fails, something does inside the step, and most
        # solutions would be rejected.
        control[at.GIVE_UP_EARLY] = AT_ONCE
    if control[at.PREDICTING] == 0.0:
        return
    control[at.PREDICTING] = 0.0
    last = control[at.LAST]
    earlier = control[at.EARLIER]
    earliest = control[at.EARLIEST]
    ahead = (last + earlier) / (earlier + earliest) if earliest > 0.0 else 0.0
    change = 0.0
    size = 0.0
    bend = 0.0
    for i in range(n_dof):
        step = velocity[i] - before[i]
        change = max(change, abs(step))
        bend = max(bend, abs(step - ahead * (before[i] - older[i])))
        size = max(size, abs(velocity[i]), abs(before[i]))
    rate = 0.0
    smooth = change < JUMP * size or (earliest > 0.0 and bend < ON_LINE * change)
    if control[at.ADAPTIVE] == 1.0 and earlier > 0.0 and smooth:
        rate = (control[at.TRIAL] + last) / (last + earlier)
    for i in range(n_dof):
        guess[i] = velocity[i] + rate * (velocity[i] - before[i])
    control[at.RATE] = rate


@kernel
def judge_step(
    control: FloatArray,
    problem: Problem,
    guess: FloatArray,
    velocity: FloatArray,
    status: int,
    residual: float,
) -> int:
    """Judge a trial: CONVERGED to take it, UNDO to take the last step back, RETRY with another
    trial, else the status with which the rollout ends.

    Parameters
    ----------
    control : FloatArray
        In: `CLOSING`, `BOUNCES` and `PARTED` of the trial. Out: the next trial or the next step.
    problem : Problem
        With the solution of the trial.
    guess : FloatArray
        The velocity that was expected; the one to expect next, after a jump.
    velocity : FloatArray
        Velocity where the step begins.
    status : int
        Of the trial: CONVERGED, CONTACT_OVERFLOW, JAMMED (unsolved, may have no solution),
        MAX_ITERATIONS or NON_FINITE (unsolved), or THROWN.
    residual : float
        Of the trial.
    """
    trial = control[at.TRIAL]
    smallest = control[at.SMALLEST]
    tolerance = control[at.TOLERANCE]
    adaptive = control[at.ADAPTIVE] == 1.0
    renewed = control[at.GUESSED] == RENEWED
    if status == codes.CONTACT_OVERFLOW:
        return status
    if control[at.CLOSING] < 0.0:
        return _try_next(control, max(smallest, -control[at.CLOSING]), PREDICTED, True)
    if control[at.CLOSING] < math.inf:
        # Contacts change inside the step: end the step there, and go on as planned.
        control[at.RESUMED] = max(control[at.RESUMED], trial)
        time = control[at.CLOSING] * (1.0 - 1e-6)
        near = FIRST * tolerance / max(1.0, largest_speed(problem))
        if time > 4.0 * near and problem.size[at.N_DOF] <= FEW:
            # What else happens before shows in the next step, as after any other.
            return _try_next(control, time - near, APPROACH, False)
        return _try_next(control, max(time, smallest), CUT, False)
    if status != codes.CONVERGED:
        if not (adaptive and trial > smallest):
            return codes.NON_FINITE if math.isinf(residual) and status == codes.JAMMED else status
        if status != codes.JAMMED and status != codes.THROWN:
            control[at.UNSOLVED] += INSIST if control[at.GIVE_UP_EARLY] == AT_ONCE else 1.0
        return _try_next(control, 0.25 * trial, PREDICTED, True)
    if not adaptive:
        return codes.CONVERGED
    if control[at.BOUNCES] == 1.0 and trial > smallest:
        # A bounce turns the velocity round: step up to it, and take it in the smallest step.
        control[at.RESUMED] = max(control[at.RESUMED], trial)
        return _try_next(control, max(smallest, 0.25 * trial), PREDICTED, True)
    change = largest_change(problem, guess)
    jumped = change > JUMP * largest_speed(problem)
    if not renewed and missed_event(control, change):
        # In a trial half as long the change is less if the motion only bends, not after an event.
        half = max(smallest, 0.5 * control[at.LAST])
        if trial <= half or control[at.PARTED] == 1.0:
            return codes.UNDO
        return _try_next(control, half, PREDICTED, True)
    error = 0.5 * trial * change
    smooth = control[at.RATE] > 0.0 and not jumped
    if smooth:
        error *= SECOND_ORDER
    if control[at.STAGGERED] == 1.0:
        # Over the whole step velocities change twice as much as up to its middle.
        error = max(error, trial * untouched_change(problem, velocity))
        if jumped or renewed:
            forced, most = forced_change(problem, velocity)
            forced *= trial
            if forced > tolerance and trial > smallest:
                # What forces can do falls with the step too.
                shrink = max(
                    CAUTION * tolerance / forced, math.sqrt(CAUTION * tolerance / (trial * most))
                )
                return _try_next(control, max(smallest, trial * shrink), PREDICTED, True)
            error = max(error, forced)
    if error <= tolerance or trial <= smallest:
        control[at.SMOOTH] = 1.0 if smooth else 0.0
        propose_step(control, problem, velocity, error)
        return codes.CONVERGED
    if jumped:
        control[at.RATE] = 0.0
        for i in range(guess.size - 2):
            guess[i] = problem.velocity[i]
        if not renewed:
            # It jumped at the step's start: take the new velocity as the guess, once.
            return _try_next(control, trial, RENEWED, False)
    control[at.GROWTH] = 1.0
    shrink = max(SHRINK, CAUTION * (tolerance / error) ** EXPONENT)
    return _try_next(control, max(smallest, trial * shrink), PREDICTED, not renewed)


@kernel
def missed_event(control: FloatArray, change: float) -> bool:
    """Whether the velocity changed by `change` where nothing is known to happen, and the last step
    can be taken back."""
    last = control[at.LAST]
    trial = control[at.TRIAL]
    if control[at.EVENTFUL] == 1.0 or min(last, trial) <= control[at.SMALLEST]:
        return False
    wrong = 0.25 * last * change
    if control[at.PARTED] == 0.0:
        return wrong > EVENT * control[at.TOLERANCE]
    # Forces changed the velocity since the contact came off, somewhere in the last step.
    return wrong * (last / trial if control[at.STAGGERED] == 1.0 else 1.0) > control[at.TOLERANCE]


@kernel
def propose_step(control: FloatArray, problem: Problem, velocity: FloatArray, error: float) -> None:
    """Propose the length of the step after one that is taken with this error."""
    trial = control[at.TRIAL]
    was_cut = control[at.GUESSED] == CUT
    growth = CAUTION * (control[at.TOLERANCE] / max(error, 1e-30)) ** EXPONENT
    following = trial * max(0.5, min(control[at.GROWTH], growth))
    if control[at.EVENTFUL] == 1.0 and control[at.STAGGERED] == 1.0:
        # An impact leaves the velocity that closed the last gap. Half way through the next step
        # that is an overlap, by which the levers of its impulses are wrong.
        following = min(following, AFTER_IMPACT * trial)
    cut_short = trial < control[at.STEP] and trial >= control[at.LEFT]
    if cut_short:
        following = max(following, control[at.STEP])
    first = FIRST * control[at.TOLERANCE] / max(1.0, largest_speed(problem))
    if control[at.GUESSED] == APPROACH:
        following = 2.0 * first
    elif control[at.RESUMED] > 0.0 and (trial <= control[at.SMALLEST] or was_cut):
        following = control[at.RESUMED]
    if was_cut and problem.size[at.N_DOF] <= FEW:
        # Half way through a longer step another contact may have taken its place, or none.
        following = min(following, first)
        if control[at.STAGGERED] == 1.0:
            # The contact acts at once, then forces do: as in `judge_step`, but before any trial.
            following = min(following, EVENT / FIRST * first)
            _, most = forced_change(problem, velocity)
            following = min(following, CLOSED * math.sqrt(control[at.TOLERANCE] * trial / most))
    control[at.STEP] = min(following, control[at.LARGEST])
    control[at.EVENTFUL] = 1.0 if was_cut or cut_short else 0.0


@kernel
def extrapolation(control: FloatArray) -> int:
    """Return how `step.move` extrapolates velocities: 0 for not at all, 2 where they changed
    smoothly, else 1."""
    if control[at.STAGGERED] == 0.0:
        return 0
    return 2 if control[at.SMOOTH] == 1.0 else 1


@kernel
def end_step(control: FloatArray) -> None:
    """Go on to the end of the step that is taken."""
    control[at.TIME_BEFORE] = control[at.TIME]
    control[at.EARLIEST] = control[at.EARLIER]
    control[at.EARLIER] = control[at.LAST]
    control[at.LAST] = control[at.TRIAL]
    control[at.TIME] += control[at.TRIAL]
    control[at.STEPS] += 1.0


@kernel
def take_back(control: FloatArray) -> None:
    """Go back to the start of the last step, to look in steps half as long for what happened there,
    or since."""
    control[at.CAREFUL] = 0.5 * control[at.LAST]
    control[at.CAREFUL_UNTIL] = control[at.TIME] + control[at.CAREFUL]
    control[at.STEP] = control[at.CAREFUL]
    control[at.TIME] = control[at.TIME_BEFORE]
    control[at.LAST] = control[at.EARLIER]
    control[at.EARLIER] = control[at.EARLIEST]
    control[at.EARLIEST] = 0.0
    control[at.EVENTFUL] = 1.0
    control[at.STEPS] -= 1.0
    control[at.UNDONE] += 1.0


@kernel
def time_to_corner(model: Model, state: State, control: FloatArray) -> float:
    """Return the time until a pusher's command changes, at most what is left.

    Looks half a step further than the proposed step, so that no sliver of a step is left over.
    """
    left = control[at.LEFT]
    for d in range(model.force_limit.size):
        own = control[at.TIME] if model.drive_dof[d] < 0 else state.path_time[d]
        ahead = min(left, 1.5 * control[at.STEP])
        straight = straight_time(model.path_start, model.path, d, own, ahead, control[at.TOLERANCE])
        if straight < ahead:
            left = straight
    return left


@kernel
def event_time(
    problem: Problem, guess: FloatArray, step: float, lead: float, min_gap: float
) -> float:
    """Time at which, at the guessed velocity, contacts first change inside the step; else infinite.

    They change where a gap wider than `min_gap` closes, and where a vertex that presses reaches an
    end of its edge. Changes after a shorter way than `min_gap` do not count. Where one body may
    have passed another, minus the length of a step that is worth another look.
    """
    earliest = math.inf
    few = problem.size[at.N_DOF] <= FEW
    for i in range(problem.size[at.N_CONTACT]):
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        motion = 0.0
        slide = 0.0
        for k in range(3):
            motion += problem.normal[i, k] * guess[a + k]
            slide += problem.tangent[i, k] * guess[a + k]
            if b >= 0:
                motion += problem.normal[i, 3 + k] * guess[b + k]
                slide += problem.tangent[i, 3 + k] * guess[b + k]
        if few and problem.impulse[i, 0] > 0.0:
            earliest = min(earliest, _leaving_time(problem, i, slide, step, lead, min_gap))
        given_back = problem.contact_place[i, at.GIVEN_BACK]
        normal_bias = problem.bias[i, 0] - given_back
        # The gap at both ends of the step and where the rows are taken give a parabola.
        start = step * (normal_bias - problem.contact_place[i, at.DRIVEN_NORMAL])
        end = step * (motion + normal_bias)
        gap = problem.contact_place[i, at.GAP]
        speed = math.hypot(
            motion + problem.contact_place[i, at.DRIVEN_NORMAL], slide + problem.bias[i, 1]
        )
        ahead = lead * step
        looks_back = few or ahead * speed > MAX_MOTION
        if (start <= min_gap and not looks_back) or (end > 0.0 and lead == 0.0):
            continue
        spin = abs(guess[a + 2])
        along, across = problem.normal[i, 2], problem.tangent[i, 2]
        arm = math.sqrt(along * along + across * across)
        if 0 <= b < problem.size[at.N_FREE_DOF]:
            spin += abs(guess[b + 2])
            along, across = problem.normal[i, 5], problem.tangent[i, 5]
            arm += math.sqrt(along * along + across * across)
        # Of the third order, what bends away from the parabola.
        bent = 0.5 * (ahead * (ahead * ahead)) * spin * spin * (spin * arm + 2.0 * abs(slide))
        deep = problem.contact_place[i, at.OVERLAP] - start
        looks_back = looks_back and problem.impulse[i, 0] <= 0.0
        if looks_back and EVENT * min_gap + bent < deep < ahead * speed:
            # From its far side, a path through a corner or past it looks like an overlap at the
            # step's start. There was none, if since then the bodies have moved farther.
            return -0.5 * step
        if start <= min_gap + bent:
            continue
        curve = 0.0
        if lead > 0.0:
            curve = (start + lead * (end - start) - gap) / (ahead * (step - ahead))
        slope = (end - start) / step - curve * step
        if end > 0.0 and (slope >= 0.0 or slope * slope <= 4.0 * curve * (start + min_gap)):
            continue  # nor does it graze by more than the tolerance
        if problem.inertia[a, 0] > 0.0:
            start -= AIM * min_gap
        root = math.sqrt(max(0.0, slope * slope - 4.0 * curve * start))
        if root > slope:
            earliest = min(earliest, 2.0 * start / (root - slope))
    return earliest if earliest < step else math.inf


@kernel
def _leaving_time(
    problem: Problem, i: int, slide: float, step: float, lead: float, min_gap: float
) -> float:
    """Time at which a vertex that presses reaches an end of its edge, or did where it is on the
    next edge half way through the step; infinite for never, and where another contact of its pair
    presses."""
    slide += problem.bias[i, 1]
    if abs(slide) * step <= min_gap:
        return math.inf
    for k in range(max(0, i - 1), min(problem.size[at.N_CONTACT], i + 2)):
        pair = problem.contact_key[k] // FEATURES
        if k != i and pair == problem.contact_key[i] // FEATURES and problem.impulse[k, 0] > 0.0:
            return math.inf
    behind = problem.contact_place[i, at.TO_START if slide > 0.0 else at.TO_END] / abs(slide)
    left = problem.contact_place[i, at.TO_END if slide > 0.0 else at.TO_START] / abs(slide)
    shortest = min_gap / abs(slide)
    time = lead * step - behind
    if not time > shortest:
        time = lead * step + left
    return time if time > shortest else math.inf


@large_kernel
def bounces(model: Model, state: State, control: FloatArray, problem: Problem) -> bool:
    """Whether a contact with restitution is loaded in this step, and was approached."""
    if control[at.INERTIAL] == 0.0:
        return False
    time = control[at.TIME]
    step = control[at.TRIAL]
    n_free = model.mass.size
    for i in range(problem.size[at.N_CONTACT]):
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
            rx = problem.contact_place[i, at.POINT_X] - x
            ry = problem.contact_place[i, at.POINT_Y] - y
            nx = problem.contact_place[i, at.NORMAL_X]
            ny = problem.contact_place[i, at.NORMAL_Y]
            before -= speed * (nx * (dx - ry * da) + ny * (dy + rx * da))
        if before < -BOUNCE:
            return True
    return False


@kernel
def parts(control: FloatArray, problem: Problem, work: Workspace) -> bool:
    """Whether a pair of pieces that pressed on each other in the last step taken no longer does;
    never among many bodies, where contacts come off all the time."""
    if problem.size[at.N_DOF] > FEW:
        return False
    k = 0
    n = problem.size[at.N_CONTACT]
    pressed = -1  # pair that does press in this step
    for i in range(int(control[at.TAKEN_CONTACTS])):
        if work.old_impulse[i, 0] <= 0.0:
            continue
        pair = work.old_key[i] // FEATURES
        while k < n and problem.contact_key[k] // FEATURES <= pair:
            if problem.impulse[k, 0] > 0.0:
                pressed = problem.contact_key[k] // FEATURES
            k += 1
        if pressed != pair:
            return True
    return False


@kernel
def rests(model: Model, before: State, state: State, control: FloatArray, problem: Problem) -> bool:
    """Whether nothing moved in the step just taken, nor will until the end.

    Bodies and drives rest at both ends of the step as at its middle, and the step is long enough
    for any force to show; no pusher moves by its path, unless it stalls.
    """
    left = control[at.DURATION] - control[at.TIME]
    if (
        control[at.ADAPTIVE] == 0.0
        or control[at.LAST] < LONG * control[at.LARGEST]
        or left < control[at.LAST]
    ):
        return False
    for i in range(problem.size[at.N_DOF]):
        ends = max(abs(before.velocity[i]), abs(state.velocity[i]))
        if max(ends, abs(problem.velocity[i])) > STILL_VELOCITY:
            return False
    for d in range(model.force_limit.size):
        own = control[at.TIME] if model.drive_dof[d] < 0 else state.path_time[d]
        stalls = False
        for e in range(problem.size[at.N_ELEMENT]):
            if problem.element_dof[e] == model.drive_dof[d]:
                stalls = problem.element_bias[e, 0] < 0.0
        if not (stalls or own >= model.path[model.path_start[d + 1] - 1, 0]):
            return False
    return True


@kernel
def end_at_rest(control: FloatArray) -> float:
    """Go to the end in one step that moves nothing; returns its length."""
    left = control[at.DURATION] - control[at.TIME]
    control[at.TIME] = control[at.DURATION]
    control[at.STEPS] += 1.0
    return left


@kernel
def is_thrown(model: Model, state: State, control: FloatArray, problem: Problem) -> bool:
    """Whether a body would move further than the step's rows are valid, without a visible cause.

    Where surfaces almost oppose each other, a body that is squeezed between them finds room only
    by turning about a lever of no length: a million times as fast as it was asked to.
    """
    time = control[at.TIME]
    step = control[at.TRIAL]
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
    for i in range(problem.size[at.N_FREE_DOF]):
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
def largest_change(problem: Problem, guess: FloatArray) -> float:
    """Largest difference between solved and guessed velocity, over bodies and drives; of many
    bodies at most what `CROWD` of them would have if the others had none."""
    largest = squares = 0.0
    v = problem.velocity
    for o in range(0, problem.size[at.N_FREE_DOF], 3):
        dx = v[o] - guess[o]
        dy = v[o + 1] - guess[o + 1]
        change = math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - guess[o + 2])
        largest = max(largest, change)
        squares += change * change
    largest = _of_crowd(problem, largest, squares)
    for o in range(problem.size[at.N_FREE_DOF], problem.size[at.N_DOF]):
        largest = max(largest, abs(v[o] - guess[o]))
    return largest


@kernel
def _of_crowd(problem: Problem, largest: float, squares: float) -> float:
    """Limit a largest change to that of a crowd with this sum of squares."""
    n = problem.size[at.N_FREE_DOF] // 3
    return min(largest, math.sqrt(CROWD * squares / n)) if n > CROWD else largest


@kernel
def largest_speed(problem: Problem) -> float:
    """Largest speed of the solved velocity, over bodies and drives."""
    largest = 0.0
    v = problem.velocity
    for o in range(0, problem.size[at.N_FREE_DOF], 3):
        speed = math.sqrt(v[o] * v[o] + v[o + 1] * v[o + 1])
        largest = max(largest, speed + abs(v[o + 2]))
    for o in range(problem.size[at.N_FREE_DOF], problem.size[at.N_DOF]):
        largest = max(largest, abs(v[o]))
    return largest


@kernel
def untouched_change(problem: Problem, guess: FloatArray) -> float:
    """Largest difference as in `largest_change`, over bodies without loaded contacts only."""
    largest = squares = 0.0
    v = problem.velocity
    touched = problem.stiffness  # of this step; from here on only the first of each body counts
    for o in range(0, problem.size[at.N_FREE_DOF], 3):
        touched[o + 2] = 0.0
    for i in range(problem.size[at.N_CONTACT]):
        for side in range(2):
            o = problem.contact_dof[i, side]
            if problem.impulse[i, 0] > 0.0 and 0 <= o < problem.size[at.N_FREE_DOF]:
                touched[o + 2] = 1.0
    for o in range(0, problem.size[at.N_FREE_DOF], 3):
        dx = v[o] - guess[o]
        dy = v[o + 1] - guess[o + 1]
        change = math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - guess[o + 2])
        if touched[o + 2] == 0.0:
            largest = max(largest, change)
            squares += change * change
    return _of_crowd(problem, largest, squares)


@large_kernel
def forced_change(problem: Problem, before: FloatArray) -> tuple[float, float]:
    """Largest change of velocity over the step that forces can explain, and that they can cause.

    A jump is over at once, and no reason for short steps. What the wrenches and the friction of
    supports may have done took time, and a step that begins with a jump has nothing to be compared
    with that would show how much.
    """
    largest = 0.0
    most = 1e-30
    v = problem.velocity
    e = 0  # elements are in the order of the bodies
    for o in range(0, problem.size[at.N_FREE_DOF], 3):
        dx = v[o] - before[o]
        dy = v[o + 1] - before[o + 1]
        change = math.sqrt(dx * dx + dy * dy) + abs(v[o + 2] - before[o + 2])
        impulse = 0.0
        for k in range(o, o + 3):
            impulse += abs(problem.momentum[k] - problem.inertia[k, k - o] * before[k])
        while e < problem.size[at.N_ELEMENT] and problem.element_dof[e] == o:
            impulse += problem.element_limit[e]
            e += 1
        caused = 2.0 * impulse / problem.inertia[o, 0]
        most = max(most, caused)
        largest = max(largest, min(change, caused))
    return largest, most
