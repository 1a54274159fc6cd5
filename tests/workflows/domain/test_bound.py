"""Error bounds against order statistics, new pushes, and another fit of the parameters."""

import math

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel.testing.pushes import TRUTH, example_pushes
from fixel.testing.scenes import grasp
from fixel.workflows.domain import evidence
from fixel.workflows.error_bound import BoundAnswer, error_bound, report_of

# Friction alone cannot repair the radius: errors are those of a wrong model.
SPACE = {"mu_pusher": (0, 1), "tripod_radius": 0.03}
QUIET = {"progress": False, "threads": 1}


@pytest.fixture(scope="module")
def pushes():
    return example_pushes(14, duration=0.3)


@pytest.fixture(scope="module")
def found(pushes):
    return error_bound(pushes, SPACE, folds=2, **QUIET)


def test_bounds_of_few_experiments_are_an_order_statistic(pushes, found):
    """The bound is the (n + 1) level'th smallest held-out error (Vovk et al., 2005)."""
    bound = found.at(pushes[3])
    k = math.ceil(15 * 0.9) - 1
    # Every score is the error itself, less a constant that differs a little between folds.
    assert bound.position == pytest.approx(np.sort(found.position)[k], rel=0.2)
    assert bound.verdict == "bounded"


def test_held_out_errors_are_those_of_simulations(pushes, found):
    """The errors at the end, with a friction that was fitted to the other fold."""
    own = found.fold == 0
    fit = fixel.calibrate(
        [p for p, k in zip(pushes, own, strict=True) if not k],
        SPACE,
        verdicts=False,
        progress=False,
    )
    for k in np.flatnonzero(own)[:3]:
        off = fit.residuals(pushes[k])[-1]
        assert found.position[k] == pytest.approx(math.hypot(*off[:2]), rel=0.3, abs=2e-5)


def test_new_pushes_stay_within_their_bounds(found):
    new = example_pushes(9, duration=0.3, seed=8)
    fit = {"mu_pusher": 0.25, "tripod_radius": 0.03}
    inside = 0
    for push in new:
        end = fixel.simulate(push.scene, fixel.Parameters(fit)).final["part"]
        off = math.hypot(*(end - push.trajectory.pose[-1])[:2])
        inside += off <= 1.3 * found.at(push.scene).position
    assert inside >= 7
    assert TRUTH["tripod_radius"] != fit["tripod_radius"]


def test_coverage_has_an_interval_and_is_printed(found):
    own = found.coverage["position"]
    assert own.low <= own.value <= own.high
    assert own.n <= 14
    assert own.high >= 0.8
    assert "holds for 90 % of new pushes (held out, 2 folds, 14 experiments)" in repr(found)
    assert len(found.to_dict()["position_bound"]) == 14


def test_a_finding_of_a_report_is_a_sentence(found):
    (finding,) = report_of(BoundAnswer(found, [], None, {}, True)).analysis.headline
    assert finding.startswith("The errors of 90 % of new pushes stay within their bounds, at the")
    assert "(14 experiments, held out)" in finding


def test_a_push_unlike_all_others_has_no_data(found):
    own = found.at(grasp("seated"))
    assert (own.verdict, own.position) == ("no data", None)
    assert own.reason.startswith("part: its outline is unlike")
    assert repr(own).startswith("unseen: part: its outline")


def test_groups_have_bounds_of_their_own(pushes, tmp_path):
    own = error_bound(pushes, SPACE, groups=["side"], folds=2, store=tmp_path, **QUIET)
    assert own.at(pushes[0]).verdict == "bounded"
    assert own.at(pushes[0].scene, side="below").verdict == "no data"
    refused(own.at, pushes[0].scene, match="side")
    own.save(tmp_path / "bound")
    assert fixel.load(tmp_path / "bound") == own


def test_too_few_experiments_are_refused_before_any_fit(pushes):
    refused(error_bound, pushes[:8], SPACE, match="9 at least", **QUIET)
    refused(error_bound, pushes, SPACE, level=1.0, match="level", **QUIET)
    refused(error_bound, pushes, SPACE, groups=["surface"], match="surface", **QUIET)


@pytest.mark.parametrize("function", [fixel.error_bound, fixel.map_domain])
def test_a_program_that_a_call_names_is_permitted(function, pushes, monkeypatch):
    named = []
    monkeypatch.setattr(evidence, "permit", named.append)
    refused(function, pushes, SPACE, motion="./no-engine", **QUIET)
    assert named == ["./no-engine"]
