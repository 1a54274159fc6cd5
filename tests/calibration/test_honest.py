"""Intervals of simulated laboratories whose truth is known, and whose model is wrong.
Correlations of calibrated parameters, and draws from them.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest

import fixel
from fixel import Dynamic, Noise, SimulatedTestbed
from fixel.calibration.assess import assess, fit_steps, run_assessment
from fixel.calibration.honest import (
    INSTANTS,
    Honest,
    Probes,
    ShiftModel,
    draw_joint,
    linear_fit,
    mixed_study,
)
from fixel.calibration.objective import Comparer
from fixel.calibration.target import targets_of
from fixel.calibration.usual_parameters import default_unknowns
from fixel.model.space import ParameterSpace
from fixel.sampling.published import thesis_plan
from fixel.testing.pushes import example_pushes

DEMO = thesis_plan().experiments[:21]
# Every 30th push of the square: seven layouts, one push each.
PLANNED = thesis_plan().experiments[2:210:30]
FRICTIONS = ("mu_pusher", "mu_fixel")
WRONG = SimulatedTestbed(seed=41, pusher_friction=1.5, fixel_friction=1.0)
RIGHT = replace(
    SimulatedTestbed.ideal(seed=41), pusher_friction=1.5, position_noise=5e-5, angle_noise=2e-3
)


def _true(experiments, label):
    ratio = f"truth_{label.removeprefix('mu_')}_friction_ratio"
    return 0.2 * np.mean([one.conditions[ratio] for one in experiments])


def _still(target):
    """A recording of the same part, while the pusher stays a metre away."""
    scene = target.case.scene
    pusher = replace(scene.pushers[0], pose=scene.pushers[0].pose - [1.0, 0.0, 0.0])
    case = target.case._replace(scene=replace(scene, pushers=(pusher,)))
    noise = np.random.default_rng(7).normal(size=target.pose.shape) * [5e-5, 5e-5, 2e-3]
    key, pose = f"{target.key}-still", scene.bodies[0].pose + noise
    return target._replace(key=key, conditions={"experiment": key}, case=case, pose=pose)


def _comparer(bench, planned=PLANNED, twice=False, still=0):
    experiments = list(bench.run(planned))
    if twice:
        experiments += [replace(one, name=f"{one.name}-again") for one in experiments]
    targets = targets_of(experiments)
    targets += [_still(target) for target in targets[:still]]
    scenes = [target.case.scene for target in targets]
    space = ParameterSpace(unknowns=default_unknowns(scenes)).with_frozen({"mu_support": 0.25})
    return Comparer(targets, space, motion=Dynamic())


@functools.cache
def _fitted(name, start=""):
    """Return comparer, assessment and steps; `start`: of the search, another one's end."""
    comparer = {
        "demo": lambda: _comparer(SimulatedTestbed(seed=1), DEMO),
        "wrong": lambda: _comparer(WRONG),
        "still": lambda: _comparer(WRONG, still=3),
        "twice": lambda: _comparer(WRONG, twice=True),
        "right": lambda: _comparer(RIGHT),
        "one": lambda: _comparer(WRONG, PLANNED[:1]),
    }[name]()
    members = range(len(comparer.targets))
    first = _fitted(start)[1].point if start else comparer.space.nominal
    asked = []

    def counted():
        running = fit_steps(comparer, members, first)
        try:
            ask = next(running)
            while True:
                asked.append(ask)
                ask = running.send((yield ask))
        except StopIteration as end:
            return end.value

    return comparer, run_assessment(comparer, members, counted()), asked


@pytest.mark.system
def test_intervals_of_the_demo_hold_its_true_friction():
    comparer, found, _ = _fitted("demo")
    assert found.misfit.ratio > 10.0
    low, high = found.honest.ends(0.95)
    experiments = list(SimulatedTestbed(seed=1).run(DEMO))
    for label in FRICTIONS:
        k = comparer.space.labels.index(label)
        assert low[k] <= _true(experiments, label) <= high[k]
        assert low[k] <= found.honest.value[k] <= high[k]


def test_a_right_model_loses_nothing():
    _, found, asked = _fitted("right")
    assert 0.8 < found.misfit.ratio < 1.3
    assert found.honest is None
    assert found.misfit.sentences == ()
    # Its start is the planned one: no noise of the start, and no simulation more.
    assert {ask.kind for ask in asked} == {"noise", "frames"}


def test_the_noise_that_is_read_off_is_that_of_the_bench():
    for name in ("wrong", "right"):
        noise = _fitted(name)[1].misfit.noise
        assert noise.position_m == pytest.approx(5e-5, rel=0.1)
        assert noise.angle_rad == pytest.approx(2e-3, rel=0.1)


def test_the_mixed_fit_asks_for_at_most_a_hundred_rollouts_an_experiment():
    comparer, _, asked = _fitted("wrong")
    rollouts = sum(len(ask.points) for ask in asked if ask.kind == "shifted")
    assert 0 < rollouts <= 100 * len(comparer.targets)


