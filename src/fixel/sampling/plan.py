"""Plans: all combinations of shapes, layouts, offsets and repetitions, and their checks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import atan2, hypot
from typing import Final, NamedTuple, final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Fixel,
    LineDrive,
    PlannedExperiment,
    Pusher,
    Scene,
    Shape,
    placed,
)
from fixel.model.fields import settle, whole
from fixel.sampling.offsets import Offset, OffsetScheme, Triple
from fixel.sampling.rig import FixelLayout, PlannedShape, SamplingRig, plain_name, shape_of
from fixel.sampling.rows import moved
from fixel.simulation import QuasiStatic, simulate_batch
from fixel.typing import FloatArray

OBJECT: Final = "object"
HEAD: Final = "actuator"

# Experiments of one plan. Without this limit, a short file could fill the memory.
MAX_EXPERIMENTS: Final = 100_000

SAMPLES: Final = 61  # instants of the motion; one every 2.5 mm of the thesis's travel

# [m] Distance that counts as touching, as in the thesis's own synthetic tactile sensors.
TOUCH: Final = 0.95e-3


HERE: Final[Triple] = (0.0, 0.0, 0.0)
_PLACE: Final = ("place_x_m", "place_y_m", "place_theta_rad")


class PlanEntry(NamedTuple):
    """Line of a plan, before its scene is built."""

    name: str
    shape: PlannedShape
    layout: FixelLayout
    offset: Offset
    place: Triple
    repetition: int


@final
@dataclass(frozen=True, kw_only=True)
class Plan:
    """Plan of experiments.

    Parameters
    ----------
    name : str
        Name of the plan; see `plain_name`.
    rig : SamplingRig
        Apparatus of all experiments.
    shapes : tuple of PlannedShape
        Objects.
    layouts : tuple of FixelLayout
        Layouts of the fixels.
    schemes : tuple of OffsetScheme
        Schemes of the object's offsets, one after the other.
    places : tuple of (x, y, theta)
        Poses of the frame of the rig on the table, one run after the other [m, m, rad].
    repetitions : int
        Number of consecutive runs of every configuration.

    Raises
    ------
    InvalidInput
        A list is empty, a name is used twice, or there are more than `MAX_EXPERIMENTS`.
    """

    name: str
    rig: SamplingRig
    shapes: tuple[PlannedShape, ...]
    layouts: tuple[FixelLayout, ...]
    schemes: tuple[OffsetScheme, ...]
    places: tuple[Triple, ...] = (HERE,)
    repetitions: int = 1

    def __post_init__(self) -> None:
        plain_name(self.name, "plan.name")
        settle(
            self,
            shapes=tuple(self.shapes),
            layouts=tuple(self.layouts),
            schemes=tuple(self.schemes),
            places=tuple((float(x), float(y), float(a)) for x, y, a in self.places),
        )
        _refuse_repeats([shape.name for shape in self.shapes], "shapes")
        _refuse_repeats([layout.name for layout in self.layouts], "layouts")
        if not self.schemes:
            raise InvalidInput("offsets", found="none", expected="at least the nominal pose")
        if not self.places:
            raise InvalidInput("places", found="none", expected="at least [0, 0, 0]")
        whole(self.repetitions, "repetitions")
        if self.total > MAX_EXPERIMENTS:
            found = f"{self.total} experiments"
            expected = f"at most {MAX_EXPERIMENTS}"
            hint = "use coarser grids, or sample instead"
            raise InvalidInput("plan", found=found, expected=expected, hint=hint)

    @property
    def configurations(self) -> int:
        """Number of configurations of the object, for each shape and layout."""
        return sum(len(scheme) for scheme in self.schemes)

    @property
    def total(self) -> int:
        """Number of all experiments, also of those that cannot be built."""
        runs = len(self.places) * self.repetitions
        return len(self.shapes) * len(self.layouts) * self.configurations * runs

    @cached_property
    def offsets(self) -> tuple[Offset, ...]:
        """Offsets of the object, in order."""
        return tuple(offset for scheme in self.schemes for offset in scheme.offsets())

    @property
    def experiments(self) -> tuple[PlannedExperiment, ...]:
        """Experiments in order, without those whose bodies overlap, which `check` reports."""
        return self._built[0]

    def check(self) -> tuple[PlanProblem, ...]:
        """Return the problems of these experiments, by geometry alone; see `scene_problems`."""
        _, refused = self._built
        found = [PlanProblem(x.name, s) for x in self.experiments for s in scene_problems(x.scene)]
        return tuple(sorted([*refused, *found]))

    def entries(self) -> Iterator[PlanEntry]:
        """Yield the lines of the plan in order."""
        width = len(str(self.total))
        runs = range(1, self.repetitions + 1)
        lines = product(self.shapes, self.layouts, self.offsets, self.places, runs)
        for number, (shape, layout, offset, place, repetition) in enumerate(lines, 1):
            # The number comes first, so that the names sort in the order of the plan.
            parts = [f"{number:0{width}d}", shape.name, layout.name, offset.label]
            parts += [f"r{repetition}"] if self.repetitions > 1 else []
            yield PlanEntry("-".join(parts), shape, layout, offset, place, repetition)

    def scene(self, shape: PlannedShape, layout: FixelLayout, offset: Offset) -> Scene:
        """Return the scene of one configuration; raise `InvalidInput` if bodies overlap."""
        rig, pose = self.rig, object_pose(self.rig, shape, offset)
        drive = LineDrive(speed=rig.speed, travel=rig.travel, force_limit=rig.force_limit)
        head = Pusher(
            HEAD, shape_of(rig.head), pose=np.zeros(3), drive=drive, friction=rig.head_friction
        )
        peg, pegs = Disk(rig.fixel_radius), rig.peg_places(shape, layout).tolist()
        return Scene(
            bodies=(Body(OBJECT, shape.shape, mass=shape.mass, pose=pose, support=shape.support),),
            pushers=(head,),
            fixels=tuple(
                Fixel(f"fixel-{number}", peg, pose=(x, y, 0.0), friction=rig.fixel_friction)
                for number, (x, y) in enumerate(pegs, 1)
            ),
            duration=rig.duration,
        )

    @cached_property
    def _built(self) -> tuple[tuple[PlannedExperiment, ...], tuple[PlanProblem, ...]]:
        built, refused = [], []
        for entry in self.entries():
            try:
                scene = self.scene(entry.shape, entry.layout, entry.offset)
                scene = scene if entry.place == HERE else moved(scene, entry.place)
            except InvalidInput as problem:
                refused.append(PlanProblem(entry.name, str(problem)))
                continue
            conditions = _conditions(entry)
            if self.places != (HERE,):
                conditions |= dict(zip(_PLACE, entry.place, strict=True))
            built.append(PlannedExperiment(name=entry.name, scene=scene, conditions=conditions))
        return tuple(built), tuple(refused)


def object_pose(rig: SamplingRig, shape: PlannedShape, offset: Offset) -> FloatArray:
    """Return the pose (3,) of the object, which an offset rotates about its centroid."""
    angle = rig.angle + offset.theta
    c, s = np.cos(angle), np.sin(angle)
    arm = np.array([[c, -s], [s, c]]) @ shape.shape.centroid
    place = rig.nominal_centroid(shape.shape) + np.array([offset.x, offset.y]) - arm
    return np.array([place[0], place[1], angle])


def _conditions(entry: PlanEntry) -> dict[str, str | float]:
    return {
        "shape": entry.shape.name,
        "layout": entry.layout.name,
        "axis": entry.offset.axis,
        "step": entry.offset.step,
        "offset_x_m": entry.offset.x,
        "offset_y_m": entry.offset.y,
        "offset_theta_rad": entry.offset.theta,
        "repetition": float(entry.repetition),
    }


def _refuse_repeats(names: Sequence[str], where: str) -> None:
    if not names:
        raise InvalidInput(where, found="none", expected="at least one")
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InvalidInput(
                f"{where}[{k}].name", found=f"{name!r} twice", expected="different names"
            )


class Rehearsal(NamedTuple):
    """Results of a simulated plan."""

    # Fixels to which the object came closer than 0.95 mm, by experiment.
    touched: dict[str, list[bool]]
    # Experiments that touch no fixel, or whose simulation did not finish.
    problems: tuple[PlanProblem, ...]


def rehearse(plan: Plan) -> Rehearsal:
    """Simulate every experiment once, quasi-statically, with nominal friction."""
    # Repetitions have the same scene, so they are simulated once.
    distinct: dict[Scene, PlannedExperiment] = {}
    for experiment in plan.experiments:
        distinct.setdefault(experiment.scene, experiment)
    times = np.linspace(0.0, plan.rig.duration, SAMPLES)
    results = simulate_batch(list(distinct), motion=QuasiStatic(), times=times)
    touched: dict[str, list[bool]] = {}
    problems = []
    for (scene, experiment), result in zip(distinct.items(), results, strict=True):
        contacts = _touched(scene, result.pose[0, :, 0])
        touched[experiment.name] = contacts
        if not result.converged[0]:
            sentence = f"the simulation stopped after {result.stopped_at[0]:.3g} s"
            problems.append(PlanProblem(experiment.name, sentence))
        elif scene.fixels and not any(contacts):
            problems.append(PlanProblem(experiment.name, "simulated, the object touches no fixel"))
    return Rehearsal(touched, tuple(problems))


def _touched(scene: Scene, poses: FloatArray) -> list[bool]:
    """Return the fixels that the object touches in one of its poses (n, 3) [m, m, rad]."""
    outline = scene.bodies[0].shape.outline
    path = shapely.polygons([placed(outline, pose) for pose in poses])
    pegs = [shapely.Polygon(placed(f.shape.outline, f.pose)) for f in scene.fixels]
    return [bool((shapely.distance(path, peg) < TOUCH).any()) for peg in pegs]


# Checks by geometry find experiments that cannot work; passing them is no guarantee. `rehearse`
# simulates.


# [m] Larger than any plate.
FAR_AWAY: Final = 1e6


class PlanProblem(NamedTuple):
    """Problem of one experiment of a plan."""

    name: str  # name of the experiment
    sentence: str  # description of the problem


def scene_problems(scene: Scene) -> Iterator[str]:
    """Yield the problems of a scene with one head on a line.

    The head must meet the object, must not run into a fixel, and must be able to push the object
    to one. For the last check, the object is replaced by the smallest circle about its centroid
    that contains it. The circle moves straight ahead for the rest of the travel after the head has
    met it: the object may rotate, but does not slide sideways.
    """
    x, y, _ = scene.pushers[0].pose.tolist()
    drive = scene.pushers[0].drive
    assert isinstance(drive, LineDrive)
    angle = atan2(drive.direction[1], drive.direction[0])
    if (x, y, angle) != HERE:  # back in the frame of the rig, along +x
        scene = moved(moved(scene, (-x, -y, 0.0)), (0.0, 0.0, -angle))
    way = _clearance(scene)
    if way is None:
        yield "the head passes the object without contact"
    elif way > drive.travel:
        yield f"the head stops {_mm(way - drive.travel)} short of the object"
    else:
        yield from _out_of_reach(scene, drive.travel - way)
    yield from _head_hits(scene, drive.travel)


def _clearance(scene: Scene) -> float | None:
    """Return the distance that the head moves until it meets the object [m]; None if it misses.

    Measured from the foremost point of the head: exact for a flat face normal to the motion.
    """
    head, body = scene.pushers[0], scene.bodies[0]
    points = placed(head.shape.outline, head.pose)
    (_, low), (front, high) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    outline = shapely.Polygon(placed(body.shape.outline, body.pose))
    ahead = shapely.intersection(outline, shapely.box(front, low, FAR_AWAY, high))
    return None if ahead.is_empty else max(float(ahead.bounds[0]) - front, 0.0)


def _out_of_reach(scene: Scene, way: float) -> Iterator[str]:
    """Yield a problem if the object cannot meet a fixel while it moves `way` [m] ahead."""
    body = scene.bodies[0]
    x, y = placed(body.shape.centroid, body.pose).tolist()
    track = shapely.LineString([(x, y), (x + way, y)])
    radius = _circle(body.shape)
    if not scene.fixels:
        return
    distance = {
        fixel.name: float(track.distance(shapely.Point(fixel.pose[:2])))
        - radius
        - (fixel.shape.radius if isinstance(fixel.shape, Disk) else _circle(fixel.shape))
        for fixel in scene.fixels
    }
    nearest = min(distance, key=lambda name: distance[name])
    if distance[nearest] > 0.0:
        yield (
            f"the object cannot reach a fixel: the distance to the nearest, {nearest}, stays "
            f"{_mm(distance[nearest])}"
        )


def _head_hits(scene: Scene, travel: float) -> Iterator[str]:
    """Yield a problem for each fixel that the head runs into."""
    head = scene.pushers[0]
    start = placed(head.shape.outline, head.pose)
    end = start + np.array([travel, 0.0])
    swept = shapely.MultiPoint(np.vstack((start, end))).convex_hull
    for fixel in scene.fixels:
        peg = shapely.Polygon(placed(fixel.shape.outline, fixel.pose))
        if swept.intersects(peg):
            yield f"the head collides with {fixel.name}"


def _circle(shape: Shape) -> float:
    """Return the largest distance of the outline from the centroid [m]."""
    return max(hypot(x, y) for x, y in (shape.outline - shape.centroid).tolist())


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"
