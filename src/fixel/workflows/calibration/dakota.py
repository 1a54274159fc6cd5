"""Search and parameters out of an input file of Dakota."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from fixel.formats.dakota_file import load_dakota
from fixel.model.space import Unknown
from fixel.workflows.calibration.request import NamedOptions


def from_dakota(path: Path) -> tuple[NamedOptions, list[Unknown]]:
    """The pattern search and the unknowns the file asks for."""
    found = load_dakota(path)
    options = {
        field.name: getattr(found.optimiser, field.name)
        for field in dataclasses.fields(found.optimiser)
    }
    return NamedOptions(name=found.optimiser.name, options=options), list(found.space.unknowns)
