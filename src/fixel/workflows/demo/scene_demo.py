"""Short tour: one grasp is simulated, described, drawn and filmed."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import final

from fixel.errors import InvalidInput, os_reason
from fixel.io.atomic import written_whole
from fixel.simulation import Simulation
from fixel.typing import Notify, Progress
from fixel.workflows.demo.events import MotionEvent, story
from fixel.workflows.simulation import Outputs, simulate_file

EXAMPLE = "grasp"


@final
@dataclass(frozen=True, slots=True)
class Demo:
    """Result of the tour.

    Attributes
    ----------
    simulation : Simulation
    events : list of MotionEvent
        Events of the motion, in order.
    files : dict from kind to Path
        ``scene``, ``plot``, ``animate``, ``trajectory``.
    """

    simulation: Simulation
    events: list[MotionEvent]
    files: dict[str, Path]


def example_names() -> list[str]:
    """Return the names of the scenes that come with fixel."""
    folder = files("fixel.testing") / "examples"
    return sorted(Path(f.name).stem for f in folder.iterdir() if f.name.endswith(".yaml"))


def example_text(name: str) -> str:
    """Return the scene file of an example, with its comments."""
    with as_file(files("fixel.testing") / "examples" / f"{name}.yaml") as path:
        return path.read_text(encoding="utf-8")


def run_demo(folder: Path, notify: Notify | None = None, progress: Progress | None = None) -> Demo:
    """Simulate the example grasp; write its scene, picture, film and trajectory.

    Parameters
    ----------
    folder : Path
        Created if missing; files of the same names are replaced.
    say, progress : callable, optional
        See `simulate_file`.

    Raises
    ------
    InvalidInput
        The folder cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        reason = os_reason(problem)
        raise InvalidInput(str(folder), found=reason, expected="a folder to write to") from None
    scene = folder / f"{EXAMPLE}.yaml"
    outputs = Outputs(
        trajectory=scene.with_suffix(".csv"),
        plot=scene.with_suffix(".png"),
        animate=scene.with_suffix(".mp4"),
    )
    with written_whole(scene) as temporary:
        temporary.write_text(example_text(EXAMPLE), encoding="utf-8")
    simulation = simulate_file(scene, outputs=outputs, notify=notify, progress=progress)
    return Demo(simulation, story(simulation), {"scene": scene, **outputs.files})
