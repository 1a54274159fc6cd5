"""Experiments of a project, read from it when they are used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import final

from fixel.database.store import Store
from fixel.datasets.experiments import ExperimentEntry, Experiments
from fixel.model import Experiment
from fixel.model.selection import ExperimentQuery

MAX_STORES = 8  # open at a time, for sequences of experiments


@final
@dataclass(frozen=True, slots=True)
class StoredExperiment:
    """Function that reads an experiment of a database by its id."""

    url: str
    media: Path

    def __call__(self, experiment_id: int) -> Experiment:
        """Read an experiment."""
        return _store(self.url, self.media).experiment(experiment_id)


@lru_cache(MAX_STORES)
def _store(url: str, media: Path) -> Store:
    return Store(url, media)


def stored_experiments(store: Store, query: ExperimentQuery) -> Experiments:
    """Return the experiments that match a query, in its order; none of them is read yet."""
    page = store.experiments(query, details=True)
    entries = tuple(map(ExperimentEntry, page.rows, page.details))
    skipped = [f"{page.left_out} with faults in their data"] if page.left_out else []
    published = store.published_simulations()
    simulations = {
        entry.row.key: store.simulation(published[entry.row.id])
        for entry in entries
        if entry.row.id in published
    }
    load = StoredExperiment(store.url, store.media)
    return Experiments(entries, load, (), tuple(skipped), simulations)
