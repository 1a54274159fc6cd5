"""Explore the domain of a project and store the result as an analysis."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

from fixel.database.project import Project
from fixel.domain.along_axis import SIZES
from fixel.domain.growth import Index
from fixel.drawing.growth import error_matrix
from fixel.workflows.analysis import Analysis, StoredAnalysis, store_analysis
from fixel.workflows.growth import report
from fixel.workflows.growth.explore import Exploration, explore

THESIS: Final = "rpi2011"  # key of the bibliography


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GrowthRequest:
    """Options of an exploration; the fields are those of `explore`."""

    shape: str | None = None
    dataset: str | None = None
    index: Index = "corrected"
    sizes: Mapping[str, Sequence[int]] | None = None
    threshold: str | None = None
    motion: str | None = None
    error: str | None = None


def run_growth(
    project: Project,
    asked: GrowthRequest | None = None,
    *,
    command: str = "",
    where: str = "",
    threads: int | None = None,
    notify: Callable[[str], None] | None = None,
) -> tuple[Exploration, StoredAnalysis]:
    """Explore the domain of applicability and store the result.

    Parameters
    ----------
    project : Project
        Project with experiments of a plan and single calibrations of each.
    asked : GrowthRequest, optional
    command : str
        Command as typed.
    where : str
        ` --project FOLDER`, for commands in hints.
    threads : int, optional
        Threads of the simulations; by default all cores.
    notify : callable, optional
        Called with a sentence before long operations.
    """
    asked, begun = asked or GrowthRequest(), time.perf_counter()
    sizes = {**SIZES, **(asked.sizes or {})}
    with project.store() as store:
        found = explore(
            store,
            shape=asked.shape,
            dataset=asked.dataset,
            index=asked.index,
            sizes=sizes,
            threshold=asked.threshold,
            motion=asked.motion,
            error=asked.error,
            command=command,
            project=where,
            threads=threads,
            notify=notify,
        )
    analysis = Analysis(
        kind="growth",
        title="Domain of applicability, grown as in the thesis",
        question={
            "shape": asked.shape,
            "dataset": asked.dataset,
            "index": asked.index,
            "sizes": {axis: list(own) for axis, own in sizes.items()},
            "threshold": found.threshold,
            "motion": asked.motion,
            "error": asked.error,
        },
        headline=report.headline(found),
        warnings=tuple(_warnings(found)),
        tables=(report.matrix_table(found), report.edges_table(found)),
        methods=report.methods(found),
        references=(THESIS,),
        numbers=report.numbers(found),
        calibrations=tuple(sorted({one.id for one in found.stored.best})),
        experiments=tuple(found.samples.ids),
        command=command,
        seconds=time.perf_counter() - begun,
    )
    shown = list(report.pictures(found))
    if notify is not None:
        notify(f"Drawing {len(shown)} charts.")
    kept = store_analysis(project, analysis, shown, {"largest_error": error_matrix(found.growth)})
    return found, kept


def _warnings(found: Exploration) -> list[str]:
    banner = found.samples.banner
    simulated = [f"{banner}: these experiments were simulated, not recorded."] if banner else []
    return [*simulated, *found.warnings]
