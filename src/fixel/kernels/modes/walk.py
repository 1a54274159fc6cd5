"""Integration of quasi-static motion from mode to mode.

Within a mode: Dormand and Prince's method of order 5(4) with its continuous extension. The end of a
mode is the root of a margin, bracketed. The solver of the stepper proposes the next mode from its
solution a little ahead; the mode must then hold there. Where none does, the rollout is lost, with
the reason. docs/theory/modes.md.
"""

import math
from typing import NamedTuple

import numpy as np

from fixel.kernels import arrays as at
from fixel.kernels.arrays import Batch, Model, Problem, State, StepMethod, Workspace
from fixel.kernels.jit import allocating_kernel, entry, kernel, large_kernel
from fixel.kernels.modes.equation import seed, solve_mode
from fixel.kernels.modes.geometry import (
    CLOCK_END,
    DRIVE,
    DURATION,
    MOST,
    N_CLOSED,
    N_MARGIN,
    OPEN,
    OWN,
    PART_REACH,
    PIVOT,
    POLE,
    PUSHER_SPEED,
    ROWS,
    SPEED,
    STEP_LENGTH,
    SUPPORT,
    ContactMode,
    GapArrays,
    empty_mode,
    gap_arrays,
    measure,
    open_gap,
    place_mode,
    set_motion,
)
from fixel.kernels.modes.proposal import (
    RESTS,
    SLIDES,
    STALLS,
    UNKNOWN,
    enter,
    propose,
    read_mode,
    settle,
)
from fixel.kernels.rollout import allocate, begin, select
from fixel.typing import FloatArray, IntArray

# How a rollout ended.
STALLED = -1
COMPLETE = 0
UNSUITED = 1  # not one free part under one pusher, or with what the modes do not describe
NO_MODE = 2  # the proposed mode does not hold
CHATTER = 3  # too many modes
FOLD = 4  # a mode ended where none of its margins did

AHEAD = 1e-6  # how far ahead the next mode is looked for
AFTER_FOLD = 1e-4
FARTHEST = 1e-3  # where none holds nearer
ACCURACY = 1e-7  # of a step
MODE_ROOM = 200  # rows of a tape for one rollout
STEP_ROOM = 1000
LONGEST = 0.3
SHORTEST = 1e-8
FLOOR = 1e-9  # by which a margin that begins at zero may fall
GROWN = 1e-7  # a margin above this is no longer taken for one that begins at zero
MOST_MODES = 400
MOST_FOLDS = 4
INSIDE = 8  # states inside a step that are looked at where something may happen
FIRST_WAIT = 1e-5  # of the clock, where a gap is too narrow for its width to matter
LAST_WAIT = 4e-3
NARROW = 1e-6
FIRST_STEP = 0.05
# Entries of the counts.
MODES = 0
STEPS = 1
FOLDS = 2
SUDDEN = 3  # 1 where the drive stalls at once as a mode ends
MODE_AT = 4  # place of the first on the tape
STEP_AT = 5
ROOT = 1e-12
TOUCH = 1e-10  # gap that closes

# How a mode ended, where none of its margins did.
CLOCK_RAN_OUT = -1
FOLDED = -2  # it has no solution any more
# Columns of `Tape.mode`.
BEGIN = 0
KIND = 1
CLOSED = 2
STICKING = 3
EVENT = 4
CONTACTS = 5
POSE = CONTACTS + 6 * MOST
MODE_WIDE = POSE + 3
# Columns of `Tape.step`.
OF_MODE = 0
START = 1
LENGTH = 2
PART = 3  # of the step, to the end of its mode
FROM = 4
TO = 7
SLOPES = 10
UNKNOWNS = 31
AROUND = 40
STEP_WIDE = 41


class Tape(NamedTuple):
    """Modes and steps of one rollout after the other, as far as there is room for each."""

    mode: FloatArray  # (n, MODE_WIDE)
    step: FloatArray  # (n, STEP_WIDE)


class ModeRecord(NamedTuple):
    """Ends and counts of a batch of rollouts."""

    status: IntArray  # (n,) see COMPLETE
    end: FloatArray  # (n, 4) pose, and the pusher's clock
    count: IntArray  # type: ignore[assignment]  # (n, 6) see MODES


