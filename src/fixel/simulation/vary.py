"""Application of named parameters to scenes, which defines their meaning.

All quantities are SI, and vectorised over rollouts: a value (n,) makes the quantities that it
changes (n, ...); others remain shared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.model import Body, Disk, Parameters, Pusher, Scene, SupportPoints, UniformPressure
from fixel.model.fields import floats, instance
from fixel.model.parameters import check_supports, info_of
from fixel.model.support import LOAD_ROUNDING, cells, tilted_shares, times_each, triangle_shares
from fixel.simulation import load_profile
from fixel.typing import FloatArray, IntArray

Values = Mapping[str, FloatArray]  # name -> (n,)

MIN_FACTOR = 0.05  # least friction of the plane in one direction, relative to its mean
NO_LOAD = 1e-300  # share of a point without load, whose logarithm is needed
PRESSURE_POINTS = 24  # approximate number of points for pressure under the whole body

_CORNERS = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")


class Variation(NamedTuple):
    """Quantities that differ between rollouts of one scene; None for those that do not."""

    parameters: Values
    start: FloatArray | None = None  # (n, n_free, 3) poses of the free bodies' shape frames
    path: FloatArray | None = None  # (n_path, n_sample, 4) waypoints of the one pusher
    path_of: IntArray | None = None  # (n,) index of the path of a rollout; its own by default
    fixels: FloatArray | None = None  # (n, n_fixel, 3) errors of the poses of the fixels


AS_IT_IS = Variation({})


class Elements(NamedTuple):
    """Support friction elements of all free bodies."""

    body: IntArray  # (n_element,)
    kind: IntArray  # (n_element,)
    point: FloatArray  # ([n,] n_element, 2) from the centre of mass [m]
    load: FloatArray  # ([n,] n_element) force [N]; of an ellipsoid its largest, with friction 1
    friction: FloatArray  # ([n,] n_element)
    arm: FloatArray  # ([n,] n_element) ellipsoid: largest torque over largest force [m]
    unit: FloatArray  # (n_element, 2) tripods: direction of the point, else zero


class VariedScene(NamedTuple):
    """Quantities of a scene that parameters change; None for those that they leave."""

    start: FloatArray | None  # (n, n_free, 3) poses of the outlines at the start
    elements: Elements
    mass_ratio: FloatArray | None  # (n,) of the one free body
    friction: FloatArray  # ([n,] n_body, n_body)
    growth: FloatArray | None  # (n,) of the pushers' radii [m]
    registration: FloatArray | None  # (n, 3) pose of the frame of the pusher's path
    plane: FloatArray  # ([n,] 3) see `varied_plane`
    outline: FloatArray | None  # (n, 3) pose of the outline in the frame of the poses


def vary(
    scene: Scene, elements: Elements, friction: FloatArray, variation: Variation
) -> VariedScene:
    """Apply a variation to a scene, with its supports and the friction of its pairs."""
    values = variation.parameters
    _check_own(values)
    plane = varied_plane(scene, values)
    if plane.ndim == 2 and _is_slippery(plane).any():  # changed by parameters
        found = "a plane without friction along one axis"
        expected = f"differences from the mean below {1.0 - MIN_FACTOR:g}"
        raise InvalidInput("parameters.anisotropy_xy", found=found, expected=expected)
    start = varied_start(scene, variation.start, values)
    return VariedScene(
        start=start,
        elements=varied_elements(scene, elements, values, start),
        mass_ratio=heavier_by(scene, values),
        friction=varied_friction(scene, friction, values),
        growth=grown_by(scene, values),
        registration=registration_of(values),
        plane=plane,
        outline=_columns(values, "outline"),
    )


def _check_own(values: Values) -> None:
    """Raise for parameters of another engine, which change nothing here."""
    for name in values:
        engine, dot, _ = name.partition(".")
        if dot:
            expected = "parameters of the scene, for a motion model of fixel"
            hint = f"simulate by the engine: motion={engine!r}, or --engine {engine}"
            raise InvalidInput("parameters", found=name, expected=expected, hint=hint)


def _only_body(scene: Scene, name: str) -> Body:
    """Return the one free body that a parameter needs."""
    n = len(scene.bodies)
    if n != 1:
        raise InvalidInput(f"parameters.{name}", found=f"{n} free bodies", expected="one")
    return scene.bodies[0]


# --- supports -----------------------------------------------------------------------------------


def varied_elements(
    scene: Scene, elements: Elements, values: Values, start: FloatArray | None = None
) -> Elements:
    """Apply parameters to the supports; raise where no support matches a name.

    `start` (n, n_free, 3) are poses of the outlines at the start, from `varied_start` [m, m, rad];
    the scene's by default.
    """
    check_supports(values)
    if "pressure_spread" in values:
        elements = _under_pressure(scene, elements, values["pressure_spread"])
    if any(name in values for name in _CORNERS):
        elements = _on_three_points(scene, elements, values)
    if any(name.startswith("load_") for name in values):
        elements = _under_loads(scene, elements, values)
    if any(name in values for name in load_profile.PROFILE_NAMES):
        elements = _on_net(scene, elements, values, start)
    elif any(name in values for name in load_profile.TABLE_NAMES):
        elements = _on_table(scene, elements, values, start)
    elements = on_load_map(scene, elements, start)
    if "tripod_radius" in values:
        elements = _at_radius(elements, values["tripod_radius"])
    if "mu_support" in values:
        if np.any(elements.kind == codes.ELLIPSOID):
            found = "a body on an ellipsoidal limit surface, which has no coefficient"
            expected = "bodies on support points"
            hint = "change the force and torque of the ellipsoid instead"
            raise InvalidInput("parameters.mu_support", found=found, expected=expected, hint=hint)
        mu = values["mu_support"][:, None] * np.ones(len(elements.body))
        elements = elements._replace(friction=mu)
    if "ellipsoid_force" in values or "ellipsoid_torque" in values:
        elements = _of_ellipsoid(elements, values)
    heavier = heavier_by(scene, values)
    if heavier is not None:
        points = elements.kind == codes.POINT
        load = np.where(points, heavier[:, None], 1.0) * elements.load
        elements = elements._replace(load=load)
    for axis, name in enumerate(("friction_centre_x", "friction_centre_y")):
        if name in values:
            point = np.array(_own(elements.point, len(values[name]), 2))
            point[:, :, axis] += values[name][:, None]
            elements = elements._replace(point=point)
    return elements


def pressure_shares(scene: Scene, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (k, 2) under the one body from its centre of mass [m], and their shares (n, k) of the
    weight, which may come out negative.

    Pressure is even times exp(spread/2 (r^2/g^2 - 1)), with the distance r from the centroid and
    its root mean square g, tilted to balance the weight.
    """
    body = _only_body(scene, "pressure_spread")
    points, share = cells(body.shape, PRESSURE_POINTS)
    square = ((points - body.shape.centroid) ** 2).sum(axis=1)
    exponent = 0.5 * spread[:, None] * (square / (share @ square) - 1.0)
    # Larger exponents would have no further effect.
    load = share * np.exp(
        np.clip(exponent, -load_profile.MAX_TABLE_EXPONENT, load_profile.MAX_TABLE_EXPONENT)
    )
    load /= load.sum(axis=1, keepdims=True)
    return points - body.com, tilted_shares(load, points - body.com)


