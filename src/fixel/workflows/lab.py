"""Analyses of experiments of a project, which are stored in it: what `Project` offers in Python.

They run what the commands run, with the same numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

from fixel.database.project import Project
from fixel.domain.domain import DomainMap
from fixel.progress import ProgressOption
from fixel.uncertainty.posterior import Posterior
from fixel.workflows.analysis import StoredAnswer
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.capabilities import call, report_result
from fixel.workflows.domain.evidence import store_evidence
from fixel.workflows.domain.mapping import DomainAnswer, claimed
from fixel.workflows.domain.run import DOMAIN

Fit = Calibration | int | None


def map_domain(
    project: Project,
    filter: str = "",
    fit: Fit = None,
    *,
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
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.
    **options
        Options of `fixel.map_domain`.
    """
    options |= {"where": (filter,) if filter else (), "calibration": _id_of(project, fit)}
    return cast(DomainMap, call(project, "domain", progress=progress, **options).domain)


def store_map(project: Project, domain: DomainMap) -> StoredAnswer:
    """Store a map of experiments that a project has; raise `NotStored` if it lacks one of them."""
    asked = claimed(DOMAIN.request(domain.question), domain.claimed)
    gathered = store_evidence(project, domain.source, asked)
    number = dict(zip(gathered.errors.keys, gathered.errors.ids, strict=True))
    evidence = domain.evidence
    own = replace(domain, evidence=replace(evidence, ids=tuple(number[k] for k in evidence.keys)))
    answer = DomainAnswer(asked, gathered, own, len(number) - len(evidence))
    return report_result(DOMAIN, asked, project, answer, 0.0)


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
