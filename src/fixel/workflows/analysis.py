"""Analyses of a project, stored with their charts for reports and other tools.

An analysis is a folder in the project's `analyses`: `analysis.json`, the charts as PNG, PDF and
CSV, and long arrays in `arrays.npz`. Repeating the same request replaces the analysis.
"""

from __future__ import annotations

import datetime
import json
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Final, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, InstanceOf, PlainSerializer

from fixel.capability.capability import Capability
from fixel.database.project import ANALYSES, Project, analysis_name
from fixel.errors import FixelError, NotStored
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.io.atomic import each_readable, readable, usable, write_whole
from fixel.io.document import plain_numbers
from fixel.model import Experiment
from fixel.results import Result
from fixel.table import Column, Table, Value
from fixel.trust import repeatable
from fixel.typing import FloatArray

CONTENT: Final = "analysis.json"
ARRAYS: Final = "arrays.npz"
ENDINGS: Final = ("png", "pdf", "csv")
MAX_BANNER: Final = 80  # characters of a banner that fit across a chart one column wide


class _TableContent(BaseModel, extra="forbid", frozen=True):
    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]  # earlier versions stored the texts of the cells
    formats: tuple[Annotated[str, Field(pattern=r"^\+?(\.\d[efg])?$")], ...] = ()
    left: int = 1


def _table_of(value: Any) -> Any:
    """Convert the stored content of a table into a `Table`; return anything else unchanged."""
    if not isinstance(value, dict):
        return value
    own = _TableContent.model_validate(value)
    formats = own.formats or ("",) * len(own.head)
    columns = [Column(name, "", form) for name, form in zip(own.head, formats, strict=True)]
    return Table(columns, own.rows, title=own.title, left=own.left)


# Stored as a title, a head with units, values and their formats.
StoredTable = Annotated[
    Table, BeforeValidator(_table_of), InstanceOf(), PlainSerializer(Table.content)
]


class AnalysisFigure(BaseModel, extra="forbid", frozen=True):
    """Figure of an analysis."""

    # Name of its files, without ending; never a path, as a bundle may come from elsewhere.
    name: Annotated[str, Field(pattern=r"^[\w-]{1,80}$")]
    caption: str


class Analysis(BaseModel, extra="forbid", frozen=True):
    """Result of one analysis of a project."""

    kind: str
    title: str
    # The request as plain content, but for options of the effort; the same question has the same
    # folder.
    question: dict[str, Any]
    # The whole request of a capability, which makes its form and repeats it.
    request: dict[str, Any] = {}
    headline: tuple[str, ...]  # main results in sentences with units, the most important first
    # Warnings that a reader must know before relying on the results, in plain words.
    warnings: tuple[str, ...] = ()
    tables: tuple[StoredTable, ...] = ()
    pictures: tuple[AnalysisFigure, ...] = ()
    notes: tuple[str, ...] = ()  # further sentences, such as the effort
    methods: tuple[str, ...] = ()  # sentences for the methods section of a paper
    references: tuple[str, ...] = ()  # keys of the bibliography (`workflows/report`)
    # Results as plain values in SI units, for `--json`; None for missing or infinite ones.
    numbers: Annotated[dict[str, Any], BeforeValidator(plain_numbers)] = {}
    # Ids of the calibrations and experiments used.
    calibrations: tuple[int, ...] = ()
    experiments: tuple[int, ...] = ()
    command: Annotated[str, BeforeValidator(repeatable)] = ""  # command that repeats the analysis
    # Version of fixel; time of creation, as ISO 8601 in UTC.
    version: str = ""
    created: str = ""
    seed: int | None = None
    seconds: float = 0.0  # duration of the computation [s]

    def lines(self) -> list[str]:
        """Return the text for people: warnings, since they limit the rest, results, tables."""
        lines = [
            sentence if sentence.startswith("Unseen") else f"Warning: {sentence}"
            for sentence in self.warnings
        ]
        lines += self.headline
        for table in self.tables:
            lines += ["", *([table.title] if table.title else []), *table.lines()]
        return [*lines, *(["", *self.notes] if self.notes else [])]

    def texts(self) -> dict[str, Any]:
        """Return what `lines` has, as JSON can hold it."""
        own = self.model_dump(include={"headline", "warnings", "notes"})
        rows = [{"title": t.title, "head": t.head, "rows": t.rows} for t in self.tables]
        return {**own, "tables": rows}


