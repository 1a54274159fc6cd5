"""Projects that tests share, as artefacts; each function copies one into a new folder."""

import shutil
from pathlib import Path

import numpy as np
from tests import calibrating as run
from tests.artefacts import artefact, copied
from tests.fixtures import project_of
from tests.workflows import growing

from fixel.database.project import Project
from fixel.model import Flag
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed


def laboratory(folder: Path) -> Path:
    """Return a copy of a project: 30 experiments of two shapes, three stored simulations."""
    return copied("laboratory", _make_laboratory, folder)


def trusted_laboratory(folder: Path) -> Path:
    """Return a copy of the same with a calibration of six experiments and a map of all."""
    return copied("trusted_laboratory", _make_trusted, folder)


def campaign(folder: Path) -> Path:
    """Return a copy of a project: the steps of the thesis along each axis, each calibrated."""
    return copied("campaign", _make_campaign, folder)


def _make_campaign(folder: Path) -> None:
    experiments, points = growing.performed(growing.planned()), growing.made_up_points(21)
    errors = growing.comparer_of(experiments).errors(np.arange(21), points).error
    growing.project_with(folder, experiments, points, errors)


def _make_laboratory(folder: Path) -> None:
    from fixel.workflows.project.compare import compare_run

    project = project_of(folder, SimulatedTestbed(seed=1).run(thesis_plan().experiments[::14]))
    with project.store() as store:
        store.flag([3], Flag("misregistered", "starts 4.2 mm inside the pusher"))
        store.flag([5], Flag("late", "by 0.2 s", fault=False))
        for number in (1, 2, 3):  # with nominal values
            answer = compare_run(store.experiment(number))
            store.add_simulation(answer.record(number, "fixel compare --save"))


def _make_trusted(folder: Path) -> None:
    from fixel.workflows.capabilities import CAPABILITIES, call, prepare

    shutil.copytree(artefact("laboratory", _make_laboratory), folder)
    project = Project(folder)
    own = CAPABILITIES["calibrate"]
    asked = dict(
        name="first",
        experiments=tuple(map(str, range(6, 12))),
        fit=("mu_pusher=0:1:0.2", "tripod_radius=0.001:0.0755:0.0409"),
        mode="joint",
        optimiser="nelder-mead",
        max_evaluations=60,
        starts=2,
    )
    job = prepare(own, own.request(asked), project)
    run.run(job)
    run.collect(project, job, "fixel calibrate --name first", {})
    options = {"axes": ("offset_y_m", "shape"), "fit": ("mu_pusher",), "folds": 2}
    call(project, "domain", threshold=6e-3, **options, progress=False)
