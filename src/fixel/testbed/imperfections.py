"""Imperfections of the simulated testbed: uneven plate, support and drive, and its sensors."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fixel import model
from fixel.errors import InvalidInput
from fixel.model.fields import frozen
from fixel.model.probability import stream
from fixel.model.support import cells, support_points
from fixel.simulation import Simulation
from fixel.typing import BoolArray, FloatArray

# Area with a friction map: the thesis's plate with a margin.
PLATE_ORIGIN = (-0.2, -0.4)  # [m]
PLATE_SIZE = (0.8, 0.8)  # [m]
NODES_PER_GRAIN = 3
# Number of plane waves in the field: enough that its values are close to normal.
N_WAVES = 64
ON_CLOCK = 1e-6  # largest distance of a sample from the clock, in frames [-]
WAYPOINT_INTERVAL = 1.0 / 60.0  # [s]; resolves a ripple of a few hertz


def rough_plane(plane: model.Plane, seed: int, roughness: float, grain: float) -> model.Plane:
    """Return the plane with a smooth random multiplier of friction, fixed in space.

    A friction map of the planned plane remains as a factor. `roughness` is the standard deviation
    of the logarithm of the multiplier [-], `grain` the distance over which it changes: its
    correlation falls to exp(-1/2) [m].
    """
    if roughness == 0.0:
        return plane
    place, field = _smooth_field(seed, grain, "plate")
    factor = np.exp(roughness * field)
    if plane.friction_map is not None:
        factor *= plane.friction_map.at(place)
    cell = np.full(2, grain / NODES_PER_GRAIN)
    friction_map = model.FrictionMap(origin=np.array(PLATE_ORIGIN), cell=cell, factor=factor)
    return replace(plane, friction_map=friction_map)


def uneven_table(plane: model.Plane, seed: int, spread: float, length: float) -> model.Plane:
    """Return the plane with a smooth random map of loads: the standard deviation of their logarithm
    [-], and the distance over which it changes [m], as `grain` of `rough_plane`."""
    if spread == 0.0:
        return plane
    _, field = _smooth_field(seed, length, "table")
    origin, cell = np.array(PLATE_ORIGIN), np.full(2, length / NODES_PER_GRAIN)
    return replace(plane, load_map=model.LoadMap(origin=origin, cell=cell, log_load=spread * field))


@functools.lru_cache(maxsize=8)  # every run has the same plate
def _smooth_field(seed: int, grain: float, what: str) -> tuple[FloatArray, FloatArray]:
    """Return nodes (n_y, n_x, 2) [m] and values (n_y, n_x) of mean 0 and variance 1 [-].

    The field is a sum of waves. Normal wave vectors of deviation 1/grain give values at a distance
    d the correlation exp(-(d/grain)^2 / 2).
    """
    spans = zip(PLATE_ORIGIN, PLATE_SIZE, strict=True)
    x, y = (start + np.arange(0.0, size, grain / NODES_PER_GRAIN) for start, size in spans)
    rng = stream(seed, what)
    wave = rng.standard_normal((2, N_WAVES)) / grain
    phase = rng.uniform(0.0, 2.0 * math.pi, N_WAVES)
    # Each wave is a product of one along x and one along y: no array has nodes times waves.
    along_x, along_y = np.outer(wave[0], x), np.outer(wave[1], y) + phase[:, None]
    products = [(np.cos(along_y), np.cos(along_x)), (-np.sin(along_y), np.sin(along_x))]
    values = sum(np.einsum("ky,kx->yx", own_y, own_x) for own_y, own_x in products)
    return frozen(np.stack(np.meshgrid(x, y), axis=-1)), frozen(math.sqrt(2.0 / N_WAVES) * values)


def uneven_support(
    body: model.Body,
    gravity: float,
    seed: int,
    *,
    friction_ratio: float,
    n_cells: int,
    unevenness: float,
    centre: ArrayLike,
) -> model.SupportPoints | model.NoSupport:
    """Return the true support of a body: many points that press unequally.

    The true friction is `friction_ratio` of the nominal one, that of the planned support. Bodies of
    equal shape have the same underside. `unevenness` is the standard deviation of the logarithm of
    the pressure [-], `centre` the centre of pressure from the centre of mass, in body axes (2,)
    [m]. `InvalidInput` is raised where it is so far out that a point would pull.
    """
    friction = nominal_friction(body, gravity)
    if friction is None:
        return model.NoSupport()
    points, share = cells(body.shape, n_cells)
    outline = body.shape.outline.tobytes().hex()  # the same for equal shapes, in any process
    rng = stream(seed, "underside", type(body.shape).__name__ + outline)
    share = share * np.exp(unevenness * rng.standard_normal(len(share)))
    share = _centred(share / share.sum(), points, body.com + np.asarray(centre))
    return model.SupportPoints(
        points=points, friction=friction_ratio * friction, loads=body.mass * gravity * share
    )


def planned_support(support: model.Support, friction_ratio: float) -> model.Support:
    """Return the planned support with its friction multiplied by `friction_ratio` [-]."""
    if isinstance(support, model.NoSupport):
        return support
    if isinstance(support, model.Ellipsoid):
        force, torque = friction_ratio * support.force, friction_ratio * support.torque
        return replace(support, force=force, torque=torque)
    friction: Any = friction_ratio * support.friction  # one number, or one per point
    return replace(support, friction=friction)


def nominal_friction(body: model.Body, gravity: float) -> float | None:
    """Friction of a body against the plane, for any kind of support [-]; None without support."""
    support = body.support
    if isinstance(support, model.NoSupport):
        return None
    if isinstance(support, model.Ellipsoid):
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
            found=f"{np.hypot(*(centre - found)) * 1e3:.3g} mm from the centre of the pressure, "
            "so that the load on the far side would be negative",
            expected="a centre of pressure closer to that centre",
            hint="reduce centre_of_pressure or unevenness",
        )
    return tilted


def frames_of(simulation: Simulation, frame_rate: float) -> BoolArray:
    """Return (n_sample,) bool: samples on the camera's clock; the end of a run may be off it."""
    count = simulation.time * frame_rate
    return np.asarray(np.abs(count - np.rint(count)) < ON_CLOCK)


