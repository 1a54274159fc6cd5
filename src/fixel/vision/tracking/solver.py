"""Selection of edges and robust least squares for a pose, compiled.

As in the kernels, arguments are arrays and numbers, and errors a status instead of exceptions.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fixel.kernels.jit import entry, kernel
from fixel.typing import BoolArray, FloatArray

LEVEL = 0.35  # largest deviation of brightness from the median, as a share of the contrast
MIN_LEVELS = 4  # edges that a group needs for a median

ROUNDS = 12  # largest number of weightings
CONVERGED_PX = 0.005  # [px] change between them at convergence
OPEN = 1e-3  # least over largest pivot, below which the pose is undetermined


@kernel
def _ranked(values: FloatArray, n: int, rank: int) -> float:
    """Select the value of a rank from below among the first n, by Hoare's method; reorders them."""
    first, last = 0, n - 1
    while first < last:
        pivot = values[(first + last) // 2]
        i, j = first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            last = j
        elif rank >= i:
            first = i
        else:
            break
    return float(values[rank])


@entry
def plausible(
    found: FloatArray, group: NDArray[np.int64], clear: BoolArray, usable: BoolArray
) -> int:
    """Write which edges have the same dark and bright levels as others of their group.

    Edges of an object that covers a marker rarely have the marker's black and white. Returns the
    number of edges selected.
    """
    n = len(group)
    dark, bright = np.empty(n), np.empty(n)
    total, start = 0, 0
    while start < n:
        end, count = start, 0
        while end < n and group[end] == group[start]:
            usable[end] = False
            if clear[end]:
                dark[count], bright[count] = found[end, 1], found[end, 2]
                count += 1
            end += 1
        if count >= MIN_LEVELS:
            half = count // 2
            low, high = _ranked(dark, count, half), _ranked(bright, count, half)
            slack = LEVEL * (high - low)
            for i in range(start, end):
                usable[i] = (
                    clear[i] and abs(found[i, 1] - low) < slack and abs(found[i, 2] - high) < slack
                )
                total += usable[i]
        start = end
    return total


@kernel
def _solve(
    slope: FloatArray,
    offset: FloatArray,
    usable: BoolArray,
    weight: FloatArray,
    size: FloatArray,
    factor: FloatArray,
    step: FloatArray,
) -> bool:
    """Solve weighted least squares by a Cholesky factor of the normal equations, also written."""
    n, m = slope.shape
    factor[:] = 0.0
    step[:] = 0.0
    for i in range(n):
        if usable[i]:
            for j in range(m):
                row = weight[i] * slope[i, j] / size[j]
                step[j] += row * offset[i]
                for k in range(j + 1):
                    factor[j, k] += row * slope[i, k] / size[k]
    largest = 0.0
    for j in range(m):
        largest = max(largest, factor[j, j])
    for j in range(m):
        for k in range(j + 1):
            total = factor[j, k]
            for q in range(k):
                total -= factor[j, q] * factor[k, q]
            if j > k:
                factor[j, k] = total / factor[k, k]
            elif total < OPEN * largest or total <= 0.0:
                return False
            else:
                factor[j, j] = math.sqrt(total)
    for j in range(m):
        for k in range(j):
            step[j] -= factor[j, k] * step[k]
        step[j] /= factor[j, j]
    for j in range(m - 1, -1, -1):
        for k in range(j + 1, m):
            step[j] -= factor[k, j] * step[k]
        step[j] /= factor[j, j]
    for j in range(m):
        step[j] /= size[j]
    return True


@kernel
def _inverse(factor: FloatArray, column: FloatArray, inverse: FloatArray) -> None:
    """Write the inverse of the matrix with this Cholesky factor."""
    m = len(factor)
    for c in range(m):
        for j in range(m):
            column[j] = 1.0 if j == c else 0.0
            for k in range(j):
                column[j] -= factor[j, k] * column[k]
            column[j] /= factor[j, j]
        for j in range(m - 1, -1, -1):
            for k in range(j + 1, m):
                column[j] -= factor[k, j] * column[k]
            column[j] /= factor[j, j]
        for j in range(m):
            inverse[j, c] = column[j]


@kernel
def _rest(slope: FloatArray, step: FloatArray, offset: FloatArray, i: int) -> float:
    """Offset of an edge that a step leaves [px]."""
    left = offset[i]
    for j in range(len(step)):
        left -= slope[i, j] * step[j]
    return float(left)


@entry
def solve_robustly(
    slope: FloatArray,
    found: FloatArray,
    usable: BoolArray,
    least: float,
    cut: float,
    step: FloatArray,
    covariance: FloatArray,
    used: BoolArray,
    room: FloatArray,
    square: FloatArray,
) -> float:
    """Solve `slope @ step = offset` by least squares without outliers.

    The offsets are the first column of `found`.
    Cauchy's weights identify the rows that agree; only these are used in the final solution.
    Writes the step (m,), its covariance (m, m), and which rows were used (n,); `room` (4, n) and
    `square` (m + 2, m) are workspace.

    Returns
    -------
    float
        Root mean square residual [px], or -1 where the rows do not determine the step.
    """
    n, m = slope.shape
    offset = found[:, 0]
    weight, rest, before, sizes = room
    size, factor = square[m], square[:m]
    weight[:] = 1.0
    before[:] = 0.0
    for j in range(m):
        size[j] = np.abs(slope[:, j]).max()
        if not size[j] > 0.0:
            return -1.0
    scatter = least
    for _ in range(ROUNDS):
        if not _solve(slope, offset, usable, weight, size, factor, step):
            return -1.0
        change, count = 0.0, 0
        for i in range(n):
            if usable[i]:
                rest[i] = _rest(slope, step, offset, i)
                change = max(change, abs(rest[i] - before[i]))
                before[i] = rest[i]
                sizes[count] = abs(rest[i])
                count += 1
        scatter = max(1.4826 * np.median(sizes[:count]), least)
        if change < CONVERGED_PX:
            break
        for i in range(n):
            weight[i] = 1.0 / (1.0 + (rest[i] / scatter) ** 2)
    count = 0
    for i in range(n):
        used[i] = usable[i] and abs(rest[i]) < cut * scatter
        weight[i] = 1.0
        count += used[i]
    if count < 2 * m + 2 or not _solve(slope, offset, used, weight, size, factor, step):
        return -1.0
    total = 0.0
    for i in range(n):
        if used[i]:
            total += _rest(slope, step, offset, i) ** 2
    residual = math.sqrt(total / count)
    _inverse(factor, square[m + 1], covariance)
    variance = max(residual, least) ** 2
    for j in range(m):
        for k in range(m):
            covariance[j, k] *= variance / (size[j] * size[k])
    return residual
