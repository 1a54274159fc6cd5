"""Derivatives of the motion by the start pose and by parameters, along the modes of a rollout.

Inside a mode the derivative obeys the linear equation of the flow. Where one mode ends and the next
begins it jumps by the change of velocity times the derivative of that time; docs/theory/modes.md
derives both. By parameters, rows change by differences of the residual, not of solutions, so that
Newton's method solves for nothing but the motion. Each is visited once, along the whole rollout.
"""

import math
from typing import NamedTuple

import numpy as np

from fixel.kernels import arrays
from fixel.kernels.arrays import Batch, Model
from fixel.kernels.gap import contact_pair
from fixel.kernels.jit import allocating_kernel, entry, kernel, large_kernel
from fixel.kernels.modes import geometry, walk
from fixel.kernels.modes.equation import (
    assemble,
    reduce_balance,
    solve_mode,
    write_dual,
    write_rows,
)
from fixel.kernels.modes.geometry import ContactMode
from fixel.kernels.modes.walk import Tape
from fixel.kernels.rollout import select
from fixel.typing import FloatArray, IntArray

NUDGE = 1e-6  # of a pose and the clock, in scaled units
FLAT = 1e-9  # rate of a margin below which its root has no derivative
BEFORE = 3e-3  # part of a step before its end at which a part that comes to rest still moves
AT_REST = 1e-2  # velocity over that at the start of a mode, at its end
AT_ONCE = 1e-6  # duration of a rest between two modes that touch
BENT = 0.005  # second difference of the velocity's derivative over a piece, times its length
GROWTH = 0.75  # velocity's derivative times the length of a piece
MOST_PIECES = 1000  # of a step
NEAR = 1e-6  # gap at the end of a mode that closes at the same time, and speed at which it does
NEAR_ROOM = 64  # such gaps
ROUNDING = 1e-6  # of a column: derivative of such a gap that is none
SPARE = 256  # states, of steps that are divided
TOUCHING = -3  # event of a part that touches the pusher at the start: as if it came from a gap
TO_TOUCH = walk.MODE_ROOM  # number of that event
# Columns of `Flow.near`: gap, normal and point as in `Problem.contact_place`, and behind them:
RATE = 5  # of the gap, by the time
CHANGE = 6  # its derivative
# Columns of `Flow.near_pair`.
PAIR = 0  # of pieces
ENDS = 1  # mode that ends as they close
# Columns of `Flow.span`: of a mode, its first state and the one after its last.
ONWARD = 0
UP_TO = 1


class Flow(NamedTuple):
    """Linear equations of the derivatives along a rollout.

    They are known at states: at the start, in the middle and at the end of each piece of a step,
    where the end of one piece is the start of the next.
    """

    span: IntArray  # (n_mode, 2) see ONWARD; no states of modes at rest and of those not entered
    state: FloatArray  # (n_state, 4)
    unknown: FloatArray  # (n_state, 9)
    pole: IntArray  # (n_state,)
    gain: FloatArray  # (n_state, 3, 6) change of the velocity by a change of the residual
    velocity: FloatArray  # (n_state, 3)
    slope: FloatArray  # (n_state, 3, 3 + n_parameter) derivative of the velocity
    event: FloatArray  # (n_mode + 1, 4) state at the end of a mode; see TO_TOUCH
    margin: FloatArray  # (n_mode + 1,) the one that ends it, close to zero
    rate: FloatArray  # (n_mode + 1,) by the time, of that margin
    slant: FloatArray  # (n_mode + 1, 3 + n_parameter) its derivative
    near: FloatArray  # (NEAR_ROOM, CHANGE + 3 + n_parameter) gaps that close at the same time
    near_pair: IntArray  # (NEAR_ROOM, 2) see PAIR
    n_near: IntArray  # (1,)


@large_kernel
def _load_mode(model: Model, mode: ContactMode, row: FloatArray, moves: bool) -> None:
    """Set a mode on the tape."""
    geometry.set_motion(model, mode, row[walk.BEGIN])
    mode.size[geometry.N_CLOSED] = int(row[walk.CLOSED]) if moves else 0
    mode.size[geometry.PIVOT] = int(row[walk.STICKING])
    for c in range(geometry.MOST):
        for i in range(6):
            mode.contact[c, i] = int(row[walk.CONTACTS + 6 * c + i])


