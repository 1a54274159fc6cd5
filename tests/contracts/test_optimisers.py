"""Every built-in optimiser keeps the contract of its family."""

import numpy as np
import pytest

from fixel.calibration import (
    OPTIMISERS,
    AbstractOptimiser,
    CmaEs,
    FixedStepSearch,
    MultiStart,
    NelderMead,
    PatternSearch,
)
from fixel.testing.optimiser_contract import OptimiserContract

CONVERGING = [
    *[member() for member in OPTIMISERS if member is not FixedStepSearch],
    PatternSearch(contract_always=True, contraction_factor=0.98),
    NelderMead(speculative=False),
    NelderMead(random_simplex=True, restarts=1),
    CmaEs(restarts=1),
    MultiStart(optimiser=NelderMead(), starts=3),
    MultiStart(optimiser=PatternSearch(), starts=2),
]


@pytest.fixture(autouse=True)
def _leaves_the_dice_of_others_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    yield
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


class TestConverging(OptimiserContract):
    @pytest.fixture(params=range(len(CONVERGING)), ids=lambda k: f"{k}-{CONVERGING[k].name}")
    def optimiser(self, request) -> AbstractOptimiser:
        return CONVERGING[request.param]


class TestFixedStepSearch(OptimiserContract):
    precision = 0.3  # steps of half a scale

    @pytest.fixture
    def optimiser(self) -> AbstractOptimiser:
        return FixedStepSearch()
