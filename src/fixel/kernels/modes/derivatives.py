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
def _differentiate(
    batch: Batch, base: int, method: StepMethod, tape: Tape, counts: IntArray, result: FloatArray
) -> bool:
    """Differentiate rollout `base`; False where there is no derivative."""
    model = select(batch, base)
    start = batch.pose[batch.begin[base, BODY] : batch.begin[base, BODY] + batch.count[base, BODY]]
    problem, work = allocate(model, method.max_contacts)
    mode = empty_mode(model)
    measure(model, mode, start)
    mode.number[DURATION] = batch.settings[base, SETTING_DURATION]
    wide = result.shape[1]
    state = np.zeros((3, wide))
    for i in range(3):
        state[i, i] = 1.0
    times = np.zeros(wide)
    before = np.zeros(3)
    velocity = np.zeros(3)
    slope = np.zeros((3, 3, wide))
    stage = np.zeros((4, 3, wide))
    trial = np.zeros((3, wide))
    q = np.zeros(4)
    x = np.zeros(4)
    number = 0
    step = 0
    while number < counts[MODES]:
        row = tape.mode[number]
        number += 1
        if row[KIND] < 0.0:
            continue
        for i in range(3):
            velocity[i] = 0.0
        if row[KIND] == 0.0:
            if not (step < counts[STEPS] and tape.step[step, OF_MODE] == number - 1):
                continue  # a mode that did not hold
            for i in range(3):
                velocity[i] = tape.step[step, SLOPES + i]
        # The jump from the mode before, at the time when it ended.
        for column in range(wide):
            for i in range(3):
                state[i, column] += (before[i] - velocity[i]) * times[column]
            times[column] = 0.0
        for i in range(3):
            before[i] = velocity[i]
        _load_mode(mode, row)
        which = int(row[EVENT])
        if row[KIND] == 1.0 and which == OPEN and number < counts[MODES]:
            for i in range(3):
                q[i] = row[POSE + i]
            q[3] = tape.mode[number, BEGIN]
            set_motion(model, mode, row[BEGIN])
            mode.size[N_CLOSED] = 0
            if not _event_times(
                batch,
                base,
                model,
                mode,
                q,
                row[BEGIN],
                before,
                OPEN,
                state,
                start,
                work,
                problem,
                times,
            ):
                return False
        while step < counts[STEPS] and tape.step[step, OF_MODE] == number - 1:
            own = tape.step[step]
            h = _load_step(mode, own, q)
            set_motion(model, mode, own[START])
            part = own[PART]
            for k in range(3):
                dense(mode, q, h, 0.5 * k * part, x)
                if not _slopes(batch, base, model, mode, x, own[START], start, slope[k]):
                    return False
            span = h * part
            for k in range(4):
                here = slope[(k + 1) // 2]
                for column in range(wide):
                    for i in range(3):
                        total = state[i, column]
                        if k > 0:
                            total += span * (0.5 if k < 3 else 1.0) * stage[k - 1, i, column]
                        trial[i, column] = total
                for column in range(wide):
                    for i in range(3):
                        total = here[i, column] if column >= 3 else 0.0
                        for j in range(3):
                            total += here[i, j] * trial[j, column]
                        stage[k, i, column] = total
            for column in range(wide):
                for i in range(3):
                    state[i, column] += (span / 6.0) * (
                        stage[0, i, column]
                        + 2.0 * stage[1, i, column]
                        + 2.0 * stage[2, i, column]
                        + stage[3, i, column]
                    )
            step += 1
            if part < 1.0 or step == counts[STEPS] or tape.step[step, OF_MODE] != number - 1:
                for i in range(4):
                    q[i] = x[i]
                if not solve_mode(model, mode, q):
                    return False
                for i in range(3):
                    before[i] = mode.velocity[i]
                if which >= 0 and not _event_times(
                    batch,
                    base,
                    model,
                    mode,
                    q,
                    own[START],
                    before,
                    which,
                    state,
                    start,
                    work,
                    problem,
                    times,
                ):
                    return False
    # A part that stalls stops where the last mode ended.
    for column in range(wide):
        for i in range(3):
            state[i, column] += before[i] * times[column]
    for i in range(3):
        for column in range(wide):
            result[i, column] = state[i, column]
    return True