@large_kernel
def _load_step(mode: ContactMode, row: FloatArray, q: FloatArray) -> None:
    """Set a step of the tape."""
    for i in range(3):
        q[i] = row[walk.FROM + i]
        mode.point[0, i] = row[walk.TO + i]
        for k in range(7):
            mode.slope[k, i] = row[walk.SLOPES + 3 * k + i]
    q[3] = row[walk.START]
    for i in range(9):
        mode.unknown[i] = row[walk.UNKNOWNS + i]
    mode.size[geometry.POLE] = int(row[walk.AROUND])


@kernel
def _load_unknowns(mode: ContactMode, flow: Flow, k: int) -> None:
    """Set the unknowns that solve the mode at state k."""
    mode.size[geometry.POLE] = flow.pole[k]
    for i in range(9):
        mode.unknown[i] = flow.unknown[k, i]


@kernel
def _extrapolate(mode: ContactMode, flow: Flow, k: int) -> None:
    """Set the unknowns of state k on a line with those of two states before, of one pole."""
    pole = mode.size[geometry.POLE]
    if flow.pole[k - 1] == pole and flow.pole[k - 2] == pole:
        last = flow.state[k - 1, 3]
        part = (flow.state[k, 3] - last) / (last - flow.state[k - 2, 3])
        for i in range(9):
            now = flow.unknown[k - 1, i]
            mode.unknown[i] = now + part * (now - flow.unknown[k - 2, i])


@kernel
def _respond(flow: Flow, k: int, column: int, change: FloatArray, n: int) -> None:
    """Add what a change of n residuals makes of the velocity to a column of its derivative."""
    for i in range(3):
        for j in range(n):
            flow.slope[k, i, column] -= flow.gain[k, i, j] * change[j]


@large_kernel
def _write_pose_columns(model: Model, mode: ContactMode, flow: Flow, k: int) -> None:
    """Write the derivative of the velocity by the pose at state k, where the mode is solved.

    Seen from the part, with which supports and velocity turn, the obstacles move instead.
    """
    v = mode.velocity
    change = mode.vector
    for j in range(3):
        spun = -1.0 if j == 2 else 0.0  # turn of the obstacles
        flow.slope[k, 0, j] = spun * v[1]
        flow.slope[k, 1, j] = -spun * v[0]
        flow.slope[k, 2, j] = 0.0
        change[:] = 0.0
        n = 3
        for c in range(mode.size[geometry.N_CLOSED]):
            own = mode.contact[c]
            row = mode.row[n - 3]
            tangent = mode.tangent[c]
            body = model.piece_body[own[geometry.SECOND]]
            near = model.piece_radius[own[geometry.FIRST]]
            far = model.piece_radius[own[geometry.SECOND]]
            # Turn of the normal, and motion of the point along tangent and normal.
            turn = 0.0 if own[geometry.FORM] == geometry.TIP else spun
            if own[geometry.FORM] == geometry.ROUND:
                turn = (tangent[j] + spun * far) / (near + far)
            along = far * (turn - spun) - tangent[j]
            away = -row[j]
            if own[geometry.FORM] == geometry.EDGE:
                along = -near * turn
                away = 0.0
            sticks = own[geometry.SLIP] == 0
            normal = mode.unknown[n]
            friction = own[geometry.SLIP] * model.friction[0, body] * normal
            if sticks:
                friction = mode.unknown[n + 1]
            change[0] -= turn * (normal * tangent[0] - friction * row[0])
            change[1] -= turn * (normal * tangent[1] - friction * row[1])
            change[2] -= turn * (normal * tangent[2] - friction * row[2])
            change[2] += along * normal - away * friction
            spin = mode.motion[2] if body == 1 else 0.0
            slip = -tangent[3]
            for i in range(3):
                slip += tangent[i] * v[i]
            right = mode.right[n - 3]
            change[n] = turn * slip - along * v[2] + spun * tangent[3] + spin * (along + tangent[j])
            if sticks:
                n += 1
                change[n] = away * v[2] - spun * right - spin * (away + row[j])
            n += 2 if own[geometry.FORM] == geometry.FLUSH else 1
        _respond(flow, k, j, change, n)


