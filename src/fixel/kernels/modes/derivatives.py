"""Derivatives of the motion by the start pose and by parameters, along the modes of a rollout.

Inside a mode the derivative obeys the linear equation of the flow. Where one mode ends and the next
begins it jumps by the change of velocity times the derivative of that time; docs/theory/modes.md
derives both. Rows change by differences of the residual, not of solutions, so that Newton's method
is never asked.
"""

import numpy as np

from fixel.kernels.allocate import allocate
from fixel.kernels.arrays import DURATION as SETTING_DURATION
from fixel.kernels.arrays import Batch, Model, Problem, StepMethod, Workspace
from fixel.kernels.batch import BODY, select
from fixel.kernels.jit import allocating_kernel, entry
from fixel.kernels.linear import solve_dense
from fixel.kernels.modes.equation import assemble, solve_mode, write_rows
from fixel.kernels.modes.geometry import (
    DURATION,
    MOST,
    N_CLOSED,
    OPEN,
    PIVOT,
    POLE,
    ROWS,
    ContactMode,
    empty_mode,
    measure,
    open_gap,
    place_mode,
    set_motion,
)
from fixel.kernels.modes.walk import (
    AROUND,
    BEGIN,
    CLOSED,
    COMPLETE,
    CONTACTS,
    EVENT,
    FOLDS,
    FROM,
    KIND,
    LENGTH,
    MODES,
    OF_MODE,
    PART,
    POSE,
    SLOPES,
    START,
    STEPS,
    STICKING,
    TO,
    UNKNOWNS,
    ModeRecord,
    Tape,
    dense,
)
from fixel.typing import FloatArray, IntArray

NUDGE = 1e-5  # of a pose, in scaled units
AGO = 1e-6  # of the clock
FLAT = 1e-9  # rate of a margin below which its root has no derivative


@allocating_kernel
def _load_mode(mode: ContactMode, row: FloatArray) -> None:
    """Set the contacts of a mode on the tape."""
    mode.size[N_CLOSED] = int(row[CLOSED])
    mode.size[PIVOT] = int(row[STICKING])
    for c in range(MOST):
        for i in range(6):
            mode.contact[c, i] = int(row[CONTACTS + 6 * c + i])


@allocating_kernel
def _load_step(mode: ContactMode, row: FloatArray, q: FloatArray) -> float:
    """Set a step of the tape; returns its length."""
    for i in range(3):
        q[i] = row[FROM + i]
        mode.point[0, i] = row[TO + i]
        for k in range(7):
            mode.slope[k, i] = row[SLOPES + 3 * k + i]
    q[3] = row[START]
    for i in range(9):
        mode.unknown[i] = row[UNKNOWNS + i]
    mode.size[POLE] = int(row[AROUND])
    return float(row[LENGTH])


@allocating_kernel
def _slopes(
    batch: Batch,
    base: int,
    model: Model,
    mode: ContactMode,
    q: FloatArray,
    clock: float,
    start: FloatArray,
    slope: FloatArray,
) -> bool:
    """Write the derivative of the velocity by the pose and by the parameters, (3, 3 + n)."""
    if not solve_mode(model, mode, q):
        return False
    n = mode.size[ROWS]
    assemble(model, mode, n, True)
    matrix = mode.matrix.copy()
    ways = mode.ways.copy()
    change = np.zeros((2, 6))
    velocity = np.zeros((2, 3))
    at = q.copy()
    for column in range(slope.shape[1]):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            own = model
            for i in range(4):
                at[i] = q[i]
            if column < 3:
                at[column] += sign * NUDGE
            else:
                own = select(batch, base + 2 * column - 5 + side)
                measure(own, mode, start)
                set_motion(own, mode, clock)
            place_mode(own, mode, at)
            write_rows(own, mode)
            assemble(own, mode, n, False)
            for i in range(6):
                change[side, i] = mode.vector[i]
            for i in range(3):
                velocity[side, i] = mode.velocity[i]
        width = 0.5 / NUDGE if column < 3 else 0.5
        for i in range(6):
            mode.vector[i] = width * (change[1, i] - change[0, i])
        for i in range(6):
            for j in range(6):
                mode.matrix[i, j] = matrix[i, j]
        if not solve_dense(mode.matrix, mode.vector, 3 + n):
            return False
        for i in range(3):
            slope[i, column] = width * (velocity[0, i] - velocity[1, i])
            for j in range(3):
                slope[i, column] += ways[i, j] * mode.vector[j]
    if slope.shape[1] > 3:
        measure(model, mode, start)
        set_motion(model, mode, clock)
    return True


