"""Scenes of the scene page: open, check, simulate within limits, write."""

from __future__ import annotations

import functools
from contextlib import suppress
from typing import Any, Final

from pydantic import Field

from fixel.errors import InvalidInput, JobRefused, check_name
from fixel.formats import SceneFile
from fixel.formats.scene_file import scene_dict, scene_file_from_dict
from fixel.io.document import parse_json, parse_yaml, plain_numbers
from fixel.jobs.worker_process import WorkerProcess
from fixel.model import Disk, PathDrive, Scene, SupportPoints, UniformPressure
from fixel.simulation import simulate
from fixel.simulation.motion import motion_model
from fixel.simulation.stepping import Adaptive
from fixel.web.values import Answer
from fixel.web.views.live_comparison import warm_up
from fixel.web.views.motion_views import Animation, animation_of_scene, simulated_motion
from fixel.workflows.demo.scene_demo import example_names, example_text

LIMIT: Final = 20.0  # [s] of computing
MAX_TEXT: Final = 512 * 1024  # [byte] of a scene file
MAX_DURATION: Final = 600.0  # [s] of simulated time
MAX_STEPS: Final = 20_000
MAX_THINGS: Final = 60
MAX_CORNERS: Final = 4_000  # of all outlines
MAX_POINTS: Final = 4_000  # of all supports
MAX_WAYPOINTS: Final = 20_000
SAMPLES: Final = 440  # of a motion that is shown; 40 per second for the runs of the thesis


class SceneExample(Answer):
    """A scene that comes with fixel."""

    name: str
    sentence: str


class SceneMotion(Answer):
    """Result of simulating a scene."""

    story: Animation
    summary: dict[str, Any] = Field(description="answer of `fixel simulate --json`")


def examples() -> list[SceneExample]:
    """Return the scenes that come with fixel, each with its first comment."""
    return [
        SceneExample(name=name, sentence=_first_sentence(example_text(name)))
        for name in example_names()
    ]


def example(name: str) -> dict[str, Any]:
    """Return a scene that comes with fixel, as the keys of a scene file."""
    check_name("example", name, example_names())
    return read_scene(example_text(name))


def read_scene(text: str, *, json: bool = False) -> dict[str, Any]:
    """Parse and check the text of a scene file; return its keys, or raise `InvalidInput`."""
    if len(text.encode()) > MAX_TEXT:
        raise InvalidInput(
            "file", found=f"more than {MAX_TEXT // 1024} kB", expected="a scene file"
        )
    content = (parse_json if json else parse_yaml)(text, "file")
    return scene_dict(check_scene(content))


def check_scene(content: Any) -> SceneFile:
    """Return the scene of these keys, or raise the first error in it."""
    found = scene_file_from_dict(content)
    motion_model(found.motion)
    _check_size(found)
    return found


def simulated(content: Any) -> SceneMotion:
    """Simulate a scene given by its keys, with limited numbers of steps and samples."""
    file = check_scene(content)
    scene = file.scene
    simulation = simulate(
        file,
        stepper=Adaptive(max_steps=MAX_STEPS) if file.step is None else None,
        output_interval=scene.duration / SAMPLES,
    )
    names = ", ".join(body.name for body in scene.bodies)
    motions = [simulated_motion(simulation)]
    return SceneMotion(
        story=animation_of_scene(scene, motions, f"simulation of {names}"),
        summary=plain_numbers(simulation.summary()),
    )


@functools.cache
def simulation_worker() -> WorkerProcess:
    """Process that runs `simulated`, shared by all clients."""
    return WorkerProcess(
        simulated,
        limit=LIMIT,
        ready=warm_up,
        hint="make the simulation shorter or the scene simpler, or use the command: fixel simulate",
    )


def get_ready() -> None:
    """Start that process, so that the first simulation need not wait for it."""
    with suppress(JobRefused):  # the simulation itself reports it
        simulation_worker().start()


def _check_size(file: SceneFile) -> None:
    scene = file.scene
    steps = 0.0 if file.step is None else scene.duration / file.step
    for where, found, most, unit in (
        ("duration", scene.duration, MAX_DURATION, " s"),
        ("step", steps, MAX_STEPS, " steps"),
        ("bodies", len(scene.names), MAX_THINGS, " bodies, pushers and fixels"),
        ("bodies[0].shape.polygon", _corners(scene), MAX_CORNERS, " corners in all"),
        ("bodies[0].support", _points(scene), MAX_POINTS, " support points in all"),
        ("pushers[0].drive.waypoints", _waypoints(scene), MAX_WAYPOINTS, " waypoints in all"),
    ):
        if found > most:
            raise InvalidInput(
                where,
                found=f"{found:g}{unit}",
                expected=f"at most {most:g}{unit} on this page",
                hint="use the command: fixel simulate",
            )


def _corners(scene: Scene) -> int:
    shapes = [body.shape for body in scene.bodies]
    shapes += [
        obstacle.shape for obstacles in (scene.pushers, scene.fixels) for obstacle in obstacles
    ]
    return sum(1 if isinstance(shape, Disk) else len(shape.vertices) for shape in shapes)


def _points(scene: Scene) -> int:
    total = 0
    for body in scene.bodies:
        match body.support:
            case UniformPressure(n_points=n):
                total += n
            case SupportPoints(points=points):
                total += len(points)
            case _:
                total += 3
    return total


def _waypoints(scene: Scene) -> int:
    drives = [pusher.drive for pusher in scene.pushers]
    return sum(len(drive.waypoints) for drive in drives if isinstance(drive, PathDrive))


def _first_sentence(text: str) -> str:
    words = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        words.append(line.lstrip("# "))
    return " ".join(words).partition(". ")[0].rstrip(".")