@large_kernel
def _linearise_state(model: Model, mode: ContactMode, flow: Flow, k: int) -> bool:
    """Solve the mode at state k, and differentiate its velocity by the pose."""
    if not solve_mode(model, mode, flow.state[k]):
        return False
    n = mode.size[geometry.ROWS]
    flow.pole[k] = mode.size[geometry.POLE]
    for i in range(9):
        flow.unknown[k, i] = mode.unknown[i]
    if n == 3:
        assemble(model, mode, n, True)  # Newton's method left the slopes of the others
    if not reduce_balance(mode, n):
        return False
    for i in range(3):
        flow.velocity[k, i] = mode.velocity[i]
        flow.gain[k, i] = 0.0
        for m in range(3):
            part = 0.0
            for j in range(3):
                part += mode.ways[i, j] * mode.dual[m, j]
            if m < n:
                flow.gain[k, i, 3 + m] = part
                continue
            for j in range(3):
                flow.gain[k, i, j] += part * mode.pull[m, j]
    _write_pose_columns(model, mode, flow, k)
    return True


@large_kernel
def _margin(model: Model, mode: ContactMode, q: FloatArray, which: int) -> float:
    """Margin of the mode at a state; NaN where the mode cannot be solved."""
    if which == TOUCHING:
        geometry.place_mode(mode, q)
        write_rows(model, mode)
        return float(mode.gap[0])
    if which == geometry.OPEN:
        geometry.place_mode(mode, q)
        n_piece = model.piece_body.size
        while mode.size[geometry.N_CLOSED] == 0 and model.piece_body[n_piece - 1] > 1:
            n_piece -= 1  # a part at rest may touch fixels, but only the pusher comes nearer
        return float(geometry.open_gap(geometry.gap_arrays(model, mode, n_piece)))
    if not solve_mode(model, mode, q):
        return np.nan
    return float(mode.margin[which])


@large_kernel
def _linearise_event(model: Model, mode: ContactMode, flow: Flow, number: int, which: int) -> bool:
    """Differentiate the margin that ends a mode by the pose and along the motion."""
    q = flow.event[number]
    rate = 0.0
    for column in range(4):
        middle = q[column]
        # Where the velocity vanishes, only differences to both sides contain how a margin jumps.
        q[column] = middle + NUDGE
        above = _margin(model, mode, q, which)
        q[column] = middle - NUDGE
        below = _margin(model, mode, q, which)
        q[column] = middle
        slant = (above - below) / (2.0 * NUDGE)
        flow.margin[number] = 0.5 * (above + below)
        speed = 1.0
        if column < 3:
            flow.slant[number, column] = slant
            speed = _last_speed(flow, number, column)
        rate += slant * speed
    flow.rate[number] = rate
    return abs(rate) > FLAT


@kernel
def _last_speed(flow: Flow, number: int, i: int) -> float:
    """Entry of the velocity at the end of a mode."""
    last = flow.span[number, UP_TO] - 1 if number != TO_TOUCH else -1
    moves = last >= 0 and last >= flow.span[number, ONWARD]
    return float(flow.velocity[last, i]) if moves else 0.0


@large_kernel
def _find_near(model: Model, mode: ContactMode, flow: Flow, number: int, reach: float) -> int:
    """Write the open gaps at the end of a mode behind those that are kept; returns the place after
    the last."""
    geometry.place_mode(mode, flow.event[number])
    pieces = geometry.gap_arrays(model, mode, model.piece_body.size)
    start = pieces.start
    n_piece = pieces.body.size
    n = flow.n_near[0]
    for pair in range(n_piece * n_piece):
        one = pair // n_piece
        two = pair % n_piece
        skipped = pieces.body[one] != 0 or pieces.body[two] == 0
        for c in range(mode.size[geometry.N_CLOSED] if number != TO_TOUCH else 0):
            own = mode.contact[c]
            skipped = skipped or (own[geometry.FIRST] == one and own[geometry.SECOND] == two)
        if skipped:
            continue
        geometry.place_piece(pieces, one)
        geometry.place_piece(pieces, two)
        found = contact_pair(
            pieces.world, pieces.real,
            start[one], start[one + 1], pieces.radius[one],
            start[two], start[two + 1], pieces.radius[two],
            reach, pieces.place, pieces.key, 0,
        )  # fmt: skip
        for k in range(min(found, NEAR_ROOM - n)):
            flow.near_pair[n, PAIR] = pair
            for i in range(RATE):
                flow.near[n, i] = pieces.place[k, i]
            n += 1
    return int(n)


