"""`fixel simulate SCENE`: move the bodies of a scene file."""

from enum import StrEnum
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from fixel.cli.options import AsJson, option, required, with_options
from fixel.cli.screen import (
    command_of,
    notice,
    paragraphs,
    print_answer,
    progress_bar,
    seconds,
    shortened,
    wrote,
)
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.simulation import Simulation
    from fixel.workflows.simulation import Outputs

NOT_SOLVED = 3
MAX_ROWS = 20


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
    trajectory: Path | None = option(None, "Write the motion to this file: .csv or .parquet."),
    set_: list[str] | None = option(
        None,
        "Change one value of the scene, e.g. bodies.0.mass=0.2; may be repeated.",
        "--set",
        metavar="PATH=VALUE",
    ),
    plot: Path | None = option(None, "Draw the motion: .png, .svg or .pdf."),
    animate: Path | None = option(None, "Film the motion: .mp4 or .gif."),
    motion: MotionChoice | None = option(
        None, "Motion model, instead of the scene's.", show_default=False
    ),
    step: float | None = option(
        None, "Fixed time step in seconds, instead of the scene's.", metavar="SECONDS"
    ),
    tolerance: float | None = option(
        None, "Position error allowed in one step; selects adaptive steps.", metavar="MM"
    ),
    solver: Solver = option(
        Solver.NEWTON, "Solver of the step's problem; lemke needs support_directions."
    ),
    plain: bool = option(False, "Walk the steps in Python, slowly, as a cross-check.", "--plain"),
) -> None:
    """Simulate a scene file; show where everything came to rest."""
    from fixel.workflows.simulation import Outputs, SimulationMethod, simulate_file

    outputs = Outputs(trajectory=trajectory, plot=plot, animate=animate)
    method = SimulationMethod(
        motion=motion,
        solver=solver,
        step=step,
        tolerance=None if tolerance is None else 1e-3 * tolerance,
        plain=plain,
    )
    simulation = simulate_file(
        scene,
        set_ or (),
        method,
        outputs,
        notify=notice(as_json),
        progress=progress_bar("Filming"),
    )
    print_answer(
        as_json,
        lambda: _content(simulation, outputs),
        lambda: _lines(simulation, scene, outputs),
    )
    if not simulation.converged:
        raise typer.Exit(NOT_SOLVED)


def _content(simulation: "Simulation", outputs: "Outputs") -> dict[str, Any]:
    files = {name: str(path) for name, path in outputs.files.items()}
    return simulation.summary() | {"files": files}


def _lines(simulation: "Simulation", scene: Path, outputs: "Outputs") -> list[str]:
    """About a screen of text: status, poses, pushers, contacts, files, next command."""
    return paragraphs(
        _status(simulation, scene),
        _poses(simulation),
        _pushers(simulation),
        _touching(simulation),
        _effort(simulation),
        wrote(outputs.files.values()),
        [f"Next: {_next(simulation, scene, outputs)}"],
    )


def _status(simulation: "Simulation", scene: Path) -> list[str]:
    if simulation.converged:
        return [f"{scene.name}: converged, simulated {simulation.duration:g} s"]
    planned = simulation.scene.duration
    when = f"{simulation.stopped_at:.6g} of {planned:g} s"
    return [f"{scene.name}: {simulation.status}, stopped at {when}", simulation.advice]


def _poses(simulation: "Simulation") -> list[str]:
    bodies = simulation.scene.bodies
    x_and_y = (Column("x", "mm", ".4f"), Column("y", "mm", ".4f"))
    rows = []
    for body in bodies[:MAX_ROWS]:
        x, y, angle = simulation.final[body.name].tolist()
        rows.append((body.name, 1e3 * x, 1e3 * y, degrees(angle)))
    lines = Table(("body, at the end", *x_and_y, Column("angle", "deg", ".4f")), rows).lines()
    return shortened(lines, len(bodies) + 1)


def _pushers(simulation: "Simulation") -> list[str]:
    rows = [
        (name, 1e3 * trace.travel, float(trace.force[-1]), "stalled" if trace.stalled[-1] else "")
        for name, trace in list(simulation.pushers.items())[:MAX_ROWS]
    ]
    columns = ("pusher", Column("travel", "mm", ".4f"), Column("force", "N", ".4g"), "")
    return Table(columns, rows).lines() if rows else []


def _touching(simulation: "Simulation") -> list[str]:
    pairs = simulation.touching
    if not pairs:
        return ["Nothing touches at the end."]
    shown = [f"  {a} - {b}" for a, b in pairs[:MAX_ROWS]]
    more = [f"  ... and {len(pairs) - MAX_ROWS} more"] if len(pairs) > MAX_ROWS else []
    return ["touching at the end", *shown, *more]


def _effort(simulation: "Simulation") -> list[str]:
    method = simulation.method
    fallbacks = f", {simulation.fallbacks} by a fallback" if simulation.fallbacks else ""
    return [
        f"{simulation.steps} steps{fallbacks} in {seconds(simulation.wall_time_s)}"
        f" ({method['motion']}, {method['stepper']}, {method['solver']})"
        f"; worst residual {simulation.max_residual:.1e}"
    ]


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
