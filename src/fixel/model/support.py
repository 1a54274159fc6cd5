"""Supports of bodies on the plane: points, tripod, pressure or ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
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
    non_negative,
    positive,
    settle,
    table,
    vector,
)
from fixel.model.footprint import cells
from fixel.model.shape import Shape
from fixel.typing import ArrayField, FloatArray

# Share of the weight below which a negative load is a rounding error and becomes zero.
LOAD_ROUNDING = 1e-12


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tripod(Comparable):
    """Three equal support points, equilateral about the centre of mass.

    Parameters
    ----------
    radius : float
        Distance of the points from the centre of mass [m].
    friction : float
        Coefficient of friction against the plane [-].
    angle : float
        Angle of the first point from the body's x axis [rad].

    Examples
    --------
    >>> from fixel.units import mm
    >>> Tripod(radius=38 * mm, friction=0.25).radius
    0.038
    """

    radius: Annotated[float, Value(positive, "m")]
    friction: Annotated[float, Value(non_negative)]
    angle: Annotated[float, Value(finite, "rad")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "tripod")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SupportPoints(Comparable):
    """Support at given points.

    Loads on three points follow from the balance out of the plane; others are given or equal.

    Parameters
    ----------
    points : (n, 2) array_like
        Points in the frame of the shape [m].
    friction : float or (n,) array_like
        Coefficients of friction against the plane [-].
    loads : (n,) array_like, optional
        Normal force at each point [N]; not for three points.

    Examples
    --------
    >>> feet = [(-0.03, -0.02), (0.03, -0.02), (0.0, 0.04)]
    >>> SupportPoints(points=feet, friction=0.25).points.shape
    (3, 2)
    """

    points: Annotated[FloatArray, Value(table, "x [m], y [m]")]
    friction: float | FloatArray
    loads: FloatArray | None = None

    def __post_init__(self) -> None:
        points = table(self.points, "points.at", "x [m], y [m]")
        friction = self.friction
        if np.ndim(friction) == 0:
            friction = non_negative(friction, "points.friction")
        else:
            friction = _one_per_point(friction, len(points), "points.friction", "coefficient")
        loads = self.loads
        if loads is not None:
            loads = _one_per_point(loads, len(points), "points.loads", "load [N]")
            _check_loads(loads)
        settle(self, points=points, friction=friction, loads=loads)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UniformPressure(Comparable):
    """Even pressure over the footprint, as quadrature points.

    For a centre of mass away from the centroid, the pressure is tilted linearly to balance it.

    Parameters
    ----------
    friction : float
        Coefficient of friction against the plane [-].
    n_points : int
        Approximate number of points of the footprint; the exact one depends on the shape.

    Examples
    --------
    >>> UniformPressure(friction=0.25).n_points
    64
    """

    friction: Annotated[float, Value(non_negative)]
    n_points: int = 64

    def __post_init__(self) -> None:
        n_points = finite(self.n_points, "uniform.n_points")
        if n_points != int(n_points) or not 3 <= n_points <= 100_000:
            raise InvalidInput(
                "uniform.n_points", found=self.n_points, expected="a whole number from 3 to 100000"
            )
        check_fields(self, "uniform")
        settle(self, n_points=int(n_points))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipsoid(Comparable):
    """Ellipsoidal limit surface. Prefer points where the pressure is known.

    Parameters
    ----------
    force : float
        Largest friction force, sliding without rotation [N].
    torque : float
        Largest friction torque, rotating about the centre [N m].
    centre : (2,) array_like
        Centre of friction in the frame of the shape [m].

    References
    ----------
    :cite:t:`howe1996`; :cite:t:`goyal1991`.

    Examples
    --------
    >>> Ellipsoid(force=0.37, torque=0.014).centre
    array([0., 0.])
    """

    force: Annotated[float, Value(positive, "N")]
    torque: Annotated[float, Value(positive, "N m")]
    centre: Annotated[ArrayField, Value(vector, "x [m], y [m]")] = (0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        check_fields(self, "ellipsoid")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoSupport(Comparable):
    """Support without friction.

    Examples
    --------
    >>> from fixel.model import Body, Disk
    >>> Body("puck", Disk(0.03), mass=0.1).support == NoSupport()
    True
    """


Support = Tripod | SupportPoints | UniformPressure | Ellipsoid | NoSupport


def support_points(
    support: Support, shape: Shape, centre_of_mass: ArrayLike, mass: float, gravity: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the support points (n, 2) [m] of a body, and their loads [N] and friction [-].

    Points are relative to the centre of mass, in body axes; `NoSupport` has none. The centre of
    mass (2,) is in the frame of the shape [m]. An `Ellipsoid`, or a support that cannot carry the
    centre of mass, raises `InvalidInput`.
    """
    com = np.asarray(centre_of_mass, dtype=np.float64)
    weight = mass * gravity
    friction: float | FloatArray
    if isinstance(support, Tripod):
        angle = support.angle + np.arange(3) * (2.0 * pi / 3.0)
        points = support.radius * np.column_stack((np.cos(angle), np.sin(angle)))
        loads = np.full(3, weight / 3.0)
        friction = support.friction
    elif isinstance(support, SupportPoints):
        points = support.points - com
        loads = _point_loads(support, points, com, weight)
        friction = support.friction
    elif isinstance(support, UniformPressure):
        points, share = cells(shape, support.n_points)
        points = points - com
        loads = weight * _tilted(share, points, com)
        friction = support.friction
    elif isinstance(support, NoSupport):
        points, loads, friction = np.zeros((0, 2)), np.zeros(0), 0.0
    else:
        raise InvalidInput(
            "support",
            found=type(support).__name__,
            expected="Tripod, SupportPoints, UniformPressure or NoSupport",
            hint="an ellipsoidal limit surface has no points",
        )
    return frozen(points), frozen(loads), frozen(np.broadcast_to(friction, loads.shape))


