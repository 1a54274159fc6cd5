"""Drake: discrete contact by convex problems that are solved to high accuracy, three dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version as version_of
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np

from fixel.model.parameters import DRAKE, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine, model_of
from fixel.simulation.engines.scripts import run_drake
from fixel.simulation.engines.sdf import MAX_FRICTION, sdf
from fixel.simulation.engines.solids import footed
from fixel.simulation.engines.task import PlainTask, planar_refusal
from fixel.typing import FloatArray


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
    at_bench_size: ClassVar[bool] = True

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
        pairs = [fixel.friction for fixel in task.fixels]
        pairs += [] if task.pusher is None else [task.pusher.friction]
        largest = max([*pairs, *footed(task.body, task.gravity).friction.tolist()], default=0.0)
        if largest >= MAX_FRICTION:
            return f"a friction coefficient of {largest:.3g}; it takes less than {MAX_FRICTION:g}"
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        with TemporaryDirectory() as folder:  # meshes have to be files
            for name, text in sdf(task, asdict(self)).items():
                Path(folder, name).write_text(text, "utf-8")
            return np.array(run_drake.simulate(model_of(self, task), Path(folder)))
