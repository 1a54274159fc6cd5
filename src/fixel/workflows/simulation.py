"""Simulate a scene file and write the requested files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, final

from fixel.drawing.animation import FILM_ENDINGS, animate_simulation
from fixel.drawing.chart import PICTURE_ENDINGS, refuse_ending
from fixel.drawing.picture import draw_simulation
from fixel.errors import InvalidInput
from fixel.formats import SceneFile, load_scene
from fixel.formats.trajectory_file import refuse_trajectory_ending, save_trajectory
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.simulation import (
    AbstractMotionModel,
    AbstractSolver,
    AbstractStepper,
    Adaptive,
    Simulation,
    StewartTrinkle,
    simulate,
)
from fixel.simulation.motion import MOTION_MODELS
from fixel.simulation.simulate import check_method
from fixel.simulation.solver import SOLVERS
from fixel.typing import Notify, ProgressCallback
from fixel.workflows.compilation import get_ready

Part = TypeVar("Part", AbstractMotionModel, AbstractSolver)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationMethod:
    """Method of a simulation; None uses the setting of the scene file.

    Parameters
    ----------
    motion, solver : str, optional
        Names of the motion model and of the solver.
    step : float, optional
        Step of the Stewart-Trinkle stepper [s].
    tolerance : float, optional
        Tolerance of the adaptive stepper [m].
    plain : bool
        Whether to run the loop over steps in Python.
    """

    motion: str | None = None
    solver: str | None = None
    step: float | None = None
    tolerance: float | None = None
    plain: bool = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs:
    """Files to write; None for files that are not requested."""

    trajectory: Path | None = None
    plot: Path | None = None
    animate: Path | None = None

    def check(self) -> None:
        """Reject invalid endings and folders before anything is simulated."""
        if self.trajectory:
            refuse_trajectory_ending(self.trajectory)
        if self.plot:
            refuse_ending(self.plot, PICTURE_ENDINGS, "picture")
        if self.animate:
            refuse_ending(self.animate, FILM_ENDINGS, "film")
        for path in self.files.values():
            refuse_unwritable(path)

    @property
    def files(self) -> dict[str, Path]:
        """Files that will be written, by their option."""
        asked = {"trajectory": self.trajectory, "plot": self.plot, "animate": self.animate}
        return {name: path for name, path in asked.items() if path is not None}


def simulate_file(
    path: str | Path,
    overrides: Sequence[str] = (),
    method: SimulationMethod | None = None,
    outputs: Outputs | None = None,
    *,
    notify: Notify | None = None,
    progress: ProgressCallback | None = None,
) -> Simulation:
    """Simulate a scene file and write the requested files.

    Parameters
    ----------
    path : str or Path
        Scene file.
    overrides : sequence of str
        Changes to the scene file, as `path.to.key=value`.
    method : SimulationMethod, optional
    outputs : Outputs, optional
    notify : callable, optional
        Called with a sentence before long operations.
    progress : callable, optional
        Called as `progress(done, total)` while a film is made.

    Returns
    -------
    Simulation
        Result with a status; a failed simulation is written and drawn, too.

    Raises
    ------
    InvalidInput
        Invalid scene, method or file name.
    """
    method, outputs = method or SimulationMethod(), outputs or Outputs()
    scene_file = load_scene(path, overrides)
    motion, stepper, solver = parts(scene_file, method)
    check_method(scene_file.scene, solver)
    outputs.check()
    get_ready(scene_file.scene, notify, solver, method.plain)
    simulation = simulate(
        scene_file.scene,
        motion=motion,
        stepper=stepper,
        solver=solver,
        output_interval=scene_file.output_interval,
        plain=method.plain,
    )
    write_outputs(simulation, outputs, progress)
    return simulation


def parts(
    scene_file: SceneFile, method: SimulationMethod
) -> tuple[AbstractMotionModel, AbstractStepper, AbstractSolver]:
    """Return motion model, stepper and solver of a scene file, as changed by `method`."""
    return (
        _named(method.motion or scene_file.motion, MOTION_MODELS, "motion"),
        _stepper(scene_file, method),
        _named(method.solver or "newton", SOLVERS, "solver"),
    )


def write_outputs(
    simulation: Simulation, outputs: Outputs, progress: ProgressCallback | None = None
) -> None:
    """Write the requested files, each completely or not at all."""
    if outputs.trajectory:
        save_trajectory(simulation, outputs.trajectory)
    if outputs.plot:
        with written_whole(outputs.plot) as temporary:
            draw_simulation(simulation, temporary)
    if outputs.animate:
        with written_whole(outputs.animate) as temporary:
            animate_simulation(simulation, temporary, progress=progress)


def _stepper(scene_file: SceneFile, method: SimulationMethod) -> AbstractStepper:
    if method.step is not None and method.tolerance is not None:
        raise InvalidInput(
            "step and tolerance",
            found="both",
            expected="one of them",
            hint="a fixed step has no tolerance; leave one out",
        )
    if method.tolerance is not None:
        return Adaptive(tolerance=method.tolerance)
    step = scene_file.step if method.step is None else method.step
    return Adaptive() if step is None else StewartTrinkle(step=step)


def _named(name: str, family: Sequence[Callable[[], Part]], where: str) -> Part:
    members = {getattr(member, "name", ""): member for member in family}
    if name not in members:
        raise InvalidInput(where, found=repr(name), expected="one of " + ", ".join(members))
    return members[name]()
