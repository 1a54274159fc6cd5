"""Motions prepared for drawing: shapes, poses, contact forces, signals, errors.

Pages, films and other programs draw the same data: outlines with a role, poses against time,
contact forces, tactile signals, errors. Nothing here depends on how they are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, final

import numpy as np

from fixel.calibration.target import scene_of
from fixel.drawing.view import forces
from fixel.model import Channel, Experiment, Scene, Trajectory
from fixel.model.records import SimulationRecord
from fixel.model.shape import Shape, placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray, IntArray
from fixel.workflows.project.compare import Comparison, errors_of

Kind = Literal["measured", "simulated"]
Role = Literal["object", "body", "pusher", "fixel"]

MARGIN: Final = 0.05  # margin around the drawing, as a fraction of its size


class Thing(NamedTuple):
    """Body, pusher or fixel, with its pose at the start."""

    name: str
    role: Role
    shape: Shape
    pose: FloatArray  # (3,) [m, m, rad]


class ContactViews(NamedTuple):
    """Contacts of all samples; forces act on the first of the pair."""

    sample: IntArray  # (n,) not decreasing
    pair: IntArray  # (n, 2) indices into the things
    point: FloatArray  # (n, 2) in the world [m]
    force: FloatArray  # (n, 2) in the world [N]


class MotionErrors(NamedTuple):
    """Errors of a simulation against the measurement."""

    time: FloatArray  # (n,) measured instants [s]
    position: FloatArray  # (n,) [m]
    angle: FloatArray  # (n,) from measured to simulated [rad]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MotionView:
    """Motion of everything in a scene, measured or simulated.

    Parameters
    ----------
    id : str
        Identifier, unique among motions shown together: `"measured"`, `"simulation-12"`.
    label : str
    kind : str
    time : (n,) float64
        Times on the clock of the experiment [s].
    pose : mapping from name to (n, 3) float64
        Poses of everything that moves; angles are continuous [m, m, rad].
    contacts : ContactViews, optional
    touch : Channel, optional
        One column per fixel, 1 where it is touched.
    errors : MotionErrors, optional
    status, advice : str
        Status and advice of a `Simulation`; empty for a measured motion.
    """

    id: str
    label: str
    kind: Kind
    time: FloatArray
    pose: Mapping[str, FloatArray]
    contacts: ContactViews | None = None
    touch: Channel | None = None
    errors: MotionErrors | None = None
    status: str = ""
    advice: str = ""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """Motions of the same things, to be drawn together.

    Parameters
    ----------
    title : str
    object_name : str
        Name of the thing whose motion is compared.
    reference : (2,) float64
        Its centre of mass in its own frame [m], which draws the trail.
    things : tuple of Thing
        Things in the order of `Scene.names`.
    motions : tuple of MotionView
    """

    title: str
    object_name: str
    reference: FloatArray
    things: tuple[Thing, ...]
    motions: tuple[MotionView, ...]

    @property
    def box(self) -> FloatArray:
        """(4,) box of everything that is ever visible: x and y of the lower left, x and y of the
        upper right [m]."""
        points = [placed(thing.shape.outline, thing.pose) for thing in self.things]
        for motion in self.motions:
            for thing in self.things:
                if thing.name in motion.pose:
                    points.append(_swept(thing.shape, motion.pose[thing.name]))
        everything = np.concatenate(points)
        everything = everything[np.isfinite(everything).all(axis=1)]
        low, high = everything.min(axis=0), everything.max(axis=0)
        margin = MARGIN * float((high - low).max())
        return np.concatenate((low - margin, high + margin))


def story_of_scene(scene: Scene, motions: Sequence[MotionView], title: str) -> Story:
    """Build the motions of a scene that is no experiment; its first body is the object."""
    body = scene.bodies[0]
    return Story(
        title=title,
        object_name=body.name,
        reference=body.com,
        things=things_of(scene, body.name),
        motions=tuple(motions),
    )


def story_of_experiment(experiment: Experiment, motions: Sequence[MotionView]) -> Story:
    """Build the motions of an experiment: as measured, and as simulated.

    Raises
    ------
    InvalidInput
        The experiment has no scene, so that its shapes are unknown.
    """
    scene = scene_of(experiment)
    body = next(b for b in scene.bodies if b.name == experiment.object_name)
    return Story(
        title=experiment.key,
        object_name=body.name,
        reference=body.com,
        things=things_of(scene, body.name),
        motions=(measured_motion(experiment), *motions),
    )


def things_of(scene: Scene, object_name: str) -> tuple[Thing, ...]:
    """Return everything in a scene, in the order of its names."""
    bodies = [
        Thing(b.name, "object" if b.name == object_name else "body", b.shape, b.pose)
        for b in scene.bodies
    ]
    pushers = [Thing(p.name, "pusher", p.shape, p.pose) for p in scene.pushers]
    fixels = [Thing(f.name, "fixel", f.shape, f.pose) for f in scene.fixels]
    return (*bodies, *pushers, *fixels)


def measured_motion(experiment: Experiment) -> MotionView:
    """Return the motion that the camera and the fixels measured."""
    track = experiment.trajectory
    poses = {experiment.object_name: _continuous(track.pose)}
    pushers = scene_of(experiment).pushers
    if experiment.pusher is not None and pushers:
        poses[pushers[0].name] = _continuous(experiment.pusher.at(track.time))
    return MotionView(
        id="measured",
        label="measured" if experiment.real else "measured (simulated testbed)",
        kind="measured",
        time=track.time,
        pose=poses,
        touch=experiment.channel("tactile"),
    )


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


def compared_motion(answer: Comparison, label: str, *, id: str) -> MotionView:
    """Return the motion of a simulation of an experiment, with its errors."""
    simulation = answer.simulation
    start = float(answer.simulated.time[0]) - float(simulation.time[0])
    return replace(
        simulated_motion(simulation, label, id=id, start=start),
        touch=answer.contacts,
        errors=MotionErrors(answer.time, answer.position, answer.angle),
    )


def stored_motion(
    experiment: Experiment, record: SimulationRecord, label: str, *, id: str
) -> MotionView:
    """Return the motion of a stored simulation: poses, without contacts."""
    track = record.trajectory
    poses = {experiment.object_name: _continuous(track.pose)}
    pushers = scene_of(experiment).pushers
    if record.pusher is not None and pushers:
        poses[pushers[0].name] = _continuous(record.pusher.at(track.time))
    return MotionView(
        id=id,
        label=label,
        kind="simulated",
        time=track.time,
        pose=poses,
        errors=MotionErrors(*errors_of(experiment, track)),
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
        none = np.zeros((0, 2))
        return ContactViews(np.zeros(0, np.int64), np.zeros((0, 2), np.int64), none, none)
    sample = np.searchsorted(instants, rows["time"])
    pair = np.column_stack((rows["body"], rows["other"]))
    written = _when_written(rows["time"], pair, rows["point"])
    point, force = np.array(rows["point"], np.float64), forces(rows)
    for k, name in enumerate(simulation.names[: len(simulation.pose)]):
        own = np.flatnonzero(pair[:, 0] == k)
        if len(own):
            track = Trajectory(time=instants, pose=simulation.pose[name][:n_sample])
            then, now = track.at(written[own]), track.at(rows["time"][own])
            point[own] = now[:, :2] + _turned(point[own] - then[:, :2], now[:, 2] - then[:, 2])
            force[own] = _turned(force[own], now[:, 2] - then[:, 2])
    return ContactViews(sample, pair, point, force)


def _when_written(time: FloatArray, pair: IntArray, point: FloatArray) -> FloatArray:
    """(n,) middle of the instants at which the same contact is in the table [s]."""
    keys = np.column_stack((pair.astype(np.float64), point))
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.ravel()
    count = np.bincount(group)
    return np.asarray((np.bincount(group, time) / count)[group], np.float64)


def _turned(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.column_stack((c * x - s * y, s * x + c * y))


def _continuous(pose: FloatArray) -> FloatArray:
    """Return the same poses without jumps of the angle by whole turns."""
    return np.column_stack((pose[:, :2], np.unwrap(pose[:, 2])))


def _swept(shape: Shape, poses: FloatArray) -> FloatArray:
    """(n, 2) corners of the boxes about a shape at some of its poses."""
    reach = float(np.hypot(*shape.outline.T).max())
    places = poses[:, :2]
    return np.concatenate((places - reach, places + reach))
