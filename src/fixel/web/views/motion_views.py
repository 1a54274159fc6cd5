"""Motions prepared for drawing: shapes, poses, contact forces, signals, errors.

Pages, films and other programs draw the same data: outlines with a role, poses against time,
contact forces, tactile signals, errors. Nothing here depends on how they are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, PlainSerializer, PlainValidator

from fixel.calibration.target import errors_of, scene_of
from fixel.drawing.view import forces
from fixel.model import Body, Channel, Disk, Experiment, Fixel, Pusher, Scene, Trajectory
from fixel.model.records import SimulationRecord
from fixel.model.shape import Shape, placed, rotated
from fixel.simulation import Simulation
from fixel.typing import FloatArray, IntArray
from fixel.web.values import Answer, Array, IndexArray, Numbers
from fixel.workflows.project.compare import RunComparison

Role = Literal["object", "body", "pusher", "fixel"]

MARGIN: Final = 0.05  # margin around the drawing, as a fraction of its size


class ShapeOutline(Answer):
    """An outline in its own frame: a polygon or a disk."""

    polygon_m: list[list[float]] | None = Field(description="corners x, y of a polygon")
    disk_m: float | None = Field(description="radius")


def _outline(shape: Shape) -> ShapeOutline:
    if isinstance(shape, Disk):
        return ShapeOutline(polygon_m=None, disk_m=shape.radius)
    return ShapeOutline(polygon_m=shape.vertices.tolist(), disk_m=None)


class DrawnShape(Answer):
    """Body, pusher or fixel."""

    name: str
    role: Role = Field(
        description="role in the scene; `object` is the body whose motion is compared"
    )
    shape: Annotated[Shape, PlainValidator(lambda shape: shape), PlainSerializer(_outline)]
    pose: Numbers = Field(description="start pose: x [m], y [m], angle [rad]")


class ContactViews(Answer):
    """All contacts of all samples."""

    sample: IndexArray = Field(
        description="(n,) index of the sample of the motion, in ascending order"
    )
    pair: IndexArray = Field(description="(n, 2) indices of the two shapes")
    point: Array = Field(
        serialization_alias="point_m", description="(n, 2) contact point in the world"
    )
    force: Array = Field(
        serialization_alias="force_n",
        description="(n, 2) force on the first shape of the pair, in world axes",
    )


class TouchView(Answer):
    """Touched fixels at each time."""

    names: list[str]
    time: Array = Field(serialization_alias="time_s")
    values: Array = Field(description="(n, n_fixel) 1 if touched, 0 if not, NaN without a reading")


class MotionErrors(Answer):
    """Errors of a simulation against the measurement."""

    time: Array = Field(serialization_alias="time_s")
    position: Array = Field(serialization_alias="position_m")
    angle: Array = Field(
        serialization_alias="angle_rad", description="angle from the measured to the simulated pose"
    )


class MotionView(Answer):
    """Motion of everything in a scene, measured or simulated."""

    id: str = Field(description="identifier, unique among the motions of the page")
    label: str
    kind: Literal["measured", "simulated"]
    time: Array = Field(
        serialization_alias="time_s", description="time on the clock of the experiment"
    )
    pose: dict[str, Array] = Field(
        description="poses by name of the moving body: (n, 3) x [m], y [m], angle [rad], with "
        "continuous angles"
    )
    contacts: ContactViews | None = None
    touch: TouchView | None = None
    errors: MotionErrors | None = None
    status: str = Field(
        default="", description="status of the simulation: converged, or the reason why it stopped"
    )
    advice: str = Field(default="", description="advice if the simulation stopped early")


class Animation(Answer):
    """Motions of the same things, to be drawn together."""

    title: str
    object: str = Field(description="name of the body whose motion is compared")
    reference: Numbers = Field(
        serialization_alias="reference_m", description="centre of mass of this body in its frame"
    )
    things: list[DrawnShape] = Field(description="shapes in the order of the names of the scene")
    box: Numbers = Field(
        serialization_alias="box_m",
        description="x, y of the lower left and upper right corner of the visible area",
    )
    motions: list[MotionView]


def animation_of_scene(
    scene: Scene, motions: Sequence[MotionView], title: str, object_name: str | None = None
) -> Animation:
    """Put motions of a scene together; its first body is the object by default."""
    body = next((b for b in scene.bodies if b.name == object_name), scene.bodies[0])
    things = things_of(scene, body.name)
    return Animation(
        title=title,
        object=body.name,
        reference=body.com,
        things=things,
        box=_box(things, motions),
        motions=list(motions),
    )


def animation_of_experiment(experiment: Experiment, motions: Sequence[MotionView]) -> Animation:
    """Put the motions of an experiment together: as measured, and as simulated.

    An experiment without a scene raises `InvalidInput`, as its shapes are unknown.
    """
    return animation_of_scene(
        scene_of(experiment),
        [measured_motion(experiment), *motions],
        experiment.key,
        experiment.object_name,
    )


def _box(things: Sequence[DrawnShape], motions: Sequence[MotionView]) -> FloatArray:
    """(4,) box of everything that is ever visible [m]."""
    points = [placed(thing.shape.outline, thing.pose) for thing in things]
    points += [
        _swept(thing.shape, motion.pose[thing.name])
        for motion in motions
        for thing in things
        if thing.name in motion.pose
    ]
    everything = np.concatenate(points)
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = MARGIN * float((high - low).max())
    return np.concatenate((low - margin, high + margin))


def things_of(scene: Scene, object_name: str) -> list[DrawnShape]:
    """Return everything in a scene, in the order of its names."""
    kinds: tuple[tuple[Role, Sequence[Body | Pusher | Fixel]], ...] = (
        ("body", scene.bodies),
        ("pusher", scene.pushers),
        ("fixel", scene.fixels),
    )
    return [
        DrawnShape(
            name=one.name,
            role="object" if one.name == object_name else role,
            shape=one.shape,
            pose=one.pose,
        )
        for role, every in kinds
        for one in every
    ]


def measured_motion(experiment: Experiment) -> MotionView:
    """Return the motion that the camera and the fixels measured."""
    return MotionView(
        id="measured",
        label="measured" if experiment.real else "measured (simulated testbed)",
        kind="measured",
        time=experiment.trajectory.time,
        pose=_poses(experiment, experiment),
        touch=_touch(experiment.channel("tactile")),
    )


def _poses(experiment: Experiment, run: Experiment | SimulationRecord) -> dict[str, FloatArray]:
    """Poses of the object and of the pusher in a run of an experiment, where they are known."""
    track = run.trajectory
    poses = {experiment.object_name: _continuous(track.pose)}
    pushers = scene_of(experiment).pushers
    if run.pusher is not None and pushers:
        poses[pushers[0].name] = _continuous(run.pusher.at(track.time))
    return poses


def _touch(channel: Channel | None) -> TouchView | None:
    if channel is None:
        return None
    names = [column.removesuffix("_bool").replace("_", " ") for column in channel.columns]
    return TouchView(names=names, time=channel.time, values=channel.values)


def simulated_motion(
    simulation: Simulation, label: str = "simulated", *, id: str = "simulation", start: float = 0.0
) -> MotionView:
    """Return the motion of a simulation, `start` [s] later than on its own clock."""
    poses = np.stack(list(simulation.pose.values()), axis=1)
    known = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    n = int(np.argmin(np.append(known, False)))  # number of samples before the first that fails
    return MotionView(
        id=id,
        label=label,
        kind="simulated",
        time=start + simulation.time[:n],
        pose={name: _continuous(pose[:n]) for name, pose in simulation.pose.items()},
        contacts=contacts_of(simulation, n),
        status=simulation.status,
        advice=simulation.advice,
    )


def compared_motion(answer: RunComparison, label: str, *, id: str) -> MotionView:
    """Return the motion of a simulation of an experiment, with its errors."""
    simulation = answer.simulation
    start = float(answer.simulated.time[0]) - float(simulation.time[0])
    motion = simulated_motion(simulation, label, id=id, start=start)
    errors = MotionErrors(time=answer.time, position=answer.position, angle=answer.angle)
    return motion.model_copy(update={"touch": _touch(answer.contacts), "errors": errors})


def stored_motion(
    experiment: Experiment, record: SimulationRecord, label: str, *, id: str
) -> MotionView:
    """Return the motion of a stored simulation: poses, without contacts."""
    time, position, angle = errors_of(experiment, record.trajectory)
    return MotionView(
        id=id,
        label=label,
        kind="simulated",
        time=record.trajectory.time,
        pose=_poses(experiment, record),
        errors=MotionErrors(time=time, position=position, angle=angle),
        status=record.status,
    )


def contacts_of(simulation: Simulation, n_sample: int) -> ContactViews:
    """Return the contacts of the first samples, each at the place of its sample.

    The table of a simulation has the place of a contact when the equations of its step were
    written. Samples of one step therefore share a point, which belongs to the middle of their
    instants. From there it is moved with its body to each of them, and its force is turned.
    """
    rows = simulation.contacts
    instants = simulation.time[:n_sample]
    rows = rows[rows["time"] <= instants[-1]] if n_sample else rows[:0]
    if len(rows) == 0:
        none, nowhere = np.zeros((0, 2), np.int64), np.zeros((0, 2))
        return ContactViews(sample=none[:, 0], pair=none, point=nowhere, force=nowhere)
    sample = np.searchsorted(instants, rows["time"])
    pair = np.column_stack((rows["body"], rows["other"]))
    written = _when_written(rows["time"], pair, rows["point"])
    point, force = np.array(rows["point"], np.float64), forces(rows)
    for k, name in enumerate(simulation.names[: len(simulation.pose)]):
        own = np.flatnonzero(pair[:, 0] == k)
        if len(own):
            track = Trajectory(time=instants, pose=simulation.pose[name][:n_sample])
            then, now = track.at(written[own]), track.at(rows["time"][own])
            point[own] = now[:, :2] + rotated(point[own] - then[:, :2], now[:, 2] - then[:, 2])
            force[own] = rotated(force[own], now[:, 2] - then[:, 2])
    return ContactViews(sample=sample, pair=pair, point=point, force=force)


def _when_written(time: FloatArray, pair: IntArray, point: FloatArray) -> FloatArray:
    """(n,) middle of the instants at which the same contact is in the table [s]."""
    keys = np.column_stack((pair.astype(np.float64), point))
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.ravel()
    count = np.bincount(group)
    return np.asarray((np.bincount(group, time) / count)[group], np.float64)


def _continuous(pose: FloatArray) -> FloatArray:
    """Return the same poses without jumps of the angle by whole turns."""
    return np.column_stack((pose[:, :2], np.unwrap(pose[:, 2])))


def _swept(shape: Shape, poses: FloatArray) -> FloatArray:
    """(n, 2) corners of the boxes about a shape at some of its poses."""
    reach = float(np.hypot(*shape.outline.T).max())
    places = poses[:, :2]
    return np.concatenate((places - reach, places + reach))
