"""`fixel simulate SCENE`: move the bodies of a scene file."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from fixel.cli.options import AsJson, Engine, engine_or_motion, option, required, with_options
from fixel.cli.screen import command_of, paragraphs, print_answer, seconds, wrote

if TYPE_CHECKING:
    from fixel.simulation import Simulation
    from fixel.workflows.simulation import Outputs

NOT_SOLVED = 3


class MotionChoice(StrEnum):
    """Names of the motion models, as in scene files."""

    DYNAMIC = "dynamic"
    QUASISTATIC = "quasistatic"
    FIRST_ORDER = "first-order"


class Solver(StrEnum):
    """Names of the solvers."""

    NEWTON = "newton"
    GAUSS_SEIDEL = "gauss-seidel"
    LEMKE = "lemke"


@with_options
def simulate(
    *,
    scene: Path = required(
        "Scene file, YAML or JSON.",
        metavar="SCENE",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
    as_json: AsJson = False,
    trajectory: Path | None = option(None, "Write the trajectory to this file: .csv or .parquet."),
    set_: list[str] | None = option(
        None,
        "Change one value of the scene, e.g. bodies.0.mass=0.2; may be repeated.",
        "--set",
        metavar="PATH=VALUE",
    ),
    plot: Path | None = option(None, "Draw the motion: .png, .svg or .pdf."),
    animate: Path | None = option(None, "Animate the motion: .mp4 or .gif."),
    motion: MotionChoice | None = option(
        None, "Motion model; that of the scene file by default.", show_default=False
    ),
    engine: Engine = None,
    step: float | None = option(
        None, "Fixed time step; that of the scene file by default.", metavar="SECONDS"
    ),
    tolerance: float | None = option(
        None, "Position error allowed per step; selects the adaptive stepper.", metavar="MM"
    ),
    solver: Solver = option(Solver.NEWTON, "Solver; lemke needs support_directions in the scene."),
    plain: bool = option(False, "Run the steps in Python, slowly, as a cross-check.", "--plain"),
) -> None:
    """Simulate a scene file and report its end."""
    from fixel.formats import load_scene
    from fixel.simulation.stepper import stepper_of
    from fixel.workflows.simulation import Outputs, simulate_file

    outputs = Outputs(trajectory=trajectory, plot=plot, animate=animate)
    simulation = simulate_file(
        load_scene(scene, set_ or ()),
        outputs,
        motion=engine_or_motion(engine, motion),
        stepper=stepper_of(step, None if tolerance is None else 1e-3 * tolerance),
        solver=solver,
        plain=plain,
    )
    files = {name: str(path) for name, path in outputs.files.items()}
    print_answer(
        as_json,
        lambda: simulation.summary() | {"files": files},
        lambda: paragraphs(
            [f"{scene.name}, computed in {seconds(simulation.wall_time_s)}"],
            repr(simulation).splitlines(),
            wrote(outputs.files.values()),
            [f"Next: {_next(simulation, scene, outputs)}"],
        ),
    )
    if not simulation.converged:
        raise typer.Exit(NOT_SOLVED)


def _next(simulation: "Simulation", scene: Path, outputs: "Outputs") -> str:
    """Return the command that most users need next."""
    again = ("simulate", scene)
    rigid = [p.name for p in simulation.scene.pushers if p.drive.force_limit is None]
    if simulation.status == "jammed" and rigid:
        return command_of(*again, "--set", f"pushers.{rigid[0]}.drive.force_limit=34.3")
    if simulation.status in ("max_iterations", "step_too_small"):
        return command_of(*again, "--step", "0.001")
    for name, ending in (("plot", ".png"), ("animate", ".mp4"), ("trajectory", ".csv")):
        if name not in outputs.files:
            return command_of(*again, f"--{name}", scene.stem + ending)
    body = simulation.scene.bodies[0]
    return command_of(*again, "--set", f"bodies.{body.name}.mass={2.0 * body.mass:g}")
