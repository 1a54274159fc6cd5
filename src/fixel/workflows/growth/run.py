"""Grow the domain of a project from stored calibrations, as the thesis did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal

from fixel.capability.capability import Capability
from fixel.capability.options import Dataset, Door

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.progress import ProgressOption
    from fixel.workflows.growth.explore import Exploration


def _check_sizes(texts: tuple[str, ...]) -> None:
    from fixel.workflows.growth.explore import sizes_in

    sizes_in(texts)


def _check_limit(text: str) -> None:
    from fixel.workflows.growth.explore import threshold_in

    threshold_in(text, "mm^2")


def grow_stored(
    project: Project,
    *,
    shape: Annotated[str, Door(metavar="NAME")] = "",
    dataset: Dataset = "",
    index: Literal["corrected", "printed"] = "corrected",
    sizes: Annotated[tuple[str, ...], Door(metavar="[AXIS=]N[,N]", check=_check_sizes)] = (),
    limit: Annotated[str, Door(metavar="E", also=("--threshold",), check=_check_limit)] = "",
    motion: Annotated[str, Door(metavar="MODEL")] = "",
    error: Annotated[str, Door(metavar="NAME")] = "",
    progress: ProgressOption = None,
) -> Exploration:
    """Grow the domain from stored calibrations, as the thesis did.

    Step i adds the experiments x+i, y+i, y-i and theta+i to the nominal one; one set of parameters
    simulates them all, and the largest error counts.

    Parameters
    ----------
    shape : str
        Select experiments with this shape only.
    index : str
        Order of the rows: corrected, or printed as in the code of the thesis, with theta one row
        too early.
    sizes : sequence of str
        Numbers of samples of the intervals, 2 to 5, for one axis or for all; may be repeated. By
        default x=2,4 y=3,5 theta=2,4.
    limit : str
        Largest error in the domain, as a number in its unit or as a distance: 5 or 2.2mm; by
        default 5 mm² as in the thesis.
    motion : str
        Use only calibrations with this motion model.
    error : str
        Use only calibrations with this error.

    Raises
    ------
    InvalidInput
        There are no experiments of a plan, or some have no calibration of the same method.
    """
    from fixel.progress import show_progress
    from fixel.workflows.growth.explore import explore

    asked = GROWTH.asked(locals())
    with project.store() as store, show_progress(progress, "reading experiments") as report:
        command = GROWTH.command(asked, project.folder)
        return explore(store, asked, project.folder, command, report)


GROWTH: Final = Capability(name="growth", group="domain", function=grow_stored)