def _under_pressure(scene: Scene, elements: Elements, spread: FloatArray) -> Elements:
    """Replace the supports by pressure under the whole body, with the same total friction."""
    points, share = pressure_shares(scene, spread)
    if not (share >= -LOAD_ROUNDING).all():
        found = "pressure that would be negative at one end"
        expected = "a centre of mass closer to the centroid"
        raise InvalidInput("parameters.pressure_spread", found=found, expected=expected)
    return _pressing(scene, elements, points, np.maximum(share, 0.0))


def _on_net(scene: Scene, elements: Elements, values: Values, start: FloatArray | None) -> Elements:
    """Replace the supports by balanced loads on a net of points, with the same total friction.

    An uneven table changes the loads before the balance.
    """
    body = _only_body(scene, "pressure_rim")
    net = load_profile.LoadNet.of(body.shape)
    n = next(len(values[name]) for name in load_profile.PROFILE_NAMES if name in values)
    angle = np.broadcast_to(body.pose[2] if start is None else start[:, 0, 2], n)
    shares = net.shares(values, body.com, angle, body.shape.centroid)
    return _pressing(scene, elements, net.points - body.com, shares)


def _pressing(scene: Scene, elements: Elements, points: FloatArray, share: FloatArray) -> Elements:
    """Return supports on points (k, 2) from the centre of mass with shares (n, k) of the weight,
    and the total friction of others."""
    weight = scene.bodies[0].mass * scene.gravity
    force = float(elements.load @ elements.friction)
    k = len(points)
    return Elements(
        body=np.zeros(k, np.int64),
        kind=np.full(k, codes.POINT, np.int64),
        point=points,
        load=weight * share,
        friction=np.full(k, force / weight if weight > 0.0 else 0.0),
        arm=np.zeros(k),
        unit=np.zeros((k, 2)),
    )


