"""Tour of a laboratory that differs from the model: calibration, domain, sensitivity, report."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.jobs.folder import read_job
from fixel.jobs.functions import stamp
from fixel.model import Experiment
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.table import Table
from fixel.testbed.simulated import TRUTH, SimulatedTestbed
from fixel.typing import Notify
from fixel.workflows.capabilities import call
from fixel.workflows.report.write import Report

# One shape in one layout: the nominal pose, and steps along x, y and theta.
EXPERIMENTS: Final = 21
SEED: Final = 1
# Pushes whose sensitivity to the start is analysed: straight on, off the middle, turned.
ABOUT: Final = (1, 8, 19)


class Tour(NamedTuple):
    """Result of the tour."""

    project: Path
    report: Report
    truth: Table  # estimates with the true values of the laboratory


def run_tour(folder: Path, notify: Notify | None = None) -> Tour:
    """Create a project of simulated experiments, calibrate it, and report how reliable it is.

    Experiments that an earlier tour stored are not simulated again. `notify` is called with a
    sentence before each part of the tour.
    """
    notify = notify or (lambda _: None)
    folder = own_folder(folder, notify)
    project = Project(folder) if (folder / "fixel.yaml").is_file() else Project.create(folder)
    at = f"--project {shlex.quote(str(folder))}"
    notify(f"performing {EXPERIMENTS} experiments on a simulated testbed")
    with project.store() as store:
        _perform(store)
    notify("calibrating friction and support, with verdicts")
    number = call(project, "calibrate", optimiser="least-squares", progress=False).ids[-1]
    notify("mapping the domain of applicability")
    call(project, "domain", calibration=number)
    notify("computing the sensitivity to the start pose")
    keys = tuple(map(str, ABOUT))
    call(project, "sensitivity", experiments=keys, samples=500, calibration=number)
    notify("writing the report")
    report = project.report(
        folder.parent / "report", calibration=number, command=f"fixel report {at}"
    )
    return Tour(project=folder, report=report, truth=_compared_with_truth(project, number))


def own_folder(folder: Path, notify: Notify) -> Path:
    """Return the folder of a demo: another one if another version of fixel began a job in it."""
    jobs = [file.parent for file in folder.rglob("job.json")]
    if all(read_job(job).stamp == stamp() for job in jobs):
        return folder
    own = folder.with_name(f"{folder.name}-{stamp()[-8:]}")
    notify(f"another version of fixel began {folder}; using {own}")
    return own


def _perform(store: Store) -> None:
    """Store the experiments, unless there are some already."""
    if store.experiments(ExperimentQuery(limit=1)).total == 0:
        planned = thesis_plan().experiments[:EXPERIMENTS]
        for experiment in SimulatedTestbed(seed=SEED).run(planned):
            store.add_experiment(experiment)


def _compared_with_truth(project: Project, number: int) -> Table:
    """Table of the estimates with the true mean friction of the simulated laboratory."""
    with project.store() as store:
        record = store.calibration(number)
        experiments = [store.experiment(member.experiment_id) for member in record.members]
    rows = []
    for own in record.estimates:
        true = true_mean(own.label, experiments)
        known = "none" if true is None else f"{true:.3g}"
        rows.append((own.label, own.value_text, own.interval_text, known, own.verdict_text))
    head = ("parameter", "value", "interval", "truth", "verdict")
    return Table(head, rows, title="Estimated and true values")


def true_mean(label: str, experiments: Sequence[Experiment]) -> float | None:
    """Compute the mean true friction; None if the laboratory has no such property."""
    kind = label.removeprefix("mu_")
    if kind not in ("pusher", "fixel", "support"):
        return None
    found = []
    for experiment in experiments:
        scene = experiment.scene
        assert scene is not None
        body = scene.bodies[0]
        nominal = float(np.mean(getattr(body.support, "friction", math.nan)))
        if kind != "support":
            thing = scene.pushers[0] if kind == "pusher" else scene.fixels[0]
            nominal = scene.friction(body.name, thing.name)
        found.append(nominal * float(experiment.conditions[f"{TRUTH}{kind}_friction_ratio"]))
    return float(np.mean(found))