@allocating_kernel
def _margin(
    model: Model, mode: ContactMode, q: FloatArray, which: int, work: Workspace, problem: Problem
) -> float:
    """Margin of the mode at a state; NaN where the mode cannot be solved."""
    if which == OPEN:
        place_mode(model, mode, q)
        return open_gap(model, mode, work, problem, 1.0)
    if not solve_mode(model, mode, q):
        return np.nan
    return float(mode.margin[which])


@allocating_kernel
def _event_times(
    batch: Batch,
    base: int,
    model: Model,
    mode: ContactMode,
    q: FloatArray,
    clock: float,
    velocity: FloatArray,
    which: int,
    state: FloatArray,
    start: FloatArray,
    work: Workspace,
    problem: Problem,
    times: FloatArray,
) -> bool:
    """Write the derivative of the time at which a margin vanishes, by each column of `state`."""
    at = q.copy()
    unknown = mode.unknown.copy()
    value = np.zeros(2)
    for column in range(-1, state.shape[1]):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            own = model
            at[3] = q[3]
            for i in range(3):
                if column < 0:
                    at[i] = q[i] + sign * AGO * velocity[i]
                else:
                    width = NUDGE if column < 3 else 1.0
                    at[i] = q[i] + sign * width * state[i, column]
            if column < 0:
                at[3] = q[3] + sign * AGO
            elif column >= 3:
                own = select(batch, base + 2 * column - 5 + side)
                measure(own, mode, start)
                set_motion(own, mode, clock)
            for i in range(9):
                mode.unknown[i] = unknown[i]
            value[side] = _margin(own, mode, at, which, work, problem)
        if column < 0:
            rate = (value[0] - value[1]) / (2.0 * AGO)
            if not abs(rate) > FLAT:
                return False
        else:
            width = NUDGE if column < 3 else 1.0
            times[column] = -(value[0] - value[1]) / (2.0 * width * rate)
            if np.isnan(times[column]):
                return False
    measure(model, mode, start)
    set_motion(model, mode, clock)
    return True


@entry
def differentiate_batch(
    batch: Batch, method: StepMethod, stride: int, record: ModeRecord, slope: FloatArray,
    found: IntArray, first: int, last: int,
) -> None:  # fmt: skip
    """Write the derivatives of the last poses by the start poses and by parameters.

    Rollout ``stride * r`` of the batch is the one on tape r; after it, two rollouts for each
    parameter have it a little larger and a little smaller, and are not simulated. Column 3 + k of
    `slope` (n, 3, 3 + n_parameter) is half the difference that parameter k makes. `found` (n,) is
    zero where a mode or its end has no derivative.
    """
    for r in range(first, last):
        complete = record.status[r] == COMPLETE and record.count[r, FOLDS] == 0
        room = record.count[r, MODES] <= record.mode.shape[1]
        room = room and record.count[r, STEPS] <= record.step.shape[1]
        tape = Tape(record.mode[r], record.step[r])
        found[r] = 0
        if (
            complete
            and room
            and _differentiate(batch, stride * r, method, tape, record.count[r], slope[r])
        ):
            found[r] = 1


