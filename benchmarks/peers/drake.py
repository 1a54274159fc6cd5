"""Drake: discrete contact by convex problems that are solved to high accuracy, three dimensions."""

from __future__ import annotations

from importlib.metadata import version as version_of
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
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

from benchmarks.peers.task import Task

name = "Drake"
version = version_of("drake")
# The approximations that replace TAMSI. Contacts of 1e5 N/m and less drift further.
variants: dict[str, dict[str, Any]] = {
    "as shipped": {"approximation": "lagged"},
    "similar": {"approximation": "similar"},
    "sap": {"approximation": "sap"},
}

FOOT = 0.002  # [m] radius of a foot
CORNER = 1e-5  # [m] radius of the balls at corners, where two boxes touch at points
HEIGHT = 0.1  # [m] of the square and the head
GRAVITY = 9.81  # [m/s^2]
HEAVY = 1e7  # [kg]: a head that nothing slows down
STIFFNESS = 1e6  # [N/m] of a contact; this and the next two as shipped
DISSIPATION = 50.0  # [s/m] of lagged, similar and TAMSI
RELAXATION = 0.1  # [s] of SAP
LIGHT = 1e-3  # [kg] of the body apart from its feet


class World(NamedTuple):
    simulator: Any
    plant: Any
    joint: Any
    duration: float


def build(task: Task, step: float, approximation: str) -> World:
    """Support friction: three balls on a floor, each pressed down by its own weight ``N / g``."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=step,
        discrete_contact_approximation=approximation,
        contact_model="point",
    )
    plant, scene_graph = AddMultibodyPlant(config, builder)
    world = plant.world_body()

    def touching(body: Any, place: Any, shape: Any, label: str, friction: float = 1.0) -> Any:
        """Add a shape; friction 1 against `_partner(mu)` is mu."""
        material = ProximityProperties()
        AddContactMaterial(
            dissipation=DISSIPATION,
            point_stiffness=STIFFNESS,
            friction=CoulombFriction(friction, friction),
            properties=material,
        )
        material.AddProperty("material", "relaxation_time", RELAXATION)
        return plant.RegisterCollisionGeometry(body, RigidTransform(place), shape, label, material)

    def offset(label: str, body: Any, place: Any) -> Any:
        frame = FixedOffsetFrame(label, body.body_frame(), RigidTransform(place))
        return plant.AddFrame(frame)

    floor = touching(world, [0.0, 0.0, 0.0], HalfSpace(), "floor")
    pegs = [
        touching(world, [x, y, FOOT], Sphere(task.peg_radius), f"peg{k}", _partner(task.mu_peg))
        for k, (x, y) in enumerate(task.pegs)
    ]
    own = task.inertia - sum(
        load / GRAVITY * float(foot @ foot)
        for foot, load in zip(task.feet, task.loads, strict=True)
    )
    unit = max(own, 1e-9) / LIGHT
    inertia = SpatialInertia(
        LIGHT, np.zeros(3), UnitInertia(unit, unit, unit), skip_validity_check=True
    )
    square = plant.AddRigidBody("object", inertia)
    joint = plant.AddJoint(
        PlanarJoint("object", world.body_frame(), square.body_frame(), np.zeros(3))
    )
    block = touching(square, [0.0, 0.0, FOOT], _box(task.vertices), "object")
    corners = [
        touching(square, [x, y, FOOT], Sphere(CORNER), f"corner{k}")
        for k, (x, y) in enumerate(_inner(task.vertices))
    ]
    feet = []
    for k, (place, load) in enumerate(zip(task.feet, task.loads, strict=True)):
        mass = SpatialInertia(load / GRAVITY, np.zeros(3), UnitInertia(1e-6, 1e-6, 1e-6))
        foot = plant.AddRigidBody(f"foot{k}", mass)
        slide = offset(f"foot{k}_slide", square, [*place, FOOT])
        plant.AddJoint(PrismaticJoint(f"foot{k}", slide, foot.body_frame(), [0.0, 0.0, 1.0]))
        feet.append(
            touching(foot, np.zeros(3), Sphere(FOOT), f"foot{k}", _partner(task.mu_support))
        )
    head = plant.AddRigidBody(
        "head", SpatialInertia(HEAVY, np.zeros(3), UnitInertia(1.0, 1.0, 1.0))
    )
    rail = offset("rail", world, [0.0, 0.0, FOOT])
    drive = plant.AddJoint(PrismaticJoint("head", rail, head.body_frame(), [1.0, 0.0, 0.0]))
    middle = 0.5 * (task.head.min(axis=0) + task.head.max(axis=0))
    face = touching(head, [*middle, 0.0], _box(task.head), "head", _partner(task.mu_head))
    tips = [
        touching(head, [x, y, 0.0], Sphere(CORNER), f"tip{k}", _partner(task.mu_head))
        for k, (x, y) in enumerate(_inner(task.head))
    ]
    filters = scene_graph.collision_filter_manager()
    everything = [floor, *pegs, block, *corners, *feet, face, *tips]
    filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(everything)))
    allowed = CollisionFilterDeclaration()
    for one, other in (([floor], feet), ([block], pegs), ([block], tips), (corners, [face])):
        allowed.AllowBetween(GeometrySet(one), GeometrySet(other))
    filters.Apply(allowed)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_translation(context, task.start[:2])
    joint.set_rotation(context, task.start[2])
    drive.set_translation_rate(context, task.speed)
    simulator.Initialize()
    return World(simulator, plant, joint, task.duration)


def run(world: World) -> tuple[float, float, float]:
    world.simulator.AdvanceTo(world.duration)
    context = world.plant.GetMyContextFromRoot(world.simulator.get_context())
    x, y = world.joint.get_translation(context)
    return float(x), float(y), float(world.joint.get_rotation(context))


def _partner(friction: float) -> float:
    """Coefficient that combines with 1 to `friction`: Drake takes the harmonic mean."""
    return friction / (2.0 - friction)


def _box(corners: Any) -> Any:
    return Box(*np.ptp(corners, axis=0), HEIGHT)


def _inner(corners: Any) -> Any:
    """Centres of balls that touch both edges at each corner."""
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return corners - CORNER * np.sign(corners - middle)
