"""MuJoCo: soft contacts by a convex problem in three dimensions; its models of tasks (MJCF)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from string import Template
from typing import Any, ClassVar, Final

import mujoco
import numpy as np

from fixel.model.parameters import MUJOCO, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, model_of
from fixel.simulation.engines.scripts import run_mujoco
from fixel.simulation.engines.solids import FOOT, HEAVY, footed, solids
from fixel.simulation.engines.task import PlainOutline, PlainTask, drive_refusal
from fixel.typing import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class MuJoCo(AbstractPhysicsEngine):
    """Engine MuJoCo, by default with the contacts that it is shipped with.

    Every support point is a ball on a floor, pressed down by its own weight; an ellipsoidal limit
    surface is one ball with torsional friction. Cones are elliptic.

    Parameters
    ----------
    step : float
        Time step [s].
    timeconst : float
        Time constant of contacts, the first of `solref` [s].
    dmin, dmax, width : float
        Impedance of contacts at no overlap, the largest one [-], and the overlap at which it is
        reached [m]: the first three of `solimp`.
    impratio : float
        Stiffness of friction over that of contacts.
    torsion : float
        Torsional friction of every support point [m].
    noslip : int
        Iterations of the solver that suppresses slow sliding.
    """

    name: ClassVar[str] = "mujoco"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = MUJOCO
    at_bench_size: ClassVar[bool] = True

    step: float = 2e-3
    timeconst: float = 0.02
    dmin: float = 0.9
    dmax: float = 0.95
    width: float = 1e-3
    impratio: float = 1.0
    torsion: float = 0.0
    noslip: int = 0

    @property
    def version(self) -> str:
        return str(mujoco.__version__)

    def refusal(self, task: PlainTask) -> str:
        if task.gravity == 0.0 and (task.body.arms > 0.0).any():
            return "an ellipsoidal limit surface without gravity"
        return drive_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        physics = mujoco.MjModel.from_xml_string(mjcf(task, asdict(self)))
        return np.array(run_mujoco.poses_of(model_of(self, task), physics))


THICKNESS = 0.005  # [m] of bodies, half

_JOINTS: Final = (
    '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    '<joint type="hinge" axis="0 0 1"/>'
)
_MODEL: Final = Template(files(__package__).joinpath("mujoco.xml").read_text("utf-8"))


def mjcf(task: PlainTask, choices: Mapping[str, Any]) -> str:
    """Return the model of a task as MJCF, with the fields of `MuJoCo` by name.

    The body moves on two slides and a hinge; its weight is on its feet. Only the named pairs touch,
    each with its own coefficient.
    """
    feet, meshes = footed(task.body, task.gravity), list[str]()
    numbers = range(len(feet.masses))
    body = list(_geoms("object", task.body.outline, meshes))
    pairs = [
        _pair("floor", f"foot{k}", friction, friction * arm + choices["torsion"], choices)
        for k, friction, arm in zip(
            numbers, feet.friction.tolist(), feet.arms.tolist(), strict=True
        )
    ]
    fixels = []
    for k, fixel in enumerate(task.fixels):
        geoms = list(_geoms(f"fixel{k}_", fixel.outline, meshes))
        x, y, theta = fixel.pose.tolist()
        fixels.append(
            f'<body pos="{x!r} {y!r} {FOOT}" euler="0 0 {theta!r}">{"".join(geoms)}</body>'
        )
        pairs += _all_pairs(body, geoms, fixel.friction, choices)
    pusher: list[str] = []
    if task.pusher is not None:
        pusher = list(_geoms("pusher", task.pusher.outline, meshes))
        pairs += _all_pairs(body, pusher, task.pusher.friction, choices)
    return _MODEL.substitute(
        choices,
        gravity=task.gravity,
        joints=_JOINTS,
        foot=FOOT,
        mass=feet.mass,
        heavy=HEAVY,
        inertia=feet.inertia,
        meshes="".join(meshes),
        fixels="".join(fixels),
        body="".join(body),
        feet="".join(
            _foot(k, at, mass, feet.foot_inertia)
            for k, at, mass in zip(numbers, feet.points.tolist(), feet.masses.tolist(), strict=True)
        ),
        pusher="".join(pusher),
        pairs="".join(pairs),
    )


def _foot(k: int, at: list[float], mass: float, inertia: float) -> str:
    x, y = at
    return (
        f'<body pos="{x!r} {y!r} 0"><joint type="slide" axis="0 0 1"/>'
        f'<inertial pos="{-x!r} {-y!r} 0" mass="{mass!r}" '
        f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
        f'<geom name="foot{k}" type="sphere" size="{FOOT}"/></body>'
    )


def _all_pairs(
    body: list[str], others: list[str], friction: float, choices: Mapping[str, Any]
) -> list[str]:
    return [
        _pair(one, other, friction, 0.0, choices)
        for one in _names(body)
        for other in _names(others)
    ]


def _pair(one: str, other: str, friction: float, torsion: float, choices: Mapping[str, Any]) -> str:
    size = 4 if torsion > 0.0 else 3
    timeconst, dmin, dmax, width = (
        choices[name] for name in ("timeconst", "dmin", "dmax", "width")
    )
    return (
        f'<pair geom1="{one}" geom2="{other}" condim="{size}" '
        f'friction="{friction!r} {friction!r} {torsion!r} 0 0" solref="{timeconst!r} 1" '
        f'solimp="{dmin!r} {dmax!r} {width!r} 0.5 2"/>'
    )


def _geoms(name: str, outline: PlainOutline, meshes: list[str]) -> Iterator[str]:
    """Yield the geoms of an outline, and add the meshes that they need."""
    for k, solid in enumerate(solids(outline)):
        own = f'name="{name}{k}"'
        x, y, theta = solid.at
        length, width = solid.size
        if solid.kind == "disc":
            yield f'<geom {own} type="sphere" pos="{x!r} {y!r} 0" size="{length!r}"/>'
        elif solid.kind == "box":
            yield (
                f'<geom {own} type="box" pos="{x!r} {y!r} 0" euler="0 0 {theta!r}" '
                f'size="{length / 2!r} {width / 2!r} {THICKNESS}"/>'
            )
        else:
            corners = [
                f"{x!r} {y!r} {z}"
                for x, y in solid.corners.tolist()
                for z in (-THICKNESS, THICKNESS)
            ]
            meshes.append(f'<mesh {own} vertex="{" ".join(corners)}"/>')
            yield f'<geom {own} type="mesh" mesh="{name}{k}"/>'


def _names(geoms: list[str]) -> list[str]:
    return [geom.split('"')[1] for geom in geoms]
