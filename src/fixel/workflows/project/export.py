"""Export a project's experiments as a bundle, Parquet tables, or a LeRobot dataset."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.bundle import export_bundle, import_bundle, record_counts
from fixel.database.bundle_file import opened_bundle
from fixel.database.project import Project, stored_experiments
from fixel.datasets import IMPORTERS
from fixel.datasets.experiments import Experiments, different
from fixel.datasets.table import CsvTable
from fixel.drawing.chart import require_file
from fixel.errors import LIST_EXPERIMENTS, InvalidInput, NotStored, check_name, require
from fixel.formats.frames_file import folder_whole, refuse_folder, write_frames
from fixel.formats.lerobot import write_lerobot
from fixel.model import Experiment
from fixel.model.fields import path_of
from fixel.model.selection import ExperimentQuery, ExperimentRow
from fixel.progress import ProgressOption, Reporter, show_progress
from fixel.typing import ProgressCallback

FORMATS: Final = ("bundle", "parquet", "lerobot")
RATES: Final = (1, 1000)  # [Hz]


class ExportAnswer(NamedTuple):
    """Result of an export."""

    target: Path
    format: str  # ``bundle``, ``parquet`` or ``lerobot``
    # Number of ``experiments``, of them ``flagged`` and ``simulated``, and of other records.
    counts: dict[str, int]
    # Number of records that were not exported, by reason.
    left_out: dict[str, int]
    bytes: int
    seconds: float

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return self._asdict() | {"target": str(self.target), "seconds": round(self.seconds, 3)}


def import_zip(
    project: Project, path: Path, progress: ProgressCallback | None = None, *, dry_run: bool = False
) -> dict[str, int]:
    """Add the records of a bundle to a project; return how many of each kind were new.

    With `dry_run`, return how many there are, and add nothing.
    """
    if dry_run:
        with opened_bundle(path, project.folder) as bundle:
            return record_counts(bundle)
    with project.store() as store:
        return import_bundle(path, store, progress=progress)


def export(
    what: Project | Experiment | Iterable[Experiment],
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    dataset: str | None = None,
    fps: int | None = None,
    progress: ProgressOption = None,
) -> ExportAnswer:
    """Write experiments to files for other programs, those with faults in their data too.

    Parameters
    ----------
    what : Project or experiments
        A project with all that was computed from its experiments, or some experiments.
    path : path
        A ``.zip``, else a new or empty folder.
    format : str, optional
        ``bundle``: a ``.zip`` that another project imports; ``parquet``: two tables, experiments
        and frames; ``lerobot``: a LeRobot dataset, version 3.0. By default a bundle for a ``.zip``,
        else tables.
    dataset : str, optional
        Dataset whose experiments are exported; by default all.
    fps : int, optional
        Frame rate of a LeRobot dataset [Hz]; by default the median rate of the experiments.
    progress : bool or callable, optional

    Returns
    -------
    ExportAnswer
        Number of records, and those that were left out.

    Raises
    ------
    InvalidInput
        The target cannot be written.
    MissingExtra
        Another format than a bundle, and pyarrow is not installed.
    NotStored
        There are no experiments.
    StoreRefused
        The project cannot be opened or read.

    Examples
    --------
    >>> import fixel, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fixel.export(fixel.datasets.example()[:3], f"{folder}/tables", progress=False)
    >>> done.counts["frames"]
    183
    """
    target = path_of(path, "path")
    if format is None:
        format = "bundle" if target.suffix.lower() == ".zip" else "parquet"
    _check_arguments(target, format, fps)
    started = time.perf_counter()
    left_out: dict[str, int] = {}
    source = what if isinstance(what, Project) else different(what)
    if isinstance(source, Experiments) and dataset is not None:
        source = source.where(f'"dataset:{dataset}"')
    if format == "bundle":
        counts, left_out = _bundled(source, target, dataset, progress)
    else:
        with ExitStack() as opened:
            if isinstance(source, Project):
                name, store = source.settings.name, opened.enter_context(source.store())
                chosen = stored_experiments(store, _query(dataset))
            else:
                chosen, name = source, source.entries[0].row.dataset if len(source) else ""
            _refuse_none(len(chosen), dataset)
            counts = _written(chosen, target, format, fps, dataset or name, progress)
    return ExportAnswer(
        target=target,
        format=format,
        counts=counts,
        left_out={what: n for what, n in left_out.items() if n},
        bytes=_size(target),
        seconds=time.perf_counter() - started,
    )


def _query(dataset: str | None) -> ExperimentQuery:
    return ExperimentQuery(dataset=dataset, include_faulty=True)


def _bundled(
    source: Project | Experiments, target: Path, dataset: str | None, progress: ProgressOption
) -> tuple[dict[str, int], dict[str, int]]:
    """Write a bundle; return the number of records, and of those left out."""
    if isinstance(source, Experiments):
        with TemporaryDirectory(prefix="fixel-export-") as folder:
            project = Project.create(folder)
            project.add(source, progress=False)
            return _bundled(project, target, None, progress)
    query = replace(_query(dataset), limit=0)
    with source.store() as store:
        n = store.experiments(query).total
        _refuse_none(n, dataset)
        with show_progress(progress, "exporting") as report:
            counts, left_out = export_bundle(store, target, dataset=dataset, progress=report)
        simulated = store.experiments(replace(query, marks=("simulated", "replaced"))).total
        return {"experiments": n} | counts | {"simulated": simulated}, left_out


def _refuse_none(n: int, dataset: str | None) -> None:
    if not n:
        what = "experiment" if dataset is None else f"experiment of dataset {dataset!r}"
        raise NotStored(what, hint=LIST_EXPERIMENTS)


def _written(
    experiments: Experiments,
    target: Path,
    format: str,
    fps: int | None,
    name: str,
    progress: ProgressOption,
) -> dict[str, int]:
    """Write experiments as tables or as a LeRobot dataset; return counts."""
    rows = [entry.row for entry in experiments.entries]
    with show_progress(progress, "exporting") as report, folder_whole(target) as unfinished:
        records = _reported(experiments, report)
        if format == "parquet":
            frames = write_frames(records, unfinished)
        else:
            rate = fps or median_rate(rows)
            importers = {k: x for k, x in IMPORTERS.items() if not isinstance(x, CsvTable)}
            rights = {k: (x.licence, x.citation) for k, x in importers.items()}
            frames = write_lerobot(records, unfinished, fps=rate, name=name, rights=rights)
    faulty = [any(flag.fault for flag in e.details.flags) for e in experiments.entries]
    simulated = sum(not row.is_real for row in rows)
    counts = {"experiments": len(rows), "frames": frames, "flagged": sum(faulty)}
    return counts | {"simulated": simulated}


def _reported(experiments: Experiments, report: Reporter) -> Iterator[Experiment]:
    for done, experiment in enumerate(experiments, start=1):
        yield experiment
        report(done, len(experiments))


def median_rate(summaries: list[ExperimentRow]) -> int:
    """Median frame rate of the experiments [Hz], rounded and limited."""
    rates = [(s.n_frame - 1) / s.duration_s for s in summaries if s.duration_s > 0.0]
    middle = round(float(np.median(rates))) if rates else RATES[0]
    return min(max(middle, RATES[0]), RATES[1])


def _check_arguments(target: Path, format: str, fps: int | None) -> None:
    """Reject invalid arguments before any work."""
    check_name("format", format, FORMATS)
    if fps is not None and (format != "lerobot" or not RATES[0] <= fps <= RATES[1]):
        raise InvalidInput(
            "fps", found=fps, expected=f"from {RATES[0]} to {RATES[1]} Hz in a LeRobot dataset"
        )
    if format == "bundle":
        require_file(target, (".zip",), "bundle")
    else:
        require("pyarrow", f"the format {format}", extra="parquet")
        refuse_folder(target)


def _size(target: Path) -> int:
    files = [target] if target.is_file() else [p for p in target.rglob("*") if p.is_file()]
    return sum(path.stat().st_size for path in files)
