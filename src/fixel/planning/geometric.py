"""Pushes computed in closed form, with which a search for a plan starts."""

from __future__ import annotations

from math import pi, remainder, tau
from typing import Final

import numpy as np
import shapely
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import Body, Ellipsoid, NoSupport, Shape
from fixel.model.fields import finite, non_negative, numbers, positive, vector, whole
from fixel.model.support import support_points
from fixel.model.trajectory import pose_error, wrapped
from fixel.planning.orienting import OrientingPlan, PushFunction, hull_of, surviving_plan
from fixel.planning.pushes import outline_points
from fixel.typing import BoolArray, FloatArray
from fixel.units import deg

CONTACTS: Final = 64  # evenly spaced along the outline, besides those in line with the centre
ANGLES: Final = 9  # of each contact, up to the largest
LENGTHS: Final = 48  # of each angle, up to the longest
ANGLE_ERRORS: Final = (0.0, 5.0 * deg, 10.0 * deg)  # that plans by a fence survive


def geometric_pushes(
    part: Body,
    displacement: ArrayLike,
    *,
    friction: float = 0.25,
    tool_radius: float = 5e-3,
    angle: float = pi / 6,
    length: tuple[float, float] | None = None,
    n: int = 32,
) -> FloatArray:
    """Return straight pushes by a round tool that bring a part near to a displacement.

    The motion follows in closed form from a contact that does not slip and an ellipsoidal limit
    surface. Contacts of which the tool would slip are used last, and those that the tool does not
    reach not at all. Pushes through the centre of friction are among the contacts: they do not turn
    the part.

    Parameters
    ----------
    part : Body
        Part with a support that has friction.
    displacement : (3,) array_like
        Pose of the part after the push in its frame before it [m, m, rad].
    friction : float
        Friction of the tool on the part [-].
    tool_radius : float
        Radius of the tool [m].
    angle : float
        Largest angle between the push and the inward normal [rad].
    length : (float, float), optional
        Range of the length of the push [m]; by default up to twice the way of the part.
    n : int
        Largest number of pushes.

    Returns
    -------
    (m, 3) float64
        Contact as a share of the way round the outline [-], angle from the inward normal [rad] and
        length [m]; the nearest to the displacement first, each pair of contact and angle once.

    Raises
    ------
    InvalidInput
        The displacement is zero or not finite, or the support has no friction.

    References
    ----------
    :cite:t:`howe1996`; :cite:t:`lynch1996`.

    Examples
    --------
    >>> from fixel import Polygon, UniformPressure
    >>> square = Polygon.rectangle(0.1, 0.1)
    >>> part = Body("part", square, mass=1, support=UniformPressure(friction=0.3))
    >>> geometric_pushes(part, (0.02, 0, 0), n=1).round(3)
    array([[0.875, 0.   , 0.02 ]])
    """
    non_negative(friction, "friction"), positive(tool_radius, "tool_radius", "m"), whole(n, "n")
    x, y, turn = vector(displacement, "displacement", "x [m], y [m], angle [rad]").tolist()
    arm = friction_arm(part)
    # Motion of the centre of mass.
    c, s = np.cos(turn), np.sin(turn)
    wanted = np.array([x, y, remainder(turn, tau)])
    wanted[:2] += np.array([[c, -s], [s, c]]) @ part.com - part.com
    way = float(np.hypot(*wanted[:2])) + 2.0 * arm * abs(wanted[2])
    if way == 0.0:
        raise InvalidInput("displacement", found="none", expected="a motion other than zero")
    low, high = length or (2.0 * way / LENGTHS, 2.0 * way)
    share = _contacts(part)
    point, inward = outline_points(part.shape, share)
    reached = _reached(part.shape, point, inward, tool_radius)
    share, point, inward = share[reached], point[reached] - part.com, inward[reached]
    turns = np.linspace(-angle, angle, ANGLES)
    own = np.repeat(np.arange(len(share)), ANGLES)
    turns = np.tile(turns, len(share))
    heading = np.arctan2(inward[own, 1], inward[own, 0]) + turns
    ways = np.linspace(low, high, LENGTHS)
    moved = point_push(point[own][:, None], heading[:, None], ways, arm)
    apart, turned = pose_error(moved, wanted)
    far = apart + arm * np.abs(turned)
    best = np.argmin(far, axis=1)
    rows = np.arange(len(best))
    # The contact turns with the part, so that the cone is widest used at one of the two ends.
    slips = _slips(point[own], inward[own], heading, friction, arm)
    slips |= _slips(point[own], inward[own], heading - moved[rows, best, 2], friction, arm)
    order = np.lexsort((far[rows, best], slips))[:n]
    return np.column_stack((share[own], turns, ways[best]))[order]


