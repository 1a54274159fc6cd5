"""Data model: shapes, bodies, pushers, fixels and scenes, checked when created."""

from fixel.model.bodies import Body, Drive, Fixel, LineDrive, PathDrive, Pusher, Spring
from fixel.model.experiment import Channel, Experiment, Flag, PlannedExperiment, Provenance
from fixel.model.goals import (
    AllOf,
    AnyOf,
    Beyond,
    BodyTrack,
    Contact,
    Exit,
    ForceAbove,
    Goal,
    Inside,
    PoseRegion,
    Seated,
)
from fixel.model.parameters import KNOWN_PARAMETERS, ParameterInfo, Parameters
from fixel.model.plane import FrictionMap, LoadMap, Plane
from fixel.model.probability import Probability
from fixel.model.scene import PairFriction, Scene
from fixel.model.shape import Disk, Polygon, Shape, placed, rotated
from fixel.model.support import (
    Ellipsoid,
    NoSupport,
    Support,
    SupportPoints,
    Tripod,
    UniformPressure,
    support_points,
)
from fixel.model.trajectory import Pose, Trajectory, pose_error, wrapped

__all__ = [
    "KNOWN_PARAMETERS",
    "AllOf",
    "AnyOf",
    "Beyond",
    "Body",
    "BodyTrack",
    "Channel",
    "Contact",
    "Disk",
    "Drive",
    "Ellipsoid",
    "Exit",
    "Experiment",
    "Fixel",
    "Flag",
    "ForceAbove",
    "FrictionMap",
    "Goal",
    "Inside",
    "LineDrive",
    "LoadMap",
    "NoSupport",
    "PairFriction",
    "ParameterInfo",
    "Parameters",
    "PathDrive",
    "Plane",
    "PlannedExperiment",
    "Polygon",
    "Pose",
    "PoseRegion",
    "Probability",
    "Provenance",
    "Pusher",
    "Scene",
    "Seated",
    "Shape",
    "Spring",
    "Support",
    "SupportPoints",
    "Trajectory",
    "Tripod",
    "UniformPressure",
    "placed",
    "pose_error",
    "rotated",
    "support_points",
    "wrapped",
]