_A = np.array(
    [
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_C = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_R = np.array([0.0, 1 / 2, 5.0, 8 / 45, 5 / 4, 0.0])  # spans of `_C`, each over the one before
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
_D = np.array(
    [
        -12715105075 / 11282082432,
        0,
        87487479700 / 32700410799,
        -10690763975 / 1880347072,
        701980252875 / 199316789632,
        -1453857185 / 822651844,
        69997945 / 29380423,
    ]
)


@kernel
def suits(model: Model) -> bool:
    """Whether the modes describe a model: one free part and one pusher, on an even plane."""
    if model.mass.size != 1 or model.force_limit.size != 1 or model.sides != 0:
        return False
    if model.plane[0] != 1.0 or model.plane[1] != 1.0 or model.map_factor.size > 0:
        return False
    if model.spring[0, 0] > 0.0 or model.element_body.size == 0:
        return False
    w = model.wrench[0]
    return bool(w[0] == 0.0 and w[1] == 0.0 and w[2] == 0.0)


@kernel
def least(mode: ContactMode) -> tuple[float, int]:
    """Smallest margin above its floor, and which."""
    best = math.inf
    which = -1
    used = OWN * mode.size[N_CLOSED]
    for n in range(used + N_MARGIN - SUPPORT):
        k = n if n < used else n - used + SUPPORT
        m = mode.margin[k] + mode.floor[k]
        if m < best:
            best = m
            which = k
    return best, which


@kernel
def dense(mode: ContactMode, q: FloatArray, h: float, x: float, out: FloatArray) -> None:
    """Write the state at the part x of a step, of fourth order (Hairer, Norsett and Wanner,
    II.6)."""
    end = mode.point[0]
    slope = mode.slope
    y = 1.0 - x
    for i in range(3):
        change = end[i] - q[i]
        bump = h * slope[0, i] - change
        swing = change - h * slope[6, i] - bump
        bend = 0.0
        for s in range(7):
            bend += _D[s] * slope[s, i]
        out[i] = q[i] + x * (change + y * (bump + x * (swing + y * h * bend)))
    out[3] = q[3] + x * h


@kernel
def try_step(
    model: Model, mode: ContactMode, q: FloatArray, h: float, last: float
) -> tuple[float, bool]:
    """Take a step of Dormand and Prince from the first slopes, after one of the length `last`, or
    zero for none; returns its error, infinite where the mode could not be solved, and whether a
    margin was broken at a stage."""
    slope = mode.slope
    stage = mode.point[1]
    broken = False
    for s in range(6):
        # Newton's method starts where the unknowns would be if they changed evenly. The unknowns
        # before those of a step are of its fourth stage.
        part = _R[s]
        if s == 0:
            part = 1.8 * h / last if last > 0.0 else 0.0
        for i in range(9):
            now = mode.unknown[i]
            mode.unknown[i] += part * (now - mode.before[i])
            if s < 5:
                mode.before[i] = now
        for i in range(3):
            change = 0.0
            for j in range(s + 1):
                change += _A[s, j] * slope[j, i]
            stage[i] = q[i] + h * change
        stage[3] = q[3] + _C[s] * h
        if not (settle(model, mode, stage) if s == 5 else solve_mode(model, mode, stage)):
            return math.inf, broken
        low, _ = least(mode)
        broken = broken or low < 0.0
        for i in range(3):
            slope[s + 1, i] = mode.velocity[i]
    error = 0.0
    for i in range(3):
        total = 0.0
        for s in range(7):
            total += _E[s] * slope[s, i]
        error = max(error, abs(h * total))
    for i in range(4):
        mode.point[0, i] = stage[i]
    return error, broken


@large_kernel
def look(
    model: Model, mode: ContactMode, q: FloatArray, pieces: GapArrays, exact: bool
) -> tuple[float, int]:
    """Smallest margin at a state, with open gaps, and which; `exact` on the closed gaps."""
    solved = settle(model, mode, q) if exact else solve_mode(model, mode, q)
    if not solved:
        return -1.0, -1
    mode.margin[OPEN] = open_gap(pieces)
    return least(mode)


@kernel
def between(a: float, above: float, b: float, below: float, n: int) -> float:
    """Place of a root between a and b, where a function is `above` and `below` zero: by false
    position, and from the twentieth look `n` by bisection."""
    x = (a * below - b * above) / (below - above) if n < 20 else 0.5 * (a + b)
    return min(max(x, a + 1e-3 * (b - a)), b - 1e-3 * (b - a))


@kernel
def tighten(
    a: float, above: float, b: float, below: float, side: int, x: float, value: float
) -> tuple[float, float, float, float, int]:
    """Return the bracket of `between` with the value at x, and the side that moved: the other one
    counts half when it moves twice."""
    if value < 0.0:
        return a, above * (0.5 if side == -1 else 1.0), x, value, -1
    return x, value, b, below * (0.5 if side == 1 else 1.0), 1


@large_kernel
def find_end(
    model: Model,
    mode: ContactMode,
    q: FloatArray,
    h: float,
    a: float,
    b: float,
    low: float,
    pieces: GapArrays,
) -> int:
    """Go to where the smallest margin vanishes between the parts a and b of a step; returns which
    margin, or FOLDED."""
    point = mode.point[2]
    above = 1e-9
    if a > 0.0:
        dense(mode, q, h, a, point)
        above, _ = look(model, mode, point, pieces, False)
        above = max(above, 1e-12)
    below = low
    side = 0
    narrow = ROOT / max(h, 1e-3)
    which = -1
    x = a
    for n in range(80):
        if b - a < narrow:
            break
        x = between(a, above, b, below, n)
        dense(mode, q, h, x, point)
        value, which = look(model, mode, point, pieces, True)
        a, above, b, below, side = tighten(a, above, b, below, side, x, value)
        if -1e-11 < value < 0.0:
            break
    if x != b:
        dense(mode, q, h, b, point)
        _, which = look(model, mode, point, pieces, True)
    for i in range(4):
        q[i] = point[i]
    return which if which >= 0 else FOLDED


@kernel
def write_mode(mode: ContactMode, q: FloatArray, kind: int, counts: IntArray, tape: Tape) -> None:
    """Write the mode that begins, while there is room."""
    if counts[MODES] > tape.mode.shape[0]:
        return
    row = tape.mode[counts[MODES] - 1]
    row[BEGIN] = q[3]
    row[KIND] = kind
    row[CLOSED] = mode.size[N_CLOSED]
    row[STICKING] = mode.size[PIVOT]
    row[EVENT] = CLOCK_RAN_OUT
    for i in range(3):
        row[POSE + i] = q[i]
    for c in range(MOST):
        for i in range(6):
            row[CONTACTS + 6 * c + i] = mode.contact[c, i]


@kernel
def write_step(mode: ContactMode, q: FloatArray, h: float, counts: IntArray, tape: Tape) -> None:
    """Write a step that is taken, while there is room."""
    if counts[STEPS] >= tape.step.shape[0]:
        return
    row = tape.step[counts[STEPS]]
    row[OF_MODE] = counts[MODES] - 1
    row[START] = q[3]
    row[LENGTH] = h
    row[PART] = 1.0
    for i in range(3):
        row[FROM + i] = q[i]
        row[TO + i] = mode.point[0, i]
        for k in range(7):
            row[SLOPES + 3 * k + i] = mode.slope[k, i]
    for i in range(9):
        row[UNKNOWNS + i] = mode.saved[i]
    row[AROUND] = mode.size[POLE]


@large_kernel
def follow(
    model: Model, mode: ContactMode, q: FloatArray, pieces: GapArrays, counts: IntArray, tape: Tape
) -> int:
    """Integrate one mode to its end or to the end of the clock; returns the margin that ended it,
    CLOCK_RAN_OUT or FOLDED."""
    number = mode.number
    end = mode.point[0]
    point = mode.point[2]
    slope = mode.slope
    h = number[STEP_LENGTH]
    before = 0.0
    for i in range(3):
        slope[0, i] = mode.velocity[i]
    was_open = mode.margin[OPEN]
    while True:
        left = number[CLOCK_END] - q[3]
        if left <= 1e-12:
            return CLOCK_RAN_OUT
        last = h >= left
        h = min(h, left)
        for i in range(9):
            mode.saved[i] = mode.unknown[i]
        error, broken = try_step(model, mode, q, h, before)
        before = 0.0
        if not error <= ACCURACY:
            for i in range(9):
                mode.unknown[i] = mode.saved[i]
            h *= 0.3 if math.isinf(error) else max(0.2, 0.9 * (ACCURACY / error) ** 0.2)
            if h < SHORTEST:
                return FOLDED
            continue
        if last:
            end[3] = number[CLOCK_END]
        # At the end, and inside where a stage or the gaps make it doubtful.
        now_open = open_gap(pieces)
        mode.margin[OPEN] = now_open
        low, _ = least(mode)
        a = 0.0
        b = 1.0
        fastest = number[PUSHER_SPEED]
        for s in range(7):
            speed = math.sqrt(slope[s, 0] ** 2 + slope[s, 1] ** 2)
            speed += number[PART_REACH] * abs(slope[s, 2])
            fastest = max(fastest, number[PUSHER_SPEED] + speed)
        doubtful = broken or low < 0.0
        if not doubtful and was_open + now_open < 1.2 * h * fastest:
            for n in range(1, INSIDE):
                dense(mode, q, h, n / INSIDE, point)
                place_mode(mode, point)
                if open_gap(pieces) + mode.floor[OPEN] < 0.0:
                    doubtful = True
                    break
        broken = False
        if doubtful:
            for n in range(1, INSIDE + 1):
                x = n / INSIDE
                dense(mode, q, h, x, point)
                low, _ = look(model, mode, point, pieces, n == INSIDE)
                if low < 0.0:
                    broken = True
                    b = x
                    break
                a = x
        write_step(mode, q, h, counts, tape)
        counts[STEPS] += 1
        if broken:
            number[STEP_LENGTH] = max(0.05, 0.5 * h)
            ended = find_end(model, mode, q, h, a, b, low, pieces)
            if counts[STEPS] <= tape.step.shape[0]:
                tape.step[counts[STEPS] - 1, PART] = (
                    q[3] - tape.step[counts[STEPS] - 1, START]
                ) / h
            return ended
        for i in range(4):
            q[i] = end[i]
        # The last stage was solved there.
        mode.margin[OPEN] = now_open
        was_open = now_open
        for i in range(N_MARGIN):
            if mode.margin[i] > GROWN:
                mode.floor[i] = 0.0
        for i in range(3):
            slope[0, i] = mode.velocity[i]
        if (mode.size[ROWS] == 3 or not seed(model, mode, False)) and not doubtful:
            before = h
        h = min(LONGEST, h * min(5.0, max(0.2, 0.9 * (ACCURACY / max(error, 1e-14)) ** 0.2)))
        number[STEP_LENGTH] = h


@large_kernel
def wait(mode: ContactMode, q: FloatArray, pieces: GapArrays) -> None:
    """Move the clock on while the part rests, to the first gap that closes or to its end.

    No gap closes in less than its width over the speed of the pusher's fastest point.
    """
    mode.size[N_CLOSED] = 0
    number = mode.number
    slow = FIRST_WAIT
    wide = _gap_at(mode, q, q[3], pieces)
    last = -1.0
    while q[3] < number[CLOCK_END] - 1e-12 and not wide <= TOUCH < last:
        low = q[3]
        last = max(wide, 0.0)
        step = last / number[PUSHER_SPEED]
        if wide < NARROW:
            # It may slide along the part, or leave it.
            step = max(step, slow)
            slow = min(2.0 * slow, LAST_WAIT)
        wide = _gap_at(mode, q, min(number[CLOCK_END], low + step), pieces)
        if wide >= -FLOOR:
            continue
        high = q[3]
        above = last + FLOOR
        below = wide + FLOOR
        side = 0
        for n in range(60):
            if high - low < 1e-13:
                break
            wide = _gap_at(mode, q, between(low, above, high, below, n), pieces)
            if abs(wide + FLOOR) < 1e-13:
                break
            low, above, high, below, side = tighten(
                low, above, high, below, side, q[3], wide + FLOOR
            )
        return


@kernel
def _gap_at(mode: ContactMode, q: FloatArray, clock: float, pieces: GapArrays) -> float:
    """Go to a time of the clock; returns the smallest gap there."""
    q[3] = clock
    place_mode(mode, q)
    return open_gap(pieces)


@allocating_kernel
def _walk(
    model: Model,
    start: FloatArray,
    method: StepMethod,
    settings: FloatArray,
    q: FloatArray,
    counts: IntArray,
    tape: Tape,
) -> int:
    """Follow the modes of a rollout to its end `q`; returns how it ended."""
    problem, work = allocate(model, method.max_contacts)
    mode = empty_mode(model)
    wide = problem.momentum.size
    state = State(start.copy(), np.zeros(wide), np.zeros(2), np.zeros(wide), np.zeros(1))
    rows = start.copy()
    guess = np.zeros(wide)
    control = np.zeros(at.N_CONTROL)
    begin(model, state, np.zeros((1, 3)), settings[at.STEP], problem, work)
    for i in range(at.N_SETTING):
        control[i] = settings[i]
    duration = settings[at.DURATION]
    measure(model, mode, start)
    mode.number[DURATION] = duration
    mode.number[STEP_LENGTH] = FIRST_STEP
    for i in range(3):
        q[i] = start[0, i]
    q[3] = 0.0
    status = COMPLETE
    while q[3] < duration - 1e-12 and status == COMPLETE:
        set_motion(model, mode, q[3])
        if mode.number[SPEED] < 1e-14:
            q[3] = mode.number[CLOCK_END]
            continue
        status = _follow_piece(
            model, state, mode, rows, guess, control, q, problem, work, counts, tape
        )
    return COMPLETE if status == STALLED else status


@large_kernel
def _follow_piece(
    model: Model,
    state: State,
    mode: ContactMode,
    rows: FloatArray,
    guess: FloatArray,
    control: FloatArray,
    q: FloatArray,
    problem: Problem,
    work: Workspace,
    counts: IntArray,
    tape: Tape,
) -> int:
    """Follow the modes of one straight piece of the path; returns how it ended."""
    ahead = AHEAD
    pieces = gap_arrays(model, mode, model.piece_body.size)
    while q[3] < mode.number[CLOCK_END] - 1e-12:
        counts[MODES] += 1
        if counts[MODES] > MOST_MODES:
            return CHATTER
        kind = UNKNOWN
        if propose(model, mode, q, ahead, state, control, guess, rows, problem, work):
            kind = read_mode(model, mode, rows, ahead, problem)
        write_mode(mode, q, kind, counts, tape)
        if kind == STALLS:
            counts[SUDDEN] = 1
            return STALLED
        if kind == RESTS:
            wait(mode, q, pieces)
            if q[3] < mode.number[CLOCK_END] and counts[MODES] <= tape.mode.shape[0]:
                tape.mode[counts[MODES] - 1, EVENT] = OPEN
            ahead = AHEAD
            continue
        held = mode.point[1]
        for i in range(4):
            held[i] = q[i]
        holds = kind == SLIDES and enter(model, mode, q, ahead)
        if not holds and mode.margin[DRIVE] < 0.0 and kind == SLIDES:
            return STALLED
        if not holds:
            if ahead < FARTHEST:
                ahead *= 10.0
                for i in range(4):
                    q[i] = held[i]
                continue
            return NO_MODE
        ahead = AHEAD
        write_mode(mode, q, kind, counts, tape)
        mode.margin[OPEN] = open_gap(pieces)
        for c in range(N_MARGIN):
            # What begins at zero may fall a little.
            mode.floor[c] = 0.0
            if mode.margin[c] < FLOOR:
                mode.floor[c] = FLOOR + max(0.0, -mode.margin[c])
        ended = follow(model, mode, q, pieces, counts, tape)
        if counts[MODES] <= tape.mode.shape[0]:
            tape.mode[counts[MODES] - 1, EVENT] = ended
        if ended == DRIVE:
            return STALLED
        if ended == FOLDED:
            # The velocity vanishes, or the mode has no solution any more: what follows is a jump.
            counts[FOLDS] += 1
            if counts[FOLDS] > MOST_FOLDS:
                return FOLD
            ahead = AFTER_FOLD
        for i in range(3):
            guess[i] = mode.velocity[i]
    return COMPLETE


@entry
def walk_batch(
    batch: Batch, method: StepMethod, stride: int, record: ModeRecord, tape: Tape,
    first: int, last: int,
) -> None:  # fmt: skip
    """Follow the modes of every `stride`-th rollout of a batch, `first` to ``last - 1`` of the
    record, without Python's lock. The tape has no rows, or room for each rollout."""
    m = 0
    s = 0
    for r in range(first, last):
        model = select(batch, stride * r)
        if not suits(model):
            record.status[r] = UNSUITED
            continue
        a = batch.begin[stride * r, at.BODY]
        own = Tape(tape.mode[m : m + MODE_ROOM], tape.step[s : s + STEP_ROOM])
        count = record.count[r]
        count[MODE_AT] = m
        count[STEP_AT] = s
        start = batch.pose[a : a + batch.count[stride * r, at.BODY]]
        settings = batch.settings[stride * r]
        record.status[r] = _walk(model, start, method, settings, record.end[r], count, own)
        m += min(count[MODES], own.mode.shape[0])
        s += min(count[STEPS], own.step.shape[0])