@large_kernel
def _keep_near(model: Model, mode: ContactMode, flow: Flow, number: int) -> bool:
    """Keep the gaps that close where a mode ends, if there are several; False where there is no
    room. The smallest of all has no derivative then: the first takes its place."""
    first = flow.n_near[0]
    until = _find_near(model, mode, flow, number, NEAR)
    n = first
    for k in range(first, until):
        near = flow.near[k]
        nx = near[arrays.NORMAL_X]
        ny = near[arrays.NORMAL_Y]
        px = near[arrays.POINT_X]
        py = near[arrays.POINT_Y]
        near[CHANGE] = nx
        near[CHANGE + 1] = ny
        near[CHANGE + 2] = (px - mode.frame[0, 2]) * ny - (py - mode.frame[0, 3]) * nx
        rate = 0.0
        for i in range(3):
            rate += near[CHANGE + i] * _last_speed(flow, number, i)
        if model.piece_body[flow.near_pair[k, PAIR] % model.piece_body.size] == 1:
            motion = mode.motion
            rate -= nx * (motion[0] - motion[2] * (py - mode.frame[1, 3]))
            rate -= ny * (motion[1] + motion[2] * (px - mode.frame[1, 2]))
        if rate < -NEAR:
            near[RATE] = rate
            flow.near_pair[n, PAIR] = flow.near_pair[k, PAIR]
            flow.near_pair[n, ENDS] = number
            for i in range(CHANGE + 3):
                flow.near[n, i] = near[i]
            n += 1
    if n > first + 1:
        flow.n_near[0] = n
        flow.rate[number] = flow.near[first, RATE]
        for i in range(3):
            flow.slant[number, i] = flow.near[first, CHANGE + i]
    return until < NEAR_ROOM


@large_kernel
def _vary_near(own: Model, mode: ContactMode, flow: Flow, number: int, column: int) -> None:
    """Write what a little more of a parameter changes of the gaps that are kept at the end of a
    mode."""
    until = -1
    for n in range(flow.n_near[0]):
        if flow.near_pair[n, ENDS] != number:
            continue
        first = until < 0
        if first:
            until = _find_near(own, mode, flow, number, 100.0 * NEAR)
        near = flow.near[n]
        near[CHANGE + column] = np.nan
        nearest = np.inf
        for k in range(flow.n_near[0], until):
            away = abs(flow.near[k, arrays.POINT_X] - near[arrays.POINT_X])
            away += abs(flow.near[k, arrays.POINT_Y] - near[arrays.POINT_Y])
            if flow.near_pair[k, PAIR] == flow.near_pair[n, PAIR] and away < nearest:
                nearest = away
                near[CHANGE + column] = flow.near[k, arrays.GAP] - near[arrays.GAP]
        if first:
            flow.slant[number, column] = near[CHANGE + column]


@kernel
def _slows_down(flow: Flow, first: int, last: int) -> bool:
    """Whether a mode begins to move and ends at rest, or nearly so."""
    begin = 0.0
    end = 0.0
    for i in range(3):
        begin += flow.velocity[first, i] ** 2
        end += flow.velocity[last, i] ** 2
    return last > first and end < AT_REST**2 * begin


@kernel
def _divisor(slope: FloatArray, k: int, length: float) -> int:
    """Number of parts of a piece from state k over which the derivatives are accurate to 0.1 %."""
    most = 1.0
    for i in range(3):
        bent = 0.0
        growth = 0.0
        for j in range(3):
            bent += abs(slope[k, i, j] - 2.0 * slope[k + 1, i, j] + slope[k + 2, i, j])
            growth += abs(slope[k + 1, i, j])
        most = max(most, length * growth / GROWTH)
        if length * bent > BENT:
            most = max(most, (length * bent / BENT) ** (1.0 / 3.0))
    return math.ceil(min(most, MOST_PIECES))


