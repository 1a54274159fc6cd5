"""`fixel demo` and `fixel doctor`: a tour that ends in a report, and checks of the installation."""

import shlex
import time
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from fixel.cli.options import AsJson, option, with_options
from fixel.cli.screen import notify, print_answer
from fixel.progress import show_progress, time_text

if TYPE_CHECKING:
    from fixel.workflows.demo.camera_demo import CameraTour
    from fixel.workflows.demo.laboratory_demo import Tour
    from fixel.workflows.demo.scene_demo import Demo
    from fixel.workflows.diagnostics import Diagnosis

_WHAT = {"scene": "the scene", "plot": "picture", "animate": "film", "trajectory": "numbers"}
LAB = "lab"
CAMERA = "camera"
NOT_SOLVED = 3


@with_options
def demo(
    *,
    out: Path = option(
        Path("fixel-demo"), "Folder for the figures; created if missing.", metavar="FOLDER"
    ),
    quick: bool = option(
        False, "Simulate the grasp only, without experiments and report.", "--quick"
    ),
    camera: bool = option(
        False,
        "Film simulated pushes instead, record the films from a network camera, track, "
        "calibrate, and compare with the truth. This takes minutes; the same command resumes it.",
        "--camera",
    ),
) -> None:
    """Simulate and film a grasp, then assess the simulator.

    For the second part, simulated experiments are calibrated.
    """
    if camera:
        from fixel.workflows.demo.camera_demo import run_camera_tour

        begin = time.monotonic()
        with show_progress(stage="filming") as report:
            tour = run_camera_tour(
                out / CAMERA,
                notify=lambda what: notify(f"{time.monotonic() - begin:4.0f} s  {what} ..."),
                progress=report,
            )
        return typer.echo("\n".join(_camera_lines(tour)))
    from fixel.workflows.demo.scene_demo import run_demo

    result = run_demo(out)
    typer.echo("\n".join(_scene_lines(result)))
    if not result.simulation.converged:
        raise typer.Exit(NOT_SOLVED)
    if not quick:
        from fixel.workflows.demo.laboratory_demo import run_tour

        typer.echo("\nHow accurate is such a simulation? Assess it on a simulated laboratory:\n")
        laboratory = run_tour(out / LAB, notify=lambda what: notify(f"  {what} ..."))
        typer.echo("\n".join(_laboratory_lines(laboratory)))


def _camera_lines(tour: "CameraTour") -> list[str]:
    from fixel.workflows.demo.camera_demo import estimate_table
    from fixel.workflows.report.write import next_command

    errors, lab = tour.errors, shlex.quote(str(tour.project))
    return [
        "",
        f"{tour.frames} frames recorded, {tour.lost} lost. Tracked poses are"
        f" {1e3 * errors.position:.3f} mm and {degrees(errors.angle):.3f} deg from the true"
        " ones (RMS).",
        "",
        *estimate_table(tour.estimates, tour.truths).lines(),
        "",
        *(f"  overlay    {path}" for path in tour.overlays if path.suffix == ".png"),
        "",
        "The report compares true and tracked trajectories:",
        f"  {next_command(tour.report)}",
        "Next, look at a tracked experiment, or use your own camera:",
        f"  fixel show tracked/{tour.runs[0].name} --project {lab}",
        "  fixel camera board --help",
    ]


def _laboratory_lines(tour: "Tour") -> list[str]:
    from fixel.workflows.report.write import next_command

    content = tour.report.content
    lab = shlex.quote(str(tour.project))
    return [
        "",
        *content.findings,
        "",
        "This laboratory is simulated, so the true values are known; the intervals were computed "
        "without them:",
        *tour.truth.lines(),
        "",
        f"{len(content.warnings)} warnings are at the top of the report, which has figures, "
        "methods and references:",
        f"  {next_command(tour.report)}",
        "Next, use a threshold other than 5 mm, or look at one experiment:",
        f"  fixel domain --threshold-mm 8 --project {lab}",
        f"  fixel show 8 --project {lab}",
    ]


def _scene_lines(result: "Demo") -> list[str]:
    run, files = result.simulation, result.files
    scene = shlex.quote(str(files["scene"]))
    return [
        "A flat head pushes a square against three fixed pegs (fixels).",
        "",
        *(f"  t = {event.time:6.3f} s  {event.text}" for event in result.events),
        "",
        f"{run.duration:g} s of motion took {time_text(run.wall_time_s)}: {run.steps} steps,"
        f" worst residual {run.max_residual:.0e}.",
        "",
        *(f"  {_WHAT[kind]:10} {path}" for kind, path in files.items()),
        "",
        "Next, remove the force limit: a rigid drive jams, and fixel reports it:",
        f"  fixel simulate {scene} --set pushers.0.drive.force_limit=null",
        "or reduce the friction, and draw the motion:",
        f"  fixel simulate {scene} --set fixels.0.friction=0.02 --plot slippery.png",
        "or change the scene file and simulate it again. fixel simulate --help lists the options.",
    ]


def doctor(as_json: AsJson = False) -> None:
    """Check this installation and report how to repair it."""
    from fixel.workflows.diagnostics import examine

    found = examine()
    print_answer(as_json, found.summary, lambda: _lines(found))
    if not found.passed:
        raise typer.Exit(1)


def _lines(found: "Diagnosis") -> list[str]:
    from fixel.workflows.diagnostics import worst_residual

    versions = [f"{name} {number}" for name, number in found.versions.items()]
    state = "warm" if found.cache["warm"] else "compiled just now"
    failed = sum(not check.passed for check in found.checks)
    verdict = f"{failed} of {len(found.checks)} checks failed" if failed else "All checks passed"
    return [
        ", ".join(versions[:4]),
        ", ".join(versions[4:]),
        f"{found.machine['platform']}, {found.machine['cores']} cores,"
        f" batches on {found.machine['threads']} threads",
        f"kernels  {found.cache['folder']}",
        f"         {found.cache['bytes'] / 1e6:.1f} MB, {state}",
        "",
        *(_line(c.name, c.passed, c.detail, c.residual) for c in found.checks),
        "",
        f"{verdict}. Worst residual {worst_residual(found.checks):.1e}; took"
        f" {time_text(found.seconds)}.",
        "Next: fixel demo" if not failed else "Please report the lines marked FAIL.",
    ]


def _line(name: str, passed: bool, detail: str, residual: float | None) -> str:
    mark = "PASS" if passed else "FAIL"
    end = "" if residual is None else f"  (residual {residual:.0e})"
    return f"{mark}  {name:42}  {detail}{end}"
