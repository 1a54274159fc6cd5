"""Python names its own arguments where commands name their options."""

import pytest
from tests.fixtures import refused

import fixel
from fixel import calibrate, calibrate_each, map_domain
from fixel.testing.pushes import example_pushes

SPACE = {"mu_pusher": (0, 1), "tripod_radius": 0.038}


@pytest.mark.parametrize(("call", "named"), [
    (lambda p: map_domain(p, SPACE, threshold=-1e-3), "threshold is -1 mm"),
    (lambda p: map_domain(p, SPACE, axes=["side", "side"]), "axes: "),
    (lambda p: map_domain(p, SPACE, axes=["side"], nominal={"side": "top"}), "nominal side: "),
    (lambda p: map_domain(p, SPACE, axes=["side"], folds=1), "folds is "),
    (lambda p: calibrate(p, SPACE, level=2.0), "level is "),
    (lambda p: calibrate(p, SPACE, name="a/b"), "name is "),
    (lambda p: calibrate(p, SPACE, error="squares"), "error is "),
    (lambda p: calibrate_each(p, SPACE, budget=1.0), "budget: found mode each"),
    (lambda p: calibrate(p, SPACE, motion="fast"), "motion is "),
    (lambda p: calibrate(p, SPACE, workers=-1), "workers is -1"),
    (lambda p: fixel.filter(p[0], particles=1), "particles is 1"),
])  # fmt: skip
def test_python_names_its_own_arguments(call, named):
    problem = str(refused(call, example_pushes(6, duration=0.2)))
    assert problem.startswith(named)
    assert "--" not in problem
