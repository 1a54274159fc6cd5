"""`fixel demo`: a short tour that leaves figures behind."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fixel.workflows.demo import Demo

_WHAT = {"scene": "the scene", "plot": "picture", "animate": "film", "trajectory": "numbers"}
NOT_SOLVED = 3


def demo(
    out: Annotated[
        Path, typer.Option(help="Folder for the figures; made when missing.", metavar="FOLDER")
    ] = Path("fixel-demo"),
) -> None:
    """Simulate, tell, draw and film a grasp: a square pushed against three fixels."""
    from fixel.cli.screen import progress_bar, say
    from fixel.workflows.demo import run_demo

    result = run_demo(out, say=say, progress=progress_bar("Filming"))
    typer.echo("\n".join(_told(result)))
    if not result.simulation.converged:
        raise typer.Exit(NOT_SOLVED)


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
