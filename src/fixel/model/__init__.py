"""Data model: shapes, bodies, pushers, fixels and scenes, checked when created."""

from fixel.model.bodies import (
    Body as Body,
    Drive as Drive,
    Fixel as Fixel,
    LineDrive as LineDrive,
    PathDrive as PathDrive,
    Pusher as Pusher,
    Spring as Spring,
)
from fixel.model.experiment import (
    Channel as Channel,
    Experiment as Experiment,
    Flag as Flag,
    PlannedExperiment as PlannedExperiment,
    Provenance as Provenance,
)
from fixel.model.goals import (
    AllOf as AllOf,
    AnyOf as AnyOf,
    Beyond as Beyond,
    BodyTrack as BodyTrack,
    Contact as Contact,
    Exit as Exit,
    ForceAbove as ForceAbove,
    Goal as Goal,
    Inside as Inside,
    PoseRegion as PoseRegion,
    Seated as Seated,
)
from fixel.model.parameters import (
    KNOWN_PARAMETERS as KNOWN_PARAMETERS,
    ParameterInfo as ParameterInfo,
    Parameters as Parameters,
)
from fixel.model.probability import Probability as Probability
from fixel.model.scene import PairFriction as PairFriction, Scene as Scene
from fixel.model.shape import (
    Disk as Disk,
    Polygon as Polygon,
    Shape as Shape,
    placed as placed,
    rotated as rotated,
)
from fixel.model.support import (
    Ellipsoid as Ellipsoid,
    FrictionMap as FrictionMap,
    LoadMap as LoadMap,
    NoSupport as NoSupport,
    Plane as Plane,
    Support as Support,
    SupportPoints as SupportPoints,
    Tripod as Tripod,
    UniformPressure as UniformPressure,
    support_points as support_points,
)
from fixel.model.trajectory import (
    Pose as Pose,
    Trajectory as Trajectory,
    pose_error as pose_error,
    wrapped as wrapped,
)
