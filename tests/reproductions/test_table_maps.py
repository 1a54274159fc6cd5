"""Share of the squared error that equal pushes have in common, against noise of known size."""

import numpy as np
import pytest
from reproductions.table_maps import _share


@pytest.mark.parametrize("common", [0.0, 2e-3])
def test_the_interval_of_a_share_holds_the_true_one(common):
    rng = np.random.default_rng(4)
    variance = common**2 * 5.0 / 3.0  # of Student's t with 5 degrees of freedom
    expected = variance / (variance + 1e-3**2)
    found = []
    for _ in range(40):
        both = common * rng.standard_t(5, size=(150, 1, 2))
        found.append(_share(both + 1e-3 * rng.normal(size=(150, 2, 2))))
    share, low, high = np.array(found).T
    assert np.mean(share) == pytest.approx(expected, abs=0.03)
    assert np.mean((low < expected) & (expected < high)) > 0.85
