"""Export a project's experiments as a bundle, Parquet tables, or a LeRobot dataset."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.database.bundle import export_bundle, import_bundle, record_counts
from fixel.database.bundle_file import opened_bundle
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.datasets import IMPORTERS
from fixel.datasets.table import CsvTable
from fixel.drawing.chart import refuse_ending
from fixel.errors import InvalidInput, NotStored, unknown_name
from fixel.formats.frames_file import folder_whole, refuse_folder, write_frames
from fixel.formats.lerobot import write_lerobot
from fixel.io.atomic import refuse_unwritable
from fixel.model import Experiment
from fixel.model.selection import ExperimentQuery, ExperimentRow
from fixel.typing import ProgressCallback

FORMATS: Final = ("bundle", "parquet", "lerobot")
RATES: Final = (1, 1000)  # [Hz]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExportAnswer:
    """ExperimentRow of an export.

    Attributes
    ----------
    target : Path
    format : str
        ``bundle``, ``parquet`` or ``lerobot``.
    counts : dict of str to int
        Number of ``experiments``, of them ``flagged`` and ``simulated``, and of other records.
    left_out : dict of str to int
        Number of records that were not exported, by reason.
    bytes : int
    seconds : float
    """

    target: Path
    format: str
    counts: dict[str, int]
    left_out: dict[str, int] = field(default_factory=dict)
    bytes: int
    seconds: float

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "target": str(self.target),
            "format": self.format,
            "counts": self.counts,
            "left_out": self.left_out,
            "bytes": self.bytes,
            "seconds": round(self.seconds, 3),
        }


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
    folder: Path,
    target: Path,
    *,
    format: str = "bundle",
    dataset: str | None = None,
    fps: int | None = None,
    progress: ProgressCallback | None = None,
) -> ExportAnswer:
    """Export a project's experiments.

    Parameters
    ----------
    folder : Path
        Folder of the project.
    target : Path
        A ``.zip`` for a bundle, else a new or empty folder.
    format : str
        One of `FORMATS`.
    dataset : str, optional
        Dataset whose experiments are exported; by default all.
    fps : int, optional
        Frame rate of a LeRobot dataset; by default the median rate of the experiments.
    progress : callable, optional
        Called with the number of exported experiments and their total.

    Raises
    ------
    InvalidInput
        The target cannot be written.
    NotStored
        There are no experiments.
    StoreRefused
        The project cannot be opened or read.
    """
    _check_arguments(target, format, fps)
    started = time.perf_counter()
    project = Project.open(folder)
    with project.store() as store:
        everything = store.experiments(ExperimentQuery(dataset=dataset, include_faulty=True)).rows
        if not everything:
            what = "experiments" if dataset is None else f"experiments of dataset {dataset!r}"
            raise NotStored(what, hint="see what there is with: fixel list")
        counts, left_out = {"experiments": len(everything)}, {}
        if format == "bundle":
            written = export_bundle(store, target, dataset=dataset, progress=progress)
            counts, left_out = written.counts, written.left_out
        else:
            name = dataset or project.settings.name
            counts["frames"] = _tables(store, everything, target, format, fps, name, progress)
            counts["flagged"] = store.experiments(
                ExperimentQuery(dataset=dataset, limit=0)
            ).left_out
        marks = ("simulated", "replaced") if format == "bundle" else ("simulated",)
        simulated = ExperimentQuery(dataset=dataset, marks=marks, include_faulty=True, limit=0)
        counts["simulated"] = store.experiments(simulated).total
    return ExportAnswer(
        target=target,
        format=format,
        counts=counts,
        left_out={what: n for what, n in left_out.items() if n},
        bytes=_size(target),
        seconds=time.perf_counter() - started,
    )


def _tables(
    store: Store,
    summaries: list[ExperimentRow],
    target: Path,
    format: str,
    fps: int | None,
    name: str,
    progress: ProgressCallback | None,
) -> int:
    records = _read(store, summaries, progress)
    with folder_whole(target) as unfinished:
        if format == "parquet":
            return write_frames(records, unfinished)
        rate = fps or median_rate(summaries)
        return write_lerobot(records, unfinished, fps=rate, name=name, rights=_rights())


def _read(
    store: Store, summaries: list[ExperimentRow], progress: ProgressCallback | None
) -> Iterator[Experiment]:
    for done, summary in enumerate(summaries, start=1):
        yield store.experiment(summary.id)
        if progress is not None:
            progress(done, len(summaries))


def median_rate(summaries: list[ExperimentRow]) -> int:
    """Median frame rate of the experiments [Hz], rounded and limited."""
    rates = [(s.n_frame - 1) / s.duration_s for s in summaries if s.duration_s > 0.0]
    middle = round(float(np.median(rates))) if rates else RATES[0]
    return min(max(middle, RATES[0]), RATES[1])


def _rights() -> dict[str, tuple[str, str]]:
    """Licence and citation of each known dataset, by the name its experiments have."""
    return {
        name: (importer.licence, importer.citation)
        for name, importer in IMPORTERS.items()
        if not isinstance(importer, CsvTable)  # its data is the user's own
    }


def _check_arguments(target: Path, format: str, fps: int | None) -> None:
    """Reject invalid arguments before any work."""
    if format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    if fps is not None and (format != "lerobot" or not RATES[0] <= fps <= RATES[1]):
        raise InvalidInput(
            "fps", found=fps, expected=f"{RATES[0]} to {RATES[1]} Hz, of a LeRobot dataset"
        )
    if format == "bundle":
        refuse_ending(target, (".zip",), "bundle")
        refuse_unwritable(target)
    else:
        refuse_folder(target)


def _size(target: Path) -> int:
    files = [target] if target.is_file() else [p for p in target.rglob("*") if p.is_file()]
    return sum(path.stat().st_size for path in files)
