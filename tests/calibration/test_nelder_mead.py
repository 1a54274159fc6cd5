"""Nelder-Mead compared with SciPy's, its bounds and its size; several starts."""

import numpy as np
import pytest
from scipy.optimize import minimize

from fixel.calibration import MultiStart, NelderMead, SearchBox
from fixel.calibration.nelder_mead import simplex_size, stepped_simplex
from fixel.calibration.optimiser import feasible_points
from fixel.errors import InvalidInput
from fixel.testing.optimiser_contract import bowl, box, crease, run


def wide(n, start):
    start = np.array(start, np.float64)
    return SearchBox(start - 1e3, start + 1e3, start, np.full(n, 0.5))


def rosenbrock(x):
    return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)


def bent(x):
    return float(np.abs(x[0] - x[1] ** 2) + np.abs(x[1] + x[2]) + 0.1 * np.abs(x[2] - 1.0))


@pytest.mark.parametrize(("error", "start"), [(rosenbrock, (-1.2, 1.0)), (bent, (2.0, -1.5, 0.3))])
def test_same_simplex_same_points_as_scipy(error, start):
    area = wide(len(start), start)
    theirs = []

    def noted(x):
        theirs.append(x.copy())
        return error(x)

    simplex = stepped_simplex(area, 1.0)
    options = {"initial_simplex": simplex, "xatol": 0.0, "fatol": 0.0, "maxfev": 150}
    minimize(noted, area.start, method="Nelder-Mead", options=options)
    search = NelderMead(speculative=False).start(area)
    ours = np.concatenate([points for points, _ in run(search, error, 150)])
    assert len(theirs) == 150
    assert ours[:150] == pytest.approx(np.array(theirs), abs=1e-9)


@pytest.mark.parametrize("error", [bowl, crease])
def test_speculation_changes_no_decision(error):
    eager, patient = (NelderMead(speculative=s).start(box()) for s in (True, False))
    many, few = run(eager, error), run(patient, error)
    assert np.array_equal(eager.vertices, patient.vertices)
    assert eager.size == patient.size
    assert len(many) < len(few)
    assert eager.evaluations > patient.evaluations


def test_first_simplex_steps_one_scale_away_from_bounds():
    area = SearchBox(
        np.zeros(3), np.array([1.0, 1.0, 0.5]), np.array([0.2, 0.95, 0.1]), np.full(3, 0.1)
    )
    vertices = stepped_simplex(area, 1.0)
    assert vertices - area.start == pytest.approx(
        np.array([[0, 0, 0], [0.1, 0, 0], [0, -0.1, 0], [0, 0, 0.1]])
    )
    # A step wider than the box ends at the farther bound.
    assert stepped_simplex(area, 20.0)[1:].diagonal() == pytest.approx([1.0, 0.0, 0.5])


def test_size_is_the_mean_distance_from_the_centre_in_scales():
    area = SearchBox(np.zeros(2), np.ones(2), np.full(2, 0.5), np.array([0.1, 0.01]))
    # An equilateral triangle of radius 3 scales about its centre.
    angles = 2.0 * np.pi * np.arange(3) / 3
    corners = 3.0 * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    assert simplex_size(area, area.start + corners * area.scale) == pytest.approx(3.0)


def test_ends_below_the_size_and_keeps_it():
    search = NelderMead(size=0.01).start(box())
    run(search, bowl)
    assert search.reason == "the simplex shrank to 0.01 of the scale"
    assert 0.0 < search.size < 0.01


def test_points_out_of_bounds_fail_without_being_asked_for():
    area = SearchBox(np.zeros(1), np.ones(1), np.array([0.05]), np.array([0.1]))
    search = NelderMead(speculative=False).start(area)
    search.tell(np.array([1.0, 2.0]))
    # Reflection leads to -0.05; the next point is the contraction inside.
    assert search.ask().ravel().tolist() == pytest.approx([0.1])


def test_stops_after_evaluations():
    search = NelderMead(max_evaluations=20, speculative=False).start(box())
    run(search, bowl)
    assert search.reason == "20 evaluations were made"
    assert 20 <= search.evaluations <= 24