@allocating_kernel
def _jump(state: FloatArray, before: FloatArray, after: FloatArray, times: FloatArray) -> None:
    """Add the change of velocity at an event times the derivatives of its time, which are spent."""
    for column in range(times.size):
        for i in range(3):
            state[i, column] += (before[i] - after[i]) * times[column]
        times[column] = 0.0


@allocating_kernel
def _advance(state: FloatArray, slope: FloatArray, span: float, stage: FloatArray) -> None:
    """Integrate the linear equation of the derivatives over a step by the classical method of Runge
    and Kutta; `slope` has its factors at the start, in the middle and at the end."""
    trial = state.copy()
    for k in range(4):
        here = slope[(k + 1) // 2]
        for column in range(state.shape[1]):
            for i in range(3):
                total = here[i, column] if column >= 3 else 0.0
                for j in range(3):
                    total += here[i, j] * trial[j, column]
                stage[k, i, column] = total
        reach = 0.5 * span if k < 2 else span
        for column in range(state.shape[1]):
            for i in range(3):
                trial[i, column] = state[i, column] + reach * stage[k, i, column]
    for column in range(state.shape[1]):
        for i in range(3):
            middle = stage[1, i, column] + stage[2, i, column]
            ends = stage[0, i, column] + stage[3, i, column]
            state[i, column] += (span / 6.0) * (ends + 2.0 * middle)


@allocating_kernel
def _differentiate(
    batch: Batch, base: int, method: StepMethod, tape: Tape, counts: IntArray, state: FloatArray
) -> bool:
    """Write the derivatives of rollout `base` into zeros; False where there are none."""
    model = select(batch, base)
    start = batch.pose[batch.begin[base, BODY] : batch.begin[base, BODY] + batch.count[base, BODY]]
    problem, work = allocate(model, method.max_contacts)
    mode = empty_mode(model)
    measure(model, mode, start)
    mode.number[DURATION] = batch.settings[base, SETTING_DURATION]
    wide = state.shape[1]
    for i in range(3):
        state[i, i] = 1.0
    times = np.zeros(wide)
    before = np.zeros(3)
    velocity = np.zeros(3)
    slope = np.zeros((3, 3, wide))
    stage = np.zeros((4, 3, wide))
    q = np.zeros(4)
    x = np.zeros(4)
    step = 0
    for number in range(counts[MODES]):
        row = tape.mode[number]
        first = step
        while step < counts[STEPS] and tape.step[step, OF_MODE] == number:
            step += 1
        if row[KIND] < 0.0 or (row[KIND] == 0.0 and step == first):
            continue  # a mode that did not hold
        for i in range(3):
            velocity[i] = tape.step[first, SLOPES + i] if step > first else 0.0
        _jump(state, before, velocity, times)
        for i in range(3):
            before[i] = velocity[i]
        _load_mode(mode, row)
        which = int(row[EVENT])
        clock = row[BEGIN]
        if step == first:
            # At rest, up to the gap that closes where the next mode begins.
            for i in range(3):
                x[i] = row[POSE + i]
            x[3] = tape.mode[min(number + 1, counts[MODES] - 1), BEGIN]
            set_motion(model, mode, clock)
            mode.size[N_CLOSED] = 0
        for k in range(first, step):
            own = tape.step[k]
            h = _load_step(mode, own, q)
            clock = own[START]
            set_motion(model, mode, clock)
            for part in range(3):
                dense(mode, q, h, 0.5 * part * own[PART], x)
                if not _slopes(batch, base, model, mode, x, clock, start, slope[part]):
                    return False
            _advance(state, slope, h * own[PART], stage)
        if step > first:
            if not solve_mode(model, mode, x):
                return False
            for i in range(3):
                before[i] = mode.velocity[i]
        if which >= 0 and not _event_times(
            batch, base, model, mode, x, clock, before, which, state, start, work, problem, times
        ):
            return False
    # A part that stalls stops where the last mode ended.
    for i in range(3):
        velocity[i] = 0.0
    _jump(state, before, velocity, times)
    return True
