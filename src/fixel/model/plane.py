"""Anisotropic and uneven friction of the plane on which bodies rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    finite,
    frozen,
    instance,
    settle,
    table,
    vector,
)
from fixel.typing import ArrayField, FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrictionMap(Comparable):
    """Multiplier of support friction that depends on the place.

    It is bilinear between the nodes of a grid, and constant beyond the border.

    Parameters
    ----------
    origin : (2,) array_like
        World position of node [0, 0] [m].
    cell : (2,) array_like
        Distance of neighbouring nodes along x and y [m].
    factor : (n_y, n_x) array_like
        Multiplier at each node, row by row from low y to high [-].
    """

    origin: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    cell: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    factor: FloatArray

    def __post_init__(self) -> None:
        check_fields(self, "friction_map")
        if (self.cell <= 0.0).any():
            found = self.cell.tolist()
            raise InvalidInput(
                "friction_map.cell", found=found, expected="numbers greater than 0 [m]"
            )
        settle(self, factor=_positive_grid(self.factor))

    def at(self, position: ArrayLike) -> FloatArray:
        """Interpolate the multipliers (...) at world positions (..., 2) [m]."""
        n_y, n_x = self.factor.shape
        node = (np.asarray(position, dtype=np.float64) - self.origin) / self.cell
        column = np.clip(node[..., 0], 0.0, n_x - 1.0)
        row = np.clip(node[..., 1], 0.0, n_y - 1.0)
        left = np.minimum(column.astype(np.intp), max(n_x - 2, 0))
        low = np.minimum(row.astype(np.intp), max(n_y - 2, 0))
        right, high = np.minimum(left + 1, n_x - 1), np.minimum(low + 1, n_y - 1)
        u, v = column - left, row - low
        below = (1.0 - u) * self.factor[low, left] + u * self.factor[low, right]
        above = (1.0 - u) * self.factor[high, left] + u * self.factor[high, right]
        return np.asarray((1.0 - v) * below + v * above)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane(Comparable):
    """Multipliers of the friction of all supports.

    Parameters
    ----------
    anisotropy : (2,) array_like
        Factors along the principal axes of the plane [-].
    axis : float
        Angle of the first principal axis from world x [rad].
    friction_map : FrictionMap, optional
        Multiplier by place.

    Examples
    --------
    >>> Plane(anisotropy=(1.1, 0.9)).anisotropy
    array([1.1, 0.9])
    """

    anisotropy: Annotated[ArrayField, Value(vector, "along the axis, across it")] = (1.0, 1.0)  # type: ignore[assignment]
    axis: Annotated[float, Value(finite, "rad")] = 0.0
    friction_map: FrictionMap | None = None

    def __post_init__(self) -> None:
        check_fields(self, "plane")
        if (self.anisotropy <= 0.0).any():
            found = self.anisotropy.tolist()
            raise InvalidInput("plane.anisotropy", found=found, expected="factors greater than 0")
        instance(
            self.friction_map, FrictionMap | None, "plane.friction_map", "a FrictionMap, or None"
        )


def _positive_grid(factor: ArrayLike) -> FloatArray:
    where = "friction_map.factor"
    try:
        width = len(factor[0])  # type: ignore[index,arg-type]
    except (TypeError, IndexError, KeyError):
        raise InvalidInput(where, found=type(factor).__name__, expected="rows of factors") from None
    grid = table(factor, where, ", ".join(["factor"] * width))
    if (grid <= 0.0).any():
        row, column = np.argwhere(grid <= 0.0)[0].tolist()
        raise InvalidInput(
            f"{where}[{row}][{column}]",
            found=float(grid[row, column]),
            expected="factors greater than 0",
        )
    return frozen(grid)