def _point_loads(
    support: SupportPoints, points: FloatArray, com: FloatArray, weight: float
) -> FloatArray:
    if support.loads is not None:
        return support.loads
    n = len(points)
    if n != 3:
        return np.full(n, weight / n)
    return weight * _barycentric(points, com)


def _barycentric(points: FloatArray, com: FloatArray) -> FloatArray:
    """Shares of three points in a weight at the origin; raise if one would pull."""
    share = triangle_shares(points)
    if np.isnan(share).any():
        raise InvalidInput(
            "support.points.at",
            found="three points on one line",
            expected="a triangle",
            hint="give more points, or move one",
        )
    if share.min() < -LOAD_ROUNDING:
        weights = ", ".join(f"{s:.4g}" for s in share)
        raise InvalidInput(
            "support.points.at",
            found=f"the centre of mass ({com[0]:g}, {com[1]:g}) outside the support triangle"
            f" (barycentric weights {weights})",
            expected="weights of at least 0",
            hint="the body would tip over: move a point, or the centre of mass",
        )
    return np.maximum(share, 0.0)


def triangle_shares(points: FloatArray) -> FloatArray:
    """Shares (..., 3) of three points (..., 3, 2) in a weight at the origin.

    These are the barycentric coordinates of the origin: negative where a point would have to pull,
    NaN where the three lie on one line.

    Source: ASME 2006 paper, balance out of the plane.
    """
    a, b, c = (points[..., k, :] for k in range(3))
    with np.errstate(over="ignore", invalid="ignore"):  # points too far away for their area
        area = np.stack((_cross(b, c), _cross(c, a), _cross(a, b)), axis=-1)
        total = area.sum(axis=-1, keepdims=True)
        size = np.ptp(points, axis=-2).max(axis=-1)[..., None]
        flat = ~(np.abs(total) >= 1e-9 * size**2) | ~np.isfinite(total)
    share = np.divide(area, total, out=np.full_like(area, np.nan), where=~flat & (size > 0.0))
    return np.asarray(share)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _tilted(share: FloatArray, points: FloatArray, com: FloatArray) -> FloatArray:
    """Tilt shares of the weight to balance it; raise if one would be negative."""
    tilted = tilted_shares(share, points)
    if tilted.min() < -LOAD_ROUNDING:
        x, y = -(share @ points)
        raise InvalidInput(
            "support.uniform",
            found=f"a centre of mass at ({com[0]:g}, {com[1]:g}),"
            f" ({x:g}, {y:g}) m from the centroid: the pressure would be negative at one end",
            expected="a centre of mass closer to the centroid",
            hint="give support points instead",
        )
    return np.maximum(tilted, 0.0)


def tilted_shares(share: FloatArray, points: FloatArray) -> FloatArray:
    """Tilt shares (..., n) of the weight under p0 to p0 (1 + a . r), such that their centre is the
    origin; they may come out negative. Points (n, 2) are relative to the centre of mass [m].
    """
    centroid = times_each(share, points)
    r = points - centroid[..., None, :]
    moment = np.swapaxes(share[..., None] * r, -1, -2) @ r
    tilt = np.linalg.solve(moment, -centroid[..., None])
    return np.asarray(share * (1.0 + (r @ tilt)[..., 0]))


def times_each(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Multiply rows (..., k) by a matrix (k, m), each by itself: in a product of all, the last bits
    of a row depend on the number of rows."""
    return np.asarray((rows[..., None, :] @ matrix)[..., 0, :])


def _one_per_point(value: ArrayLike, n: int, where: str, what: str) -> FloatArray:
    row = np.asarray(value)
    if row.shape != (n,) or row.dtype.kind not in "iuf":
        raise InvalidInput(
            where, found=f"{row.size} values", expected=f"one {what} for each of the {n} points"
        )
    return frozen([non_negative(x, f"{where}[{k}]") for k, x in enumerate(row.tolist())])


def _check_loads(loads: FloatArray) -> None:
    if len(loads) == 3:
        raise InvalidInput(
            "points.loads",
            found="loads for three points",
            expected="no loads, since equilibrium determines them",
            hint="remove the loads, or split one point into two",
        )
    if loads.sum() <= 0.0:
        raise InvalidInput("points.loads", found="only zeros", expected="at least one load above 0")