@large_kernel
def _linearise_step(
    model: Model, mode: ContactMode, own: FloatArray, flow: Flow, k: int, room: int, first: int
) -> tuple[int, bool]:
    """Write the states of a step of the tape, from state `k` on.

    A step is as long as the motion allows, and is divided where neighbouring motions bend. Its
    first state is known unless it is the `first` of its mode. Returns the place after the last,
    negative where there is none, and whether the velocity vanishes at the end.
    """
    q = mode.point[1]
    _load_step(mode, own, q)
    begins = k == first
    k -= 0 if begins else 1
    n = 0
    pieces = 1
    while n < pieces:
        if k + 2 * (pieces - n) >= room:
            return -1, False
        for i in range(0 if begins else 1, 3):
            x = own[walk.PART] * (n + 0.5 * i) / pieces
            walk.dense(mode, q, own[walk.LENGTH], x, flow.state[k + i])
            if k + i > first + 1:
                _extrapolate(mode, flow, k + i)
            if _linearise_state(model, mode, flow, k + i):
                continue
            if i < 2 or pieces > 1:
                return -1, False
            # A velocity that vanishes has no direction. Just before it has.
            walk.dense(mode, q, own[walk.LENGTH], x * (1.0 - BEFORE), flow.state[k + 2])
            mode.size[geometry.POLE] = flow.pole[k + 1]
            for j in range(9):
                # From the middle of the step the velocity falls evenly.
                lasts = j > 2 or (j == 1 and flow.pole[k + 1] >= 0)
                share = 1.0 if lasts else 2.0 * BEFORE
                mode.unknown[j] = share * flow.unknown[k + 1, j]
            return k + 3 if _linearise_state(model, mode, flow, k + 2) else -1, True
        parts = _divisor(flow.slope, k, flow.state[k + 2, 3] - flow.state[k, 3])
        if parts > 1:
            pieces *= parts
            n *= parts
            _load_unknowns(mode, flow, k)
            continue
        k += 2
        n += 1
        begins = False
    return k + 1, False


@large_kernel
def _linearise(model: Model, mode: ContactMode, tape: Tape, flow: Flow) -> bool:
    """Write the equations of all modes, without columns of parameters."""
    n_mode = tape.mode.shape[0]
    room = n_mode + 4 * tape.step.shape[0] + SPARE
    k = 0
    step = 0
    rests = True  # without a gap that closes
    for number in range(n_mode):
        row = tape.mode[number]
        span = flow.span[number]
        span[ONWARD] = k
        span[UP_TO] = k
        event = flow.event[number]
        n_step = tape.step.shape[0]
        moves = step < n_step and int(tape.step[step, walk.OF_MODE]) == number
        which = int(row[walk.EVENT])
        _load_mode(model, mode, row, moves)
        if moves and rests:
            for i in range(3):
                flow.event[TO_TOUCH, i] = tape.step[0, walk.FROM + i]
            flow.event[TO_TOUCH, 3] = row[walk.BEGIN] + NUDGE
            # One contact closes at once; several do so in one order or in another, and a contact
            # along which the pusher slid first may have closed before.
            one = number == 0 and mode.size[geometry.N_CLOSED] == 1
            one = one and mode.contact[0, geometry.FORM] != geometry.FLUSH
            if not (one and _linearise_event(model, mode, flow, TO_TOUCH, TOUCHING)):
                return False
            if not _keep_near(model, mode, flow, TO_TOUCH):
                return False
        while step < n_step and tape.step[step, walk.OF_MODE] == number:
            own = tape.step[step]
            k, folds = _linearise_step(model, mode, own, flow, k, room, span[ONWARD])
            if k < 0:
                return False
            if folds:
                which = walk.FOLDED
            step += 1
        span[UP_TO] = k
        # At rest, up to the gap that closes where the next mode begins.
        for i in range(3):
            event[i] = flow.state[k - 1, i] if moves else row[walk.POSE + i]
        event[3] = tape.mode[min(number + 1, n_mode - 1), walk.BEGIN]
        if moves:
            event[3] = own[walk.START] + own[walk.PART] * own[walk.LENGTH]
        last = flow.span[max(number, 1) - 1]
        by_clock = last[UP_TO] > last[ONWARD] and tape.mode[number - 1, walk.EVENT] < 0.0
        if number > 0 and by_clock and not moves and event[3] - row[walk.BEGIN] < AT_ONCE:
            # Where its path bends the pusher still touches, whatever changes.
            row[walk.EVENT] = walk.CLOCK_RAN_OUT
            rests = False
            continue
        if which == walk.FOLDED:
            # It comes to rest, or else it jumps.
            if not _slows_down(flow, span[ONWARD], k - 1):
                return False
            row[walk.EVENT] = walk.CLOCK_RAN_OUT
        elif (
            which >= 0
            and not _is_skipped(row, flow, number)
            and not _linearise_event(model, mode, flow, number, which)
        ):
            return False
        if _is_skipped(row, flow, number):
            rests = which < 0 and rests
            continue
        rests = which < 0 and not moves
        if which == geometry.OPEN and not _keep_near(model, mode, flow, number):
            return False
    return True


