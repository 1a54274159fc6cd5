"""Waiting times at the bench: ``python -m benchmarks bench``.

An emulated campaign at 1280 x 720 gives a film of 11 s and 20 experiments. Then, with the calls and
processes of `fixel bench`: tracking of that film, while it is recorded again from a network camera
in real time; and the estimates after each further experiment. Waiting depends on what else runs
here, processor time does not; the bars of both are those of a machine of its own.
"""

from __future__ import annotations

import queue
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from benchmarks.figures import Figure, Size, at_most
from fixel.calibration.usual_parameters import searched_unknowns
from fixel.database.project import Project
from fixel.formats.recording import RIG_FILE, SCENE_FILE
from fixel.formats.rig_file import rig_of
from fixel.model import Experiment, PlannedExperiment
from fixel.model.space import ParameterSpace
from fixel.testbed.file_source import LoopbackCamera
from fixel.testbed.frame_source import SharedCamera
from fixel.testbed.open_source import source_of
from fixel.testbed.recorder import Recorder
from fixel.workflows.acquisition.overlay import Tolerance
from fixel.workflows.acquisition.record import codec_for
from fixel.workflows.bench import devices
from fixel.workflows.bench.estimates import LiveAnswer, estimate_rows
from fixel.workflows.bench.judge import track_attempt
from fixel.workflows.bench.loop import Background
from fixel.workflows.bench.run import open_bench

TRACKED_WITHIN = ESTIMATED_WITHIN = 10.0  # [s]
TRAVEL, QUICK = 0.12, 0.06  # [m], [m/s]
SLOW = TRAVEL / 9.7  # [m/s]: with the rest before and after the push, a film of 11 s
PLAN = """fixel_plan: 1
name: {name}
head:
  shape: {{regular: {{sides: 4, side: 0.0287}}}}
  speed: {speed}
  travel: {travel}
  friction: 0.2
fixels: {{radius: 0.0047625, friction: 0.2, zone_side: 0.21}}
nominal: {{gap: 0.05, angle: 0.3927}}
shapes:
- name: square
  shape: {{regular: {{sides: 4, side: 0.1068}}}}
  mass: 0.2564
  zone_start: 0.125
  support: {{tripod: {{radius: 0.0409, friction: 0.25}}}}
layouts:
- {{name: three-fixels, pegs: [[0.6, 0.34], [0.6, 0.5], [0.6, 0.66]]}}
offsets:
- nominal: {{}}
- axis: {{name: y, step: 0.01, first: -2, last: 2}}
repetitions: {repetitions}
"""


class Call(NamedTuple):
    """Answer of a call in another process, and its processor time there [s]."""

    answer: Any
    work: float


def measured(function: Callable[..., Any], *arguments: Any) -> Call:
    """Call a function and measure its processor time."""
    begun = time.process_time()
    answer = function(*arguments)
    return Call(answer, time.process_time() - begun)


def run(size: Size) -> list[Figure]:
    """Tracking during a recording, and live estimates."""
    n = 20 if size.rollouts >= 500 else 2
    with tempfile.TemporaryDirectory() as folder, patch.object(devices, "SMALLER", 1.0):
        film, row = _filmed(Path(folder), n)
        done, rows = _performed(Path(folder), n)
        return [*_tracking(film, row, Path(folder), n), *_estimates(done, rows)]


