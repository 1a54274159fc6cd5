"""Import tables, run the simulated testbed, list experiments, and download datasets."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from fixel.database.project import AddSummary, Project, add_experiments, check_known_names
from fixel.database.query import ExperimentPage
from fixel.database.store import Store
from fixel.datasets import IMPORTERS, ImportPlan, plan_import
from fixel.datasets.bag import DATASET as BAG
from fixel.datasets.own_scene import template_text
from fixel.datasets.table import DATASET as TABLE
from fixel.errors import InvalidInput, StoreRefused, require
from fixel.io.atomic import one_line
from fixel.model.selection import ExperimentQuery
from fixel.typing import ProgressCallback


def write_template(plan: ImportPlan, folder: Path) -> Path | None:
    """Write the template of a scene for a table or bag that was imported without one.

    It is written next to the table, or into `folder` if that is not possible; an existing file of
    that name is not changed. Nothing is written for public datasets.
    """
    if plan.importer not in (TABLE, BAG):
        return None
    experiment = next(plan.experiments())
    if experiment.scene is not None:
        return None
    stem = experiment.name if experiment.dataset in (TABLE, BAG) else experiment.dataset
    name = f"{stem.replace('/', '-')}.scene.yaml"
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


def import_texts(
    store: Store,
    name: str,
    table: str,
    scene: str | None,
    *,
    options: Mapping[str, str] | None = None,
    dry_run: bool = False,
) -> tuple[ImportPlan, str | None, AddSummary]:
    """Store the experiments in the text of a CSV table, or with `dry_run` only read them.

    Return how they were read, the template of a scene if they have none, and how many experiments
    were added. They get their names from `name`, that of the table's file. `scene` is the YAML of a
    scene file; `options` are those of the importer of tables.
    """
    with TemporaryDirectory(prefix="fixel-import-") as folder:
        source, file = Path(folder) / name, Path(folder) / "scene"
        # A browser has replaced bytes that are not UTF-8; they are refused as those of a file.
        source.write_bytes(table.encode().replace("\ufffd".encode(), b"\xff"))
        file.write_text(scene or "", encoding="utf-8", newline="")
        known = None if scene is None else file
        try:
            plan = plan_import(source, TABLE, options=options, scene=known)
        except InvalidInput as problem:  # the folder is not the user's
            raise problem.at(problem.where.removeprefix(f"{folder}{os.sep}")) from None
        experiments = list(plan.experiments())
        template = None if experiments[0].scene else template_text(experiments[0], name)
        done = AddSummary(0, 0, 0, 0.0) if dry_run else add_experiments(store, experiments)
    return plan, template, done


def run_testbed(
    project: Project,
    plan: Path | None,
    *,
    seed: int = 1,
    uneven_table: float = 0.0,
    limit: int | None = None,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> AddSummary:
    """Perform a sampling plan on the simulated testbed, and store the measurements."""
    from fixel.formats.plan_file import load_plan
    from fixel.sampling import thesis_plan
    from fixel.testbed.simulated import SimulatedTestbed

    planned = (thesis_plan() if plan is None else load_plan(plan)).experiments[:limit]
    testbed = SimulatedTestbed(seed=seed, uneven_table=uneven_table)
    experiments = testbed.run(planned, threads=threads)
    with project.store() as store:
        return add_experiments(store, experiments, progress, len(planned))


def list_experiments(project: Project, query: ExperimentQuery) -> ExperimentPage:
    """Return one page of a project's experiments."""
    with project.store() as store:
        found = store.experiments(query)
        if not found.total and not found.left_out:
            check_known_names(store, query)
        return found


def datasets() -> list[dict[str, str]]:
    """Return name, title, licence and citation of every dataset that can be imported."""
    shown = ("name", "title", "licence", "citation")
    public = [importer for importer in IMPORTERS.values() if importer.citation]
    return [{name: getattr(importer, name) for name in shown} for importer in public]


def fetch(url: str, folder: Path, sha256: str | None = None) -> tuple[Path, str]:
    """Download a file into a folder: completely, with the required checksum, or not at all.

    Return its path and checksum. Without the checksum `sha256`, any content is accepted.
    """
    require("pooch", "a download", extra="download")
    import pooch

    name = _name(url)
    if sha256 is not None and not re.fullmatch(r"[0-9a-fA-F]{64}", sha256):
        raise InvalidInput("sha256", found=sha256, expected="64 hexadecimal digits")
    pooch.get_logger().setLevel("ERROR")  # fixel gives the warnings itself
    wanted = None if sha256 is None else f"sha256:{sha256.lower()}"
    try:
        path = Path(pooch.retrieve(url, wanted, fname=name, path=folder))
    except ValueError as problem:
        raise StoreRefused(
            f"{url} is not the requested file: {one_line(problem, 300)}",
            hint="check the URL and the checksum; nothing was stored",
        ) from None
    except Exception as problem:  # whatever the network library under pooch raises
        if (answer := getattr(problem, "response", None)) is not None:
            answer.close()  # pooch leaves the connection of a failed request open
        raise StoreRefused(
            f"{url} could not be downloaded: {one_line(problem, 300)}",
            hint="check the URL and the network",
        ) from None
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return path, digest


def _name(url: str) -> str:
    """File name at the end of an address."""
    parts = urlsplit(url)
    name = Path(parts.path).name
    if parts.scheme not in ("http", "https", "ftp") or not name or name.startswith("."):
        raise InvalidInput("URL", found=url, expected="http(s)://HOST/.../FILE")
    return name
