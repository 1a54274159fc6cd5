"""The loops of tracking that are run thousands of times a second, compiled.

As for the kernels: arrays and numbers only, a status in place of exceptions.
"""

import math

import numpy as np

from fixel.kernels.arrays import FloatArray
from fixel.kernels.jit import entry, kernel
from fixel.model.fields import BoolArray
from fixel.vision.frame import Gray

STEP = 0.5  # [px] between readings along a normal
WINDOW = 2.6  # [px] to either side of an edge that its rise is looked for in
SHIFTS = 4  # of that window onto the centre of what is in it
BESIDE = 2.5  # [px] from an edge to where its dark and its bright side are judged
LEAST_RISE = 12.0  # of brightness, of 255, below which nothing is an edge

ROUNDS = 12  # of weighting, at most
SAME = 0.005  # [px] of change between them that ends it
OPEN = 1e-3  # least over largest pivot, below which the edges tell no pose


@entry
def edges_along(
    picture: Gray,
    pixel: FloatArray,
    normal: FloatArray,
    reach: float,
    found: FloatArray,
    clear: BoolArray,
) -> None:
    """Find the rise of brightness along normals.

    Writes offset, dark and bright into the rows of `found` (n, 3), and whether there is an edge
    into `clear` (n,). Readings are bilinear; beyond the picture, as at its border.
    """
    height, width = picture.shape
    half = math.ceil(reach / STEP)
    m = 2 * half + 1
    profile = np.empty(m)
    for i in range(len(pixel)):
        u0, v0 = pixel[i, 0], pixel[i, 1]
        for k in range(m):
            s = STEP * (k - half)
            u = min(max(u0 + s * normal[i, 0], 0.0), width - 1.0)
            v = min(max(v0 + s * normal[i, 1], 0.0), height - 1.0)
            x, y = min(int(u), width - 2), min(int(v), height - 2)
            a, b = u - x, v - y
            above = (1.0 - a) * picture[y, x] + a * picture[y, x + 1]
            below = (1.0 - a) * picture[y + 1, x] + a * picture[y + 1, x + 1]
            profile[k] = (1.0 - b) * above + b * below
        best, fastest = 0, -1e300
        for k in range(m - 1):
            last, first = min(k + 2, m - 1), max(k - 1, 0)
            if profile[last] - profile[first] > fastest:
                best, fastest = k, profile[last] - profile[first]
        centre = STEP * (best + 0.5 - half)
        total = 0.0
        for _ in range(SHIFTS):
            total = moment = 0.0
            for k in range(m - 1):
                middle = STEP * (k + 0.5 - half)
                apart = (middle - centre) / WINDOW
                rise = profile[k + 1] - profile[k]
                if rise > 0.0 and abs(apart) < 1.0:
                    weight = rise * (1.0 - apart * apart)
                    total += weight
                    moment += weight * middle
            if total > 0.0:
                centre = moment / total
        found[i, 0] = centre
        for side in range(2):
            place = round((centre + (2 * side - 1) * BESIDE) / STEP) + half
            k = int(min(max(place, 1), m - 2))
            found[i, 1 + side] = (profile[k - 1] + profile[k] + profile[k + 1]) / 3.0
        clear[i] = (
            total > LEAST_RISE
            and abs(centre) <= reach - 0.5 * WINDOW
            and 1.0 <= u0 <= width - 2.0
            and 1.0 <= v0 <= height - 2.0
        )


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
    """Weighted least squares by Cholesky's factor of the normal equations, which it writes too."""
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
    """Of the matrix whose Cholesky factor this is."""
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


@entry
def solve_robustly(
    slope: FloatArray,
    offset: FloatArray,
    usable: BoolArray,
    least: float,
    cut: float,
    step: FloatArray,
    covariance: FloatArray,
    used: BoolArray,
    room: FloatArray,
    square: FloatArray,
) -> float:
    """Least squares of `slope @ step = offset` without what does not agree.

    Weights of Cauchy find the rows that agree, whatever the others are; these alone then count.
    Writes the step (m,), its covariance (m, m), and which rows were used (n,); `room` (4, n) and
    `square` (m + 2, m) are to work in.

    Returns
    -------
    float
        Root mean square of what is left over [px], or -1 where the rows leave something open.
    """
    n, m = slope.shape
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
                rest[i] = offset[i]
                for j in range(m):
                    rest[i] -= slope[i, j] * step[j]
                change = max(change, abs(rest[i] - before[i]))
                before[i] = rest[i]
                sizes[count] = abs(rest[i])
                count += 1
        scatter = max(1.4826 * np.median(sizes[:count]), least)
        if change < SAME:
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
            left = offset[i]
            for j in range(m):
                left -= slope[i, j] * step[j]
            total += left * left
    residual = math.sqrt(total / count)
    _inverse(factor, square[m + 1], covariance)
    variance = max(residual, least) ** 2
    for j in range(m):
        for k in range(m):
            covariance[j, k] *= variance / (size[j] * size[k])
    return residual
