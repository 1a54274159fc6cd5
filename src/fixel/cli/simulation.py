"""`fixel simulate SCENE`: move the bodies of a scene file."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fixel.cli.options import AsJson

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


def simulate(
    scene: Annotated[
        Path,
        typer.Argument(
            help="Scene file, YAML or JSON.",
            metavar="SCENE",
            exists=True,
            dir_okay=False,
            show_default=False,
        ),
    ],
    as_json: AsJson = False,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Write the motion to this file: .csv or .parquet.", metavar="FILE"),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change one value of the scene, e.g. bodies.0.mass=0.2; may be repeated.",
            metavar="PATH=VALUE",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the motion: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    animate: Annotated[
        Path | None, typer.Option(help="Film the motion: .mp4 or .gif.", metavar="FILE")
    ] = None,
    motion: Annotated[
        MotionChoice | None,
        typer.Option(help="Motion model, instead of the scene's.", show_default=False),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(help="Fixed time step in seconds, instead of the scene's.", metavar="SECONDS"),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(help="Error allowed in one step, for steps of free length.", metavar="MM"),
    ] = None,
    solver: Annotated[
        Solver, typer.Option(help="Solver of the step's problem; lemke needs support_directions.")
    ] = Solver.NEWTON,
    plain: Annotated[
        bool, typer.Option("--plain", help="Walk the steps in Python, slowly, as a cross-check.")
    ] = False,
) -> None:
    """Simulate a scene file; show where everything came to rest."""
    from fixel.cli.screen import notify, progress_bar
    from fixel.workflows.simulation import Outputs, SimulationMethod, simulate_file

    outputs = Outputs(trajectory=trajectory, plot=plot, animate=animate)
    simulation = simulate_file(
        scene,
        set_ or (),
        SimulationMethod(
            motion=motion,
            solver=solver,
            step=step,
            tolerance=None if tolerance is None else 1e-3 * tolerance,
            plain=plain,
        ),
        outputs,
        notify=notify if sys.stderr.isatty() or not as_json else None,
        progress=progress_bar("Filming"),
    )
    if as_json:
        from fixel.cli.answer import json_answer

        typer.echo(json_answer(simulation, outputs))
    else:
        from fixel.cli.answer import written_answer

        typer.echo(written_answer(simulation, scene, outputs))
    if not simulation.converged:
        raise typer.Exit(NOT_SOLVED)