def fence_pushes(
    part: Body, target: float, *, most: int, angle: float = pi / 6, length: tuple[float, float]
) -> list[FloatArray]:
    """Return plans by a fence wider than the part that turn it to an angle from any other angle.

    Parameters
    ----------
    part : Body
        Part at its planned start pose.
    target : float
        Angle of the part after the plan, in the world [rad].
    most : int
        Largest number of pushes.
    angle : float
        Largest angle between a push and the inward normal at its contact [rad].
    length : (float, float)
        Range of the length of a push [m].

    Returns
    -------
    list of (k, 3) float64
        Contact as a share of the way round the outline [-], angle from the inward normal [rad] and
        length [m] of each push: the plan of fewest pushes, and those that survive larger errors.
        Plans with a larger angle than allowed at every contact are left out.

    Raises
    ------
    InvalidInput
        The part has no corners.

    Examples
    --------
    >>> from fixel import Polygon, UniformPressure
    >>> block = Polygon.rectangle(0.05, 0.035)
    >>> part = Body("part", block, mass=1, support=UniformPressure(friction=0.3))
    >>> [plan.shape for plan in fence_pushes(part, 0.0, most=2, angle=1.0, length=(0.02, 0.1))]
    [(2, 3)]
    """
    finite(target, "target", "rad"), whole(most, "most"), non_negative(angle, "angle", "rad")
    vector(length, "length", "shortest [m], longest [m]")
    plans = [surviving_plan(part, error) for error in ANGLE_ERRORS]
    found = {tuple(plan.rotations): plan for plan in plans if plan and plan.pushes <= most}
    pushes = [_carried_out(part, target, plan, angle, length) for plan in found.values()]
    return [own for own in pushes if np.abs(own[:, 1]).max() <= angle]


def _carried_out(
    part: Body, target: float, plan: OrientingPlan, angle: float, length: tuple[float, float]
) -> FloatArray:
    """Return the pushes (k, 3) of an orienting plan, from the planned pose of a part."""
    share = _contacts(part)
    point, inward = outline_points(part.shape, share)
    normal = np.arctan2(inward[:, 1], inward[:, 0])
    # Until flush from every start that is not closer to a border than the margins.
    off = min(plan.margin, 5.0 * deg)
    starts = pi - np.concatenate((plan.function.borders - off, plan.function.borders + off))
    way = float(np.clip(flush_distance(part, starts).max(), *length))
    heading = target - plan.angle - float(plan.rotations.sum())
    own, rows = float(part.pose[2]), []
    for rotation in (*plan.rotations.tolist(), 0.0):
        turns = wrapped(heading - own - normal)
        across = np.array([-np.sin(heading - own), np.cos(heading - own)])
        aside = np.abs((point - part.com) @ across)
        best = int(np.argmin(np.where(np.abs(turns) <= angle, aside, np.inf)))
        rows.append((share[best], turns[best], way))
        rest = plan.function.stable[plan.function.rest(pi - own + heading)]
        own, heading = pi - float(rest) + heading, heading + rotation
    return np.array(rows)


