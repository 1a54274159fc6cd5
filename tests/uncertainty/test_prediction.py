"""Pushes with the values of a model."""

from types import SimpleNamespace

from fixel import Estimate, QuasiStatic
from fixel.testing.pushes import example_pushes
from fixel.uncertainty.prediction import push_of


def test_the_intervals_of_an_experiment_are_those_under_its_conditions():
    one, other = example_pushes(2)
    labels = {f"mu_pusher[experiment={own.key}]": low for own, low in ((other, 0.1), (one, 0.2))}
    estimates = {
        label: Estimate(label=label, unit="-", value=0.3, low=low, high=0.4)
        for label, low in labels.items()
    }
    model = SimpleNamespace(
        motion=QuasiStatic(),
        estimates=estimates,
        values_for=lambda **conditions: {"mu_pusher": 0.3},
        samples=lambda n, seed, **conditions: {},
    )
    assert push_of(one, model).intervals == {"mu_pusher": (0.2, 0.4)}
    assert push_of(other, model).intervals == {"mu_pusher": (0.1, 0.4)}
