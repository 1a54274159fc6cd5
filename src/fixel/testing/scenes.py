"""Named scenes for tests, benchmarks and examples."""

from __future__ import annotations

from math import pi
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Fixel,
    LineDrive,
    PairFriction,
    Polygon,
    Pusher,
    Scene,
    Shape,
    Support,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.model.fields import whole
from fixel.sampling import published, rows
from fixel.typing import FloatArray

FIXEL_RADIUS: Final = 0.00476  # [m], 3/8 inch fixels of the thesis, appendix C.3
FINGER_RADIUS: Final = 0.005  # [m], finger of `free_push`
STALL_FORCE: Final = 34.3  # [N], actuator of the thesis, section 1.3.3


def row(*numbers: float) -> FloatArray:
    """Convert numbers to an array, for parameters that are typed as an array."""
    return np.array(numbers, np.float64)


def box(width: float, height: float) -> Polygon:
    """Rectangle about the origin of its frame [m]."""
    return Polygon.rectangle(width, height)


Layout = Literal["slip", "seated"]

_PEGS: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    "slip": ((0.266, -0.067), (0.280, -0.008), (0.267, 0.070)),
    "seated": ((0.200, -0.060), (0.240, 0.000), (0.200, 0.060)),
}
_START: Final[dict[str, tuple[float, float, float]]] = {
    "slip": (0.095, -0.011, pi / 8),
    "seated": (0.090, 0.000, pi / 8),
}


def pushed_square(duration: float = 2.0) -> Scene:
    """Square that a round finger pushes off its centre line, so that it turns."""
    part = Body(
        "part", Polygon.rectangle(0.1, 0.1), mass=0.15, support=Tripod(radius=0.038, friction=0.25)
    )
    finger = Pusher(
        "finger",
        Disk(FINGER_RADIUS),
        pose=row(-0.055, 0.02, 0.0),
        friction=0.3,
        drive=LineDrive(speed=0.02),
    )
    return Scene((part,), (finger,), duration=duration)


def grasp(
    layout: Layout = "seated",
    force_limit: float | None = STALL_FORCE,
    support_directions: int | None = None,
) -> Scene:
    """Square pushed by a flat head against three fixels.

    Size of the square, speed, reach and stall force are printed in the thesis (RPI 2011, sections
    1.3 and 4.2). It prints neither mass nor support nor the fixels' coordinates; these are ours.

    Parameters
    ----------
    layout : str
        ``"seated"``: the square comes to rest between head and fixels, and the drive stalls.
        ``"slip"``: the fixels are where the square meets them late, or slides off.
    force_limit : float or None
        Force at which the drive stalls [N]; None for a rigid drive, which jams in a seated grasp.
    support_directions : int or None
        Directions of friction polygons, 16 as in the thesis; None for exact friction discs.
    """
    square = Body(
        name="object",
        shape=box(0.1075, 0.1075),
        mass=0.15,
        pose=row(*_START[layout]),
        support=Tripod(radius=0.04, friction=0.25, angle=pi / 2),
    )
    head = Pusher(
        name="actuator",
        shape=box(0.029, 0.029),
        pose=row(0.0, 0.0, 0.0),
        drive=LineDrive(
            direction=row(1.0, 0.0), speed=0.0135, travel=0.15, force_limit=force_limit
        ),
        friction=0.25,
    )
    pegs = tuple(
        Fixel(name=f"fixel-{k}", shape=Disk(FIXEL_RADIUS), pose=row(x, y, 0.0), friction=0.2)
        for k, (x, y) in enumerate(_PEGS[layout], 1)
    )
    return Scene(
        bodies=(square,),
        pushers=(head,),
        fixels=pegs,
        duration=11.0,
        support_directions=support_directions,
    )


Estimate = Literal["p1", "p2"]

_ESTIMATES: Final[dict[str, tuple[tuple[tuple[float, float], ...], float, float]]] = {
    # Support points [um] with decimal points restored, friction of probe and of plane.
    "p1": (((411.3, -563.3), (-409.1, 605.9), (-273.2, -102.1)), 0.666, 0.757),
    "p2": (((-412.4, 794.0), (-217.8, 774.5), (278.8, -538.8)), 0.536, 0.013),
}


def micro_push(
    test: int = 1, estimate: Estimate = "p1", mu_support: float | None = None, speed: float = 1e-4
) -> Scene:
    """One of the eight pushes of a 1.6 mm part by a probe, with parameters estimated in the paper.

    Source: the ASME 2006 paper on meso-scale manipulation, figures 4 and 5, table 1. Support points
    are read in a body frame whose y axis is along the long side: only then are all of them in the
    part. Pushes go along +x; the long side is along y in tests 1-5, the short one in tests 6-8. The
    scene is for `QuasiStatic` motion, as in the paper, so speed and mass do not matter.

    Parameters
    ----------
    test : int
        Number of the test, 1 to 8. Half a side off the midpoint means flush with the corner.
    estimate : str
        Column of table 1, ``"p1"`` or ``"p2"``.
    mu_support : float, optional
        Friction of the plane; by default the estimated one.
    speed : float
        Speed of the probe [m/s]; not legible in the paper.
    """
    if test not in range(1, 9):
        raise InvalidInput("test", found=test, expected="a test from 1 to 8")
    points, mu_probe, mu_plane = _ESTIMATES[estimate]
    upright = test <= 5
    depth = published.PART_WIDTH if upright else published.PART_LENGTH
    offset = published.probe_offset(test)
    part = Body(
        name="part",
        shape=box(published.PART_WIDTH, published.PART_LENGTH),
        mass=published.PART_MASS,
        pose=row(0.0, 0.0, 0.0 if upright else 0.5 * pi),
        support=SupportPoints(
            points=1e-6 * np.array(points), friction=mu_plane if mu_support is None else mu_support
        ),
    )
    probe = Pusher(
        name="probe",
        shape=box(published.PROBE_SIDE, published.PROBE_SIDE),
        pose=row(-0.5 * (depth + published.PROBE_SIDE), offset, 0.0),
        drive=LineDrive(direction=row(1.0, 0.0), speed=speed, travel=published.PROBE_TRAVEL),
        friction=mu_probe,
    )
    return Scene(bodies=(part,), pushers=(probe,), duration=published.PROBE_TRAVEL / speed)


