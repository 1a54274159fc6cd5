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
    """Map the experiments of a project that match a filter; see `Project.map_domain`."""
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
    progress: ProgressOption = None,
    **options: Any,
) -> Posterior:
    """Sample a posterior and store it with its predictions; see `Project.posterior`."""
    options |= {"calibration": _id_of(project, fit)}
    options |= {"experiments": project.experiments(filter).keys if filter else ()}
    return cast(Posterior, call(project, "uncertainty", progress=progress, **options).posterior)


def _id_of(project: Project, fit: Fit) -> int | None:
    """Return the id of a calibration, which is stored if it is not yet."""
    if not isinstance(fit, Calibration):
        return fit
    stored = fit if fit.run.ids else project.add(fit)
    return int(stored.run.ids[stored.number])
