"""Drake: discrete contact by convex problems that are solved to high accuracy, three dimensions."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version as version_of
from typing import Any, ClassVar, final

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    Convex,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PlanarJoint,
    PrismaticJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fixel.model.engine_parameters import DRAKE
from fixel.model.parameter_info import ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, EngineFailed
from fixel.simulation.engines.plane import harmonic_partner, planar_refusal
from fixel.simulation.engines.prisms import rectangle
from fixel.simulation.engines.task import PlainOutline, PlainPusher, PlainTask, pusher_poses
from fixel.typing import FloatArray

# Half spaces are fine for rigid bodies, of which it warns with every scene.
logging.getLogger("drake").setLevel(logging.ERROR)

FOOT = 0.002  # [m] radius of a foot
CORNER = 1e-5  # [m] radius of the balls at corners, where two faces touch at points
HEIGHT = 0.1  # [m] of bodies
HEAVY = 1e7  # [kg], [kg m^2]: a pusher that nothing slows down
LIGHT = 1e-3  # [kg] of the body apart from its feet


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Drake(AbstractPhysicsEngine):
    """Engine Drake, by default with the contacts that it is shipped with.

    Every support point is a ball on a floor, pressed down by its own weight.

    Parameters
    ----------
    step : float
        Time step [s].
    approximation : str
        Approximation of contact: "lagged", "similar", "sap" or "tamsi".
    stiffness : float
        Stiffness of a contact point [N/m].
    dissipation : float
        Dissipation of Hunt and Crossley [s/m].
    relaxation : float
        Relaxation time of contacts, of "sap" only [s].
    stiction : float
        Tolerance of stiction, of "tamsi" only [m/s].
    """

    name: ClassVar[str] = "drake"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = DRAKE

    step: float = 5e-3
    approximation: str = "similar"
    stiffness: float = 1e6
    dissipation: float = 50.0
    relaxation: float = 0.1
    stiction: float = 1e-3

    @property
    def version(self) -> str:
        return version_of("drake")

    def refusal(self, task: PlainTask) -> str:
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        end = float(task.times[-1])
        n = math.ceil(end / self.step * (1.0 - 1e-9))
        step = end / n
        diagram, plant, joint, drive = self._built(task, step)
        simulator = Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        joint.set_translation(context, task.body.start[:2])
        joint.set_rotation(context, float(task.body.start[2]))
        joint.set_translational_velocity(context, task.body.velocity[:2])
        joint.set_angular_velocity(context, float(task.body.velocity[2]))
        grid = np.linspace(0.0, end, n + 1)
        head = np.zeros((n + 1, 3)) if task.pusher is None else pusher_poses(task.pusher, grid)
        drive.set_translation(context, head[0, :2])
        drive.set_rotation(context, float(head[0, 2]))
        simulator.Initialize()
        track = np.zeros((n + 1, 3))
        track[0] = task.body.start
        for k in range(n):
            velocity = (head[k + 1] - head[k]) / step
            drive.set_translational_velocity(context, velocity[:2])
            drive.set_angular_velocity(context, float(velocity[2]))
            try:
                simulator.AdvanceTo(float(grid[k + 1]))
            except RuntimeError as problem:
                reason = str(problem).strip().partition("\n")[0]
                raise EngineFailed(f"at {grid[k]:.3g} s: {reason}") from None
            track[k + 1, :2] = joint.get_translation(context)
            track[k + 1, 2] = joint.get_rotation(context)
        return np.column_stack([np.interp(task.times, grid, track[:, k]) for k in range(3)])

    def _built(self, task: PlainTask, step: float) -> tuple[Any, Any, Any, Any]:
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=step,
            discrete_contact_approximation=self.approximation,
            contact_model="point",
            stiction_tolerance=self.stiction,
        )
        plant, scene_graph = AddMultibodyPlant(config, builder)
        own = task.body
        floor = self._touching(plant, plant.world_body(), RigidTransform(), HalfSpace(), "floor", 1)
        body, joint, carried = self._body(plant, task)
        blocks, corners = self._outline(plant, body, own.outline, "object", 1.0)
        feet = [
            self._foot(
                plant, body, own.points[k], float(own.loads[k]), float(own.friction[k]), k, task
            )
            for k in carried
        ]
        head_body, drive = self._head(plant, task.pusher)
        pairs = [([floor], feet)]
        obstacles = [(head_body, task.pusher.outline, task.pusher.friction)] if task.pusher else []
        for k, (holder, outline, friction) in enumerate(obstacles):
            faces, tips = self._outline(
                plant, holder, outline, f"head{k}_", harmonic_partner(friction)
            )
            pairs += [(blocks, tips), (corners, faces)]
        for k, fixel in enumerate(task.fixels):
            place = RigidTransform(RollPitchYaw(0.0, 0.0, fixel.pose[2]), [*fixel.pose[:2], FOOT])
            faces, tips = self._outline(
                plant,
                plant.world_body(),
                fixel.outline,
                f"peg{k}_",
                harmonic_partner(fixel.friction),
                place,
            )
            pairs += [(blocks, tips), (corners, faces)]
        filters = scene_graph.collision_filter_manager()
        everything = {geometry for pair in pairs for side in pair for geometry in side}
        everything |= {floor, *blocks, *corners, *feet}
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(list(everything))))
        allowed = CollisionFilterDeclaration()
        for one, other in pairs:
            if one and other:
                allowed.AllowBetween(GeometrySet(one), GeometrySet(other))
        filters.Apply(allowed)
        plant.Finalize()
        return builder.Build(), plant, joint, drive

    def _touching(
        self, plant: Any, body: Any, place: Any, shape: Any, label: str, friction: float
    ) -> Any:
        """Add a shape; friction 1 against `harmonic_partner(mu)` is mu."""
        material = ProximityProperties()
        AddContactMaterial(
            dissipation=self.dissipation,
            point_stiffness=self.stiffness,
            friction=CoulombFriction(friction, friction),
            properties=material,
        )
        material.AddProperty("material", "relaxation_time", self.relaxation)
        return plant.RegisterCollisionGeometry(body, place, shape, label, material)

    def _body(self, plant: Any, task: PlainTask) -> tuple[Any, Any, list[int]]:
        own = task.body
        loaded = np.flatnonzero(own.loads * own.friction > 0.0)
        masses = own.loads[loaded] / task.gravity
        rest = own.inertia - float(masses @ (own.points[loaded] ** 2).sum(axis=1))
        unit = max(rest, 1e-9) / LIGHT
        inertia = SpatialInertia(
            LIGHT, np.zeros(3), UnitInertia(unit, unit, unit), skip_validity_check=True
        )
        body = plant.AddRigidBody("object", inertia)
        lifted = _offset(plant, "plane", plant.world_body(), [0.0, 0.0, FOOT])
        joint = plant.AddJoint(PlanarJoint("object", lifted, body.body_frame(), np.zeros(3)))
        return body, joint, loaded.tolist()

    def _foot(
        self,
        plant: Any,
        body: Any,
        place: FloatArray,
        load: float,
        friction: float,
        k: int,
        task: PlainTask,
    ) -> Any:
        mass = SpatialInertia(load / task.gravity, np.zeros(3), UnitInertia(1e-6, 1e-6, 1e-6))
        foot = plant.AddRigidBody(f"foot{k}", mass)
        slide = _offset(plant, f"foot{k}_slide", body, [*place, 0.0])
        plant.AddJoint(PrismaticJoint(f"foot{k}", slide, foot.body_frame(), [0.0, 0.0, 1.0]))
        ball = Sphere(FOOT)
        return self._touching(
            plant, foot, RigidTransform(), ball, f"foot{k}", harmonic_partner(friction)
        )

    def _head(self, plant: Any, pusher: PlainPusher | None) -> tuple[Any, Any]:
        unit = UnitInertia(1.0, 1.0, 1.0)
        head = plant.AddRigidBody("head", SpatialInertia(HEAVY, np.zeros(3), unit))
        rail = _offset(plant, "rail", plant.world_body(), [0.0, 0.0, FOOT])
        return head, plant.AddJoint(PlanarJoint("head", rail, head.body_frame(), np.zeros(3)))

    def _outline(
        self,
        plant: Any,
        body: Any,
        outline: PlainOutline,
        label: str,
        friction: float,
        place: Any = None,
    ) -> tuple[list[Any], list[Any]]:
        """Add the pieces of an outline, and balls inside their corners; a disc is a ball."""
        place = place or RigidTransform()
        blocks, balls = [], []
        for k, piece in enumerate(outline.pieces):
            if outline.radius > 0.0:
                centre = place @ RigidTransform([*piece[0], 0.0])
                ball = Sphere(outline.radius)
                balls.append(self._touching(plant, body, centre, ball, f"{label}{k}", friction))
                continue
            shape, at = _prism(piece, f"{label}{k}")
            blocks.append(self._touching(plant, body, place @ at, shape, f"{label}{k}", friction))
            for j, corner in enumerate(_inner(piece)):
                centre = place @ RigidTransform([*corner, 0.0])
                name = f"{label}{k}_{j}"
                balls.append(self._touching(plant, body, centre, Sphere(CORNER), name, friction))
        # A disc touches faces by itself, and other discs.
        return (blocks or balls), balls


def _prism(piece: FloatArray, label: str) -> tuple[Any, Any]:
    box = rectangle(piece)
    if box is not None:
        x, y, theta, length, width = box
        return Box(length, width, HEIGHT), RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0.0])
    levels = [np.column_stack((piece, np.full(len(piece), z))) for z in (-HEIGHT / 2, HEIGHT / 2)]
    return Convex(np.concatenate(levels).T, label), RigidTransform()


def _offset(plant: Any, label: str, body: Any, place: Any) -> Any:
    return plant.AddFrame(FixedOffsetFrame(label, body.body_frame(), RigidTransform(place)))


def _inner(corners: FloatArray) -> FloatArray:
    """Return the centres of balls that touch both edges at each corner of a convex polygon."""
    ahead = np.roll(corners, -1, axis=0) - corners
    ahead /= np.hypot(*ahead.T)[:, None]
    back = -np.roll(ahead, 1, axis=0)
    bisector = ahead + back
    bisector /= np.hypot(*bisector.T)[:, None]
    sine = np.abs(bisector[:, 0] * ahead[:, 1] - bisector[:, 1] * ahead[:, 0])
    return corners + CORNER * bisector / sine[:, None]