@kernel
def _is_skipped(row: FloatArray, flow: Flow, number: int) -> bool:
    """Whether a mode on the tape was not entered, since it does not hold."""
    still = flow.span[number, ONWARD] == flow.span[number, UP_TO]
    return bool(row[walk.KIND] < 0.0 or (row[walk.KIND] == 0.0 and still))


@large_kernel
def _vary(own: Model, mode: ContactMode, tape: Tape, flow: Flow, column: int) -> None:
    """Write what a little more of a parameter changes of the velocities and margins."""
    for number in range(tape.mode.shape[0]):
        row = tape.mode[number]
        span = flow.span[number]
        if _is_skipped(row, flow, number):
            continue
        _load_mode(own, mode, row, span[UP_TO] > span[ONWARD])
        if span[UP_TO] > 0 and number == 0:
            margin = _margin(own, mode, flow.event[TO_TOUCH], TOUCHING)
            flow.slant[TO_TOUCH, column] = margin - flow.margin[TO_TOUCH]
            _vary_near(own, mode, flow, TO_TOUCH, column)
        for k in range(span[ONWARD], span[UP_TO]):
            _load_unknowns(mode, flow, k)
            geometry.place_mode(mode, flow.state[k])
            n = write_rows(own, mode)
            assemble(own, mode, n, False)
            for i in range(3):
                flow.slope[k, i, column] = mode.velocity[i] - flow.velocity[k, i]
            _respond(flow, k, column, mode.vector, 3 + n)
        if row[walk.EVENT] >= 0.0:
            margin = _margin(own, mode, flow.event[number], int(row[walk.EVENT]))
            flow.slant[number, column] = margin - flow.margin[number]
        _vary_near(own, mode, flow, number, column)


@kernel
def _jump(state: FloatArray, before: FloatArray, after: FloatArray, times: FloatArray) -> None:
    """Add the change of velocity at an event times the derivatives of its time, which are spent."""
    for column in range(times.size):
        for i in range(3):
            state[i, column] += (before[i] - after[i]) * times[column]
    times[:] = 0.0


@kernel
def _rate(slope: FloatArray, state: FloatArray, i: int, column: int) -> float:
    """Rate at which an entry of the derivatives changes."""
    total = slope[i, column] if column >= 3 else 0.0
    for j in range(3):
        total += slope[i, j] * state[j, column]
    return total


