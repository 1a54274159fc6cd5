"""Pictures of posteriors, bands, final poses and coverage, and their tables."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from tests.drawing.collisions import collisions

from fixel.drawing import palette
from fixel.drawing.uncertainty import bands_chart, corner_chart, coverage_chart, final_pose_chart
from fixel.uncertainty.error_terms import LABEL
from fixel.uncertainty.prediction import Band, CoverageCurve, Ellipse, EndBounds
from fixel.workflows.uncertainty import report

DICE = np.random.default_rng(0)
POSES = DICE.standard_normal((80, 3)) * np.array([1e-3, 2e-3, 0.02]) + np.array([0.1, 0.0, 0.5])


def _posterior(units, low, high, samples, weights=(1.0,)):
    """Stand-in for a posterior, with the parts that pictures of it use."""
    members = np.array_split(np.arange(len(samples)), len(weights))
    modes = [SimpleNamespace(weight=w, members=m) for w, m in zip(weights, members, strict=True)]
    return SimpleNamespace(
        labels=tuple(units), units=tuple(units.values()), low=np.array(low), high=np.array(high),
        points=samples, modes=modes,
    )  # fmt: skip


def _corner():
    samples = DICE.random((60, 3)) * np.array([1.0, 0.05, 1e-2]) + np.array([0.0, 0.01, 1e-4])
    units = {"mu_pusher": "-", "tripod_radius": "m", LABEL: "m"}
    low, high = (0.0, 0.01, 5e-5), (1.0, 0.06, 2e-2)
    posterior = _posterior(units, low, high, samples, (0.6, 0.4))
    return corner_chart(posterior, "Corner")


def _bands():
    time = np.linspace(0.1, 2.0, 20)
    path = np.column_stack((0.01 * time, 0.0 * time, 0.1 * time))
    bands = [Band(level, path - level * 1e-3, path + level * 1e-3) for level in (0.5, 0.9)]
    return bands_chart(time=time, measured=path, best=path, bands=bands, title="Bands")


def _final():
    outline = 0.05 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    ellipse = Ellipse(0.9, POSES[:, :2].mean(axis=0), np.array([2e-3, 1e-3]), 1.5)
    region = EndBounds(0.9, ellipse, (0.4, 0.6))
    return final_pose_chart(
        outline=outline, start=np.zeros(3), measured=POSES[0], draws=POSES, regions=[region]
    )


def _curve():
    levels = np.array([0.1, 0.5, 0.9])
    curve = CoverageCurve(levels, levels, levels - 0.05, levels + 0.05, 200)
    groups = {"final position": [levels]}
    curves = {"final position": curve, "final angle": curve}
    return coverage_chart(curves, "Coverage", groups)


@pytest.mark.parametrize(("chart", "columns", "rows"), [
    (_corner(), ("mu_pusher", "tripod_radius_m", "model error_m", "mode"), 60),
    (_final(), ("what", "x_m", "y_m", "theta_rad"), 81),
    (_curve(), ("bounds", "level", "held", "true_levels_from", "true_levels_to", "outcomes"), 6),
])  # fmt: skip
def test_a_picture_and_its_table(chart, columns, rows, tmp_path):
    chart.save(tmp_path / "a.png", tmp_path / "a.pdf", banner="SIMULATED")
    assert (tmp_path / "a.png").stat().st_size > 5_000
    table = chart.table()
    assert table.head == columns
    assert len(table.rows) == rows


def test_bands_have_their_ends_in_the_table(tmp_path):
    chart = _bands()
    chart.save(tmp_path / "b.png")
    table = chart.table()
    assert table.head[:4] == ("time_s", "measured_x_m", "measured_y_m", "measured_theta_rad")
    assert "high_90_theta_rad" in table.head
    k = table.head.index("low_50_x_m")
    assert table.rows[0][k] == pytest.approx(1e-3 - 5e-4)


NARROW = np.array([2e-3, 3e-4, 2e-4, 1e-3])
TINY = np.array([2e-5, 1e-6, 1e-6, 1e-5])
WIDE = np.array([0.25, 0.012, 3e-3, 0.6])


def _corner_of(scale):
    """A posterior of four unknowns, at least as wide a prior about it."""
    units = {"mu_pusher": "-", "tripod_radius": "m", LABEL: "m", "registration_theta": "rad"}
    low = np.array([0.0, 0.01, 5e-5, -0.5 * np.pi])
    high = np.array([1.0, 0.06, 2e-2, 0.5 * np.pi])
    centre = np.array([0.265, 0.031, 1e-3, 0.4])
    samples = np.clip(centre + scale * DICE.standard_normal((500, 4)), 1.0001 * low, high)
    return _posterior(units, low, high, samples)


@pytest.mark.parametrize("scale", [NARROW, TINY, WIDE])
def test_axes_of_a_corner_are_as_wide_as_the_samples(scale):
    posterior = _corner_of(scale)
    panels = corner_chart(posterior).figure().axes
    factors = (1.0, 1e3, 1e3, 180.0 / np.pi)
    for k, factor in enumerate(factors):
        own = factor * posterior.points[:, k]
        low, high = panels[5 * k].get_xlim()  # on the diagonal
        assert low <= np.quantile(own, 0.0005)
        assert high >= np.quantile(own, 0.9995)
        if posterior.labels[k] == LABEL:
            assert high / low < 1.5 * own.max() / own.min()
        else:
            assert high - low < 1.2 * np.ptp(own)


@pytest.mark.parametrize("scale", [NARROW, TINY, WIDE])
def test_numbers_and_names_of_a_corner_do_not_collide(scale):
    with mpl.rc_context(palette.STYLE):
        figure = corner_chart(_corner_of(scale)).figure()
    assert not collisions(figure)


def test_the_caption_of_a_corner_names_the_prior():
    said = report._priors(_corner_of(NARROW))
    assert said.startswith("mu_pusher 0 to 1, tripod_radius 10 to 60 mm, model error 0.05 to 20 mm")


def test_the_legend_of_ends_has_markers_as_large_as_the_picture():
    figure = _final().figure()
    largest = max(line.get_markersize() for axes in figure.axes for line in axes.lines)
    (legend,) = figure.legends
    assert max(line.get_markersize() for line in legend.get_lines()) <= 1.2 * largest
