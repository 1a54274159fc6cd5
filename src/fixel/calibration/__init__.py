"""Calibration of parameters from experiments, and their uncertainty."""

from fixel.calibration.evolution import CmaEs
from fixel.calibration.mads import Mads
from fixel.calibration.nelder_mead import NelderMead
from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Best,
    Feasible,
    MultiStart,
    Search,
    SearchBox,
)
from fixel.calibration.pattern_search import FixedStepSearch, PatternSearch

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
