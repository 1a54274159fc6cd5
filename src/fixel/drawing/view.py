"""Content of figures, without Matplotlib: extents, units, contacts at one time, forces."""

from __future__ import annotations

from math import log10
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.model import Body, Fixel, Pusher, Shape, placed, rotated
from fixel.simulation import Simulation
from fixel.typing import FloatArray, IntArray
from fixel.units import DisplayUnit

MARGIN = 0.06  # share of the larger side, around all that is drawn
MAX_ARROW = 0.22  # length of the longest arrow, as a share of the larger side


UNITS = (DisplayUnit("µm", 1e6), DisplayUnit("mm", 1e3), DisplayUnit("m", 1.0))


def unit_for(size: float) -> DisplayUnit:
    """Select the unit in which a size [m] has about one to four digits before the point."""
    if size < 5e-3:
        return UNITS[0]
    return UNITS[1] if size < 5.0 else UNITS[2]


class Rectangle(NamedTuple):
    """Rectangle in the world [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def size(self) -> float:
        """Length of the larger side [m]."""
        return max(self.x[1] - self.x[0], self.y[1] - self.y[0])

    @classmethod
    def around(cls, points: FloatArray, least: float = 0.0) -> Rectangle:
        """Return the rectangle around points (n, 2), with sides of a least length [m]."""
        low, high = points.min(axis=0), points.max(axis=0)
        short = np.maximum(least - (high - low), 0.0) / 2.0
        (left, bottom), (right, top) = (low - short).tolist(), (high + short).tolist()
        return cls((left, right), (bottom, top))

    def widened(self, share: float) -> Rectangle:
        """Add a margin on all sides, a `share` of the larger side."""
        m = share * self.size
        return Rectangle((self.x[0] - m, self.x[1] + m), (self.y[0] - m, self.y[1] + m))

    def with_aspect(self, aspect: float) -> Rectangle:
        """Grow about the centre until height over width is `aspect`."""
        width, height = self.x[1] - self.x[0], self.y[1] - self.y[0]
        extra_width = max(0.0, height / aspect - width) / 2.0
        extra_height = max(0.0, aspect * width - height) / 2.0
        return Rectangle(
            (self.x[0] - extra_width, self.x[1] + extra_width),
            (self.y[0] - extra_height, self.y[1] + extra_height),
        )


def shapes_of(simulation: Simulation) -> dict[str, Shape]:
    """Shapes of bodies, pushers and fixels, by name."""
    scene = simulation.scene
    things: list[Body | Pusher | Fixel] = [*scene.bodies, *scene.pushers, *scene.fixels]
    return {thing.name: thing.shape for thing in things}


def extent(simulation: Simulation) -> Rectangle:
    """Extent of a simulation: bodies and pushers over the whole time, and fixels."""
    shapes = shapes_of(simulation)
    corners = [placed(f.shape.outline, f.pose) for f in simulation.scene.fixels]
    for name, poses in simulation.pose.items():
        known = poses[np.isfinite(poses).all(axis=1)]
        corners += [placed(shapes[name].outline, pose) for pose in known[evenly(len(known), 50)]]
    return Rectangle.around(np.concatenate(corners)).widened(MARGIN)


def evenly(n: int, most: int) -> IntArray:
    """Return at most `most` of n indices, evenly chosen, with the first and the last."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def ghosts(poses: FloatArray, shape: Shape, most: int = 5) -> FloatArray:
    """Poses (k, 3) between start and end at equal travel [m, m, rad], fewer for short motions."""
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    # Rotation counts in proportion to the size of the shape.
    x, y, turn = np.diff(poses, axis=0).T
    path = np.concatenate(([0.0], np.cumsum(np.hypot(np.hypot(x, y), 0.6 * reach * turn))))
    count = min(most, int(path[-1] / (0.35 * reach)))
    if count < 1:
        return np.zeros((0, 3))
    at = path[-1] * np.arange(1, count + 1) / (count + 1)
    return np.column_stack([np.interp(at, path, column) for column in poses.T])


def centre_path(simulation: Simulation, name: str) -> FloatArray:
    """Path (n_sample, 2) of a body's centre of mass [m]."""
    body = next(b for b in simulation.scene.bodies if b.name == name)
    poses = simulation.pose[name]
    return np.asarray(poses[:, :2] + rotated(body.com, poses[:, 2]))


def contacts_at(simulation: Simulation, time: float) -> NDArray[np.void]:
    """Rows of the contact table at the time of a sample [s]."""
    table = simulation.contacts
    low, high = np.searchsorted(table["time"], (time, np.nextafter(time, np.inf)))
    return np.asarray(table[low:high])


def ever_touched(simulation: Simulation) -> set[str]:
    """Names of all bodies, pushers and fixels that had a contact at any time."""
    table, names = simulation.contacts, simulation.names
    return {names[k] for k in np.unique(np.concatenate((table["body"], table["other"])))}


def forces(rows: NDArray[np.void]) -> FloatArray:
    """Forces (n, 2) on the first body of every contact, world axes [N]."""
    normal: Any = rows["normal"]
    tangent = np.column_stack((-normal[:, 1], normal[:, 0]))
    along = rows["normal_force"][:, None] * normal + rows["tangential_force"][:, None] * tangent
    return np.asarray(along, dtype=np.float64).reshape(-1, 2)


def pose_at(time: FloatArray, poses: FloatArray, moment: float) -> FloatArray:
    """Pose (3,) at a time, interpolated linearly between samples [m, m, rad]."""
    return np.array([np.interp(moment, time, column) for column in poses.T])


def carried(
    simulation: Simulation, rows: NDArray[np.void], moment: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move rows of the contact table with their bodies to a given time [s].

    Return points [m], normals and forces on the first bodies [N], each (n, 2).

    The table has contacts where the equations of their step were evaluated: at its start, or half a
    step later.
    """
    lead = 0.0 if simulation.method["stepper"] == "stewart-trinkle" else 0.5
    time, force = simulation.time, forces(rows)
    point, normal = np.zeros((2, len(rows), 2))
    for k, row in enumerate(rows):
        poses = simulation.pose[simulation.names[row["body"]]]
        then = pose_at(time, poses, float(row["time"] - (1.0 - lead) * row["step"]))
        now = pose_at(time, poses, moment)
        c, s = np.cos(now[2] - then[2]), np.sin(now[2] - then[2])
        turn = np.array([[c, s], [-s, c]])
        point[k] = now[:2] + (row["point"] - then[:2]) @ turn
        normal[k] = row["normal"] @ turn
        force[k] = force[k] @ turn
    return point, normal, force


def frictions(simulation: Simulation, rows: NDArray[np.void]) -> FloatArray:
    """Coefficients of friction (n,) of every contact [-]."""
    names, scene = simulation.names, simulation.scene
    pairs = [(names[r["body"]], names[r["other"]]) for r in rows]
    known = {pair: scene.friction(*pair) for pair in set(pairs)}
    return np.array([known[pair] for pair in pairs], dtype=np.float64)


def round_number(value: float) -> float:
    """Round a positive value down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(log10(value))
    return float(max(k * power for k in (1.0, 2.0, 5.0) if k * power <= value * (1.0 + 1e-9)))


def arrow_length_per_newton(largest: float, size: float) -> float:
    """Scale of force arrows [m/N] that makes the largest force readable."""
    return MAX_ARROW * size / largest if largest > 0.0 else 0.0


def largest_force(force: FloatArray) -> float:
    """Magnitude of the largest of (n, 2) forces [N]; zero if there are none."""
    return float(np.hypot(*force.T).max(initial=0.0))