def test_random_simplex_is_feasible_and_seeded():
    def feasible(points):
        return points[:, 0] > 0.6

    options = NelderMead(random_simplex=True)
    a, b, c = (options.start(box(), seed, feasible).ask() for seed in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    assert np.array_equal(a[0], box().start)
    assert len(a) == 4
    assert (a[1:, 0] > 0.6).all()


def test_a_restart_leaves_a_crease():
    # Measured 2026-11: 8 of these 20 random simplices collapse where nothing is, none with one
    # restart.
    missed = {}
    for restarts in (0, 1):
        errors = []
        for seed in range(20):
            options = NelderMead(random_simplex=True, restarts=restarts)
            search = options.start(box((1 + 0.4 * seed, 2, 3)), seed)
            run(search, crease)
            errors.append(search.best.error)
        missed[restarts] = sum(error > 1.001 for error in errors)
    assert missed[0] > 0
    assert missed[1] == 0


# --- several starts -------------------------------------------------------------------------------


def two_valleys(x):
    places = (x - box().low) / box().scale
    return float(
        min(1.0 + ((places - 7.0) ** 2).sum(), 0.5 + 4.0 * ((places - [1.0, 2.0, 8.0]) ** 2).sum())
    )


def test_several_starts_find_the_deeper_valley():
    lone = NelderMead().start(box())
    run(lone, two_valleys)
    several = MultiStart(optimiser=NelderMead()).start(box(), seed=1)
    run(several, two_valleys)
    assert lone.best.error == pytest.approx(1.0, abs=1e-6)
    assert several.best.error == pytest.approx(0.5, abs=1e-6)
    assert several.reason == "all 8 searches ended"


def test_each_search_is_as_it_would_be_alone():
    several = MultiStart(optimiser=NelderMead(), starts=3).start(box(), seed=5)
    run(several, bowl)
    assert several.evaluations == sum(search.evaluations for search in several.searches)
    assert several.best.error == min(search.best.error for search in several.searches)
    for search in several.searches:
        alone = NelderMead().start(box()._replace(start=search.box.start))
        run(alone, bowl)
        assert np.array_equal(alone.best.point, search.best.point)
        assert alone.reason == search.reason
        assert alone.evaluations == search.evaluations


def test_one_ask_is_the_union_of_those_that_run():
    several = MultiStart(optimiser=NelderMead(), starts=3).start(box())
    assert len(several.ask()) == 3 * 4
    several = MultiStart(optimiser=NelderMead(max_evaluations=4), starts=3).start(box())
    several.tell(np.ones(12))
    assert several.done


def test_starts_are_feasible_and_the_given_one_comes_first():
    def feasible(points):
        return points[:, 0] < 0.52

    several = MultiStart(optimiser=NelderMead(), starts=5).start(box(), 0, feasible)
    starts = np.array([search.box.start for search in several.searches])
    assert len(np.unique(starts, axis=0)) == 5
    assert feasible(starts).all()
    assert np.array_equal(starts[0], box().start)
    refused = MultiStart(optimiser=NelderMead(), starts=5).start(box((9, 5, 5)), 0, feasible)
    assert feasible(np.array([search.box.start for search in refused.searches])).all()
    assert len(refused.searches) == 5


def test_fewer_starts_where_feasible_points_are_rare():
    area = box()

    def feasible(points):
        return (points == area.start).all(axis=1)

    assert len(MultiStart(optimiser=NelderMead()).start(area, 0, feasible).searches) == 1


def test_no_feasible_start():
    with pytest.raises(InvalidInput, match="no feasible start among 16384 random points"):
        MultiStart(optimiser=NelderMead()).start(box(), 0, lambda points: np.zeros(len(points)))


def test_feasible_points_fill_the_box_evenly():
    area = box()
    places = (feasible_points(area, 256, seed=2) - area.low) / (area.high - area.low)
    # Any interval of 1/8 of an unknown holds an eighth of a Sobol' sequence.
    for column in places.T:
        assert np.histogram(column, 8, (0.0, 1.0))[0].tolist() == [32] * 8
