"""What a picture shows: extents, units, contacts of one moment, forces. No Matplotlib here."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, log10
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.model import Body, Fixel, Pusher, Shape, placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray

MARGIN = 0.06  # of the larger side, around everything drawn
MAX_ARROW = 0.22  # of the larger side


class LengthUnit(NamedTuple):
    """A unit of length for the axes."""

    name: str
    per_metre: float


UNITS = (LengthUnit("µm", 1e6), LengthUnit("mm", 1e3), LengthUnit("m", 1.0))


def unit_for(size: float) -> LengthUnit:
    """The unit in which a size [m] has about one to four digits before the point."""
    if size < 5e-3:
        return UNITS[0]
    return UNITS[1] if size < 5.0 else UNITS[2]


@final
@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle in the world [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def size(self) -> float:
        """The larger side [m]."""
        return max(self.x[1] - self.x[0], self.y[1] - self.y[0])

    def widened(self, share: float) -> Rectangle:
        """With a margin of `share` of the larger side on all sides."""
        m = share * self.size
        return Rectangle((self.x[0] - m, self.x[1] + m), (self.y[0] - m, self.y[1] + m))

    def with_aspect(self, aspect: float) -> Rectangle:
        """Grown about its centre until height over width is `aspect`."""
        width, height = self.x[1] - self.x[0], self.y[1] - self.y[0]
        extra_width = max(0.0, height / aspect - width) / 2.0
        extra_height = max(0.0, aspect * width - height) / 2.0
        return Rectangle(
            (self.x[0] - extra_width, self.x[1] + extra_width),
            (self.y[0] - extra_height, self.y[1] + extra_height),
        )


def shapes_of(simulation: Simulation) -> dict[str, Shape]:
    """Every shape by the name of its owner."""
    scene = simulation.scene
    things: list[Body | Pusher | Fixel] = [*scene.bodies, *scene.pushers, *scene.fixels]
    return {thing.name: thing.shape for thing in things}


def extent(simulation: Simulation) -> Rectangle:
    """Everything that is ever anywhere: bodies and pushers over the whole time, and fixels."""
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
    """(n,) path length of a body so far [m], turning counted by the size of its shape."""
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    steps = np.diff(poses, axis=0)
    lengths = np.hypot(np.hypot(steps[:, 0], steps[:, 1]), 0.6 * reach * steps[:, 2])
    return np.concatenate(([0.0], np.cumsum(lengths)))


def ghosts(poses: FloatArray, shape: Shape, most: int = 5) -> FloatArray:
    """(k, 3) poses between start and end at equal travel [m, m, rad], fewer where it went less."""
    path = travel(poses, shape)
    reach = float(np.hypot(*(shape.outline - shape.centroid).T).max())
    count = min(most, int(path[-1] / (0.35 * reach)))
    if count < 1:
        return np.zeros((0, 3))
    at = path[-1] * np.arange(1, count + 1) / (count + 1)
    return np.column_stack([np.interp(at, path, column) for column in poses.T])


def centre_path(simulation: Simulation, name: str) -> FloatArray:
    """(n_sample, 2) path of a body's centre of mass [m]."""
    body = next(b for b in simulation.scene.bodies if b.name == name)
    poses = simulation.pose[name]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = body.com
    return np.asarray(poses[:, :2] + np.column_stack((c * x - s * y, s * x + c * y)))


def contacts_at(simulation: Simulation, time: float) -> NDArray[np.void]:
    """Rows of the contact table at one sample."""
    table = simulation.contacts
    return np.asarray(table[table["time"] == time])


def ever_touched(simulation: Simulation) -> set[str]:
    """Names of everything that was touched at any time."""
    table, names = simulation.contacts, simulation.names
    return {names[k] for k in np.unique(np.concatenate((table["body"], table["other"])))}


def forces(rows: NDArray[np.void]) -> FloatArray:
    """(n, 2) force on the first body of every contact, world axes [N]."""
    normal: Any = rows["normal"]
    tangent = np.column_stack((-normal[:, 1], normal[:, 0]))
    along = rows["normal_force"][:, None] * normal + rows["tangential_force"][:, None] * tangent
    return np.asarray(along, dtype=np.float64).reshape(-1, 2)


class MovedContacts(NamedTuple):
    """Contacts of a step, moved on with their bodies to another moment of that step."""

    point: FloatArray  # (n, 2) [m]
    normal: FloatArray  # (n, 2)
    force: FloatArray  # (n, 2) on the first body [N]


def pose_at(time: FloatArray, poses: FloatArray, moment: float) -> FloatArray:
    """(3,) pose between samples, linear [m, m, rad]."""
    return np.array([np.interp(moment, time, column) for column in poses.T])


def carried(simulation: Simulation, rows: NDArray[np.void], moment: float) -> MovedContacts:
    """Rows of the contact table where they are at a moment [s].

    The table says where contacts were when the equations of their step were written: at its start,
    or half a step ahead.
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
    """(n,) coefficient of friction of every contact [-]."""
    names, scene = simulation.names, simulation.scene
    pairs = [(names[r["body"]], names[r["other"]]) for r in rows]
    known = {pair: scene.friction(*pair) for pair in set(pairs)}
    return np.array([known[pair] for pair in pairs], dtype=np.float64)


def round_number(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(log10(value))
    return float(max(k * power for k in (1.0, 2.0, 5.0) if k * power <= value * (1.0 + 1e-9)))


def arrow_length_per_newton(largest: float, size: float) -> float:
    """Length of force arrows [m/N] so that the largest force stays readable."""
    return MAX_ARROW * size / largest if largest > 0.0 else 0.0


def largest_force(force: FloatArray) -> float:
    """Magnitude of the largest of (n, 2) forces [N], zero without any."""
    return max((hypot(*f) for f in force.tolist()), default=0.0)


def sentence(simulation: Simulation) -> str:
    """Status as the heading of a picture."""
    if simulation.stopped_at is not None:
        return f"{simulation.status} at {simulation.stopped_at:.4g} s"
    return f"{simulation.status}, {simulation.duration:.4g} s in {simulation.steps} steps"
