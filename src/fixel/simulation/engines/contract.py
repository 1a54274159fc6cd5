"""Contract of other engines, and the judge of their answers."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model import Disk, Polygon
from fixel.model.overlap import overlaps
from fixel.model.parameters import ParameterInfo
from fixel.simulation.engines.task import (
    PlainOutline,
    PlainTask,
    TaskUnits,
    bench_units,
    plain,
    pusher_poses,
)
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray

# A body that overlaps an obstacle by more than this, and by more than at the start, has been pushed
# through it: engines with soft contacts report no failure of their own.
MAX_OVERLAP = 1e-3  # [m] for a body of the bench, in `bench_units` for others
# Largest distance between two samples beyond the way at the fastest motion that is prescribed.
MAX_JUMP = 50e-3  # [m] likewise
JUDGED_SAMPLES = 16  # of a simulation, for overlap


class EngineInfo(NamedTuple):
    """Name, version and parameters of an engine."""

    name: str
    version: str
    parameters: Mapping[str, ParameterInfo]


@dataclass(frozen=True, slots=True, kw_only=True)
class AbstractPhysicsEngine(abc.ABC):
    """Abstract engine: simulates one body that a pusher pushes against fixels.

    The fields of a subclass are its choices, such as a time step, and its parameters. A parameter
    can be calibrated; a task overrides it by its `values`.

    Tasks are in SI. An engine with `at_bench_size` receives them in `bench_units` instead: its
    choices and parameters then have SI units for bodies of the size of a bench, and are scaled with
    the others.
    """

    name: ClassVar[str]
    parameters: ClassVar[Mapping[str, ParameterInfo]] = {}
    at_bench_size: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def version(self) -> str:
        """Version of the engine that is installed."""

    @abc.abstractmethod
    def refusal(self, task: PlainTask) -> str:
        """Return what of a task the engine cannot represent; empty for one that it can."""

    @abc.abstractmethod
    def simulate(self, task: PlainTask) -> FloatArray:
        """Return the poses (n, 3) of the body at the times of a task [m, m, rad].

        Raises
        ------
        EngineFailed
            The engine cannot finish.
        """

    def answer(self, task: PlainTask) -> FloatArray:
        """Return the poses of `simulate` for a task in SI, in units that suit the engine."""
        units = bench_units(task.body) if self.at_bench_size else TaskUnits()
        return units.si_poses(np.asarray(self.simulate(units.task(task)), np.float64))

    def info(self) -> EngineInfo:
        """Return name, version and parameters."""
        return EngineInfo(self.name, self.version, self.parameters)

    def under(self, values: Mapping[str, float]) -> AbstractPhysicsEngine:
        """Return the engine with these values of its parameters."""
        for name in values:
            check_name(f"parameters of {self.name}", name, self.parameters)
        return replace(self, **values) if values else self

    @classmethod
    def of_text(cls, text: str) -> AbstractPhysicsEngine:
        """Return an engine with choices as a user writes them: ``"step=0.001,iterations=30"``."""
        known = {own.name: own for own in fields(cls)}
        given: dict[str, Any] = {}
        for item in filter(None, text.split(",")):
            name, _, value = item.partition("=")
            check_name(f"choices of {cls.name}", name, known)
            given[name] = _value(f"{cls.name}:{name}", value, known[name].default)
        return cls(**given)


def model_of(engine: AbstractPhysicsEngine, task: PlainTask) -> dict[str, Any]:
    """Return a task with the choices of an engine as objects of JSON, for a module of `scripts`."""
    return {"choices": asdict(engine), **plain(task)}


def _value(where: str, text: str, usual: Any) -> Any:
    if isinstance(usual, str):
        return text
    try:
        number = type(usual)(text)
    except ValueError:
        number = np.nan
    if not 0.0 <= number < np.inf:
        raise InvalidInput(where, found=repr(text), expected=f"a number, such as {usual:g}")
    return number


def fault(task: PlainTask, pose: object) -> str:
    """Return why poses (n, 3) that an engine gave cannot be believed; empty for good ones."""
    try:
        found = np.array(pose, np.float64)
    except (TypeError, ValueError):
        return "an answer without a table of poses"
    if found.shape != (len(task.times), 3):
        return f"an answer of shape {found.shape}, not ({len(task.times)}, 3)"
    if not np.isfinite(found).all():
        return "poses that are not finite"
    track = np.concatenate((task.body.start[None], found))
    jumps = np.hypot(*np.diff(track[:, :2], axis=0).T)
    way = _fastest(task) * np.diff(task.times, prepend=0.0)
    unit = bench_units(task.body).length
    if (jumps > MAX_JUMP * unit + way).any():
        return f"a jump of {1e3 * jumps.max():.4g} mm between two samples"
    deepest = overlap(task, found)
    if deepest > MAX_OVERLAP * unit:
        return f"the body {1e3 * deepest:.3g} mm inside an obstacle"
    return ""


def overlap(task: PlainTask, pose: FloatArray) -> float:
    """Return how far the body enters an obstacle at most [m], more than at the start.

    A few of the poses (n, 3) at the times of the task are looked at, the last among them.
    """
    n = len(task.times)
    chosen = np.unique(np.linspace(0, n - 1, JUDGED_SAMPLES).round().astype(int))
    track = np.concatenate((task.body.start[None], pose[chosen]))
    obstacles = [(fixel.outline, fixel.pose) for fixel in task.fixels]
    if task.pusher is not None and task.pusher.force_limit is None:
        times = np.concatenate(([0.0], task.times[chosen]))
        obstacles.append((task.pusher.outline, pusher_poses(task.pusher, times)))
    return max((_entered(task.body.outline, track, *own) for own in obstacles), default=0.0)


def _entered(body: PlainOutline, track: FloatArray, outline: PlainOutline, at: FloatArray) -> float:
    seen = composed(inverted(at), track)
    depth = np.max(
        [
            overlaps(
                _shape(own, body.radius), seen, _shape(piece, outline.radius), np.zeros(3)
            ).depth
            for own in body.pieces
            for piece in outline.pieces
        ],
        axis=0,
    )
    return float(depth.max() - max(depth[0], 0.0))


def _shape(piece: FloatArray, radius: float) -> Disk | Polygon:
    return Disk(radius) if radius > 0.0 else Polygon(piece)


def _fastest(task: PlainTask) -> float:
    """Return the fastest motion of the body at the start, or of a point of the pusher [m/s]."""
    own = float(np.hypot(*task.body.velocity[:2]))
    if task.pusher is None:
        return own
    outline, steps = task.pusher.outline, np.diff(task.pusher.path, axis=0)
    reach = max(float(np.hypot(*piece.T).max()) for piece in outline.pieces) + outline.radius
    way = np.hypot(steps[:, 1], steps[:, 2]) + reach * np.abs(steps[:, 3])
    return float((way / steps[:, 0]).max(initial=own))