def point_push(contact: ArrayLike, heading: ArrayLike, length: ArrayLike, arm: float) -> FloatArray:
    """Compute the motion of a part that is pushed at a point without slip.

    Parameters
    ----------
    contact : (..., 2) array_like
        Point of contact from the centre of mass, in the frame of the part at the start [m].
    heading : (...) array_like
        Direction of the push in that frame [rad].
    length : (...) array_like
        Length of the push [m]; negative for a pull.
    arm : float
        Friction torque over friction force of an ellipsoidal limit surface [m].

    Returns
    -------
    (..., 3) float64
        Displacement of the centre of mass, and rotation [m, m, rad].

    Examples
    --------
    >>> point_push((-0.05, 0.0), 0.0, 0.02, 0.038)
    array([0.02, 0.  , 0.  ])
    """
    contact, heading = numbers(contact, "contact"), numbers(heading, "heading")
    length, arm = numbers(length, "length"), positive(arm, "arm", "m")
    lever = np.hypot(contact[..., 0], contact[..., 1])
    ahead = np.arctan2(-contact[..., 1], -contact[..., 0]) - heading
    start = wrapped(ahead)
    growth = np.exp(lever * length / (lever**2 + arm**2))
    # The half angle by its sine and cosine: the centre may lie straight behind the contact.
    end = 2.0 * np.arctan2(np.sin(0.5 * start) * growth, np.cos(0.5 * start))
    x = contact[..., 0] + length * np.cos(heading) + lever * np.cos(heading + end)
    y = contact[..., 1] + length * np.sin(heading) + lever * np.sin(heading + end)
    return np.stack(np.broadcast_arrays(x, y, end - start), axis=-1)


def _contacts(part: Body) -> FloatArray:
    """Return shares of the way round the outline: evenly spaced, and where the inward normal
    passes through the centre of mass."""
    outline = part.shape.outline
    ring = shapely.LinearRing(outline)
    even = (np.arange(CONTACTS) + 0.5) / CONTACTS
    along = np.roll(outline, -1, axis=0) - outline
    foot = ((part.com - outline) * along).sum(axis=1) / (along**2).sum(axis=1)
    inside = (foot > 0.0) & (foot < 1.0)
    feet = shapely.points(outline[inside] + foot[inside, None] * along[inside])
    return np.concatenate((shapely.line_locate_point(ring, feet, normalized=True), even))


def _reached(shape: Shape, point: FloatArray, inward: FloatArray, radius: float) -> BoolArray:
    """Return whether a round tool (n,) touches the outline at each contact without overlap."""
    centre = shapely.points(point - 1.001 * radius * inward)
    return np.asarray(shapely.distance(shapely.Polygon(shape.outline), centre) >= radius)


def _slips(
    point: FloatArray, inward: FloatArray, heading: FloatArray, friction: float, arm: float
) -> BoolArray:
    """Return whether the force that moves a contact along `heading` is outside its cone."""
    along = np.column_stack((np.cos(heading), np.sin(heading)))
    across = np.column_stack((-point[:, 1], point[:, 0]))
    # Force of which the contact moves along: the inverse of 1 + across across^T / arm^2.
    share = (across * along).sum(axis=1) / (arm**2 + (across**2).sum(axis=1))
    force = along - share[:, None] * across
    normal = (force * inward).sum(axis=1)
    tangent = np.abs(force[:, 0] * inward[:, 1] - force[:, 1] * inward[:, 0])
    return np.asarray(tangent > friction * normal)


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
    lever, arm = numbers(lever, "lever"), numbers(arm, "arm")
    start, end = numbers(start, "start"), numbers(end, "end")
    for name, angles in (("start", start), ("end", end)):
        if not ((angles >= 0.0) & (angles <= pi)).all():
            raise InvalidInput(name, found=angles.tolist(), expected="angles from 0 to pi [rad]")
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
    directions = np.mod(pi - numbers(angles, "angles"), tau)
    turn = wrapped(function.stable[function.rest(directions)] - directions)
    # Each corner touches while the fence is between the normals of its two edges.
    along = np.roll(corners, -1, axis=0) - corners
    normal = np.arctan2(-along[:, 0], along[:, 1])
    low, high = wrapped(np.roll(normal, 1) - polar), wrapped(normal - polar)
    distance = np.zeros(directions.shape)
    for k, lever in enumerate(levers):
        start = wrapped(directions - polar[k])
        for full_turn in (-tau, 0.0, tau):
            ends = np.clip([start + full_turn, start + turn + full_turn], low[k], high[k])
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
