"""Content of figures, without Matplotlib: extents, units, contacts at one time, forces."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, log10
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.drawing.chart import DisplayUnit
from fixel.model import Body, Fixel, Pusher, Shape, placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray

MARGIN = 0.06  # share of the larger side, around all that is drawn
MAX_ARROW = 0.22  # length of the longest arrow, as a share of the larger side


UNITS = (DisplayUnit("µm", 1e6), DisplayUnit("mm", 1e3), DisplayUnit("m", 1.0))


def unit_for(size: float) -> DisplayUnit:
    """Select the unit in which a size [m] has about one to four digits before the point."""
    if size < 5e-3:
        return UNITS[0]
    return UNITS[1] if size < 5.0 else UNITS[2]


@final
@dataclass(frozen=True, slots=True)
class Rectangle:
    """Rectangle in the world [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def size(self) -> float:
        """Length of the larger side [m]."""
        return max(self.x[1] - self.x[0], self.y[1] - self.y[0])

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
        for pose in known[_thinned(len(known))]:
            corners.append(placed(shapes[name].outline, pose))
    points = np.concatenate(corners) if corners else np.zeros((1, 2))
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    if right == left and top == bottom:
        right, top = left + 1.0, bottom + 1.0
    return Rectangle((left, right), (bottom, top)).widened(MARGIN)


def _thinned(n: int, most: int = 50) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def travel(poses: FloatArray, shape: Shape) -> FloatArray:
    """Path length (n,) of a body so far [m]; rotation counts in proportion to the shape's size."""
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    steps = np.diff(poses, axis=0)
    lengths = np.hypot(np.hypot(steps[:, 0], steps[:, 1]), 0.6 * reach * steps[:, 2])
    return np.concatenate(([0.0], np.cumsum(lengths)))


def ghosts(poses: FloatArray, shape: Shape, most: int = 5) -> FloatArray:
    """Poses (k, 3) between start and end at equal travel [m, m, rad], fewer for short motions."""
    path = travel(poses, shape)
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    count = min(most, int(path[-1] / (0.35 * reach)))
    if count < 1:
        return np.zeros((0, 3))
    at = path[-1] * np.arange(1, count + 1) / (count + 1)
    return np.column_stack([np.interp(at, path, column) for column in poses.T])


def centre_path(simulation: Simulation, name: str) -> FloatArray:
    """Path (n_sample, 2) of a body's centre of mass [m]."""
    body = next(b for b in simulation.scene.bodies if b.name == name)
    poses = simulation.pose[name]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = body.com
    return np.asarray(poses[:, :2] + np.column_stack((c * x - s * y, s * x + c * y)))


def contacts_at(simulation: Simulation, time: float) -> NDArray[np.void]:
    """Rows of the contact table at the time of a sample [s]."""
    table = simulation.contacts
    return np.asarray(table[table["time"] == time])


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


class MovedContacts(NamedTuple):
    """Contacts of a step, moved with their bodies to another time of that step."""

    point: FloatArray  # (n, 2) [m]
    normal: FloatArray  # (n, 2)
    force: FloatArray  # (n, 2) on the first body [N]


def pose_at(time: FloatArray, poses: FloatArray, moment: float) -> FloatArray:
    """Pose (3,) at a time, interpolated linearly between samples [m, m, rad]."""
    return np.array([np.interp(moment, time, column) for column in poses.T])


def carried(simulation: Simulation, rows: NDArray[np.void], moment: float) -> MovedContacts:
    """Move rows of the contact table with their bodies to a given time [s].

    The table has contacts where the equations of their step were evaluated: at its start, or half a
    step later.
    """
    lead = 0.0 if simulation.method["stepper"] == "stewart-trinkle" else 0.5
    time, force = simulation.time, forces(rows)
    answer = MovedContacts(
        np.zeros((len(rows), 2)), np.zeros((len(rows), 2)), np.zeros((len(rows), 2))
    )
    for k, row in enumerate(rows):
        poses = simulation.pose[simulation.names[row["body"]]]
        then = pose_at(time, poses, float(row["time"] - (1.0 - lead) * row["step"]))
        now = pose_at(time, poses, moment)
        c, s = np.cos(now[2] - then[2]), np.sin(now[2] - then[2])
        turn = np.array([[c, s], [-s, c]])
        answer.point[k] = now[:2] + (row["point"] - then[:2]) @ turn
        answer.normal[k] = row["normal"] @ turn
        answer.force[k] = force[k] @ turn
    return answer


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
    return max((hypot(*f) for f in force.tolist()), default=0.0)


def sentence(simulation: Simulation) -> str:
    """Status of a simulation, as the heading of a figure."""
    if simulation.stopped_at is not None:
        return f"{simulation.status} at {simulation.stopped_at:.4g} s"
    return f"{simulation.status}, {simulation.duration:.4g} s in {simulation.steps} steps"
