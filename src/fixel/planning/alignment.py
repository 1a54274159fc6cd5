"""Distances and angles of pushes that align a part, turn it, or leave it at rest on the tool."""

from __future__ import annotations

from math import pi, tau

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import Body, Ellipsoid, NoSupport, Shape
from fixel.model.fields import non_negative, positive
from fixel.model.support import support_points
from fixel.model.trajectory import wrapped
from fixel.planning.orienting import PushFunction, hull_of
from fixel.typing import FloatArray


def friction_arm(body: Body) -> float:
    """Return the largest friction torque of a support divided by its largest friction force [m].

    Parameters
    ----------
    body : Body
        Part with a support that has friction.

    Raises
    ------
    InvalidInput
        The support has no friction.

    Examples
    --------
    >>> from fixel import Polygon, UniformPressure
    >>> square = Polygon.rectangle(0.1, 0.1)
    >>> part = Body("part", square, mass=1.0, support=UniformPressure(friction=0.3, n_points=4096))
    >>> round(friction_arm(part), 4)
    0.0383
    """
    if isinstance(body.support, Ellipsoid):
        return body.support.torque / body.support.force
    if isinstance(body.support, NoSupport):
        raise InvalidInput("part.support", found="no friction", expected="a support with friction")
    points, loads, friction = support_points(body.support, body.shape, body.com, body.mass, 1.0)
    limit = loads * friction
    if not limit.sum() > 0.0:
        raise InvalidInput("part.support", found="no friction", expected="a support with friction")
    return float(limit @ np.hypot(*points.T) / limit.sum())


def alignment_distance(
    lever: ArrayLike, start: ArrayLike, end: ArrayLike, arm: ArrayLike
) -> FloatArray:
    """Compute how far a frictionless fence pushes a corner while the part turns.

    Parameters
    ----------
    lever : (...) array_like
        Distance of the corner from the centre of mass [m].
    start, end : (...) array_like
        Angles between the direction of pushing and the line from the corner to the centre of mass,
        between 0 and pi [rad].
    arm : (...) array_like
        Friction torque over friction force of an ellipsoidal limit surface, for which the distance
        is exact; or the radius of a disc about the centre of mass that contains the corner and all
        supports, for which it is an upper bound for every distribution of the pressure that has its
        centre at the centre of mass [m].

    Returns
    -------
    (...) float64
        Distances [m]; infinite from a start of 0, where the part may balance.

    References
    ----------
    :cite:t:`peshkin1988`.

    Examples
    --------
    >>> float(alignment_distance(0.076, 0.7, 0.785, 0.076).round(4))
    0.0139
    """
    lever, start, end, arm = (np.asarray(x, np.float64) for x in (lever, start, end, arm))
    with np.errstate(divide="ignore"):
        turned = np.log(np.tan(0.5 * end) / np.tan(0.5 * start))
    return np.asarray(lever * (np.cos(start) - np.cos(end)) + arm**2 / lever * turned)


def flush_distance(part: Body | Shape, angles: ArrayLike, arm: float | None = None) -> FloatArray:
    """Compute how far a wide fence must push until a part rests flat on it.

    Parameters
    ----------
    part : Body or Shape
        Part with an outline of corners; of a shape the centroid is the centre of mass.
    angles : (...) array_like
        Angles of the part at the start, from the direction of the push [rad].
    arm : float, optional
        Friction arm of an ellipsoidal limit surface, for which the distance is exact without
        friction at the fence [m]. By default the radius of the outline, which bounds the distance
        for every distribution of the pressure with its centre at the centre of mass.

    Returns
    -------
    (...) float64
        Distances from the first contact [m]; infinite where a corner is exactly ahead of the fence.

    Raises
    ------
    InvalidInput
        The part is a disk, its centre of mass lies outside its outline, or the arm is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from fixel import Polygon
    >>> from fixel.units import deg, mm
    >>> square = Polygon.rectangle(107.5 * mm, 107.5 * mm)
    >>> (1e3 * flush_distance(square, np.array([5, 10, 22.5]) * deg)).round(2)
    array([14.31, 29.26, 72.24])
    """
    corners = hull_of(part)
    levers, polar = np.hypot(*corners.T), np.arctan2(corners[:, 1], corners[:, 0])
    arm = float(levers.max()) if arm is None else positive(arm, "arm", "m")
    function = PushFunction.of(part)
    directions = np.mod(pi - np.asarray(angles, np.float64), tau)
    turn = wrapped(function.stable[function.rest(directions)] - directions)
    # Each corner touches while the fence is between the normals of its two edges.
    along = np.roll(corners, -1, axis=0) - corners
    normal = np.arctan2(-along[:, 0], along[:, 1])
    low, high = wrapped(np.roll(normal, 1) - polar), wrapped(normal - polar)
    distance = np.zeros(directions.shape)
    for k, lever in enumerate(levers):
        start = wrapped(directions - polar[k])
        for whole in (-tau, 0.0, tau):
            ends = np.clip([start + whole, start + turn + whole], low[k], high[k])
            inner, outer = np.sort(np.abs(ends), axis=0)
            touches = outer > inner
            inner, outer = np.where(touches, inner, 1.0), np.where(touches, outer, 1.0)
            distance += alignment_distance(lever, inner, outer, arm)
    return distance


def stable_push_angle(friction: float, half_width: float, depth: float) -> float:
    """Return the largest angle from the normal at which a flat tool pushes a part without slip.

    The tool touches an edge along `half_width` to either side of the foot of the centre of mass,
    and moves without rotation. The result holds for every distribution of the pressure with its
    centre at the centre of mass; at a larger angle the part slides or turns on the tool.

    Parameters
    ----------
    friction : float
        Friction of the tool on the part [-].
    half_width : float
        Half-width of the contact [m].
    depth : float
        Distance of the centre of mass from the edge [m].

    Returns
    -------
    float
        Angle [rad].

    References
    ----------
    :cite:t:`lynch1996`.

    Examples
    --------
    >>> from math import degrees
    >>> round(degrees(stable_push_angle(0.3, 0.009, 0.0175)), 2)
    16.7
    """
    non_negative(friction, "friction"), non_negative(half_width, "half_width", "m")
    return float(np.arctan(min(friction, half_width / positive(depth, "depth", "m"))))