@large_kernel
def _advance(flow: Flow, k: int, span: float, state: FloatArray, stage: FloatArray) -> bool:
    """Integrate the linear equation over the piece from state k to k + 2 by Lobatto's method IIIA
    of order 4; leaves the rates at both ends in the first two of the stages."""
    one = flow.slope[k + 1]
    two = flow.slope[k + 2]
    solve = stage[2]
    dual = stage[3]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for m in range(3):
                total += one[i, m] * two[m, j]
            solve[i, j] = (span / 12.0) * (span * total - 4.0 * one[i, j] - 2.0 * two[i, j])
        solve[i, i] += 1.0
    if not write_dual(solve, dual):
        return False
    middle = stage[4]
    for column in range(state.shape[1]):
        for i in range(3):
            stage[0, i, column] = _rate(flow.slope[k], state, i, column)
            ends = stage[0, i, column] - (two[i, column] if column > 2 else 0.0)
            middle[i, column] = 0.5 * state[i, column] + 0.125 * span * ends
        for i in range(3):
            ends = stage[0, i, column] + (two[i, column] if column > 2 else 0.0)
            middle_rate = _rate(one, middle, i, column)
            stage[1, i, column] = state[i, column] + (span / 6.0) * (ends + 4.0 * middle_rate)
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += dual[j, i] * stage[1, j, column]
            state[i, column] = total
        for i in range(3):
            stage[1, i, column] = _rate(two, state, i, column)
    return True


@kernel
def _write_between(
    before: FloatArray, state: FloatArray, stage: FloatArray, span: float, x: float, out: FloatArray
) -> None:
    """Write the derivatives at the part x of a step, by Hermite's cubic."""
    y = 1.0 - x
    for column in range(state.shape[1]):
        for i in range(3):
            out[i, column] = (
                y * y * (1.0 + 2.0 * x) * before[i, column]
                + x * x * (1.0 + 2.0 * y) * state[i, column]
                + span * x * y * (y * stage[0, i, column] - x * stage[1, i, column])
            )


@kernel
def _time_event(flow: Flow, number: int, state: FloatArray, late: FloatArray) -> bool:
    """Write the derivatives of the time of an event."""
    for column in range(late.size):
        total = flow.slant[number, column] if column >= 3 else 0.0
        for i in range(3):
            total += flow.slant[number, i] * state[i, column]
        late[column] = -total / flow.rate[number]
        if not abs(late[column]) < np.inf and not np.isnan(state[0, column]):
            return False
    return True


@kernel
def _drop_one_sided(flow: Flow, number: int, state: FloatArray, late: FloatArray) -> None:
    """Set the columns to NaN that change the order in which gaps close where a mode ends."""
    for n in range(flow.n_near[0]):
        if flow.near_pair[n, ENDS] != number:
            continue
        near = flow.near[n]
        for column in range(late.size):
            change = near[RATE] * late[column] + (near[CHANGE + column] if column > 2 else 0.0)
            size = 1e-5
            for i in range(3):
                change += near[CHANGE + i] * state[i, column]
                size += abs(state[i, column])
            if not abs(change) <= ROUNDING * size:
                for i in range(3):
                    state[i, column] = np.nan


@large_kernel
def _integrate(
    tape: Tape, flow: Flow, times: FloatArray, stage: FloatArray, root: FloatArray, out: FloatArray
) -> bool:
    """Integrate the derivatives, which are in the last of the stages at the start, to all times."""
    state = stage[5]
    was = stage[6]
    before = root[0]
    velocity = root[1]
    late = root[2]
    at = 0
    if flow.rate[TO_TOUCH] != 0.0 and not _time_event(flow, TO_TOUCH, state, late):
        return False
    _drop_one_sided(flow, TO_TOUCH, state, late)
    for number in range(tape.mode.shape[0]):
        row = tape.mode[number]
        span = flow.span[number]
        if _is_skipped(row, flow, number):
            continue
        moves = span[UP_TO] > span[ONWARD]
        for i in range(3):
            velocity[i] = flow.velocity[span[ONWARD], i] if moves else 0.0
        while at < times.size and times[at] < row[walk.BEGIN]:
            _write_between(state, state, stage, 0.0, 0.0, out[at])
            at += 1
        _jump(state, before, velocity, late)
        for k in range(span[ONWARD], span[UP_TO] - 2, 2):
            begin = flow.state[k, 3]
            last = k + 3 == span[UP_TO]
            length = (flow.event[number, 3] if last else flow.state[k + 2, 3]) - begin
            _write_between(state, state, stage, 0.0, 0.0, was)
            if not _advance(flow, k, length, state, stage):
                return False
            while at < times.size and times[at] < begin + length:
                _write_between(was, state, stage, length, (times[at] - begin) / length, out[at])
                at += 1
        for i in range(3):
            before[i] = flow.velocity[span[UP_TO] - 1, i] if moves else 0.0
        if row[walk.EVENT] >= 0.0 and not _time_event(flow, number, state, late):
            return False
        _drop_one_sided(flow, number, state, late)
    # A part that stalls stops where the last mode ended.
    velocity[:] = 0.0
    _jump(state, before, velocity, late)
    for k in range(at, times.size):
        _write_between(state, state, stage, 0.0, 0.0, out[k])
    return True


