"""Analyses of experiments of a project, which are stored in it: what `Project` offers in Python.

They run what the commands run, with the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from fixel.database.project import Project
from fixel.domain.domain import DomainMap
from fixel.errors import InvalidInput
from fixel.model.selection import parse_filter
from fixel.progress import ProgressOption
from fixel.uncertainty.posterior import Posterior
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.capabilities import call
from fixel.workflows.domain.request import DomainRequest
from fixel.workflows.domain.run import map_stored

Fit = Calibration | int | None


def map_domain(
    project: Project,
    filter: str = "",
    fit: Fit = None,
    *,
    threshold: float | None = None,
    relative: float | None = None,
    axes: Sequence[str] = (),
    facets: Sequence[str] = (),
    nominal: Mapping[str, str | float] | None = None,
    cells: Mapping[str, float] | None = None,
    progress: ProgressOption = None,
    **options: Any,
) -> DomainMap:
    """Map the experiments of a project that match a filter as `fixel domain` does, and store it.

    Parameters
    ----------
    project : Project
    filter : str
    fit : Calibration or int, optional
        Calibration, or the id of a stored one; by default the newest for several experiments.
    threshold, relative, axes, facets, nominal, cells, progress
        As for `fixel.map_domain`.
    **options
        `level`, `confidence`, `leave_out`, `folds` and `seed`, as for `fixel.map_domain`.
    """
    if threshold is not None and relative is not None:
        raise InvalidInput("relative", found="threshold too", expected="one of them")
    request = DomainRequest(
        query=parse_filter(filter),
        calibration=_id_of(project, fit),
        axes=tuple(axes),
        by=tuple(facets),
        nominal=nominal or {},
        steps=cells or {},
        threshold=relative if threshold is None else 1e3 * threshold,
        measure="absolute" if relative is None else "relative",
        **options,
    )
    return map_stored(project, request, progress=progress).domain


def posterior(
    project: Project,
    filter: str = "",
    fit: Fit = None,
    *,
    samples: int = 1000,
    model_error: bool = True,
    seed: int = 0,
    progress: ProgressOption = None,
) -> Posterior:
    """Sample a posterior as `fixel uncertainty` does, and store it with the predictions.

    Parameters
    ----------
    project : Project
    filter : str
        Filter of the experiments; by default those of the calibration.
    fit : Calibration or int, optional
        Calibration, or the id of a stored one, whose parameters and motion model are used.
    samples, model_error, seed, progress
        As for `fixel.posterior`.
    """
    keys = project.experiments(filter).keys if filter else ()
    options = {"samples": samples, "model_error": model_error, "seed": seed}
    fit = _id_of(project, fit)
    found = call(
        project, "uncertainty", experiments=keys, calibration=fit, **options, progress=progress
    )
    return cast(Posterior, found.posterior)


def _id_of(project: Project, fit: Fit) -> int | None:
    """Return the id of a calibration, which is stored if it is not yet."""
    if not isinstance(fit, Calibration):
        return fit
    stored = fit if fit.run.ids else project.add(fit)
    return int(stored.run.ids[stored.number])