def test_experiments_stored_twice_do_not_shrink_intervals():
    _, once, _ = _fitted("wrong")
    _, twice, _ = _fitted("twice")
    np.testing.assert_array_equal(twice.honest.sd, once.honest.sd)
    np.testing.assert_array_equal(twice.honest.freedom, once.honest.freedom)
    assert twice.dispersion == once.dispersion


def test_experiments_in_which_nothing_moves_add_no_information():
    """Three still ones of ten narrow no interval; by a sixth, if they counted as the others do.

    Both searches start at one point: their ends alone change the widths by 8 %.
    """
    _, seven, _ = _fitted("wrong", start="wrong")
    _, ten, _ = _fitted("still", start="wrong")
    assert ten.honest.clusters == seven.honest.clusters
    assert ten.dispersion.freedom == pytest.approx(seven.dispersion.freedom)
    assert ten.noise.position_m == pytest.approx(seven.noise.position_m, rel=0.01)
    assert (ten.honest.sd > 0.9 * seven.honest.sd).all()


def test_one_experiment_gives_wider_intervals_than_seven():
    comparer, several, _ = _fitted("wrong")
    _, one, _ = _fitted("one")
    assert one.misfit.experiments == 1
    assert "only one experiment" in " ".join(one.misfit.sentences)
    assert (one.honest.freedom == 1.5).all()
    k = comparer.space.labels.index("mu_pusher")
    width = [np.subtract(*found.honest.ends(0.95)[::-1])[k] for found in (one, several)]
    assert width[0] > width[1]


def test_disagreement_of_the_fits_widens_and_few_experiments_do_too():
    mixed = Honest(np.array([0.3]), np.array([0.03]), np.array([8.0]), 9)
    fits = [np.array([0.26]), np.array([0.34])]
    assert mixed.widened(fits).sd == pytest.approx(0.05)
    unknown = mixed.widened(fits, known_noise=False)
    assert unknown.sd == pytest.approx(np.sqrt(0.03**2 + 2 * 0.04**2))
    few, normal = (mixed._replace(freedom=np.array([n])) for n in (1.5, 1e9))
    np.testing.assert_allclose(normal.widened([mixed.value]).ends(0.95)[1], 0.3 + 1.959964 * 0.03,
                               rtol=1e-6)  # fmt: skip
    assert few.ends(0.95)[1] > mixed.ends(0.95)[1] > normal.ends(0.95)[1]


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_fit_to_few_data_stays_near_and_is_wide(slope):
    """Residuals of a formula: 50 mm a unit of friction at the pusher, hardly any at the fixels."""
    comparer, _, _ = _fitted("wrong")
    shifted, start = ShiftModel(comparer), np.array([0.35, 0.2, 0.05])
    noise = np.random.default_rng(1).normal(size=(len(comparer.targets), 3, INSTANTS))
    share = np.linspace(0.0, 1.0, INSTANTS)

    def answered(rows):
        pusher, fixel = (rows[:, 1 + shifted.free[k], None] for k in (0, 1))
        out = 0.05 * noise[rows[:, 0].astype(int)]
        out[:, 0] += 50.0 * (pusher - 0.3) * share
        out[:, 1] += slope * (fixel - 0.9) * share
        return out.reshape(len(rows), -1)

    members = range(len(comparer.targets))
    study = mixed_study(shifted, members, start, Noise(position_m=5e-5, angle_rad=2e-3))
    found, rows = None, next(study)
    while found is None:
        try:
            rows = study.send(answered(rows))
        except StopIteration as end:
            found = end.value
    assert found.value[0] == pytest.approx(0.3, abs=2e-3)
    assert found.sd[0] < 2e-3
    # The formula's own answer lies 0.7 off, known to 0.3 at best: noise may put it anywhere.
    assert abs(found.value[1] - start[1]) <= (0.05 if slope else 1e-9)
    assert found.sd[1] == pytest.approx(0.5) if not slope else found.sd[1] > 0.25


def test_shifts_are_of_what_is_searched_and_of_where_the_object_rests():
    comparer, _, _ = _fitted("one")
    shifted = ShiftModel(comparer)
    own = set(shifted.columns[0])
    assert {"mu_pusher", "mu_fixel", "friction_centre_x", "start_theta"} <= own
    row = np.concatenate(([0.0], shifted.space.nominal))
    plain, good, _ = comparer.differences(np.array([0]), comparer.space.nominal[None])
    assert good.all()
    last = shifted.differences(row[None]).reshape(3, -1)[:, -1]
    np.testing.assert_array_equal(last, plain[0, -1] * [1e3, 1e3, 35.0])


def test_a_probe_without_a_simulation_has_no_slope():
    comparer, found, _ = _fitted("one")
    shifted = ShiftModel(comparer)
    probes = Probes(shifted, 0, ["mu_pusher"], found.point, np.zeros(1))
    rows = np.random.default_rng(0).normal(size=(len(probes.points), 3, 4))
    whole, _ = probes.slopes(rows, comparer.space.scale, np.ones(1))
    rows[1] = rows[2] = np.inf  # both sides of the first unknown
    common, own = probes.slopes(rows, comparer.space.scale, np.ones(1))
    assert not common[..., 0].any()
    assert not own.any()
    np.testing.assert_array_equal(common[..., 1:], whole[..., 1:])


