"""Run a capability on a project: compute, report and store, for every door."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fixel.capability.capability import Capability
from fixel.workflows.filtering.run import FILTER

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fixel.progress import ProgressOption
    from fixel.workflows.analysis import Analysis

CAPABILITIES: Final[Mapping[str, Capability]] = {one.name: one for one in (FILTER,)}


class StoredAnswer(NamedTuple):
    """Result of a capability with its report.

    Attributes
    ----------
    result : object
        What the function returned.
    analysis : Analysis
    folder : Path or None
        Folder of the stored analysis; None if it was not stored.
    files : list of Path
        Files of figures that were requested.
    """

    result: Any
    analysis: Analysis
    folder: Path | None
    files: list[Path]


def run(
    capability: Capability,
    request: BaseModel,
    folder: Path,
    *,
    plot: Path | None = None,
    progress: ProgressOption = None,
) -> StoredAnswer:
    """Run a request on the project in a folder, and store its analysis with the whole request.

    Parameters
    ----------
    capability : Capability
    request : BaseModel
        Request of this capability.
    folder : Path
    plot : Path, optional
        Folder or file for figures.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.
    """
    from fixel.database.project import Project
    from fixel.workflows.analysis import store_analysis
    from fixel.workflows.figures import write_picture

    project = Project(folder)
    result = capability.function(project, **capability.arguments(request), progress=progress)
    present = capability.presentation()
    report = present.report_of(result)
    analysis = report.analysis.model_copy(
        update={
            "kind": capability.name,
            "question": capability.question(request) | report.analysis.question,
            "command": capability.command(request, folder),
            "seed": getattr(request, "seed", None),
        }
    )
    kept = None
    if getattr(request, "save", True):
        kept = store_analysis(project, analysis, report.pictures, report.arrays)
        analysis = kept.analysis
    files: list[Path] = []
    if plot is not None and capability.draws:
        present.draw(result, plot)
        files = [plot]
    elif plot is not None and kept is not None:
        files = kept.copy_pictures(plot)
    elif plot is not None:
        files = [path for picture in report.pictures for path in write_picture(plot, picture)]
    return StoredAnswer(result, analysis, None if kept is None else kept.folder, files)
