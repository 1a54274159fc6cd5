"""A plate whose friction differs from place to place, and bodies that rest on it unevenly."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import Body, Ellipsoid, FrictionMap, NoSupport, Plane, Support, SupportPoints
from fixel.model.chance import stream
from fixel.model.fields import frozen
from fixel.model.quadrature import cells
from fixel.model.shape import Shape
from fixel.model.support import support_points
from fixel.typing import FloatArray

# Area with a friction map: the thesis's plate with a margin.
PLATE_ORIGIN = (-0.2, -0.4)  # [m]
PLATE_SIZE = (0.8, 0.8)  # [m]
NODES_PER_GRAIN = 3
# Number of plane waves in the field: enough that its values are close to normal.
N_WAVES = 64


def rough_plane(plane: Plane, seed: int, roughness: float, grain: float) -> Plane:
    """Return the plane with a smooth random multiplier of friction, fixed in space.

    Parameters
    ----------
    plane : Plane
        Planned plane; its own friction map, if any, remains as a factor.
    seed : int
        Seed of the plate.
    roughness : float
        Standard deviation of the logarithm of the multiplier [-].
    grain : float
        Distance over which the multiplier changes: its correlation falls to exp(-1/2) [m].
    """
    if roughness == 0.0:
        return plane
    place, field = _smooth_field(seed, grain)
    factor = np.exp(roughness * field)
    if plane.friction_map is not None:
        factor *= plane.friction_map.at(place)
    cell = np.full(2, grain / NODES_PER_GRAIN)
    friction_map = FrictionMap(origin=np.array(PLATE_ORIGIN), cell=cell, factor=factor)
    return replace(plane, friction_map=friction_map)


@functools.lru_cache(maxsize=8)  # every run has the same plate
def _smooth_field(seed: int, grain: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes (n_y, n_x, 2) [m] and values (n_y, n_x) of mean 0 and variance 1 [-].

    The field is a sum of waves. Normal wave vectors of deviation 1/grain give values at a distance
    d the correlation exp(-(d/grain)^2 / 2).
    """
    spans = zip(PLATE_ORIGIN, PLATE_SIZE, strict=True)
    x, y = (start + np.arange(0.0, size, grain / NODES_PER_GRAIN) for start, size in spans)
    place = np.stack(np.meshgrid(x, y), axis=-1)
    random = stream(seed, "plate")
    wave = random.standard_normal((2, N_WAVES)) / grain
    phase = random.uniform(0.0, 2.0 * math.pi, N_WAVES)
    values = math.sqrt(2.0 / N_WAVES) * np.cos(place @ wave + phase).sum(axis=-1)
    return frozen(place), frozen(values)


def uneven_support(
    body: Body,
    gravity: float,
    seed: int,
    *,
    friction_ratio: float,
    n_cells: int,
    unevenness: float,
    centre: ArrayLike,
) -> SupportPoints | NoSupport:
    """Return the true support of a body: many points that press unequally.

    Parameters
    ----------
    body : Body
        Body with its planned support, from which the nominal friction is computed.
    gravity : float
        Acceleration of gravity [m/s^2].
    seed : int
        Seed of the underside; bodies of equal shape have the same underside.
    friction_ratio : float
        True friction over nominal [-].
    n_cells : int
        Approximate number of points.
    unevenness : float
        Standard deviation of the logarithm of the pressure [-].
    centre : (2,) array_like
        Centre of pressure from the centre of mass, body axes [m].

    Raises
    ------
    InvalidInput
        The centre of pressure is so far out that a point would pull.
    """
    friction = nominal_friction(body, gravity)
    if friction is None:
        return NoSupport()
    points, share = cells(body.shape, n_cells)
    random = stream(seed, "underside", _fingerprint(body.shape))
    share = share * np.exp(unevenness * random.standard_normal(len(share)))
    share = _centred(share / share.sum(), points, body.com + np.asarray(centre))
    return SupportPoints(
        points=points, friction=friction_ratio * friction, loads=body.mass * gravity * share
    )


def planned_support(support: Support, friction_ratio: float) -> Support:
    """Return the planned support with its friction multiplied by `friction_ratio` [-]."""
    if isinstance(support, NoSupport):
        return support
    if isinstance(support, Ellipsoid):
        force, torque = friction_ratio * support.force, friction_ratio * support.torque
        return replace(support, force=force, torque=torque)
    friction: Any = friction_ratio * support.friction  # one number, or one per point
    return replace(support, friction=friction)


def nominal_friction(body: Body, gravity: float) -> float | None:
    """Friction of a body against the plane, for any kind of support [-]; None without support."""
    support = body.support
    if isinstance(support, NoSupport):
        return None
    if isinstance(support, Ellipsoid):
        return support.force / (body.mass * gravity)
    _, loads, friction = support_points(support, body.shape, body.com, body.mass, gravity)
    return float(loads @ friction / loads.sum())


def _centred(share: FloatArray, points: FloatArray, centre: FloatArray) -> FloatArray:
    """Multiply shares by a linear tilt that moves their centre to `centre`."""
    found = share @ points
    r = points - found
    tilt = np.linalg.solve((share[:, None] * r).T @ r, centre - found)
    tilted = share * (1.0 + r @ tilt)
    if tilted.min() < 0.0:
        raise InvalidInput(
            "centre_of_pressure",
            found=f"{np.hypot(*(centre - found)) * 1e3:.3g} mm from the middle of the pressure,"
            " so far that the far side would pull",
            expected="a centre of pressure nearer to the middle",
            hint="make centre_of_pressure or unevenness smaller",
        )
    return tilted


def _fingerprint(shape: Shape) -> str:
    """Return a string that is the same for equal shapes, in any process."""
    return type(shape).__name__ + shape.outline.tobytes().hex()
