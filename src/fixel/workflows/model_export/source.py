"""Sources of exported models: scenes with their parameters and experiments; and URDF files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats import SceneFile, load_scene
from fixel.model import Experiment, Scene
from fixel.model.records import Estimate
from fixel.model.space import values_under
from fixel.planning.plan import PushPlan
from fixel.simulation import AbstractMotionModel, AbstractStepper, Dynamic, Simulation
from fixel.simulation.engines.sdf import MAX_FRICTION, harmonic_partner
from fixel.simulation.engines.solids import FOOT, FootedBody, PieceSolid, footed, prism_obj, solids
from fixel.simulation.engines.task import PlainTask, bench_units
from fixel.simulation.motion import OtherEngine, motion_model
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.stored import load_values

SAMPLES: Final = 100  # poses of a scene without measurements
Recordable = Simulation | PushPlan
Exportable = (
    Scene | SceneFile | Recordable | Experiment | Calibration | Project | str | PathLike[str]
)


class SourceCase(NamedTuple):
    """Scene with parameters, and the measured motion if there is one."""

    key: str  # of its experiment; empty for a scene
    scene: Scene
    times: FloatArray  # (n,) [s]
    values: Mapping[str, float]  # parameters by name, also those of engines
    measured: FloatArray | None = None  # (n, 3) poses at the times [m, m, rad]


class ModelSource(NamedTuple):
    """Cases, of which the first is exported, with their estimates and motion model."""

    kind: str  # "scene", "experiment" or "calibration"
    name: str
    cases: Sequence[SourceCase]
    estimates: Sequence[Estimate] = ()
    motion: AbstractMotionModel = Dynamic()
    stepper: AbstractStepper | None = None
    calibration_id: int | None = None
    held_out: Sequence[SourceCase] = ()
    runs: tuple[Simulation, ...] = ()  # motions that are known, of parts of a plan or one


def source_of(
    what: Exportable, calibration: int | None = None, held_out: Iterable[Experiment] = ()
) -> ModelSource:
    """Return the source of an export; raise where there is no scene.

    The calibration of a project is by default the newest for several experiments. `held_out` are
    experiments that the calibration has not used.
    """
    if calibration is not None and not isinstance(what, Project):
        raise InvalidInput(
            "calibration", found=f"the id {calibration}", expected="the project that has it"
        )
    values: Callable[[Experiment], Mapping[str, float]] | None = None
    if isinstance(what, Project):
        found, values = _stored(what, calibration)
    elif isinstance(what, Calibration):
        found, values = _calibrated(what), what.values_for
    elif isinstance(what, Recordable):
        found = _simulated(what)
    elif isinstance(what, Experiment):
        found = ModelSource("experiment", what.key, [_case(what, {})])
    else:
        found = _scene(what)
    others = tuple(held_out)
    for key in sorted({case.key for case in found.cases} & {own.key for own in others}):
        used = f"{key}, which the calibration has used"
        raise InvalidInput("held_out", found=used, expected="other experiments")
    return found._replace(held_out=[_case(own, values(own) if values else {}) for own in others])


def _scene(what: Scene | SceneFile | str | PathLike[str]) -> ModelSource:
    if isinstance(what, str | PathLike):
        what = load_scene(str(what))
    file = what if isinstance(what, SceneFile) else SceneFile(scene=what)
    scene = file.scene.complete()
    times = np.linspace(0.0, scene.duration, SAMPLES + 1)[1:]
    return ModelSource(
        "scene",
        scene.bodies[0].name if scene.bodies else "scene",
        [SourceCase("", scene, times, {})],
        motion=motion_model(file.motion),
        stepper=None if file.step is None else file.stepper,
    )


def _simulated(what: Recordable) -> ModelSource:
    """Return a simulation, or the pushes of a plan that are simulated as planned."""
    runs = (what,) if isinstance(what, Simulation) else what.as_planned()
    if not runs:
        raise InvalidInput("what", found="a plan without pushes", expected="one with a push")
    scene = runs[0].scene
    values: Mapping[str, float] = runs[0].parameters or {}
    kind = "simulation" if isinstance(what, Simulation) else "plan"
    case = SourceCase("", scene, runs[0].time[1:], values)
    return ModelSource(kind, scene.bodies[0].name, [case], runs=runs)


def _calibrated(fit: Calibration) -> ModelSource:
    ids = fit.run.ids
    return ModelSource(
        "calibration",
        fit.request.name or f"{len(fit.targets)} experiments",
        [
            SourceCase(target.key, *target.case, values_under(fit, target.conditions), target.pose)
            for target in fit.targets
        ],
        estimates=list(fit.estimates.values()),
        motion=_own_motion(fit.motion),
        calibration_id=ids[fit.number] if ids else None,
    )


def _stored(
    project: Project, calibration_id: int | None
) -> tuple[ModelSource, Callable[[Experiment], Mapping[str, float]]]:
    with project.store() as store:
        one = load_values(store, calibration_id)
        experiments = [store.experiment(number) for number in sorted(one.members)]
    source = ModelSource(
        "calibration",
        project.settings.name,
        [_case(own, one.values_for(own)) for own in experiments],
        estimates=one.record.estimates,
        motion=_own_motion(one.motion),
        calibration_id=one.id,
    )
    return source, one.values_for


def _case(experiment: Experiment, values: Mapping[str, float]) -> SourceCase:
    target = target_of(experiment)
    return SourceCase(target.key, *target.case, values, target.pose)


def _own_motion(motion: AbstractMotionModel) -> AbstractMotionModel:
    """Return a motion model of fixel itself, also for a calibration of another engine."""
    return Dynamic() if isinstance(motion, OtherEngine) else motion


HEIGHT = 0.02  # [m] of the body, if it has the size of a bench
REACH = 0.01  # [m] of the slide of a foot, likewise


def urdf(task: PlainTask, name: str) -> tuple[str, Mapping[str, str], list[str]]:
    """Return the body as URDF, the meshes that it needs, and what of the task it lacks.

    Each foot is a ball that slides vertically. Its mass is what its point carries, and lies at the
    centre of mass, so that mass and moment of inertia of all links are those of the body.
    Coefficients of feet are tags of their own: for Drake, which combines them with that of a floor
    by the harmonic mean, they are such that a floor of 1 results in the point's; for Gazebo, which
    takes the smaller of two, they are the point's.
    """
    # No foot has a torque, as an ellipsoid has.
    own = task.body._replace(friction=task.body.friction * (task.body.arms == 0.0))
    feet, unit = footed(own, task.gravity), bench_units(own).length
    meshes: dict[str, str] = {}
    shapes = "".join(
        _shape(k, solid, HEIGHT * unit, meshes) for k, solid in enumerate(solids(own.outline))
    )
    text = (
        f'<?xml version="1.0"?>\n<robot name={quoteattr(name)} xmlns:drake="drake.mit.edu">\n'
        f'<link name="object">\n{_inertial(feet.mass, feet.inertia)}{shapes}</link>\n'
    )
    masses, friction = feet.masses.tolist(), feet.friction.tolist()
    for k, place in enumerate(feet.points.tolist()):
        inertial = _inertial(masses[k], feet.foot_inertia, (-place[0], -place[1]))
        text += _foot(k, place, inertial, friction[k], unit)
    return text + "</robot>\n", meshes, _lost(task, feet)


def _lost(task: PlainTask, feet: FootedBody) -> list[str]:
    own, pusher = task.body, task.pusher
    rough = {fixel.friction for fixel in task.fixels} | ({pusher.friction} if pusher else set())
    lost = [f"{len(task.fixels)} fixels"] if task.fixels else []
    lost += ["the pusher and its drive"] if pusher else []
    if values := ", ".join(f"{friction:g}" for friction in sorted(rough)):
        lost.append(f"friction of the body against pusher and fixels: {values}")
    if not len(feet.points):
        what = "the ellipsoidal limit surface of" if own.arms.any() else "the zero friction of"
        lost.append(f"{what} the support: there are no feet")
    elif feet.friction.max() >= MAX_FRICTION:
        lost.append(f"friction of the feet for Drake, which takes less than {MAX_FRICTION:g}")
    x, y, theta = (round(value, 9) + 0.0 for value in own.start.tolist())  # no -1e-33 nor -0
    lost.append(f"the start pose of the centre of mass: {x:g} m, {y:g} m, {theta:g} rad")
    if own.velocity.any():
        lost.append("the start velocity")
    return lost


def _shape(k: int, solid: PieceSolid, height: float, meshes: dict[str, str]) -> str:
    length, width = solid.size
    x, y, theta = solid.at
    if solid.kind == "disc":
        geometry = f'<cylinder radius="{length!r}" length="{height!r}"/>'
    elif solid.kind == "box":
        geometry = f'<box size="{length!r} {width!r} {height!r}"/>'
    else:
        meshes[f"object_{k}.obj"] = prism_obj(solid.corners, height)
        geometry = f'<mesh filename="object_{k}.obj"/>'
    # The frame of the body is at the middle of a foot, the bottom of the body just above the floor.
    own = f'<origin xyz="{x!r} {y!r} {height / 2!r}" rpy="0 0 {theta!r}"/>'
    inside = f"{own}<geometry>{geometry}</geometry>"
    return f"<visual>{inside}</visual>\n<collision>{inside}</collision>\n"


def _inertial(mass: float, inertia: float, at: tuple[float, float] = (0.0, 0.0)) -> str:
    x, y = at
    return (
        f'<inertial><origin xyz="{x!r} {y!r} 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>\n"
    )


def _foot(k: int, at: list[float], inertial: str, friction: float, unit: float) -> str:
    x, y = at
    reach, drake = REACH * unit, ""
    if friction < MAX_FRICTION:
        value = f'value="{harmonic_partner(friction)!r}"'
        both = f"<drake:mu_static {value}/><drake:mu_dynamic {value}/>"
        drake = f"<drake:proximity_properties>{both}</drake:proximity_properties>"
    return (
        f'<link name="foot{k}">\n{inertial}'
        f'<collision><geometry><sphere radius="{FOOT * unit!r}"/></geometry>'
        f"{drake}</collision></link>\n"
        f'<joint name="foot{k}_slide" type="prismatic"><parent link="object"/>'
        f'<child link="foot{k}"/><origin xyz="{x!r} {y!r} 0"/><axis xyz="0 0 1"/>'
        f'<limit lower="{-reach!r}" upper="{reach!r}" effort="0" velocity="1"/></joint>\n'
        f'<gazebo reference="foot{k}"><mu1>{friction!r}</mu1><mu2>{friction!r}</mu2></gazebo>\n'
    )
