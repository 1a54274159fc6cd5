"""Pictures of posteriors, bands, final poses and coverage, and their tables."""

from __future__ import annotations

import numpy as np
import pytest

from fixel.drawing.chart import draw_chart
from fixel.drawing.coverage import CoverageChart, CoveragePanel
from fixel.drawing.uncertainty import (
    Axis,
    BandsChart,
    CornerChart,
    FinalPoseChart,
    FinalRegion,
    PathBand,
)

DICE = np.random.default_rng(0)
POSES = DICE.standard_normal((80, 3)) * np.array([1e-3, 2e-3, 0.02]) + np.array([0.1, 0.0, 0.5])


def _corner():
    axes = [
        Axis("mu_pusher", "-", 0.0, 1.0, truth=0.3),
        Axis("tripod_radius", "m", 0.01, 0.06),
        Axis("model error", "m", 5e-5, 2e-2, logarithmic=True),
    ]
    samples = DICE.random((60, 3)) * np.array([1.0, 0.05, 1e-2]) + np.array([0.0, 0.01, 1e-4])
    mode = (samples[:, 0] > 0.5).astype(int)
    return CornerChart(axes=axes, samples=samples, mode=mode, weights=(0.6, 0.4), title="Corner")


def _bands():
    time = np.linspace(0.1, 2.0, 20)
    path = np.column_stack((0.01 * time, 0.0 * time, 0.1 * time))
    bands = [PathBand(level, path - level * 1e-3, path + level * 1e-3) for level in (0.5, 0.9)]
    return BandsChart(time=time, measured=path, best=path, bands=bands, title="Bands")


def _final():
    outline = 0.05 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    region = FinalRegion(0.9, POSES[:, :2].mean(axis=0), np.array([2e-3, 1e-3]), 1.5, (0.4, 0.6))
    return FinalPoseChart(
        outline=outline, start=np.zeros(3), measured=POSES[0], draws=POSES, regions=[region]
    )


def _curve():
    levels = np.array([0.1, 0.5, 0.9])
    panel = CoveragePanel("final position", levels, levels, levels - 0.05, levels + 0.05,
                          np.array([levels]), 200)  # fmt: skip
    return CoverageChart([panel, panel], "Coverage")


@pytest.mark.parametrize(
    ("chart", "columns", "rows"),
    [
        (_corner(), ("mu_pusher", "tripod_radius_m", "model error_m", "mode"), 60),
        (_final(), ("what", "x_m", "y_m", "theta_rad"), 81),
        (
            _curve(),
            ("bounds", "promised", "held", "true_levels_from", "true_levels_to", "outcomes"),
            6,
        ),
    ],
)
def test_a_picture_and_its_table(chart, columns, rows, tmp_path):
    draw_chart(chart, tmp_path / "a.png", tmp_path / "a.pdf", banner="SIMULATED")
    assert (tmp_path / "a.png").stat().st_size > 5_000
    table = chart.table()
    assert table.columns == columns
    assert len(table.rows) == rows


def test_bands_have_their_ends_in_the_table(tmp_path):
    chart = _bands()
    draw_chart(chart, tmp_path / "b.png")
    table = chart.table()
    assert table.columns[:4] == ("time_s", "measured_x_m", "measured_y_m", "measured_theta_rad")
    assert "high_90_theta_rad" in table.columns
    k = table.columns.index("low_50_x_m")
    assert table.rows[0][k] == pytest.approx(chart.best[0, 0] - 5e-4)
