"""Small dense and skyline linear systems, in place, always in the same order (hence the same bits)."""

from fixel.kernels.arrays import FloatArray, IntArray
from fixel.kernels.jit import kernel

DENSE_LIMIT = 12  # up to this many unknowns Gauss with row pivots; above, skyline without pivots


@kernel
def solve_dense(matrix: FloatArray, right: FloatArray, n: int) -> bool:
    """Solve ``matrix x = right`` by Gaussian elimination with row pivots; x replaces `right`.

    `matrix` is destroyed. False where a pivot vanishes.
    """
    for k in range(n):
        pivot = k
        largest = abs(matrix[k, k])
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > largest:
                largest = abs(matrix[i, k])
                pivot = i
        if not largest > 0.0:
            return False
        if pivot != k:
            for j in range(k, n):
                swap = matrix[k, j]
                matrix[k, j] = matrix[pivot, j]
                matrix[pivot, j] = swap
            swap = right[k]
            right[k] = right[pivot]
            right[pivot] = swap
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = matrix[i, k] * inverse
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    for i in range(n - 1, -1, -1):
        total = right[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * right[j]
        right[i] = total / matrix[i, i]
    return True


@kernel
def solve_skyline(
    lower: FloatArray, upper: FloatArray, profile: IntArray, right: FloatArray, n: int
) -> bool:
    """Solve a structurally symmetric system kept by its skyline; x replaces `right`.

    `lower` holds the rows of the lower triangle with the diagonal, ``upper[j, i]`` the entry in row i and
    column j of the upper triangle; row i of both starts at column ``profile[i]``. Both are destroyed. No
    pivots: the systems of this package have a dominant symmetric part. False where a pivot vanishes.
    """
    for i in range(n):
        start = profile[i]
        for j in range(start, i):
            first = max(start, profile[j])
            low = lower[i, j]
            up = upper[i, j]
            for k in range(first, j):
                low -= lower[i, k] * upper[j, k]
                up -= lower[j, k] * upper[i, k]
            upper[i, j] = up
            lower[i, j] = low / lower[j, j]
        pivot = lower[i, i]
        for k in range(start, i):
            pivot -= lower[i, k] * upper[i, k]
        if not abs(pivot) > 0.0:
            return False
        lower[i, i] = pivot
        total = right[i]
        for k in range(start, i):
            total -= lower[i, k] * right[k]
        right[i] = total
    for i in range(n - 1, -1, -1):
        right[i] /= lower[i, i]
        for k in range(profile[i], i):
            right[k] -= upper[i, k] * right[i]
    return True
