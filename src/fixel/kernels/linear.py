"""Small dense and large banded linear systems, solved in place in a fixed order of operations, so
that results are bit for bit reproducible."""

from fixel.kernels.jit import kernel, view
from fixel.typing import FloatArray, IntArray

DENSE_LIMIT = 12  # up to this many unknowns, Gauss with row pivots; above, envelope without pivots


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
def solve_envelope(
    matrix: FloatArray, reach: IntArray, right: FloatArray, n_inner: int, n: int
) -> bool:
    """Solve a structurally symmetric banded system with a dense border; x replaces `right`.

    Row k of the first `n_inner` couples with the columns up to ``reach[k]`` (one past the last,
    never falling with k) and with the border, columns `n_inner` to ``n - 1``; columns likewise.
    Entries beyond are neither read nor written. `matrix` is destroyed. No pivots: the systems of
    this package have a dominant symmetric part. False where a pivot vanishes.
    """
    k = 0
    while k < n:
        inner = min(reach[k], n_inner) if k < n_inner else k + 1
        border = max(n_inner, k + 1)
        body = k + 2 < n_inner and reach[k + 2] == reach[k]  # then three pivots at once
        following = k + 3 if body else k + 1
        for p in range(k, following):
            if not abs(matrix[p, p]) > 0.0:
                return False
            for part in range(1 if body else 2):
                first = p + 1 if part == 0 else border
                last = n if part == 1 else following if body else inner
                for i in range(first, last):
                    factor = matrix[i, p] * (1.0 / matrix[p, p])
                    if factor != 0.0:
                        _subtract(matrix, i, p, factor, p + 1, inner)
                        _subtract(matrix, i, p, factor, border, n)
                        right[i] -= factor * right[p]
        if body:
            _eliminate_body(matrix, right, k, inner, border, n)
        k = following
    for k in range(n - 1, -1, -1):
        inner = min(reach[k], n_inner) if k < n_inner else k + 1
        total = right[k]
        for j in range(k + 1, inner):
            total -= matrix[k, j] * right[j]
        for j in range(max(n_inner, k + 1), n):
            total -= matrix[k, j] * right[j]
        right[k] = total / matrix[k, k]
    return True


@kernel
def _subtract(matrix: FloatArray, i: int, k: int, factor: float, first: int, last: int) -> None:
    """Subtract `factor` times the columns `first` to ``last - 1`` of row k from row i."""
    # Views are counted from zero, so that the processor takes several columns at once.
    n = last - first
    if n > 0:
        row = view(matrix, i * matrix.shape[1] + first, (n,))
        pivot = view(matrix, k * matrix.shape[1] + first, (n,))
        for j in range(n):
            row[j] -= factor * pivot[j]


@kernel
def _eliminate_body(
    matrix: FloatArray, right: FloatArray, k: int, inner: int, border: int, n: int
) -> None:
    """Subtract as `_subtract` does for the pivots k, k + 1 and k + 2, but read and write each row
    once."""
    first = 1.0 / matrix[k, k]
    second = 1.0 / matrix[k + 1, k + 1]
    third = 1.0 / matrix[k + 2, k + 2]
    for part in range(2):
        for i in range(k + 3 if part == 0 else border, inner if part == 0 else n):
            f = matrix[i, k] * first
            g = (matrix[i, k + 1] - f * matrix[k, k + 1]) * second
            h = matrix[i, k + 2] - f * matrix[k, k + 2] - g * matrix[k + 1, k + 2]
            h *= third
            if f == 0.0 and g == 0.0 and h == 0.0:
                continue
            _subtract_three(matrix, i, k, f, g, h, k + 3, inner)
            _subtract_three(matrix, i, k, f, g, h, border, n)
            right[i] = right[i] - f * right[k] - g * right[k + 1] - h * right[k + 2]


@kernel
def _subtract_three(
    matrix: FloatArray, i: int, k: int, f: float, g: float, h: float, first: int, last: int
) -> None:
    """Subtract the columns `first` to ``last - 1`` of three rows from row i."""
    n = last - first
    if n > 0:
        wide = matrix.shape[1]
        row = view(matrix, i * wide + first, (n,))
        x = view(matrix, k * wide + first, (n,))
        y = view(matrix, (k + 1) * wide + first, (n,))
        z = view(matrix, (k + 2) * wide + first, (n,))
        for j in range(n):
            row[j] = row[j] - f * x[j] - g * y[j] - h * z[j]


@kernel
def invert_block(
    inverse: FloatArray,
    o: int,
    a00: float,
    a01: float,
    a02: float,
    a11: float,
    a12: float,
    a22: float,
) -> None:
    """Write the inverse of a symmetric 3 x 3 matrix into three rows of `inverse`, from row o."""
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    inverse[o, 0] = c00 / determinant
    inverse[o, 1] = c01 / determinant
    inverse[o, 2] = c02 / determinant
    inverse[o + 1, 0] = inverse[o, 1]
    inverse[o + 1, 1] = (a00 * a22 - a02 * a02) / determinant
    inverse[o + 1, 2] = (a01 * a02 - a00 * a12) / determinant
    inverse[o + 2, 0] = inverse[o, 2]
    inverse[o + 2, 1] = inverse[o + 1, 2]
    inverse[o + 2, 2] = (a00 * a11 - a01 * a01) / determinant
