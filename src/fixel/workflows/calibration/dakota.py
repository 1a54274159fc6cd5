"""Read search and parameters from an input file of Dakota."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from fixel.formats.dakota_file import load_dakota
from fixel.model.space import Unknown
from fixel.workflows.calibration.request import NamedOptions


def from_dakota(path: Path) -> tuple[NamedOptions, list[Unknown]]:
    """Return the pattern search and the parameters that the file defines."""
    found = load_dakota(path)
    options = {
        field.name: getattr(found.optimiser, field.name)
        for field in dataclasses.fields(found.optimiser)
    }
    return NamedOptions(name=found.optimiser.name, options=options), list(found.space.unknowns)