def analysis_of(kind: str, result: Result, **more: Any) -> Analysis:
    """Return an analysis with the texts and tables that a result prints, and `more` fields."""
    said = result._summary()
    texts = {
        "title": said.heading,
        "question": {},
        "headline": (said.heading,),
        "warnings": tuple(f"Unseen: {text}" for text in said.unseen),
        "tables": tuple(said.tables),
        "notes": tuple(said.notes),
    }
    return Analysis(kind=kind, **(texts | more))


class DrawnTable(Protocol):
    """Table with its drawing; `fixel.drawing.chart.Chart` is one."""

    def save(self, *paths: str | Path, banner: str = "") -> None: ...
    def table(self) -> Table: ...


class Picture(NamedTuple):
    """Chart with the name, banner and caption of its files."""

    name: str  # name of the files, without ending
    chart: DrawnTable
    banner: str = ""  # text across the top, for experiments that no camera has seen
    caption: str = ""  # a sentence on what the chart shows


class AnalysisReport(NamedTuple):
    """Analysis with the figures and arrays stored with it, and files that were written already."""

    analysis: Analysis
    pictures: Iterable[Picture] = ()
    arrays: Mapping[str, Any] = {}
    files: Mapping[str, Path] = {}


class StoredAnalysis(NamedTuple):
    """Analysis with the folder in which it is stored."""

    folder: Path
    analysis: Analysis

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """Long arrays of the analysis, by name."""
        path = self.folder / ARRAYS
        if not path.is_file():
            return {}
        with readable(path, f"run it again: {self.analysis.command}"):
            return arrays_of(path.read_bytes())

    def picture(self, name: str, ending: str = "png") -> Path:
        """Return the path of a file of one of its charts."""
        return self.folder / f"{name}.{ending}"

    def copy_pictures(self, folder: Path) -> list[Path]:
        """Copy all files of its charts to another folder, which is created if missing."""
        sources = [self.picture(p.name, end) for p in self.analysis.pictures for end in ENDINGS]
        with new_folder(folder):
            return [Path(shutil.copyfile(source, folder / source.name)) for source in sources]


class StoredAnswer(NamedTuple):
    """Result of a capability with its report."""

    capability: Capability
    request: Any
    result: Any  # what the function returned; None if a job has computed it
    analysis: Analysis
    folder: Path | None  # folder of the stored analysis; None if it was not stored
    # Files that were written, by their option; those of a folder by their name.
    files: dict[str, Path]
    drawn: bool = False  # whether figures were requested
    failed: bool = False  # whether the run stopped early

    @property
    def again(self) -> list[str]:
        """Words of the command that repeats the request."""
        return self.capability.words(self.request)


def content_of(done: StoredAnswer) -> dict[str, Any]:
    """Return the content of `--json`: numbers, and what `JSON` of the report's module names."""
    analysis, paths = done.analysis, [str(path) for path in done.files.values()]
    known = {
        "seconds": analysis.seconds,
        "folder": None if done.folder is None else str(done.folder),
        "files": paths,
        "pictures": paths,
    }
    names = getattr(done.capability.present, "JSON", ())
    usual = {"files": {name: str(path) for name, path in done.files.items()}}
    return analysis.numbers | ({name: known[name] for name in names} or usual)


