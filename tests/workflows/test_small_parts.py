"""Results of a laboratory for parts of a millimetre: those of parts of ten centimetres, scaled."""

import matplotlib.pyplot
import numpy as np
import pytest
from numpy.testing import assert_allclose

import fixel
from fixel.calibration.target import target_of
from fixel.model.shape import length_scale
from fixel.parts.fit import PartPushes
from fixel.parts.model import distinct
from fixel.parts.table_check import equal_pushes
from fixel.uncertainty.error_terms import ModelError
from fixel.units import deg, mm

# Radius of the tripod in the smaller laboratory, in which a peg of 1.7 mm is seen to 2 um.
RADIUS = 0.42 * mm


def scene(scale, radius):
    peg = fixel.Polygon.rectangle(scale * 0.85 * mm, scale * 1.66 * mm)
    support = fixel.Tripod(radius=scale * radius, friction=0.25)
    tip = fixel.Pusher("tip", fixel.Disk(scale * 0.1 * mm), friction=0.22)
    return fixel.Scene(fixel.Body("peg", peg, mass=2e-6 * scale**3, support=support), tip)


@pytest.fixture(scope="module")
def measured():
    """Time, noisy poses of the peg and poses of the tip, of a push past its centre, at scale 1."""
    peg, tip = scene(1.0, RADIUS).bodies[0], fixel.Disk(0.1 * mm)
    drive = fixel.LineDrive(direction=(1.0, 0.05), speed=0.2 * mm, travel=0.8 * mm)
    pusher = fixel.Pusher(
        "tip", tip, friction=0.22, pose=(-0.575 * mm, -0.2 * mm, 0.0), drive=drive
    )
    run = fixel.simulate(fixel.Scene(peg, pusher, duration=4.0), motion="quasistatic")
    time = np.linspace(0.0, 4.0, 41)
    noise = np.random.default_rng(1).standard_normal((41, 3)) * [2e-6, 2e-6, 0.15 * deg]
    return time, run["peg"].at(time) + noise, run["tip"].at(time)


def pushed(measured, scale):
    """Experiment of the same push in a laboratory that is larger by a factor."""
    time, peg, tip = measured
    table = {"time_s": time, "x_m": scale * peg[:, 0], "y_m": scale * peg[:, 1]}
    table |= {"theta_rad": peg[:, 2]}
    table |= {"pusher_x_m": scale * tip[:, 0], "pusher_y_m": scale * tip[:, 1]}
    return fixel.read_experiments(table, scene=scene(scale, 0.3 * mm))[0]


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
def test_a_filter_learns_the_same_of_small_and_large_parts(measured, scale):
    found = fixel.filter(pushed(measured, scale), motion="quasistatic", progress=False)
    k = found.prior.names.index("tripod_radius")
    assert found.excited["tripod_radius"]
    assert_allclose(found.mean[-1, k], scale * RADIUS, rtol=0.15)


@pytest.mark.parametrize("scale", [0.6, 1.0, 100.0])
def test_a_posterior_predicts_small_parts_as_narrowly_as_large_ones(measured, scale):
    push = pushed(measured, scale)
    found = fixel.posterior(
        push, ["tripod_radius"], motion="quasistatic", samples=50, progress=False
    )
    low, high = np.quantile(fixel.predict(push, found, samples=200).ends, [0.05, 0.95], axis=0)
    # 90 % intervals of the ends hold little but the camera's noise.
    assert np.all((high - low)[:2] < scale * 20e-6)
    assert (high - low)[2] < 2.0 * deg


@pytest.mark.parametrize("size", [20 * mm, 60 * mm, 200 * mm])
def test_lengths_of_usual_parts_are_not_scaled(size):
    assert length_scale(fixel.Disk(size / 2.0)) == 1.0
    assert ModelError.usual(fixel.Polygon.rectangle(size, 0.1 * size)) == ModelError()


def test_lengths_of_small_parts_are_proportional_to_them():
    one, other = (ModelError.usual(fixel.Disk(radius)) for radius in (1 * mm, 0.05 * mm))
    assert_allclose(
        [one.low, one.high, one.angle_scale],
        20.0 * np.array([other.low, other.high, other.angle_scale]),
    )
    radii = np.geomspace(0.1 * mm, 50 * mm, 500)
    scales = [length_scale(fixel.Disk(radius)) for radius in radii]
    assert np.all(np.diff(scales) >= 0.0)


def test_experiments_and_predictions_show_small_parts_in_micrometres(measured):
    small, large = (pushed(measured, scale) for scale in (1.0, 100.0))
    start = fixel.StartError(x=2e-6, y=2e-6, theta=0.1 * deg, kind="normal")
    found = fixel.predict(small, start=start, motion="quasistatic", samples=10)
    for shown in (small, found):
        assert "x [um]" in repr(shown)
    assert "x [mm]" in repr(large)
    assert "moved [um]" in repr(fixel.Experiments.of([small]))
    assert "moved [mm]" in repr(fixel.Experiments.of([large]))
    end = [line.split()[1] for line in repr(small).splitlines() if line.split()[0] == "end"]
    assert end == [f"{1e6 * small.trajectory.pose[-1, 0]:.2f}"]


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
def test_the_picture_of_a_small_part_is_filled_by_its_push(measured, scale):
    figure = pushed(measured, scale).plot()[0].figure
    view = figure.axes[0]
    # The tip and the turned part cover 2.5 mm by 1.7 mm, times the scale [mm].
    assert np.ptp(view.get_ylim()) < scale * 5.0
    matplotlib.pyplot.close(figure)


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
def test_a_tip_inside_a_small_part_is_refused_as_in_a_large_one(measured, scale):
    time, peg, tip = measured
    inside = tip + np.array(
        [0.2 * mm, 0.0, 0.0]
    )  # an error of registration of 0.2 mm of a peg of 0.85 mm
    with pytest.raises(fixel.InvalidInput, match="inside the object at the start"):
        pushed((time, peg, inside), scale)


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
def test_a_small_part_that_moves_without_its_tip_is_named_as_a_large_one(measured, scale):
    time, peg, tip = measured
    away = tip - np.outer(time > 2.0, [1.5 * mm, 0.0, 0.0])  # 0.35 mm before the peg stops
    assert "moved-alone" in [flag.name for flag in pushed((time, peg, away), scale).flags]


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
@pytest.mark.parametrize(("apart", "equal"), [(0.01 * mm, True), (0.14 * mm, False)])
def test_pushes_of_small_parts_are_equal_as_those_of_large_ones(measured, scale, apart, equal):
    time, peg, tip = measured
    shifted = time, peg, tip + np.array([0.0, apart, 0.0])
    targets = [target_of(pushed(own, scale)) for own in (measured, shifted)]
    assert len(equal_pushes(targets, "", "").pushes) == equal
    assert distinct(PartPushes(targets)) == 2 - equal


@pytest.mark.parametrize("scale", [0.1, 1.0, 100.0])
def test_part_models_simulate_small_parts_as_exactly_as_large_ones(measured, scale):
    """Steps of 1 mm are one step for a peg of 1 mm; adaptive steps are right at any size."""
    push = pushed(measured, scale)
    (end,), (good,) = PartPushes([target_of(push)]).simulate(np.array([0]), {})
    exact = fixel.simulate(push.scene, motion="quasistatic")["peg"].at(4.0)
    assert good
    assert_allclose(end[:2], exact[:2], atol=scale * 0.01 * mm)
    assert_allclose(end[2], exact[2], atol=1.0 * deg)