def _judged(experiments):
    targets = targets_of(experiments)
    space = ParameterSpace(unknowns=default_unknowns([target.case.scene for target in targets]))
    comparer = Comparer(targets, space, motion=Dynamic())
    return assess(comparer, range(len(targets)), space.nominal).estimates


@pytest.mark.slow
def test_three_pushes_under_a_large_misfit_identify_no_friction():
    """Few pushes, measured within 4 um, on a model that is far off, as in the film of the demo."""
    # Only names that commit e063943 has: there this fails by its words and its numbers.
    bench = SimulatedTestbed(seed=1, position_noise=3.5e-6, angle_noise=2e-4)
    experiments = list(bench.run([thesis_plan().experiments[k] for k in (0, 12, 18)]))
    for verdict in _judged(experiments):
        assert verdict.verdict != "identified"
        if verdict.label in FRICTIONS:
            low = -np.inf if verdict.low is None else verdict.low
            high = np.inf if verdict.high is None else verdict.high
            assert low <= _true(experiments, verdict.label) <= high


@pytest.mark.slow
def test_what_is_called_identified_holds_the_truth_of_the_demo():
    # Only names that commit e063943 has: there this fails by its numbers.
    experiments = list(SimulatedTestbed(seed=1).run(DEMO))
    for verdict in _judged(experiments):
        low = -np.inf if verdict.low is None else verdict.low
        high = np.inf if verdict.high is None else verdict.high
        assert low <= verdict.value <= high
        if verdict.label in FRICTIONS:
            assert low <= _true(experiments, verdict.label) <= high
        else:
            assert verdict.verdict != "identified"  # a tripod under distributed pressure


@pytest.fixture(scope="module")
def fit():
    space = {"mu_pusher": (0.0, 1.0), "tripod_radius": (0.02, 0.06)}
    return fixel.calibrate(example_pushes(3), space, verdicts=False, progress=False)


def test_correlation_is_that_of_the_curvature_of_the_error(fit):
    """Second differences of the summed error, computed without any derivative of the motion."""
    comparer = Comparer(fit.targets, fit.space, None, fit.motion)
    step = 0.1 * fit.space.scale
    best = fit.found.point

    def error(a, b):
        point = best + np.array([a, b]) * step
        which = np.arange(len(fit.targets))
        return comparer.errors(which, np.tile(point, (len(which), 1))).error.sum()

    xx = error(1, 0) - 2 * error(0, 0) + error(-1, 0)
    yy = error(0, 1) - 2 * error(0, 0) + error(0, -1)
    xy = (error(1, 1) - error(1, -1) - error(-1, 1) + error(-1, -1)) / 4
    expected = -xy / np.sqrt(xx * yy)
    assert fit.correlation[0, 1] == pytest.approx(expected, abs=0.03)


def test_draws_have_the_given_spread_and_correlation():
    wide = np.array([-100.0, -100.0])
    correlation = np.array([[1.0, -0.8], [-0.8, 1.0]])
    drawn = draw_joint(np.zeros(2), wide, -wide, np.array([1.0, 2.0]), correlation, 20_000, 0)
    assert np.allclose(drawn.std(axis=0), [1.0, 2.0], rtol=0.02)
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(-0.8, abs=0.02)


def test_draws_stay_within_bounds_and_open_ones_fill_them():
    low, high = np.array([0.0, 0.0]), np.array([1.0, 1.0])
    drawn = draw_joint(
        np.array([0.0, 0.3]), low, high, np.array([0.5, np.inf]), np.eye(2), 4_000, 0
    )
    assert (drawn >= 0.0).all()
    assert (drawn <= 1.0).all()
    assert np.quantile(drawn[:, 1], [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.02)
    assert np.quantile(drawn[:, 0], 0.5) == pytest.approx(0.3, abs=0.03)  # half a normal, cut at 1


def test_samples_of_a_frozen_parameter_are_its_value(fit):
    drawn = fit.samples(10)
    assert set(drawn) == {"mu_pusher", "tripod_radius"}
    assert len(drawn["mu_pusher"]) == 10


def test_the_fit_moves_as_it_does_when_an_experiment_is_left_out():
    """The other experiments are calibrated again, by the search of calibrations."""
    pushes = example_pushes(6)
    space = {"mu_pusher": (0.0, 1.0), "tripod_radius": (0.02, 0.06)}

    def best(own):
        return fixel.calibrate(own, space, verdicts=False, progress=False).found.point

    fit = fixel.calibrate(pushes, space, verdicts=False, progress=False)
    comparer = Comparer(fit.targets, fit.space, None, fit.motion)
    found = linear_fit(comparer, fit.found.point).left_out()
    moved = np.array([best(pushes[:k] + pushes[k + 1 :]) for k in range(6)]) - fit.found.point
    assert (np.abs(found - moved).max(axis=0) < 0.5 * np.abs(moved).max(axis=0)).all()
    assert np.corrcoef(found.T, moved.T)[[0, 1], [2, 3]] == pytest.approx(1.0, abs=0.1)
