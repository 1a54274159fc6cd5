"""What an analysis of a project says: kept with its pictures, for reports and for other tools.

An analysis is a folder in the project's `analyses`: `analysis.json`, the pictures as PNG, PDF and
CSV, and long numbers in `arrays.npz`. The same question asked again takes its place.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from fixel.database.project import Project
from fixel.errors import FixelError
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import each_readable, readable
from fixel.typing import FloatArray
from fixel.workflows.figures import ENDINGS, Picture, make_folder, write_picture

Kind = Literal["tracking", "growth", "domain", "sensitivity", "uncertainty"]

ANALYSES: Final = "analyses"
CONTENT: Final = "analysis.json"
ARRAYS: Final = "arrays.npz"
NOTHING: Final = 1e-7  # [mm or deg]


class _StoredFigure(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TextTable(_StoredFigure):
    """A table as people read it: units in the head."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def rounded(value: float, digits: int = 3) -> str:
    """A length [mm], an angle [deg] or a share as people read it; what is below any measurement,
    and the rounding of simulations, is none."""
    return f"{value if abs(value) >= NOTHING else 0.0:.{digits}g}"


class AnalysisFigure(_StoredFigure):
    """A picture of an analysis."""

    name: str  # of its files, without ending
    caption: str


class Analysis(_StoredFigure):
    """The answer to one question about a project.

    Attributes
    ----------
    kind : str
    title : str
    question : dict
        Everything that was asked, as plain content; the same question has the same folder.
    headline : tuple of str
        What was found, in sentences with units; the most important first.
    warnings : tuple of str
        What a reader must know before believing it, in plain words.
    tables : tuple of TextTable
    pictures : tuple of AnalysisFigure
    methods : tuple of str
        Sentences for the methods paragraph of a paper.
    references : tuple of str
        Keys of the bibliography (`workflows/report`).
    numbers : dict
        The same as plain values in SI units, for `--json`; None where there is none.
    calibrations, experiments : tuple of int
        Ids of what it used.
    command : str
        That makes it again.
    version, created : str
        Of fixel; when, as ISO 8601 in UTC.
    seed : int, optional
    seconds : float
        It took [s].
    """

    kind: Kind
    title: str
    question: dict[str, Any]
    headline: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    tables: tuple[TextTable, ...] = ()
    pictures: tuple[AnalysisFigure, ...] = ()
    methods: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    numbers: dict[str, Any] = {}
    calibrations: tuple[int, ...] = ()
    experiments: tuple[int, ...] = ()
    command: str = ""
    version: str = ""
    created: str = ""
    seed: int | None = None
    seconds: float = 0.0


class StoredAnalysis(NamedTuple):
    """An analysis in its folder."""

    folder: Path
    analysis: Analysis

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """Its long numbers."""
        path = self.folder / ARRAYS
        if not path.is_file():
            return {}
        with readable(path, f"make it again with: {self.analysis.command}"):
            return arrays_of(path.read_bytes())

    def picture(self, name: str, ending: str = "png") -> Path:
        """A file of one of its pictures."""
        return self.folder / f"{name}.{ending}"

    def copy_pictures(self, folder: Path) -> list[Path]:
        """All files of its pictures once more, in another folder; made where there is none."""
        make_folder(folder)
        sources = [self.picture(p.name, end) for p in self.analysis.pictures for end in ENDINGS]
        return [Path(shutil.copyfile(source, folder / source.name)) for source in sources]


def keep(
    project: Project,
    analysis: Analysis,
    pictures: Sequence[Picture] = (),
    arrays: Mapping[str, Any] | None = None,
) -> StoredAnalysis:
    """Write an analysis into its project; its own file comes last, so it is there whole or not.

    Parameters
    ----------
    project : Project
    analysis : Analysis
        `pictures`, `version` and `created` are filled in here.
    pictures : sequence of Picture
        With captions.
    arrays : mapping of name to array, optional
    """
    folder = project.folder / ANALYSES / _name_of(analysis)
    make_folder(folder)
    (folder / CONTENT).unlink(missing_ok=True)
    for picture in pictures:
        write_picture(folder, picture)
    if arrays:
        with written_whole(folder / ARRAYS) as path:
            path.write_bytes(bytes_of(**{k: np.asarray(v) for k, v in arrays.items()}))
    done = analysis.model_copy(
        update={
            "pictures": tuple(AnalysisFigure(name=p.name, caption=p.caption) for p in pictures),
            "version": version("fixel"),
            "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        }
    )
    with written_whole(folder / CONTENT) as path:
        path.write_text(json.dumps(done.model_dump(), indent=1, allow_nan=False), encoding="utf-8")
    return StoredAnalysis(folder, done)


def kept(project: Project, kind: Kind | None = None) -> list[StoredAnalysis]:
    """Analyses of a project, the newest first.

    Raises
    ------
    StoreRefused
        One of them cannot be read.
    """
    found, unreadable = kept_and_not(project, kind)
    if unreadable:
        raise unreadable[0]
    return found


def kept_and_not(
    project: Project, kind: Kind | None = None
) -> tuple[list[StoredAnalysis], list[FixelError]]:
    """Analyses of a project, the newest first, and why others cannot be read."""
    paths = sorted((project.folder / ANALYSES).glob(f"*/{CONTENT}"))
    every, unreadable = each_readable(_kept, paths)
    found = [one for one in every if kind in (None, one.analysis.kind)]
    return sorted(found, key=lambda one: one.analysis.created, reverse=True), unreadable


def _kept(path: Path) -> StoredAnalysis:
    with readable(path, f"delete the folder {path.parent}, and make the analysis again"):
        return StoredAnalysis(path.parent, Analysis.model_validate_json(path.read_bytes()))


def _name_of(analysis: Analysis) -> str:
    asked = json.dumps([analysis.kind, analysis.question], sort_keys=True, allow_nan=False)
    return f"{analysis.kind}-{hashlib.sha256(asked.encode()).hexdigest()[:10]}"
