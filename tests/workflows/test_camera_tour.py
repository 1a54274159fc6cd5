"""The whole way from a film to parameters."""

import math
from pathlib import Path

import pytest

from fixel.errors import InvalidInput
from fixel.model.records import Estimate
from fixel.workflows.camera_tour import run_camera_tour, within_interval


def estimate(value: float, low: float | None, high: float | None) -> Estimate:
    return Estimate(label="mu_pusher", unit="", value=value, low=low, high=high)


@pytest.mark.parametrize(
    ("low", "high", "true", "expected"),
    [
        (0.2, 0.4, 0.39, True),
        (0.2, 0.4, 0.41, False),
        (None, 0.4, 0.0, True),
        (None, None, 9, True),
    ],
)
def test_an_interval_without_an_end_holds_everything_on_that_side(
    low: float | None, high: float | None, true: float, expected: bool
) -> None:
    assert within_interval(estimate(0.3, low, high), estimate(true, None, None)) is expected


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="something there already"):
        run_camera_tour(tmp_path)


@pytest.mark.slow
def test_the_film_gives_the_parameters_that_true_poses_give(tmp_path: Path) -> None:
    tour = run_camera_tour(tmp_path / "tour", pushes=(0, 12))
    assert tour.lost == 0
    assert tour.errors.position < 1.5e-4
    assert tour.errors.angle < math.radians(0.15)
    assert all(within_interval(*pair) for pair in tour.estimates)
    assert any(tracked.verdict == "identified" for tracked, _ in tour.estimates)
    assert "side_by_side" in tour.report.page.read_text(encoding="utf-8")
