"""Calibration of parameters from experiments, and their uncertainty."""

from fixel.calibration.direct_search import FixedStepSearch, NelderMead, PatternSearch
from fixel.calibration.external_searches import CmaEs, Mads
from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Best,
    Feasible,
    MultiStart,
    Search,
    SearchBox,
)

__all__ = [
    "OPTIMISERS",
    "AbstractOptimiser",
    "Best",
    "CmaEs",
    "Feasible",
    "FixedStepSearch",
    "Mads",
    "MultiStart",
    "NelderMead",
    "PatternSearch",
    "Search",
    "SearchBox",
]

# Optimisers that work alone; `MultiStart` needs another one.
OPTIMISERS: tuple[type[AbstractOptimiser], ...] = (
    PatternSearch,
    FixedStepSearch,
    NelderMead,
    CmaEs,
    Mads,
)
