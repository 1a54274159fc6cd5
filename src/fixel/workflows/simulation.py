"""Simulate a scene file and write the requested files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NamedTuple

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Motion

if TYPE_CHECKING:
    from fixel.formats import SceneFile
    from fixel.progress import ProgressOption
    from fixel.simulation import Simulation
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer

Written = Annotated[Path | None, Door(writes=True, effort=True)]


class Outputs(NamedTuple):
    """Files to write; None for files that are not requested."""

    trajectory: Path | None = None
    plot: Path | None = None
    animate: Path | None = None

    def check(self) -> None:
        """Reject invalid endings and folders before anything is simulated."""
        from fixel.drawing.animation import refuse_film
        from fixel.drawing.chart import PICTURE_ENDINGS
        from fixel.formats.trajectory_file import refuse_trajectory_ending
        from fixel.io.atomic import refuse_ending, refuse_unwritable

        if self.trajectory:
            refuse_trajectory_ending(self.trajectory)
        if self.plot:
            refuse_ending(self.plot, PICTURE_ENDINGS, "picture")
        if self.animate:
            refuse_film(self.animate)
        for path in (self.trajectory, self.plot, self.animate):
            if path:
                refuse_unwritable(path)

    def write(self, simulation: Simulation) -> None:
        """Write the requested files, each completely or not at all."""
        from fixel.drawing.picture import draw_simulation
        from fixel.formats.trajectory_file import save_trajectory

        if self.trajectory:
            save_trajectory(simulation, self.trajectory)
        if self.plot:
            draw_simulation(simulation, self.plot)
        if self.animate:
            simulation.animate(self.animate)


def simulate_file(
    file: SceneFile,
    outputs: Outputs | None = None,
    *,
    solver: str | None = None,
    plain: bool = False,
    **method: Any,
) -> Simulation:
    """Simulate a scene file by `fixel.simulate`, and write the requested files, also if it fails.

    Other arguments are those of `simulate`; the method of the file by default.
    """
    from fixel.simulation import Newton, simulate
    from fixel.simulation.motion import named_part
    from fixel.simulation.simulate import check_method, get_ready
    from fixel.simulation.stepping import SOLVERS

    outputs = outputs or Outputs()
    part = named_part(solver or Newton.name, SOLVERS, "solver")
    check_method(file.scene, part)
    outputs.check()
    get_ready(file.scene, part, plain)
    simulation = simulate(file, solver=part, plain=plain, **method)
    outputs.write(simulation)
    return simulation


def simulate_scene(
    scene: Annotated[Path, Door(metavar="SCENE")],
    *,
    trajectory: Written = None,
    overrides: Annotated[
        Sequence[str], Door(flag="--set", metavar="NAME=VALUE", plain=tuple[str, ...])
    ] = (),
    plot: Written = None,
    animate: Written = None,
    motion: Motion = None,
    step: Annotated[float | None, Door(metavar="SECONDS")] = None,
    tolerance: Annotated[float | None, Door(flag="--tolerance", unit="mm", metavar="MM")] = None,
    solver: Literal["newton", "gauss-seidel", "lemke"] = "newton",
    plain: bool = False,
    accuracy: bool = False,
    derivatives: Annotated[
        Sequence[str], Door(flag="--derivative", metavar="NAME", plain=tuple[str, ...])
    ] = (),
    progress: ProgressOption = None,
) -> Simulation:
    """Simulate a scene file and report the final poses.

    Parameters
    ----------
    scene : path
        Scene file, YAML or JSON.
    trajectory : path, optional
        Write the trajectory to this file: .csv or .parquet.
    overrides : sequence of str
        Value of a parameter, such as mu_pusher=0.2, or of a key of the scene, such as
        bodies.0.mass=0.2; may be repeated.
    plot : path, optional
        Draw the motion: .png, .svg or .pdf.
    animate : path, optional
        Animate the motion: .mp4 or .gif.
    motion : str, optional
        Motion model (dynamic, quasistatic or first-order) or another engine (mujoco, drake, pymunk,
        box2d, or the path of a program; with choices as in mujoco:step=0.001); that of the scene
        file by default.
    step : float, optional
        Fixed time step [s]; that of the scene file by default.
    tolerance : float, optional
        Position error allowed per step; selects the adaptive stepper.
    solver : str
        Solver; lemke needs support_directions in the scene.
    plain : bool
        Whether to run the steps in Python, slowly, as a cross-check.
    accuracy : bool
        Whether to solve the scene in a second, independent way and compare both results.
    derivatives : sequence of str
        Differentiate the final pose by this parameter, or by x, y, theta of the start; may be
        repeated.
    """
    from fixel.formats.scene_file import load_scene, split_settings
    from fixel.simulation.stepping import stepper_of

    keys, parameters = split_settings(overrides)
    return simulate_file(
        load_scene(scene, keys),
        Outputs(trajectory=trajectory, plot=plot, animate=animate),
        parameters=parameters,
        motion=motion if motion is None else str(motion),
        stepper=stepper_of(step, tolerance),
        solver=solver,
        plain=plain,
        accuracy=accuracy,
        derivatives=derivatives,
    )


def report_of(simulation: Simulation) -> AnalysisReport:
    """Return the end of a simulation, for people and for `--json`."""
    from fixel.workflows.analysis import AnalysisReport, analysis_of

    seconds = simulation.wall_time_s
    return AnalysisReport(
        analysis_of("simulate", simulation, numbers=simulation.summary(), seconds=seconds)
    )


def failed(simulation: Simulation) -> bool:
    """Whether the simulation stopped early."""
    return not simulation.converged


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    simulation, scene = done.result, Path(done.request.scene)
    again = ["simulate", str(scene)]
    rigid = [p.name for p in simulation.scene.pushers if p.drive.force_limit is None]
    if simulation.status == "jammed" and rigid:
        return [*again, "--set", f"pushers.{rigid[0]}.drive.force_limit=34.3"]
    if simulation.status in ("max_iterations", "step_too_small"):
        return [*again, "--step", "0.001"]
    from fixel.drawing.animation import film_ending

    for name, ending in (("plot", ".png"), ("animate", film_ending()), ("trajectory", ".csv")):
        if name not in done.files:
            return [*again, f"--{name}", scene.stem + ending]
    body = simulation.scene.bodies[0]
    return [*again, "--set", f"bodies.{body.name}.mass={2.0 * body.mass:g}"]


SIMULATE: Final = Capability(name="simulate", function=simulate_scene, plot="")
