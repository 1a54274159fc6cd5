"""Charts of success probabilities, trials and causes: what is drawn, without colliding texts."""

import numpy as np
import pytest
from matplotlib import pyplot
from tests.drawing.collisions import collisions

from fixel.errors import InvalidInput
from fixel.planning.causes import Explanation
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import PlanTrial, Trials


@pytest.fixture(autouse=True)
def _closed():
    yield
    pyplot.close("all")


def _explanation(n_unknowns=4):
    rng = np.random.default_rng(0)
    unknowns = rng.normal(0.0, 0.004, (n_unknowns, 1024))
    margins = np.stack([0.005 - unknowns[0], 0.005 + unknowns[0]])
    names = {f"unknown_number_{k}": row for k, row in enumerate(unknowns)}
    return Explanation.of(margins, names, units=dict.fromkeys(names, "m"))


@pytest.mark.parametrize("n_unknowns", [1, 2, 20])
def test_causes_are_bars_of_the_largest_shares(n_unknowns):
    found = _explanation(n_unknowns)
    left, right = found.plot()
    assert len(left.patches) == min(n_unknowns, 12)
    assert left.patches[0].get_width() == pytest.approx(100.0 * found.effects[0].share)
    assert right.patches[0].get_width() == pytest.approx(found.effects[0].worth)
    assert not collisions(left.figure)


def test_success_against_unknowns():
    found = _explanation()
    panels = found.plot("success")
    assert [axes.get_xlabel() for axes in panels[:4]] == [
        f"{own.name} [mm]" for own in found.effects
    ]
    assert not collisions(panels[0].figure)
    one = found.plot("success", unknown="unknown_number_2")
    assert one.get_xlabel() == "unknown_number_2 [mm]"
    with pytest.raises(InvalidInput, match="unknown_number_2"):
        found.plot("success", unknown="unknown_number2")


def test_rates_of_the_draws_are_ordered():
    rng = np.random.default_rng(1)
    found = SuccessProbability.of(rng.normal(1.0, 1.0, (64, 1)) + rng.normal(size=(64, 64)))
    axes = found.plot()
    assert np.all(np.diff(axes.lines[0].get_ydata()) >= 0.0)
    assert not collisions(axes.figure)


@pytest.mark.parametrize("outcomes", [[], [True], [False] * 30, [True] * 300])
def test_evidence_of_trials(outcomes):
    trials = [PlanTrial("2026-11-22T21:00:00+00:00", met) for met in outcomes]
    axes = Trials(plan="a1", stated=0.9, mean=0.95, trials=tuple(trials)).plot()
    assert len(axes.lines[0].get_ydata()) == len(outcomes) + 1
    assert not collisions(axes.figure)
