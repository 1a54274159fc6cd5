"""Importers of recorded data, one per dataset and one for your own tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from fixel.datasets.base import Importer
from fixel.datasets.cmu_tripod import CmuTripod
from fixel.datasets.cmu_two_point import CmuTwoPoint
from fixel.datasets.mit_push import MitPush
from fixel.datasets.mit_pusher_slider import MitPusherSlider
from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.datasets.table import CsvTable
from fixel.errors import DatasetMissing, unknown_name

_ALL: Final = (Rpi2dgad(), MitPush(), MitPusherSlider(), CmuTripod(), CmuTwoPoint(), CsvTable())

IMPORTERS: Final[Mapping[str, Importer]] = MappingProxyType(
    {importer.name: importer for importer in _ALL}
)


def importer_for(source: Path, name: str | None = None) -> Importer:
    """Return the importer of a given name, or the first that recognises a file or folder.

    Raises
    ------
    InvalidInput
        No importer of that name.
    DatasetMissing
        The source does not exist, or no importer recognises it.
    """
    if name is not None:
        if name not in IMPORTERS:
            raise unknown_name("format", name, IMPORTERS)
        return IMPORTERS[name]
    source = Path(source)
    if not source.exists():
        raise DatasetMissing(source)
    for importer in IMPORTERS.values():
        if importer.recognised(source):
            return importer
    raise DatasetMissing(source, f"data for one of {', '.join(IMPORTERS)}", _hint(source))


def _hint(source: Path) -> str:
    """Hint that names subfolders with known data, or else the option to name an importer."""
    inside = sorted(path for path in source.iterdir() if path.is_dir()) if source.is_dir() else []
    found = [path.name for path in inside if any(x.recognised(path) for x in _ALL)]
    return f"data found in: {', '.join(found)}" if found else "choose the importer"
