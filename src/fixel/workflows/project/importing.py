"""Create a project, import experiments, run the simulated testbed, and list experiments."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from fixel.database.browsing import ExperimentPage
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.datasets import ImportPlan, importer_for
from fixel.datasets.own_scene import template_text
from fixel.datasets.table import DATASET as TABLE
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.model.selection import ExperimentQuery
from fixel.typing import ProgressCallback
from fixel.workflows.project.filters import check_known_names


class ImportSummary(NamedTuple):
    """Number of experiments in an import."""

    new: int
    known: int  # stored before, and left unchanged
    faulty: int  # of the new, those that listings leave out by default
    wall_time_s: float


def import_plan(
    source: Path,
    importer: str | None = None,
    options: Iterable[str] = (),
    scene: Path | None = None,
) -> ImportPlan:
    """Plan the import of a file or folder; `options` are `NAME=VALUE`, `scene` is for a table.

    Raises
    ------
    InvalidInput
        Invalid data, option or scene.
    """
    found = importer_for(source, importer)
    given = _options(options)
    if scene is not None:
        if "scene" not in found.options:
            raise InvalidInput(
                "--scene", found=f"a source read as {found.name}", expected="a CSV table"
            )
        given["scene"] = str(scene)
    return found.read(source, **given)


def write_template(plan: ImportPlan, folder: Path) -> Path | None:
    """Write the template of a scene for a table that was imported without one.

    It is written next to the table, or into `folder` if that is not possible; an existing file of
    that name is not changed.

    Returns
    -------
    Path or None
        None if the experiments have a scene, or are not from a table.
    """
    if plan.importer != TABLE:
        return None
    (experiment,) = plan.experiments()
    if experiment.scene is not None:
        return None
    name = f"{experiment.name.replace('/', '-')}.scene.yaml"
    text = template_text(experiment, plan.source.name)
    for place in (plan.source.parent, folder):
        file = place / name
        try:
            with file.open("x", encoding="utf-8") as stream:
                stream.write(text)
        except FileExistsError:
            return file
        except OSError:
            continue
        return file
    return None


def import_experiments(
    project: Project, plan: ImportPlan, progress: ProgressCallback | None = None
) -> ImportSummary:
    """Store the experiments of a plan, each completely or not at all."""
    with project.store() as store:
        return _add(store, plan.experiments(), plan.n_experiments, progress)


class ImportedTable(NamedTuple):
    """Result of reading the text of a table."""

    understood: tuple[str, ...]
    template: str | None  # template of a scene, if there is none
    new: bool
    known: bool


def import_texts(
    store: Store,
    name: str,
    table: str,
    scene: str | None,
    *,
    angle_unit: str | None = None,
    dry_run: bool = False,
) -> ImportedTable:
    """Store the experiment in the text of a CSV table.

    Parameters
    ----------
    store : Store
    name : str
        Name of the table's file, from which the experiment gets its name.
    table : str
    scene : str, optional
        Scene file, as YAML.
    angle_unit : str, optional
        `rad` or `deg`, which overrides the header.
    dry_run : bool
        Whether to read the table without storing it.

    Raises
    ------
    InvalidInput
        Invalid table or scene.
    """
    with TemporaryDirectory(prefix="fixel-import-") as folder:
        source = Path(folder) / name
        source.write_text(table, encoding="utf-8", newline="")
        file = None if scene is None else Path(folder) / "scene.yaml"
        if file is not None and scene is not None:
            file.write_text(scene, encoding="utf-8", newline="")
        options = () if angle_unit is None else (f"angle_unit={angle_unit}",)
        plan = import_plan(source, TABLE, options, file)
        (experiment,) = plan.experiments()
        template = None if experiment.scene is not None else template_text(experiment, name)
        done = ImportSummary(0, 0, 0, 0.0) if dry_run else _add(store, [experiment], 1, None)
    return ImportedTable(plan.understood, template, bool(done.new), bool(done.known))


def run_testbed(
    project: Project,
    plan: Path | None,
    *,
    seed: int = 1,
    limit: int | None = None,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> ImportSummary:
    """Perform a sampling plan on the simulated testbed, and store the measurements."""
    from fixel.formats.plan_file import load_plan
    from fixel.sampling import thesis_plan
    from fixel.testbed.simulated import SimulatedTestbed

    planned = (thesis_plan() if plan is None else load_plan(plan)).experiments[:limit]
    experiments = SimulatedTestbed(seed=seed).run(planned, threads=threads)
    with project.store() as store:
        return _add(store, experiments, len(planned), progress)


def list_experiments(project: Project, query: ExperimentQuery) -> ExperimentPage:
    """Return one page of a project's experiments."""
    with project.store() as store:
        found = store.experiments(query)
        if not found.total and not found.left_out:
            check_known_names(store, query)
        return found


def overview(project: Project) -> tuple[dict[str, int], dict[str, int]]:
    """Return the number of experiments of each dataset, and of those with each flag."""
    with project.store() as store:
        return store.datasets(), store.flags()


def typed() -> str:
    """Return the running command line, as it could be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def _add(
    store: Store, experiments: Iterable[Experiment], total: int, progress: ProgressCallback | None
) -> ImportSummary:
    """Store experiments, with the command as typed in their provenance."""
    begun = time.monotonic()
    command = typed()
    new = known = faulty = 0
    for made in experiments:
        experiment = replace(made, provenance=replace(made.provenance, command=command))
        if store.add_experiment(experiment).new:
            new += 1
            faulty += any(flag.fault for flag in experiment.flags)
        else:
            known += 1
        if progress is not None:
            progress(new + known, total)
    return ImportSummary(new, known, faulty, time.monotonic() - begun)


def _options(options: Iterable[str]) -> dict[str, object]:
    return dict(map(_pair, options))


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise InvalidInput("option", found=repr(text), expected="NAME=VALUE")
    return name, value