def store_analysis(
    project: Project,
    analysis: Analysis,
    pictures: Iterable[Picture] = (),
    arrays: Mapping[str, Any] | None = None,
) -> StoredAnalysis:
    """Write an analysis into its project; its main file comes last, so it is complete or absent.

    Its `pictures`, `version` and `created`, which is later than others in any case, are set here.
    """
    folder = project.folder / ANALYSES / analysis_name(analysis.kind, analysis.question)
    pictures = tuple(pictures)
    with new_folder(folder), TemporaryDirectory(dir=folder) as drawn:
        write_pictures(Path(drawn), pictures)
        (folder / CONTENT).unlink(missing_ok=True)  # until here, an earlier one stays complete
        for path in Path(drawn).iterdir():
            path.replace(folder / path.name)
        if arrays:
            write_whole(folder / ARRAYS, bytes_of(**{k: np.asarray(v) for k, v in arrays.items()}))
        times = [path.stat().st_mtime + 1e-6 for path in folder.parent.glob(f"*/{CONTENT}")]
        created = datetime.datetime.fromtimestamp(max([time.time(), *times]), datetime.UTC)
        shown = tuple(AnalysisFigure(name=p.name, caption=p.caption) for p in pictures)
        written = created.isoformat(timespec="microseconds")
        done = analysis.model_copy(
            update={"pictures": shown, "version": version("fixel"), "created": written}
        )
        write_whole(folder / CONTENT, json.dumps(done.model_dump(), indent=1, allow_nan=False))
        os.utime(folder / CONTENT, (created.timestamp(),) * 2)
    return StoredAnalysis(folder, done)


def load_analyses(project: Project, kind: str | None = None) -> list[StoredAnalysis]:
    """Load the analyses of a project, newest first; raise `StoreRefused` if one cannot be read."""
    found, unreadable = load_with_errors(project, kind)
    if unreadable:
        raise unreadable[0]
    return found


def load_with_errors(
    project: Project, kind: str | None = None
) -> tuple[list[StoredAnalysis], list[FixelError]]:
    """Load the analyses of a project, newest first, and the errors of unreadable ones."""
    paths = sorted((project.folder / ANALYSES).glob(f"*/{CONTENT}"))
    every, unreadable = each_readable(_kept, paths)
    found = [one for one in every if kind in (None, one.analysis.kind)]
    return sorted(found, key=lambda one: one.analysis.created, reverse=True), unreadable


def find_analysis(project: Project, name: str, kind: str = "") -> StoredAnalysis:
    """Load the analysis in a folder of this name; raise `NotStored` if none can be read.

    The name is compared with existing ones and never used as a path.
    """
    paths = (project.folder / ANALYSES).glob(f"*/{CONTENT}")
    found, _ = each_readable(_kept, (path for path in paths if path.parent.name == name))
    for one in found:
        if kind in ("", one.analysis.kind):
            return one
    raise NotStored(f"{kind or 'analysis'} {name!r}", hint="the page Results lists all")


def _kept(path: Path) -> StoredAnalysis:
    with readable(path, f"delete the folder {path.parent} and run the analysis again"):
        return StoredAnalysis(path.parent, Analysis.model_validate_json(path.read_bytes()))


# --- files of charts ----------------------------------------------------------------------------


def banner_of(banners: Sequence[str]) -> str:
    """Combine the banners of several experiments into one; those of real ones are empty."""
    some = [banner for banner in banners if banner]
    if len(some) in (0, len(banners)):
        joined = " and ".join(dict.fromkeys(some))
        return joined if len(joined) <= MAX_BANNER else f"SIMULATED: all {len(some)} experiments"
    return f"{len(some)} of {len(banners)} experiments SIMULATED"


def banner_over(experiments: Iterable[Experiment]) -> str:
    """Return the banner over charts of experiments; empty if all are real."""
    return banner_of(
        ["" if one.real else f"SIMULATED by {one.simulated_by}" for one in experiments]
    )


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Create a folder for the files of the block; remove it if the block writes none."""
    missing = [own for own in (folder, *folder.parents) if not own.exists()]
    with usable(folder, "a folder to write to"):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # it is not empty
            for own in missing:
                own.rmdir()


def write_picture(folder: Path, picture: Picture) -> list[Path]:
    """Write the files of a picture, replacing those of the same names; return their paths."""
    paths = [folder / f"{picture.name}.{ending}" for ending in ENDINGS]
    picture.chart.save(*paths[:2], banner=picture.banner)
    write_whole(paths[2], picture.chart.table().csv())
    return paths


def write_pictures(folder: Path, pictures: Iterable[Picture]) -> list[Path]:
    """Write the files of pictures into a folder, which is created if missing."""
    with new_folder(folder):
        return [path for picture in pictures for path in write_picture(folder, picture)]
