"""`fixel demo`: a tour that ends in a report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fixel.workflows.demo import Demo
    from fixel.workflows.tour import Tour

_WHAT = {"scene": "the scene", "plot": "picture", "animate": "film", "trajectory": "numbers"}
LAB = "lab"
NOT_SOLVED = 3


def demo(
    out: Annotated[
        Path, typer.Option(help="Folder for the figures; made when missing.", metavar="FOLDER")
    ] = Path("fixel-demo"),
    quick: Annotated[
        bool, typer.Option("--quick", help="The grasp only: no experiments, no report.")
    ] = False,
) -> None:
    """Simulate and film a grasp; then calibrate simulated experiments and report how far to
    believe the simulator."""
    from fixel.cli.screen import progress_bar, say
    from fixel.workflows.demo import run_demo

    result = run_demo(out, say=say, progress=progress_bar("Filming"))
    typer.echo("\n".join(_told(result)))
    if not result.simulation.converged:
        raise typer.Exit(NOT_SOLVED)
    if not quick:
        from fixel.workflows.tour import run_tour

        typer.echo("\nHow far is such a simulation to be believed? A laboratory finds out:\n")
        typer.echo("\n".join(_reported(run_tour(out / LAB, say=lambda what: say(f"  {what} ...")))))


def _reported(tour: "Tour") -> list[str]:
    import shlex

    from fixel.workflows.report.write import next_command

    content = tour.report.content
    lab = shlex.quote(str(tour.project))
    return [
        "",
        *content.findings,
        "",
        f"{len(content.warnings)} warnings stand first in the report, with figures, methods and"
        " references:",
        f"  {next_command(tour.report)}",
        "Next, ask for more or less than 5 mm, or look at one experiment:",
        f"  fixel domain --threshold-mm 8 --project {lab}",
        f"  fixel show 8 --project {lab}",
    ]


def _told(result: "Demo") -> list[str]:
    import shlex

    from fixel.cli.screen import seconds

    run, files = result.simulation, result.files
    scene = shlex.quote(str(files["scene"]))
    return [
        "A flat head pushes a square against three fixels, which stand still.",
        "",
        *(f"  t = {event.time:6.3f} s  {event.text}" for event in result.events),
        "",
        f"{run.duration:g} s of motion took {seconds(run.wall_time_s)}: {run.steps} steps,"
        f" worst residual {run.max_residual:.0e}.",
        "",
        *(f"  {_WHAT[kind]:10} {path}" for kind, path in files.items()),
        "",
        "Next, take the force limit away; a rigid drive jams, and fixel says so:",
        f"  fixel simulate {scene} --set pushers.0.drive.force_limit=null",
        "or make the object slippery, and draw where it goes:",
        f"  fixel simulate {scene} --set fixels.0.friction=0.02 --plot slippery.png",
        "or change the scene file and simulate it again. fixel simulate --help lists the options.",
    ]