def touching(simulation: Simulation, body: str | None = None) -> BoolArray:
    """Return (n_sample, n_fixel) bool: whether the body, by default any, touches the fixel."""
    scene, contacts = simulation.scene, simulation.contacts
    if body is not None:
        k = simulation.names.index(body)
        contacts = contacts[(contacts["body"] == k) | (contacts["other"] == k)]
    n_moving = len(scene.bodies) + len(scene.pushers)
    fixel = np.maximum(contacts["body"], contacts["other"]) - n_moving
    sample = np.searchsorted(simulation.time, contacts["time"])
    found = np.zeros((len(simulation.time), len(scene.fixels)), np.bool_)
    found[sample[fixel >= 0], fixel[fixel >= 0]] = True
    return found


def seen(
    pose: FloatArray, position_noise: float, angle_noise: float, rng: np.random.Generator
) -> FloatArray:
    """Add white noise to poses (n, 3), with standard deviations in [m] and [rad]."""
    return pose + rng.standard_normal(pose.shape) * (position_noise, position_noise, angle_noise)


def felt(
    touches: BoolArray, false_contact: float, missed_contact: float, rng: np.random.Generator
) -> BoolArray:
    """Return readings of the fixels with independent errors, from true contacts (..., n_fixel).

    A reading is 1 without contact, and 0 with it, with the given probabilities [-].
    """
    wrong = rng.random(touches.shape) < np.where(touches, missed_contact, false_contact)
    return np.asarray(touches ^ wrong)


def driven_unevenly(
    pusher: model.Pusher,
    duration: float,
    *,
    speed_ratio: float,
    ripple: float,
    frequency: float,
    phase: float,
) -> model.Pusher:
    """Return the pusher on its planned path, with uneven timing for a duration [s].

    `speed_ratio` is the mean speed over the planned one [-]. The speed varies about its mean by
    `ripple`, a share of it [-], with a frequency [Hz] and a phase at the start [rad].
    """
    if speed_ratio == 1.0 and ripple == 0.0:
        return pusher
    time = np.arange(math.ceil(duration / WAYPOINT_INTERVAL) + 1.0) * WAYPOINT_INTERVAL
    poses = _planned_poses(pusher, speed_ratio * uneven_time(time, ripple, frequency, phase))
    drive = model.PathDrive(
        waypoints=np.column_stack((time, poses)), force_limit=pusher.drive.force_limit
    )
    return replace(pusher, drive=drive)


def uneven_time(time: FloatArray, ripple: float, frequency: float, phase: float) -> FloatArray:
    """Times at which an even drive reaches the positions of the uneven one at `time` [s]."""
    turn = 2.0 * math.pi * frequency
    return np.asarray(time + ripple / turn * (np.sin(turn * time + phase) - math.sin(phase)))


def _planned_poses(pusher: model.Pusher, time: FloatArray) -> FloatArray:
    """Poses (n, 3) of the planned drive at times (n,) [s]."""
    drive = pusher.drive
    if isinstance(drive, model.PathDrive):
        instants, *columns = drive.waypoints.T
        return np.column_stack([np.interp(time, instants, column) for column in columns])
    covered = np.minimum(drive.speed * time, drive.travel)
    return np.asarray(
        pusher.pose + np.column_stack((np.outer(covered, drive.direction), 0.0 * covered))
    )