def _campaign(folder: Path, name: str, speed: float, n: int) -> tuple[Project, Any]:
    """Perform n rows at the emulated laboratory; return the project and the campaign."""
    plan = folder / f"{name}.yaml"
    words = PLAN.format(name=name, speed=speed, travel=TRAVEL, repetitions=max(1, -(-n // 5)))
    plan.write_text(words)
    project = Project.create(folder / f"{name}-project")
    with open_bench(project, plan, emulated=True, auto=True, limit=n) as loop:
        loop.run()
        return project, loop.campaign


def _filmed(folder: Path, n: int) -> tuple[Path, PlannedExperiment]:
    _, campaign = _campaign(folder, "slow", SLOW if n > 2 else QUICK, 1)
    first = campaign.accepted[0]
    return campaign.recording(first), campaign.by_name[first.row]


def _performed(folder: Path, n: int) -> tuple[list[Experiment], list[PlannedExperiment]]:
    project, campaign = _campaign(folder, "quick", QUICK, n)
    with project.store() as store:
        return [store.experiment(own.experiment) for own in campaign.accepted], campaign.rows


def _tracking(film: Path, row: PlannedExperiment, folder: Path, n: int) -> list[Figure]:
    """Record the film n times in real time, and track each recording during the next."""
    rig = rig_of(film / RIG_FILE)
    tolerance = Tolerance(distance=rig.position_tolerance, angle=rig.angle_tolerance)
    found: queue.SimpleQueue[tuple[float, Any]] = queue.SimpleQueue()
    tracker = Background(partial(measured, track_attempt))
    waits, works, lost, frames = [], [], 0.0, []
    ends = []

    def done(answer: Any) -> None:
        found.put((time.perf_counter(), answer))

    def prepare(place: Path) -> None:
        for name in (RIG_FILE, SCENE_FILE):
            (place / name).write_bytes((film / name).read_bytes())

    for k in range(n):
        with LoopbackCamera(film) as server:
            camera = SharedCamera(partial(source_of, server.url, size=rig.camera.lens.image_size))
            place = folder / f"again-{k}"
            summary = Recorder(
                source=camera.view(), stream=camera.stream, folder=place,
                codec=codec_for("auto", camera.stream), prepare=prepare,
            ).run()  # fmt: skip
            ends.append(time.perf_counter())
            camera.close()
        lost += summary.lost
        frames.append(float(summary.frames))
        tracker.call(done, place, row, 1, "again", tolerance)
    for end in ends:
        at, answer = found.get()
        if isinstance(answer, Exception):
            raise answer
        waits.append(at - end)
        works.append(answer.work)
    tracker.close()
    label = "bench, film of 11 s during a recording"
    return [
        Figure(
            f"{label}, end of the recording to tracked poses",
            "s",
            tuple(waits),
            at_most(TRACKED_WITHIN),
        ),
        Figure(f"{label}, processor time of tracking", "s", tuple(works), at_most(TRACKED_WITHIN)),
        Figure(f"{label}, frames recorded each time", "-", tuple(frames)),
        Figure(f"{label}, frames lost in {n} recordings", "-", (lost,), at_most(0.0)),
    ]


def _estimates(done: list[Experiment], rows: list[PlannedExperiment]) -> list[Figure]:
    """Estimate after each experiment, in the order of the campaign."""
    fit = searched_unknowns((), [own.scene for own in done if own.scene is not None])
    space = ParameterSpace(unknowns=tuple(fit)) if fit else None
    figures = []
    for choosing, label in ((False, "in order"), (True, "choosing among all rows")):
        estimator = Background(partial(measured, estimate_rows))
        found: queue.SimpleQueue[Any] = queue.SimpleQueue()
        known: LiveAnswer | None = None
        wait = work = 0.0
        for k in range(1, len(done) + 1):
            begun = time.perf_counter()
            estimator.call(
                found.put, done[:k], space, "quasistatic", "", rows, choosing,
                None if known is None else known.estimates,
            )  # fmt: skip
            answer = found.get()
            if isinstance(answer, Exception):
                raise answer
            wait, work, known = time.perf_counter() - begun, answer.work, answer.answer
        estimator.close()
        name = f"bench, estimates after {len(done)} experiments, {label}"
        figures += [
            Figure(name, "s", (wait,), at_most(ESTIMATED_WITHIN)),
            Figure(f"{name}, processor time", "s", (work,), at_most(ESTIMATED_WITHIN)),
        ]
    return figures