def sliding_block(
    speed: float = 0.5, friction: float = 0.25, heading: float = 0.0, duration: float = 1.0
) -> Scene:
    """Single square block that slides and stops after ``speed^2 / (2 friction g)``."""
    block = Body(
        name="block",
        shape=box(0.1, 0.1),
        mass=0.4,
        pose=row(0.0, 0.0, 0.0),
        velocity=row(speed * np.cos(heading), speed * np.sin(heading), 0.0),
        support=Tripod(radius=0.03, friction=friction),
    )
    return Scene(bodies=(block,), duration=duration)


def spinning_disk(
    spin: float = 10.0,
    speed: float = 0.0,
    friction: float = 0.25,
    n_points: int = 256,
    duration: float = 1.0,
) -> Scene:
    """Disk of radius 50 mm on even pressure that spins, and slides if `speed` is given, to rest.

    Without sliding it stops after ``3 R spin / (4 friction g)``.
    """
    disk = Body(
        name="disk",
        shape=Disk(0.05),
        mass=0.3,
        pose=row(0.0, 0.0, 0.0),
        velocity=row(speed, 0.0, spin),
        support=UniformPressure(friction=friction, n_points=n_points),
    )
    return Scene(bodies=(disk,), duration=duration)


def heap(n: int = 9, speed: float = 0.05, duration: float = 2.0) -> Scene:
    """Heap of `n` blocks and disks in rows of three, on tripods, swept by a wide plate along +x.

    It has many bodies in contact at once. Every third one is a disk.
    """
    whole(n, "n")
    pitch = 0.055
    bodies = tuple(
        Body(
            name=f"body-{k + 1}",
            shape=Disk(0.02) if k % 3 == 2 else box(0.04, 0.03),
            mass=0.05,
            # Slightly out of line, so that results do not depend on ties.
            pose=row(0.03 + pitch * (k // 3), pitch * (k % 3 - 1) + 0.002 * (k // 3 % 2), 0.07 * k),
            support=Tripod(radius=0.012, friction=0.3, angle=0.4 * k),
        )
        for k in range(n)
    )
    plate = Pusher(
        name="plate",
        shape=box(0.01, 0.22),
        pose=row(-0.005, 0.0, 0.0),
        drive=LineDrive(direction=row(1.0, 0.0), speed=speed),
        friction=0.3,
    )
    return Scene(
        bodies=bodies,
        pushers=(plate,),
        contact_friction=(PairFriction(pair=("body-*", "body-*"), friction=0.3),),
        duration=duration,
    )


def moved(scene: Scene, shift: tuple[float, float], turn: float) -> Scene:
    """Turn a scene about the origin [rad], then shift it [m]."""
    return rows.moved(scene, (*shift, turn))


def free_push(
    support: Support,
    shape: Shape | None = None,
    friction: float = 0.0,
    speed: float = 0.01,
    step: float = 1e-4,
    support_directions: int | None = None,
) -> Scene:
    """Body of 200 g to be pushed along +x by a disk at the origin, by default for one short step.

    Batches of rollouts take their start poses from `touching_pose`.
    """
    shape = shape or box(0.1, 0.1)
    body = Body(name="body", shape=shape, mass=0.2, pose=row(0.5, 0.0, 0.0), support=support)
    finger = Pusher(
        name="finger",
        shape=Disk(FINGER_RADIUS),
        pose=row(0.0, 0.0, 0.0),
        drive=LineDrive(direction=row(1.0, 0.0), speed=speed),
        friction=friction,
    )
    return Scene(
        bodies=(body,), pushers=(finger,), duration=step, support_directions=support_directions
    )


def touching_pose(point: ArrayLike, outward: ArrayLike, towards: ArrayLike) -> FloatArray:
    """Compute poses (..., 3) [m, m, rad] at which a body touches the finger of `free_push`.

    `point` (..., 2) is on the outline [m], `outward` (...) the direction of the outward normal
    there, both in the frame of the shape, and `towards` (...) the direction from the finger into
    the body in the world [rad]; 0 is a push square to the edge.
    """
    at = np.asarray(point, np.float64)
    angle = np.asarray(towards, np.float64) + pi - np.asarray(outward, np.float64)
    c, s = np.cos(angle), np.sin(angle)
    x = FINGER_RADIUS * np.cos(towards) - (c * at[..., 0] - s * at[..., 1])
    y = FINGER_RADIUS * np.sin(towards) - (s * at[..., 0] + c * at[..., 1])
    return np.stack(np.broadcast_arrays(x, y, angle), axis=-1)
