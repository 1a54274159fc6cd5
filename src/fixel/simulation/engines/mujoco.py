"""MuJoCo: soft contacts by Newton's method on a convex problem, three dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import ClassVar, final

import mujoco
import numpy as np

from fixel.model.parameters import MUJOCO, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, model_of
from fixel.simulation.engines.mjcf import mjcf
from fixel.simulation.engines.scripts import run_mujoco
from fixel.simulation.engines.task import PlainTask, drive_refusal
from fixel.typing import FloatArray


@final
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