def three_points(scene: Scene, values: Values) -> tuple[FloatArray, FloatArray]:
    """Return free support points (n, 3, 2) in the frame of the shape [m], and their shares (n, 3)
    of the weight; negative where the body would tip over, NaN for three points on one line."""
    body = scene.bodies[0]
    support = body.support
    if len(scene.bodies) != 1 or not isinstance(support, SupportPoints) or len(support.points) != 3:
        found, expected = "no body on three support points", "a body on three support points"
        raise InvalidInput("parameters.support_1_x", found=found, expected=expected)
    n = next(len(values[name]) for name in _CORNERS if name in values)
    points = np.array(np.broadcast_to(support.points, (n, 3, 2)))
    for place, name in enumerate(_CORNERS):
        if name in values:
            points[:, place // 2, place % 2] = values[name]
    return points, triangle_shares(points - body.com)


def _on_three_points(scene: Scene, elements: Elements, values: Values) -> Elements:
    points, share = three_points(scene, values)
    if not (share >= -LOAD_ROUNDING).all():
        found = "support points with the centre of mass outside their triangle"
        expected = "points whose triangle contains the centre of mass"
        raise InvalidInput("parameters.support_1_x", found=found, expected=expected)
    body = scene.bodies[0]
    return elements._replace(
        point=points - body.com, load=body.mass * scene.gravity * np.maximum(share, 0.0)
    )


def _under_loads(scene: Scene, elements: Elements, values: Values) -> Elements:
    body = scene.bodies[0]
    support = body.support
    if len(scene.bodies) != 1 or not isinstance(support, SupportPoints) or len(support.points) < 4:
        raise InvalidInput(
            "parameters.load_1",
            found="no body on four or more support points",
            expected="a body on four or more support points",
            hint="the loads of three points follow from their positions",
        )
    given = {int(name[5:]): v for name, v in values.items() if name.startswith("load_")}
    if max(given) > len(support.points):
        found, expected = f"{len(support.points)} support points", "a load for one of them"
        raise InvalidInput(f"parameters.load_{max(given)}", found=found, expected=expected)
    n = len(next(iter(given.values())))
    load = np.array(_own(elements.load, n, 1))
    load /= load.mean(axis=1, keepdims=True)
    for k, value in given.items():
        load[:, k - 1] = value
    total = load.sum(axis=1, keepdims=True)
    if not (total > 0.0).all():
        raise InvalidInput(
            "parameters.load_1", found="only zeros", expected="at least one load above 0"
        )
    return elements._replace(load=body.mass * scene.gravity * load / total)


def _on_table(
    scene: Scene, elements: Elements, values: Values, start: FloatArray | None
) -> Elements:
    """Distribute the loads as on an uneven table; their sum does not change.

    The angle of the body is that at the start, since loads are constant during a rollout.
    """
    body = scene.bodies[0]
    known = isinstance(body.support, SupportPoints | UniformPressure) and len(elements.body) >= 4
    if len(scene.bodies) != 1 or not known:
        found = "no body on four or more support points"
        expected = "a body on four or more support points, or with uniform pressure"
        hint = "the loads of three points are the same on every table"
        raise InvalidInput("parameters.table_bend", found=found, expected=expected, hint=hint)
    n = next(len(values[name]) for name in load_profile.TABLE_NAMES if name in values)
    angle = np.broadcast_to(body.pose[2] if start is None else start[:, 0, 2], n)
    away = elements.point + body.com - body.shape.centroid
    load = elements.load * load_profile.factors_on_table(away, angle, values)
    total, now = elements.load.sum(axis=-1), load.sum(axis=-1)
    # Without gravity there is no load to distribute.
    ratio = np.divide(total, now, out=np.ones(n), where=now > 0.0)
    return elements._replace(load=load * ratio[:, None])


def on_load_map(scene: Scene, elements: Elements, start: FloatArray | None) -> Elements:
    """Distribute the loads of every body as on the uneven table of the scene.

    Their sum and their centre do not change, so that three points bear what they bore before.
    `start` (n, n_free, 3) are poses of the outlines at the start [m, m, rad]; the scene's by
    default.
    """
    uneven = scene.plane.load_map
    if uneven is None:
        return elements
    poses = np.array([[body.pose for body in scene.bodies]]) if start is None else start
    load = np.atleast_2d(elements.load)
    load = np.array(np.broadcast_to(load, (max(len(poses), len(load)), len(elements.body))))
    for k, body in enumerate(scene.bodies):
        own = np.flatnonzero((elements.body == k) & (elements.kind == codes.POINT))
        if len(own) > 3:
            place = elements.point[own] + body.com
            height = uneven.at(world_places(place, poses[:, k]))
            # Not `load[:, own]`, where sums over points depend on the number of rows.
            load[:, own] = redistributed(load.take(own, axis=1), height, place)
    shared = start is None and elements.load.ndim == 1
    return elements._replace(load=load[0] if shared else load)


def world_places(place: FloatArray, pose: FloatArray) -> FloatArray:
    """Return the places (n, k, 2) of points (k, 2) of a body at poses (n, 3)."""
    return composed(pose[:, None], np.pad(place, ((0, 0), (0, 1))))[..., :2]


def redistributed(load: FloatArray, height: FloatArray, place: FloatArray) -> FloatArray:
    """Return loads (n, k) on points (k, 2) times exp(height), with their former sum and centre."""
    total = load.sum(axis=1, keepdims=True)
    share = np.divide(load, total, out=np.zeros_like(load), where=total > 0.0)
    away = (place - place.mean(axis=0)) / float(np.ptp(place, axis=0).max())
    # Points without load keep next to none, and those of a body without weight none.
    exponent = np.log(np.maximum(share, NO_LOAD)) + height
    exponent += times_each(load_profile.balance(exponent, away, times_each(share, away)), away.T)
    bare = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return np.asarray(total * bare / bare.sum(axis=1, keepdims=True))


def _at_radius(elements: Elements, radius: FloatArray) -> Elements:
    tripod = np.any(elements.unit != 0.0, axis=1)
    if not tripod.any():
        found, expected = "no body on a tripod", "a tripod support, whose radius is changed"
        raise InvalidInput("parameters.tripod_radius", found=found, expected=expected)
    moved = radius[:, None, None] * elements.unit
    return elements._replace(point=np.where(tripod[:, None], moved, elements.point))


def _of_ellipsoid(elements: Elements, values: Values) -> Elements:
    if not np.any(elements.kind == codes.ELLIPSOID):
        found = "no body on an ellipsoidal limit surface"
        expected = "an ellipsoid, whose axes are changed"
        raise InvalidInput("parameters.ellipsoid_force", found=found, expected=expected)
    n = next(len(v) for name, v in values.items() if name.startswith("ellipsoid_"))
    curved = elements.kind == codes.ELLIPSOID
    force = _own(elements.load, n, 1)
    torque = force * elements.arm
    if "ellipsoid_force" in values:
        force = np.where(curved, values["ellipsoid_force"][:, None], force)
    if "ellipsoid_torque" in values:
        torque = np.where(curved, values["ellipsoid_torque"][:, None], torque)
    arm = np.divide(torque, force, out=np.zeros_like(force), where=curved)
    return elements._replace(load=force, arm=arm)


def _own(array: FloatArray, n: int, n_axis: int) -> FloatArray:
    """Broadcast an array that may be shared to one leading row per rollout."""
    return array if array.ndim > n_axis else np.broadcast_to(array, (n, *array.shape))


def heavier_by(scene: Scene, values: Values) -> FloatArray | None:
    """Ratio (n,) of the mass of the one free body to the scene's; None if it does not vary."""
    if "mass" not in values:
        return None
    return values["mass"] / _only_body(scene, "mass").mass


# --- contacts, plane, poses ---------------------------------------------------------------------


def varied_friction(scene: Scene, friction: FloatArray, values: Values) -> FloatArray:
    """Apply parameters to the friction of pairs, ([n,] n_body, n_body)."""
    n_free = len(scene.bodies)
    n_moving, n_body = n_free + len(scene.pushers), len(scene.names)
    for name, first, last in (("mu_pusher", n_free, n_moving), ("mu_fixel", n_moving, n_body)):
        if name in values:
            n = len(values[name])
            friction = np.array(_own(friction, n, 2))
            friction[:, :n_free, first:last] = values[name][:, None, None]
            friction[:, first:last, :n_free] = values[name][:, None, None]
    return friction


def varied_plane(scene: Scene, values: Values) -> FloatArray:
    """Factors of support friction along the plane's axes, angle of the first [rad]: (3,) or (n, 3).

    The two parameters are components of a symmetric traceless tensor, which is smooth where the
    plane is isotropic. The mean, and a component that is not given, are those of the scene.
    """
    first, second = scene.plane.anisotropy
    axis, mean = scene.plane.axis, 0.5 * (first + second)
    if "anisotropy_xy" not in values and "anisotropy_diagonal" not in values:
        return np.array([first, second, axis], np.float64)
    own = 0.5 * (first - second) / mean
    a = values.get("anisotropy_xy", own * math.cos(2.0 * axis))
    b = values.get("anisotropy_diagonal", own * math.sin(2.0 * axis))
    size = np.hypot(a, b)
    return np.column_stack((mean * (1.0 + size), mean * (1.0 - size), 0.5 * np.arctan2(b, a)))


def _is_slippery(plane: FloatArray) -> NDArray[np.bool_]:
    """Return whether planes (n, 3) have hardly any friction along one axis."""
    return np.asarray(plane[:, 1] <= MIN_FACTOR * plane[:, :2].mean(axis=1))


def varied_start(scene: Scene, start: FloatArray | None, values: Values) -> FloatArray | None:
    """Poses (n, n_free, 3) of the outlines at the start; None where they are the scene's."""
    shift, outline = _columns(values, "start"), _columns(values, "outline")
    if shift is None and outline is None:
        return start
    body = _only_body(scene, "start_x")
    n = len(shift if shift is not None else outline)  # type: ignore[arg-type]
    own = body.pose if start is None else start
    poses = np.array(np.broadcast_to(own, (n, 1, 3)))
    if shift is not None:
        poses += shift[:, None]
    if outline is not None:
        poses = composed(poses, outline[:, None])
    return poses


def registration_of(values: Values) -> FloatArray | None:
    """Pose (n, 3) that moves the recorded path of the pusher; None where no parameter does."""
    return _columns(values, "registration")


def grown_by(scene: Scene, values: Values) -> FloatArray | None:
    """Excess (n,) of the pushers' radii over those of the scene [m]; None without."""
    if "contact_offset" not in values:
        return None
    if not scene.pushers or not all(isinstance(p.shape, Disk) for p in scene.pushers):
        raise InvalidInput(
            "parameters.contact_offset", found="a pusher that is not round", expected="disks"
        )
    if values["contact_offset"].min() <= -_smallest(scene.pushers):
        raise InvalidInput(
            "parameters.contact_offset",
            found=float(values["contact_offset"].min()),
            expected="a decrease smaller than the radius of the pusher",
        )
    return values["contact_offset"]


def _smallest(pushers: tuple[Pusher, ...]) -> float:
    return min((p.shape.radius for p in pushers if isinstance(p.shape, Disk)), default=math.inf)


def _columns(values: Values, prefix: str) -> FloatArray | None:
    """Columns x, y and angle (n, 3) of a family of names; zero for missing, None without any."""
    names = [f"{prefix}_{axis}" for axis in ("x", "y", "theta")]
    n = next((len(values[name]) for name in names if name in values), None)
    if n is None:
        return None
    return np.column_stack([values.get(name, np.zeros(n)) for name in names])


def composed(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Compose poses (..., 3): a_from_c of a_from_b and b_from_c."""
    outer, inner = np.broadcast_arrays(outer, inner)
    c, s = np.cos(outer[..., 2]), np.sin(outer[..., 2])
    (x, y, turn), at = np.moveaxis(inner, -1, 0), np.moveaxis(outer, -1, 0)
    return np.stack((at[0] + c * x - s * y, at[1] + s * x + c * y, at[2] + turn), axis=-1)


def inverted(pose: FloatArray) -> FloatArray:
    """Invert poses (..., 3): b_from_a of a_from_b."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = pose[..., 0], pose[..., 1]
    return np.stack((-c * x - s * y, s * x - c * y, -pose[..., 2]), axis=-1)


# --- what cannot be -----------------------------------------------------------------------------


def infeasible(scene: Scene, values: Values) -> list[str]:
    """Reasons why each of n sets of values is infeasible; empty for feasible ones."""
    n = len(next(iter(values.values())))
    reasons = [""] * n
    for name, value in values.items():
        info = info_of(name)
        low = value <= info.lowest if info.above else value < info.lowest
        _note(reasons, np.asarray(low), f"{name} below its smallest value")
    if any(name in values for name in _CORNERS):
        points, share = three_points(scene, values)
        outline = shapely.Polygon(scene.bodies[0].shape.outline)
        inside = shapely.intersects_xy(outline, points[..., 0], points[..., 1]).all(axis=1)
        _note(reasons, ~inside, "a support point outside the outline")
        carried = np.all(share >= -LOAD_ROUNDING, axis=1)
        _note(reasons, ~carried, "the centre of mass outside the support triangle")
    if "pressure_spread" in values:
        _, share = pressure_shares(scene, values["pressure_spread"])
        tips = "the centre of mass too far from the centroid for positive pressure everywhere"
        _note(reasons, np.any(share < -LOAD_ROUNDING, axis=1), tips)
    if any(name in values for name in load_profile.PROFILE_NAMES) and len(scene.bodies) == 1:
        body = scene.bodies[0]
        if not load_profile.can_balance(load_profile.LoadNet.of(body.shape).points - body.com):
            _note(reasons, np.ones(n, bool), "the centre of mass is not above the support points")
    loads = [v for name, v in values.items() if name.startswith("load_")]
    if loads:
        _note(reasons, np.asarray(np.sum(loads, axis=0) <= 0.0), "no load on any support point")
    if "contact_offset" in values:
        gone = np.asarray(values["contact_offset"] <= -_smallest(scene.pushers))
        _note(reasons, gone, "a pusher without extent")
    if "anisotropy_xy" in values or "anisotropy_diagonal" in values:
        slippery = _is_slippery(varied_plane(scene, values))
        _note(reasons, slippery, "a plane without friction along one axis")
    return reasons


def _note(reasons: list[str], where: NDArray[np.bool_], reason: str) -> None:
    for k in np.flatnonzero(where):
        reasons[k] = reasons[k] or reason


def variation_of(
    scene: Scene,
    parameters: Mapping[str, ArrayLike] | Sequence[Mapping[str, float]] | None,
    start: ArrayLike | None,
    waypoints: ArrayLike | None,
) -> tuple[Variation, int]:
    """Check the variation of a scene; return it with its number of runs."""
    if not isinstance(parameters, Mapping | None):
        instance(parameters, Sequence, "parameters", "values by name, or a sequence of such")
        for k, own in enumerate(parameters):
            instance(own, Mapping, f"parameters[{k}]", "values by name")
            if set(own) != set(parameters[0]):
                raise InvalidInput(
                    f"parameters[{k}]",
                    found=", ".join(sorted(own)),
                    expected=f"the names of the first set: {', '.join(sorted(parameters[0]))}",
                )
        names = sorted(parameters[0] if parameters else ())
        parameters = {name: [own[name] for own in parameters] for name in names}
    values = {k: np.atleast_1d(floats(v, k, "numbers")) for k, v in (parameters or {}).items()}
    for name, column in values.items():
        # Parameters checks names and ranges; the smallest value is the most likely to fail.
        if column.size:
            Parameters({name: float(column.min())})
        _check_shape(name, column, ())
    lengths = {f"parameters.{name}": len(v) for name, v in values.items()}
    poses = path = None
    if start is not None:
        poses = floats(start, "start", "x [m], y [m], theta [rad] of each free body")
        poses = poses[:, None, :] if poses.ndim == 2 else poses
        _check_shape("start", poses, (len(scene.bodies), 3))
        lengths["start"] = len(poses)
    if waypoints is not None:
        path = floats(waypoints, "waypoints", "time [s], x [m], y [m], theta [rad]")
        check_one_pusher(scene, "waypoints")
        _check_shape("waypoints", path, (path.shape[1] if path.ndim == 3 else 0, 4))
        if np.any(np.diff(path[:, :, 0], axis=1) <= 0.0):
            found, expected = "a time that does not increase", "times in increasing order"
            raise InvalidInput("waypoints", found=found, expected=expected)
        lengths["waypoints"] = len(path)
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        found = ", ".join(f"{name}: {n}" for name, n in lengths.items())
        raise InvalidInput("variations", found=found, expected="the same length for all, not 0")
    return Variation(values, poses, path), next(iter(lengths.values()), 1)


def check_one_pusher(scene: Scene, where: str) -> None:
    """Raise for a scene with another number of pushers."""
    n = len(scene.pushers)
    if n != 1:
        raise InvalidInput(where, found=f"{n} pushers", expected="a scene with one pusher")


def _check_shape(where: str, array: FloatArray, tail: tuple[int, ...]) -> None:
    if array.shape[1:] != tail or not np.isfinite(array).all():
        raise InvalidInput(
            where,
            found=f"shape {array.shape}" + ("" if np.isfinite(array).all() else ", not all finite"),
            expected=f"finite numbers of shape ({', '.join(['n', *map(str, tail)])})",
        )
