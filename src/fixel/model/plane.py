"""Anisotropic and uneven friction of the plane on which bodies rest, and its unevenness."""

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
        _check_cell(self.cell, "friction_map.cell")
        factor = _grid(self.factor, "friction_map.factor", "factor")
        if (factor <= 0.0).any():
            row, column = np.argwhere(factor <= 0.0)[0].tolist()
            raise InvalidInput(
                f"friction_map.factor[{row}][{column}]",
                found=float(factor[row, column]),
                expected="a factor greater than 0",
            )
        settle(self, factor=factor)

    def at(self, position: ArrayLike) -> FloatArray:
        """Interpolate the multipliers (...) at world positions (..., 2) [m]."""
        return _bilinear(self.origin, self.cell, self.factor, position)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadMap(Comparable):
    """Unevenness of a table, as the logarithm of a factor of the loads on support points by place.

    A rigid part on an uneven table presses more where the table is high. The loads are those at the
    start of the motion, balanced so that their centre and sum do not change; hence a constant or an
    inclined map has no effect, nor has any map on parts on three points. It is bilinear between the
    nodes of a grid, and constant beyond the border.

    Parameters
    ----------
    origin : (2,) array_like
        World position of node [0, 0] [m].
    cell : (2,) array_like
        Distance of neighbouring nodes along x and y [m].
    log_load : (n_y, n_x) array_like
        Logarithm of the factor at each node, row by row from low y to high [-].

    Examples
    --------
    >>> hill = LoadMap(origin=(0, 0), cell=(0.1, 0.1), log_load=[[0.0, 0.0], [0.0, 1.0]])
    >>> float(hill.at((0.05, 0.05)))
    0.25
    """

    origin: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    cell: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    log_load: FloatArray

    def __post_init__(self) -> None:
        check_fields(self, "load_map")
        _check_cell(self.cell, "load_map.cell")
        settle(self, log_load=_grid(self.log_load, "load_map.log_load", "log_load"))

    def at(self, position: ArrayLike) -> FloatArray:
        """Interpolate the logarithms (...) at world positions (..., 2) [m]."""
        return _bilinear(self.origin, self.cell, self.log_load, position)


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
    load_map : LoadMap, optional
        Unevenness of the table, which changes how parts press on it.

    Examples
    --------
    >>> Plane(anisotropy=(1.1, 0.9)).anisotropy
    array([1.1, 0.9])
    """

    anisotropy: Annotated[ArrayField, Value(vector, "along the axis, across it")] = (1.0, 1.0)  # type: ignore[assignment]
    axis: Annotated[float, Value(finite, "rad")] = 0.0
    friction_map: FrictionMap | None = None
    load_map: LoadMap | None = None

    def __post_init__(self) -> None:
        check_fields(self, "plane")
        if (self.anisotropy <= 0.0).any():
            found = self.anisotropy.tolist()
            raise InvalidInput("plane.anisotropy", found=found, expected="factors greater than 0")
        instance(
            self.friction_map, FrictionMap | None, "plane.friction_map", "a FrictionMap, or None"
        )
        instance(self.load_map, LoadMap | None, "plane.load_map", "a LoadMap, or None")


def _check_cell(cell: FloatArray, where: str) -> None:
    if (cell <= 0.0).any():
        raise InvalidInput(where, found=cell.tolist(), expected="numbers greater than 0 [m]")


def _grid(values: ArrayLike, where: str, name: str) -> FloatArray:
    """Return values (n_y, n_x) of the nodes of a grid; raise for rows of different lengths."""
    try:
        width = len(values[0])  # type: ignore[index,arg-type]
    except (TypeError, IndexError, KeyError):
        found = f"the type {type(values).__name__}"
        raise InvalidInput(where, found=found, expected=f"rows of {name}s") from None
    return table(values, where, ", ".join([name] * width))


def _bilinear(
    origin: FloatArray, cell: FloatArray, grid: FloatArray, position: ArrayLike
) -> FloatArray:
    """Interpolate a grid (n_y, n_x) at positions (..., 2)."""
    n_y, n_x = grid.shape
    node = (np.asarray(position, dtype=np.float64) - origin) / cell
    column = np.clip(node[..., 0], 0.0, n_x - 1.0)
    row = np.clip(node[..., 1], 0.0, n_y - 1.0)
    left = np.minimum(column.astype(np.intp), max(n_x - 2, 0))
    low = np.minimum(row.astype(np.intp), max(n_y - 2, 0))
    right, high = np.minimum(left + 1, n_x - 1), np.minimum(low + 1, n_y - 1)
    u, v = column - left, row - low
    below = (1.0 - u) * grid[low, left] + u * grid[low, right]
    above = (1.0 - u) * grid[high, left] + u * grid[high, right]
    return np.asarray((1.0 - v) * below + v * above)
