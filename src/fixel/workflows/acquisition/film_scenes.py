"""Collect scenes to film from scene files, plans and experiments of the simulated testbed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.plan_file import load_plan
from fixel.formats.scene_file import SceneFile, load_scene
from fixel.io.document import read_document
from fixel.model import Experiment, PlannedExperiment, Scene, pose_error
from fixel.simulation import Simulation, simulate
from fixel.testbed.simulated import TRUTH, SimulatedTestbed

SAMPLE: Final = 1.0 / 240.0  # [s] between samples of the true motion

# Largest distance between the ends of a repeated and of the stored motion; the sampling of a
# rollout changes the steps of its solver, and its end by some micrometres.
SAME_END: Final = 2e-4  # [m]

FILES: Final = (".yaml", ".yml", ".json")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilmScene:
    """Scene to film, with its true motion."""

    name: str
    planned: SceneFile  # scene as the experimenter believes it to be
    simulation: Simulation  # true motion; its scene has the true shapes and frictions
    testbed: SimulatedTestbed  # testbed whose camera and fixels report the motion
    # Known true conditions, under names that end with their unit.
    truth: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> Scene:
        """Scene with the true shapes and frictions."""
        return self.simulation.scene


def film_scenes(
    sources: Sequence[str], project: Path, *, seed: int = 1, limit: int | None = None
) -> tuple[int, Iterator[FilmScene]]:
    """Return the number of scenes to film and an iterator over them.

    Parameters
    ----------
    sources : sequence of str
        Scene files, plan files, and ids or names of experiments of a project.
    project : Path
        Folder of the project; opened only if a source is an experiment.
    seed : int
        Seed of the simulated testbed that performs plans.
    limit : int, optional
        Maximum number of experiments per plan.

    Raises
    ------
    InvalidInput
        Nothing to film, an unreadable file, or an experiment of no simulated testbed.
    """
    if not sources:
        raise InvalidInput(
            "film",
            found="nothing to film",
            expected="a scene file, a plan file, or experiments of a project",
            hint="fixel testbed film scene.yaml, or: fixel testbed film EXPERIMENT --project DIR",
        )
    makers = [make for source in sources for make in _makers(source, project, seed, limit)]
    return len(makers), (make() for make in makers)


def _makers(
    source: str, project: Path, seed: int, limit: int | None
) -> list[Callable[[], FilmScene]]:
    """One function for each scene of a source, which simulates it."""
    path = Path(source)
    if path.suffix.lower() not in FILES:
        with Project(project).store() as store:
            experiment = store.experiment(store.find(source))
        _check_simulated(experiment)
        return [partial(_again, experiment)]
    if "bodies" in read_document(path):
        return [partial(_as_written, path.stem, load_scene(path), seed)]
    bench = SimulatedTestbed(seed=seed)
    return [partial(_performed, planned, bench) for planned in load_plan(path).experiments[:limit]]


def _as_written(name: str, scene_file: SceneFile, seed: int) -> FilmScene:
    """Simulate a scene file exactly as it is written."""
    simulation = simulate(scene_file, output_interval=SAMPLE)
    bench = SimulatedTestbed.ideal(seed)
    return FilmScene(name=name, planned=scene_file, simulation=simulation, testbed=bench)


def _performed(planned: PlannedExperiment, bench: SimulatedTestbed) -> FilmScene:
    """Simulate a planned experiment on the simulated testbed."""
    simulation = simulate(bench.true_scene(planned), output_interval=SAMPLE)
    return FilmScene(
        name=planned.name,
        planned=SceneFile(scene=planned.scene),
        simulation=simulation,
        testbed=bench,
    )


def _again(experiment: Experiment) -> FilmScene:
    """Repeat an experiment of the simulated testbed to obtain its true motion."""
    scene, conditions = experiment.scene, experiment.conditions
    assert scene is not None
    planned = PlannedExperiment(
        name=experiment.name,
        scene=scene,
        conditions={k: v for k, v in conditions.items() if not k.startswith(TRUTH)},
    )
    seed = experiment.provenance.seed
    bench = SimulatedTestbed(seed=1 if seed is None else seed, dataset=experiment.dataset)
    subject = _performed(planned, bench)
    end = subject.simulation.pose[experiment.object_name][-1]
    remembered = np.array([conditions[f"{TRUTH}final_{k}"] for k in ("x_m", "y_m", "angle_rad")])
    apart, _ = pose_error(end, remembered)
    if apart > SAME_END:
        raise InvalidInput(
            f"experiment {experiment.key}",
            found=f"a motion that ends {apart * 1e3:.2f} mm from the stored end",
            expected="the stored motion",
            hint="it was performed with other settings than those of `fixel testbed run`",
        )
    truth = {k: v for k, v in conditions.items() if k.startswith(TRUTH)}
    return replace(subject, truth=truth)


def _check_simulated(experiment: Experiment) -> None:
    if (
        experiment.real
        or experiment.scene is None
        or f"{TRUTH}final_x_m" not in experiment.conditions
    ):
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="a real experiment"
            if experiment.real
            else "an experiment whose true motion is unknown",
            expected="an experiment of the simulated testbed",
            hint="perform some: fixel testbed run",
        )
