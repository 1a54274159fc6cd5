"""Every built-in optimiser keeps the contract of its family."""

import math

import numpy as np
import pytest

from fixel.calibration import (
    OPTIMISERS,
    AbstractOptimiser,
    CmaEs,
    FixedStepSearch,
    Mads,
    MultiStart,
    NelderMead,
    PatternSearch,
)
from fixel.errors import InvalidInput
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
CASES = [
    # NOMAD is a process of its own, which tests/calibration/test_external_searches.py looks at.
    pytest.param(k, id=f"{k}-{own.name}", marks=[pytest.mark.system] * isinstance(own, Mads))
    for k, own in enumerate(CONVERGING)
]
# Values that each option must not have.
IMPOSSIBLE = {
    CmaEs: {"sigma": 0.0, "population": 2, "tolerance": -1.0, "restarts": -1},
    FixedStepSearch: {"step": 0.0, "steps": [0.1, -1.0], "rounds": 0},
    Mads: {"initial_frame": 0.0, "threshold": -1.0, "max_evaluations": 0},
    MultiStart: {"optimiser": "nelder-mead", "starts": 0},
    NelderMead: {"size": 0.0, "step": math.inf, "restarts": -1, "max_evaluations": 0},
    PatternSearch: {
        "initial_delta": 0.0, "threshold_delta": -1.0, "contraction_factor": 1.0, "expand_after": 0,
        "sufficient_decrease": -0.1, "resolution": -1e-6, "solution_accuracy": math.nan,
        "max_iterations": 1.5, "max_function_evaluations": True,
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "option"), [(kind, option) for kind, own in IMPOSSIBLE.items() for option in own]
)
def test_impossible_options(kind, option):
    needed = {"optimiser": NelderMead()} if kind is MultiStart else {}
    with pytest.raises(InvalidInput, match=rf"{kind.__name__}\.{option}"):
        kind(**needed | {option: IMPOSSIBLE[kind][option]})


@pytest.fixture(autouse=True)
def _leaves_the_dice_of_others_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    yield
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


class TestConverging(OptimiserContract):
    @pytest.fixture(params=CASES)
    def optimiser(self, request) -> AbstractOptimiser:
        return CONVERGING[request.param]


class TestFixedStepSearch(OptimiserContract):
    precision = 0.3  # steps of half a scale

    @pytest.fixture
    def optimiser(self) -> AbstractOptimiser:
        return FixedStepSearch()
