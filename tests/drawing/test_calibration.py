"""Drawings of calibrations: any number of anything, and data that say what the pictures show."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

from fixel.drawing import calibration, palette
from fixel.drawing.chart import add_banner, log_scale, positive
from fixel.drawing.overlay import OverlayMotions, Track, overlay_chart
from fixel.drawing.profiles import parameters_chart, profiles_chart
from fixel.drawing.searches import SearchPanel, search_chart, starts_chart
from fixel.errors import InvalidInput
from fixel.model.records import Estimate, ProfileRecord
from fixel.model.space import Unknown
from fixel.units import displayed

NONE = np.zeros(0, np.int64)
LOST = np.array([np.inf, np.inf])
SQUARE = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])


def search(errors, begins=NONE):
    errors = np.asarray(errors, float)
    return search_chart([SearchPanel("one", errors, np.asarray(begins))])


def starts(errors):
    k = len(errors)
    return starts_chart(
        title="six starts",
        errors=np.asarray(errors, float),
        points=np.linspace((0.1, 0.01), (0.9, 0.05), k),
        unknowns=(
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.3),
            Unknown(name="tripod_radius", low=0.001, high=0.07, nominal=0.03),
        ),
        evaluations=[10] * k,
    )


def errors_of(n, seed=0):
    draw = np.random.default_rng(seed)
    before = 10.0 ** draw.normal(1.0, 0.5, n)
    return calibration.errors_chart(
        keys=[f"set/{k:03d}-experiment" for k in range(n)],
        series={"before": before, "each alone": 0.02 * before, "one set for all": 0.3 * before},
    )


def rows(**changes):
    row = Estimate(label="mu_pusher", unit="-", value=0.3, bounds=(0.0, 1.0), before=0.2)
    return parameters_chart(title="one", rows=[replace(row, **changes)])


def profile(widened=False, **changes):
    values = np.linspace(0.1, 0.5, 9)
    rises = ((values - 0.3) / 0.05) ** 2
    own = ProfileRecord(
        label="mu_pusher", values=values, deviances=rises, slice_values=values,
        slice_deviances=2.0 * rises, low=0.2, high=0.4, threshold=4.0,
    )  # fmt: skip
    own = replace(own, **changes)
    estimate = Estimate(label="mu_pusher", unit="-", value=0.3, low=own.low, high=own.high)
    if widened:
        estimate = Estimate(label="mu_pusher", unit="-", value=0.7, low=0.1)
        estimate = estimate.with_noise(0.3, 0.2, 0.4)
    return profiles_chart(title="one", profiles=[own], estimates={"mu_pusher": estimate})


def seconds(values):
    values = np.asarray(values, float)
    return calibration.seconds_chart(
        keys=list("abcdefgh")[: len(values)], seconds=values, evaluations=[1] * len(values)
    )


def offsets(n, groups, axes=True):
    place = np.arange(n)
    values = np.linspace(0.01, 1.0, n)
    offsets = np.tile(np.linspace(-0.04, 0.04, n // groups), groups)
    along = [calibration.OffsetSeries(name, "m", place, offsets) for name in ("x", "y")]
    return calibration.offsets_chart(
        title="parameters",
        keys=[str(k) for k in place],
        groups=[f"layout {k // (n // groups)}" for k in place],
        axes=along if axes else [],
        quantities=[
            calibration.Quantity("mu_pusher", "-", values, bounds=(0.0, 1.0)),
            calibration.Quantity("error", "mm^2", np.where(place == 1, np.nan, values), log=True),
        ],
    )


def overlay(time, **changes):
    pose = np.asarray(time)[:, None] * np.array([0.02, 0.01, 0.3])
    track = Track(np.asarray(time), pose, 1.0)
    content = {
        "outline": SQUARE,
        "measured": track,
        "before": Track(track.time, pose * 0.9, 2.5),
        "after": track,
        "real": True,
        "fixels": [0.1 * SQUARE + (0.2, 0.0)],
        "pusher": [0.3 * SQUARE, 0.3 * SQUARE + (0.1, 0.0)],
        "unit": "mm^2",
    }
    return overlay_chart("one", OverlayMotions(**(content | changes)))


TIME = np.linspace(0.0, 2.0, 40)
SHORT = Track(np.array([0.0]), np.zeros((1, 3)))
CHARTS = {
    "one evaluation": search([3.0]),
    "all failed": search(LOST),
    "no evaluation": search([]),
    "a perfect fit": search([3.0, 0.0]),
    "iterations": search(np.geomspace(100.0, 0.1, 81), [0, *range(1, 81, 8)]),
    "some failed": search([3.0, np.inf, 2.0], [0, 1, 2]),
    "starts": starts([1.0, 1.01, 5.0, np.inf]),
    "no start found anything": starts(LOST),
    "one experiment": errors_of(1),
    "named experiments": errors_of(21),
    "420 experiments": errors_of(420),
    "no simulation": calibration.errors_chart(["a", "b"], {"before": LOST, "after": LOST}),
    "no interval": rows(),
    "an interval": rows(low=0.2, high=0.4, verdict="identified"),
    "half an interval": rows(high=0.4, noise_value=0.1, verdict="trades off with mu_fixel"),
    "nothing known": rows(verdict="not identified", label="mu_pusher[surface=plywood]"),
    "profile": profile(),
    "profile of a model that misfits": profile(widened=True),
    "open profile": profile(low=None, high=None, deviances=np.full(9, 0.1)),
    "failed profile": profile(deviances=np.array([np.inf] * 4 + [0.0] + [np.inf] * 4)),
    "seconds": seconds([1.0, 2.0, 8.0]),
    "equal seconds": seconds([2.0, 2.0]),
    "no seconds": seconds([0.0]),
    "offsets": offsets(22, 2),
    "offsets in many layouts": offsets(420, 20),
    "no offsets": offsets(5, 1, axes=False),
    "overlay": overlay(TIME),
    "two poses": overlay(TIME[[0, -1]]),
    "nothing simulated": overlay(TIME, before=SHORT, after=SHORT, fixels=[], pusher=[], real=False),
}  # fmt: skip


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
def test_everything_can_be_drawn(chart, tmp_path):
    chart.save(tmp_path / "one.png", banner="SIMULATED by a test")
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    table = chart.table()
    assert len(set(table.head)) == len(table.head)
    assert {len(row) for row in table.rows} <= {len(table.head)}


def test_the_profile_shows_the_value_and_interval_of_the_table():
    axes = profile(widened=True).figure().axes[0]
    drawn = {patch.get_label(): patch.get_extents().transformed(axes.transData.inverted())
             for patch in axes.patches}  # fmt: skip
    left, right = axes.get_xlim()
    assert [drawn["95 % interval"].x0, drawn["95 % interval"].x1] == pytest.approx([0.1, right])
    noise = drawn["interval from noise alone"]
    assert [noise.x0, noise.x1] == pytest.approx([0.2, 0.4])
    (value,) = [line.get_xdata()[0] for line in axes.lines if line.get_label() == "value"]
    assert left <= value == 0.7 <= right

    sound = profile().figure().axes[0]
    assert [patch.get_label() for patch in sound.patches] == ["95 % interval"]


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_the_same_numbers_give_the_same_file(ending, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    one, two = tmp_path / f"one.{ending}", tmp_path / f"two.{ending}"
    profile().save(one)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "100000")
    profile().save(two)
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    assert one.read_bytes().startswith(starts[ending])
    assert ending == "svg" or one.read_bytes() == two.read_bytes()
    assert b"1970-01" not in one.read_bytes()


@pytest.mark.parametrize("name", ["one", "one.bmp", "one.jpg"])
def test_other_endings_are_refused(name, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.pdf, \.png, \.svg"):
        search([1.0]).save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_banner_stands_clear_of_the_picture():
    for chart in (profile(), overlay(TIME)):
        figure = chart.figure()
        add_banner(figure, "SIMULATED")
        figure.draw_without_rendering()
        band = figure.artists[0].get_window_extent().y0
        titles = [text for text in figure.texts if text.get_text() != "SIMULATED"]
        for part in (*figure.axes, *titles):
            assert part.get_tightbbox().y1 <= band + 1.0


def test_searches_tell_iterations_and_the_best_so_far():
    table = search([3.0, np.inf, 2.0, 5.0], [0, 1]).table()
    assert table.head == ("search", "evaluation", "iteration", "error_mm", "best_mm")
    assert table.rows == [
        ("one", 1, 0, 3.0, 3.0),
        ("one", 2, 1, None, 3.0),
        ("one", 3, 1, 2.0, 2.0),
        ("one", 4, 1, 5.0, 2.0),
    ]
    assert {row[2] for row in search([3.0, 2.0]).table().rows} == {None}


def test_starts_are_sorted_and_those_nearly_as_good_are_marked():
    table = starts([5.0, 1.0, np.inf, 1.01]).table()
    assert [row[1] for row in table.rows] == [2, 4, 1, 3]
    assert [row[3] for row in table.rows] == ["true", "true", "false", "false"]
    assert table.head[-2:] == ("mu_pusher [-]", "tripod_radius [m]")


def test_the_worst_experiment_comes_first():
    chart = errors_of(30)
    last = [row[-1] for row in chart.table().rows]
    assert last == sorted(last, reverse=True)
    assert chart.table().head[0:2] == ("experiment", "before_mm")


def test_many_experiments_stay_on_one_page():
    assert errors_of(420).figure().get_size_inches()[1] < 4.0
    names = errors_of(21).figure().axes[0].get_yticklabels()
    assert [name.get_text() for name in names].count("003-experiment") == 1


def test_labels_do_not_lie_on_each_other():
    """Of rows, columns and profiles, also where names are long."""
    wide = rows(low=0.0604, high=0.177, verdict="trades off with mu_fixel, mu_support", value=0.223)
    for chart in (wide, errors_of(45), profile(), offsets(22, 2), overlay(TIME)):
        with mpl.rc_context(palette.STYLE):
            figure = chart.figure()
            figure.draw_without_rendering()
        for axes in figure.axes:
            boxes = [text.get_window_extent().padded(-1.0) for text in _shown(axes)]
            for k, box in enumerate(boxes):
                assert not any(box.overlaps(other) for other in boxes[k + 1 :])


def _shown(axes):
    texts = list(axes.texts)
    if axes.axison:
        (left, right), (low, high) = axes.get_xlim(), sorted(axes.get_ylim())
        texts += [t for t in axes.get_xticklabels() if left <= t.get_position()[0] <= right]
        texts += [t for t in axes.get_yticklabels() if low <= t.get_position()[1] <= high]
    return [text for text in texts if text.get_text() and text.get_visible()]


def test_profiles_keep_curve_and_slice_apart():
    table = profile().table()
    assert [row[2] for row in table.rows] == ["profile"] * 9 + ["slice"] * 9
    assert table.rows[4][3:] == pytest.approx((0.3, 0.0, 4.0, 0.2, 0.4, 0.2, 0.4))


def test_a_far_scan_does_not_squeeze_a_profile():
    values = np.array([0.25, 0.28, 0.30, 0.32, 0.35, 50.0])
    rises = np.array([16.0, 4.0, 0.0, 4.0, 11.0, 1e6])
    chart = profile(values=values, deviances=rises, low=0.28, high=0.32)
    left, right = chart.figure().axes[0].get_xlim()
    assert 0.24 < left < 0.28
    assert 0.32 < right < 0.5


def test_overlays_show_what_simulations_are_off_by():
    axes = {axes.get_label(): axes for axes in overlay(TIME).figure().axes}
    difference = axes["dx"].lines[0].get_ydata()
    np.testing.assert_allclose(difference, -0.1 * 20.0 * TIME, atol=1e-9)
    assert {row[0] for row in overlay(TIME).table().rows} == {"measured", "before", "after"}
    assert "recorded" in {row[0] for row in overlay(TIME, real=False).table().rows}


def test_a_turn_across_half_a_circle_is_no_error():
    pose = np.column_stack((TIME, TIME, np.pi - 0.02 + 0.02 * TIME))
    back = pose.copy()
    back[:, 2] -= 2.0 * np.pi
    chart = overlay(TIME, measured=Track(TIME, pose), after=Track(TIME, back))
    axes = {axes.get_label(): axes for axes in chart.figure().axes}
    assert np.abs(axes["dtheta"].lines[1].get_ydata()).max() < 1e-9


def test_people_read_millimetres_and_degrees():
    assert displayed("m").on("tripod_radius") == "tripod_radius [mm]"
    assert displayed("rad").text(np.pi) == "180"
    assert displayed("-").on("mu") == "mu"
    assert displayed("N m").on("torque") == "torque [N mm]"


def test_logarithmic_axes_bear_zeros_and_single_values():
    from matplotlib.figure import Figure

    np.testing.assert_array_equal(positive(np.array([0.0, 4.0, np.inf])), [2.0, 4.0, np.nan])
    for values in ([3.0], [0.0], [], [1e-9, 1e9]):
        axes = Figure().subplots()
        log_scale(axes, "y", np.array(values))
        low, high = axes.get_ylim()
        assert 0.0 < low < high
