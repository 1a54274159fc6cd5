"""Result of the filter on an experiment of a project, and its record there."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Final, NamedTuple

import numpy as np

from fixel.database.project import Project
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.recorded import FilterRun
from fixel.model import Provenance
from fixel.model.records import CalibrationRecord, FilterParameters, FilterRecord

NAME: Final = "particle"  # name of the settings in the project
# Suffixes of the columns stored for every parameter.
ENDINGS: Final = ("", "_q05", "_q50", "_q95")


class FilterAnswer(NamedTuple):
    """Run of the filter on an experiment of a project."""

    experiment_id: int
    estimates: FilterRun
    run_id: int | None  # id of the run in the project; None if it was not stored
    # Calibrations of the project with the experiment as a member, by id.
    calibrations: Mapping[int, CalibrationRecord]


def store_run(project: Project, found: FilterRun, command: str = "") -> int:
    """Store a run of the filter and its settings in a project; return the id of the run.

    Raises
    ------
    NotStored
        The project has no such experiment.
    """
    with project.store() as store:
        experiment_id = store.find(found.experiment.key)
        settings = store.add_filter_parameters(_settings(found, command))
        return store.add_filter_run(_record(found, experiment_id, settings, command))


def _record(found: FilterRun, experiment_id: int, settings_id: int, command: str) -> FilterRecord:
    values = np.concatenate((found.mean[:, :, None], found.quantiles), axis=2)
    return FilterRecord(
        experiment_id=experiment_id,
        filter_parameters_id=settings_id,
        provenance=_provenance(found, command),
        trajectory=found.trajectory,
        uses_tactile=found.uses_tactile,
        occlusion=found.occlusion,
        contact_mode=found.contact_mode,
        estimate_names=tuple(n + ending for n in found.prior.names for ending in ENDINGS),
        estimates=values.reshape(len(values), -1),
    )


def _settings(found: FilterRun, command: str) -> FilterParameters:
    numbers = {
        name: float(value)
        for name in ParticleFilter.__dataclass_fields__
        if name != "threads" and isinstance(value := getattr(found.options, name), int | float)
    }
    prior = found.prior
    for name, low, high in zip(prior.names, prior.low, prior.high, strict=True):
        numbers |= {f"{name}_low": float(low), f"{name}_high": float(high)}
    return FilterParameters(
        name=f"{NAME}, {found.options.motion.name}",
        is_particle_filter=True,
        provenance=_provenance(found, command),
        values=numbers,
    )


def _provenance(found: FilterRun, command: str) -> Provenance:
    return Provenance(version=version("fixel"), command=command, seed=found.seed)
