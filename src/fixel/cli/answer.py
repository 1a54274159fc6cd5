"""Output of `fixel simulate`, as JSON and as text."""

import json
import shlex
from math import degrees
from pathlib import Path

from fixel.cli.screen import seconds, table
from fixel.formats.trajectory_file import plain_numbers
from fixel.simulation import Simulation
from fixel.workflows.simulation import Outputs

MAX_ROWS = 20


def json_answer(simulation: Simulation, outputs: Outputs) -> str:
    """Return one JSON object on one line; numbers that are not finite become null."""
    answer = simulation.summary()
    files = {name: str(path) for name, path in outputs.files.items()}
    return json.dumps(plain_numbers(answer | {"files": files}), allow_nan=False)


def written_answer(simulation: Simulation, scene: Path, outputs: Outputs) -> str:
    """Return about a screen of text: status, poses, pushers, contacts, files, next command."""
    blocks = [
        _status(simulation, scene),
        _poses(simulation),
        _pushers(simulation),
        _touching(simulation),
        _effort(simulation),
        [f"wrote {path}" for path in outputs.files.values()],
        [f"Next: {_next(simulation, scene, outputs)}"],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _status(simulation: Simulation, scene: Path) -> list[str]:
    if simulation.converged:
        return [f"{scene.name}: converged, simulated {simulation.duration:g} s"]
    planned = simulation.scene.duration
    when = f"{simulation.stopped_at:.6g} of {planned:g} s"
    return [f"{scene.name}: {simulation.status}, stopped at {when}", simulation.advice]


def _poses(simulation: Simulation) -> list[str]:
    rows = []
    for body in simulation.scene.bodies[:MAX_ROWS]:
        x, y, angle = simulation.final[body.name].tolist()
        rows.append((body.name, f"{1e3 * x:.4f}", f"{1e3 * y:.4f}", f"{degrees(angle):.4f}"))
    lines = table(("body, at the end", "x [mm]", "y [mm]", "angle [deg]"), rows)
    left_out = len(simulation.scene.bodies) - len(rows)
    return lines + ([f"... and {left_out} more; --json has them all"] if left_out else [])


def _pushers(simulation: Simulation) -> list[str]:
    rows = [
        (name, f"{1e3 * trace.travel:.4f}", f"{trace.force[-1]:.4g}", _drive(trace.stalled[-1]))
        for name, trace in list(simulation.pushers.items())[:MAX_ROWS]
    ]
    return table(("pusher", "travel [mm]", "force [N]", ""), rows) if rows else []


def _drive(stalled: bool) -> str:
    return "stalled" if stalled else ""


def _touching(simulation: Simulation) -> list[str]:
    pairs = simulation.touching
    if not pairs:
        return ["Nothing touches at the end."]
    shown = [f"  {a} - {b}" for a, b in pairs[:MAX_ROWS]]
    more = [f"  ... and {len(pairs) - MAX_ROWS} more"] if len(pairs) > MAX_ROWS else []
    return ["touching at the end", *shown, *more]


def _effort(simulation: Simulation) -> list[str]:
    method = simulation.method
    fallbacks = f", {simulation.fallbacks} by a fallback" if simulation.fallbacks else ""
    return [
        f"{simulation.steps} steps{fallbacks} in {seconds(simulation.wall_time_s)}"
        f" ({method['motion']}, {method['stepper']}, {method['solver']})"
        f"; worst residual {simulation.max_residual:.1e}"
    ]


def _next(simulation: Simulation, scene: Path, outputs: Outputs) -> str:
    """Return the command that most users need next."""
    command = f"fixel simulate {shlex.quote(str(scene))}"
    rigid = [p.name for p in simulation.scene.pushers if p.drive.force_limit is None]
    if simulation.status == "jammed" and rigid:
        change = f"pushers.{rigid[0]}.drive.force_limit=34.3"
        return f"{command} --set {shlex.quote(change)}"
    if simulation.status in ("max_iterations", "step_too_small"):
        return f"{command} --step 0.001"
    for name, ending in (("plot", ".png"), ("animate", ".mp4"), ("trajectory", ".csv")):
        if name not in outputs.files:
            return f"{command} --{name} {shlex.quote(scene.stem + ending)}"
    body = simulation.scene.bodies[0]
    return f"{command} --set {shlex.quote(f'bodies.{body.name}.mass={2.0 * body.mass:g}')}"