@entry
def differentiate_batch(
    batch: Batch, stride: int, record: walk.ModeRecord, tape: Tape, times: FloatArray,
    slope: FloatArray, found: IntArray, first: int, last: int,
) -> None:  # fmt: skip
    """Write the derivatives of poses by the start poses and by parameters.

    Rollout ``stride * r`` of the batch is the one that the tape has; after it, one rollout for each
    parameter has a little more of it, and is not simulated. `slope` (n, n_time, 3, 3 + n_parameter)
    has the derivatives at the increasing `times` (n, n_time); column 3 + k is the difference that
    parameter k makes. `found` (n,) is zero where a mode or its end has no derivative.
    """
    flow = _empty_flow(slope.shape[3])
    for r in range(first, last):
        count = record.count[r]
        n_mode = count[walk.MODES]
        n_step = count[walk.STEPS]
        found[r] = 0
        if (
            record.status[r] == walk.COMPLETE
            and n_mode <= walk.MODE_ROOM
            and n_step <= walk.STEP_ROOM
        ):
            m = count[walk.MODE_AT]
            s = count[walk.STEP_AT]
            own = Tape(tape.mode[m : m + n_mode], tape.step[s : s + n_step])
            if _differentiate(batch, stride * r, own, flow, times[r], slope[r]):
                found[r] = 1


@allocating_kernel
def _empty_flow(wide: int) -> Flow:
    """Allocate equations with room for those of the longest tape."""
    n_state = walk.MODE_ROOM + 4 * walk.STEP_ROOM + SPARE
    return Flow(
        span=np.empty((walk.MODE_ROOM, 2), np.int64),
        state=np.empty((n_state, 4)),
        unknown=np.empty((n_state, 9)),
        pole=np.empty(n_state, np.int64),
        gain=np.empty((n_state, 3, 6)),
        velocity=np.empty((n_state, 3)),
        slope=np.empty((n_state, 3, wide)),
        event=np.empty((walk.MODE_ROOM + 1, 4)),
        margin=np.empty(walk.MODE_ROOM + 1),
        rate=np.empty(walk.MODE_ROOM + 1),
        slant=np.empty((walk.MODE_ROOM + 1, wide)),
        near=np.empty((NEAR_ROOM, CHANGE + wide)),
        near_pair=np.empty((NEAR_ROOM, 2), np.int64),
        n_near=np.zeros(1, np.int64),
    )


@allocating_kernel
def _differentiate(
    batch: Batch, base: int, tape: Tape, flow: Flow, times: FloatArray, slope: FloatArray
) -> bool:
    """Write the derivatives of rollout `base`; False where there are none."""
    mode = geometry.empty_mode(select(batch, base))
    mode.number[geometry.DURATION] = batch.settings[base, arrays.DURATION]
    wide = slope.shape[2]
    flow.rate[:] = 0.0
    flow.slant[:] = 0.0
    flow.n_near[0] = 0
    stage = np.zeros((7, 3, wide))
    start = batch.begin[base, arrays.BODY]
    for k in range(wide - 2):
        own = select(batch, base + k)
        begin = batch.begin[base + k, arrays.BODY]
        geometry.measure(own, mode, batch.pose[begin : begin + batch.count[base + k, arrays.BODY]])
        if not walk.suits(own):
            return False
        if k > 0:
            _vary(own, mode, tape, flow, 2 + k)
            for i in range(3):
                stage[5, i, 2 + k] = batch.pose[begin, i] - batch.pose[start, i]
        elif not _linearise(own, mode, tape, flow):
            return False
    for i in range(3):
        stage[5, i, i] = 1.0
    return _integrate(tape, flow, times, stage, np.zeros((3, wide)), slope)
