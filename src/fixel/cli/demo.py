"""`fixel demo`, `fixel doctor` and `fixel compile`: tours, checks, and code ahead of its use."""

import shlex
import time
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.capability.options import Door
from fixel.cli.capability import NOT_SOLVED, command
from fixel.cli.screen import CommandAnswer, notify
from fixel.errors import InvalidInput
from fixel.progress import show_progress, time_text

if TYPE_CHECKING:
    from fixel.workflows.demo.camera_demo import CameraTour
    from fixel.workflows.demo.laboratory_demo import Tour
    from fixel.workflows.demo.scene_demo import Demo
    from fixel.workflows.demo.story_demo import DemoStep
    from fixel.workflows.installation import Diagnosis

_WHAT = {"scene": "the scene", "plot": "picture", "animate": "film", "trajectory": "numbers"}
CAMERA = "camera"
WRONG = 1  # exit code where a claim is wrong


@command
def demo(
    *,
    out: Annotated[Path, Door(metavar="FOLDER")] = Path("fixel-demo"),
    seed: Annotated[int, Door(least=0)] = 1,
    misfit: Annotated[bool, Door(flag="--misfit")] = False,
    quick: Annotated[bool, Door(flag="--quick")] = False,
    camera: Annotated[bool, Door(flag="--camera")] = False,
    as_json: bool,
) -> CommandAnswer:
    """Calibrate a table of pushes, and plan a push that works.

    The laboratory is simulated, so that every claim is compared with the truth. The exit code is 1
    if one is wrong.

    Parameters
    ----------
    out : Path
        Folder for the figures; created if missing.
    seed : int
        Seed of the laboratory: another one has other true values.
    misfit : bool
        Show what happens in a laboratory that the model does not fit.
    quick : bool
        Simulate a grasp only.
    camera : bool
        Film simulated pushes instead, record the films from a network camera, track, calibrate, and
        compare with the truth. This takes minutes; the same command resumes it.
    """
    begin = time.monotonic()

    def tell(what: str) -> None:
        notify(f"{time.monotonic() - begin:4.0f} s  {what} ...")

    if as_json and (misfit or quick or camera):
        expected = "no other demo: --misfit, --quick and --camera print text only"
        raise InvalidInput("--json", found="the option of another demo", expected=expected)
    if out.exists() and not out.is_dir():
        raise InvalidInput("--out", found=f"the file {out}", expected="a folder, also a new one")
    if camera:
        from fixel.workflows.demo.camera_demo import run_camera_tour

        with show_progress(stage="filming") as report:
            tour = run_camera_tour(out / CAMERA, notify=tell, progress=report)
        return CommandAnswer({}, _camera_lines(tour))
    if misfit:
        from fixel.workflows.demo.laboratory_demo import run_tour

        typer.echo(
            "This laboratory does not fit the model: its parts stand on uneven undersides, on a "
            "rough plate.\nSo the calibration must report a misfit, and where it can still be "
            "trusted.\n"
        )
        return CommandAnswer({}, _laboratory_lines(run_tour(out / "misfit", notify=tell)))
    if quick:
        from fixel.workflows.demo.scene_demo import run_demo

        result = run_demo(out)
        code = 0 if result.simulation.converged else NOT_SOLVED
        return CommandAnswer({}, _scene_lines(result), code)
    from fixel.workflows.demo.story_demo import tell_story

    steps = []
    for number, step in enumerate(tell_story(out, seed, tell), 1):
        steps.append(step)
        if not as_json:
            typer.echo("\n".join(_step_lines(number, step)))
    claims = [claim for step in steps for claim in step.claims]
    wrong = sum(not claim.right for claim in claims)
    content = {"seed": seed, "claims": [claim._asdict() for claim in claims], "wrong": wrong}
    lines = _last_lines(len(claims), wrong, time.monotonic() - begin)
    return CommandAnswer(content, lines, WRONG if wrong else 0)


def _step_lines(number: int, step: "DemoStep") -> list[str]:
    claims = [
        f"  {'right' if own.right else 'WRONG'}  {own.what}: fixel states {own.stated};"
        f" in truth {own.truth}"
        for own in step.claims
    ]
    repeat = [f"    {line}" for line in step.repeat]
    return [f"{number}. {step.title}", *(f"  {line}" for line in step.lines), *claims,
            *(["  The same with your own table:", *repeat] if repeat else []), ""]  # fmt: skip


def _last_lines(n: int, wrong: int, seconds: float) -> list[str]:
    result = f"{wrong} of {n} claims are WRONG" if wrong else f"All {n} claims are right"
    return [
        f"{result}, after {time_text(seconds)}. Statements of 90 and 95 % may be wrong by chance.",
        "Next, another laboratory, one that the model does not fit, or a grasp:",
        "  fixel demo --seed 2",
        "  fixel demo --misfit",
        "  fixel demo --quick",
    ]


def _camera_lines(tour: "CameraTour") -> list[str]:
    from fixel.workflows.demo.camera_demo import estimate_table
    from fixel.workflows.report.write import next_command

    (position, angle), lab = tour.errors, shlex.quote(str(tour.project))
    return [
        "",
        f"{tour.frames} frames recorded, {tour.lost} lost. Tracked poses are "
        f"{1e3 * position:.3f} mm and {degrees(angle):.3f} deg from the true ones (RMS).",
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
        f"{run.duration:g} s of motion took {time_text(run.wall_time_s)}: {run.steps} steps, "
        f"worst residual {run.max_residual:.0e}.",
        "",
        *(f"  {_WHAT[kind]:10} {path}" for kind, path in files.items()),
        "",
        "Next, remove the force limit: a rigid drive jams, and fixel reports it:",
        f"  fixel simulate {scene} --set pushers.0.drive.force_limit=null",
        "or reduce the friction, and draw the motion:",
        f"  fixel simulate {scene} --set fixels.0.friction=0.02 --plot slippery.png",
        "or change the scene file and simulate it again. fixel simulate --help lists the options.",
    ]


@command
def doctor() -> CommandAnswer:
    """Check this installation and report how to repair it."""
    from fixel.workflows.installation import examine

    found = examine()
    return CommandAnswer(found.summary(), _lines(found), 0 if found.passed else 1)


@command
def compile_(*, as_json: bool) -> CommandAnswer:
    """Compile all numerical code now: for images and slow machines.

    Two processes take some minutes. Without it, the first simulation starts the compilation.
    """
    from dataclasses import asdict

    from fixel.kernels.code_cache import cache_folder
    from fixel.workflows.installation import cache_size, compile_kernels

    parts = compile_kernels(progress=False if as_json else None)
    failed = [part for part in parts if part.problem]
    folder, size = cache_folder(), cache_size()
    content = {"folder": folder, "bytes": size, "parts": [*map(asdict, parts)]}
    lines = [
        f"{part.problem or (time_text(part.seconds) if part.seconds else 'stored before'):>14}  "
        f"{part.name}"
        for part in parts
    ]
    end = "Next: fixel doctor" if failed else "Next: fixel demo"
    lines += ["", f"{size / 1e6:.1f} MB in {folder}", end]
    return CommandAnswer(content, lines, 1 if failed else 0)


def _lines(found: "Diagnosis") -> list[str]:
    from fixel.workflows.installation import worst_residual

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
