"""Readers of recorded pushes; each dataset is recognised by its files, which are never modified."""

from pathlib import Path

from fixel.datasets.raw import mit_push, mit_timeseries, rpi_2dgad
from fixel.datasets.raw.mit_push import MitPushes
from fixel.datasets.raw.mit_timeseries import PushRun, PushRuns
from fixel.datasets.raw.rpi_2dgad import LabSimulation, RpiTrial, RpiTrials
from fixel.errors import DatasetMissing

Dataset = MitPushes | RpiTrials | PushRuns

EXPECTED = (
    "pushes.csv.gz and shapes.json (mit_push_endpoints), experiments.csv and exp<number>_setup.json"
    " (rpi_2dgad), or cpush_*.csv.gz and shapes.json (mit_timeseries)"
)

_READERS = (mit_push, rpi_2dgad, mit_timeseries)


def read_dataset(folder: Path) -> Dataset:
    """Load a dataset of any known kind.

    Raises
    ------
    DatasetMissing
        The folder contains no known dataset.
    InvalidInput
        A file with invalid content.
    """
    if mit_push.recognised(folder):
        return mit_push.read(folder)
    if rpi_2dgad.recognised(folder):
        return rpi_2dgad.read(folder)
    if mit_timeseries.recognised(folder):
        return mit_timeseries.read(folder)
    raise DatasetMissing(folder, EXPECTED, _hint(folder))


def _hint(folder: Path) -> str | None:
    """Hint that names subfolders with a known dataset; None if there are none."""
    if not folder.is_dir():
        return "there is no such folder"
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    known = [path.name for path in inside if any(r.recognised(path) for r in _READERS)]
    return f"look inside: {', '.join(known)}" if known else None


__all__ = [
    "Dataset",
    "LabSimulation",
    "MitPushes",
    "PushRun",
    "PushRuns",
    "RpiTrial",
    "RpiTrials",
    "read_dataset",
]
