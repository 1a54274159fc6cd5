"""Simulate a scene file and write the requested files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final

from fixel.drawing.animation import FILM_ENDINGS
from fixel.drawing.chart import PICTURE_ENDINGS, refuse_ending
from fixel.drawing.picture import draw_simulation
from fixel.formats import SceneFile
from fixel.formats.trajectory_file import refuse_trajectory_ending, save_trajectory
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.simulation import AbstractStepper, Newton, Simulation, simulate
from fixel.simulation.motion import named_part
from fixel.simulation.simulate import check_method
from fixel.simulation.solver import SOLVERS
from fixel.workflows.compilation import get_ready


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

    def write(self, simulation: Simulation) -> None:
        """Write the requested files, each completely or not at all."""
        if self.trajectory:
            save_trajectory(simulation, self.trajectory)
        if self.plot:
            with written_whole(self.plot) as temporary:
                draw_simulation(simulation, temporary)
        if self.animate:
            simulation.animate(self.animate)

    @property
    def files(self) -> dict[str, Path]:
        """Files that will be written, by their option."""
        asked = {"trajectory": self.trajectory, "plot": self.plot, "animate": self.animate}
        return {name: path for name, path in asked.items() if path is not None}


def simulate_file(
    file: SceneFile,
    outputs: Outputs | None = None,
    *,
    motion: str | None = None,
    stepper: AbstractStepper | None = None,
    solver: str | None = None,
    plain: bool = False,
) -> Simulation:
    """Simulate a scene file by `fixel.simulate`, and write the requested files.

    Parameters
    ----------
    file : SceneFile
        Scene and method, as loaded by `load_scene`.
    outputs : Outputs, optional
        Files to write; a failed simulation is written and drawn, too.
    motion, stepper, solver, plain : optional
        Method, as for `simulate`; that of the file by default.

    Raises
    ------
    InvalidInput
        Invalid scene, method or file name.
    """
    outputs = outputs or Outputs()
    part = named_part(solver or Newton.name, SOLVERS, "solver")
    check_method(file.scene, part)
    outputs.check()
    get_ready(file.scene, part, plain)
    simulation = simulate(file, motion=motion, stepper=stepper, solver=part, plain=plain)
    outputs.write(simulation)
    return simulation
