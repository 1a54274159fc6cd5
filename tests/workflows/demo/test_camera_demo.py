"""The whole way from a film to parameters."""

import math
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.model import Flag
from fixel.model.records import Estimate
from fixel.vision.frame import Frame
from fixel.workflows.demo import camera_demo
from fixel.workflows.demo.camera_demo import estimate_table, run_camera_tour, within_interval

pytestmark = pytest.mark.system


def estimate(value: float, low: float | None, high: float | None) -> Estimate:
    return Estimate(
        label="mu_pusher", unit="", value=value, low=low, high=high, verdict="identified"
    )


@pytest.mark.parametrize(("low", "high", "true", "expected"), [
    (0.2, 0.4, 0.39, True),
    (0.2, 0.4, 0.41, False),
    (None, 0.4, 0.0, True),
    (None, None, 9, True),
])  # fmt: skip
def test_an_interval_without_an_end_holds_everything_on_that_side(
    low: float | None, high: float | None, true: float, expected: bool
) -> None:
    assert within_interval(estimate(0.3, low, high), true) is expected


def test_the_table_compares_both_estimates_with_the_truth() -> None:
    pairs = ((estimate(0.3, 0.2, 0.4), estimate(0.21, 0.2, 0.22)),) * 2
    table = estimate_table(pairs, (0.25, None))
    (_, truth, film, exact, agree), (_, none, *_) = table.rows
    assert (truth, none, agree) == ("0.2500", "none", "yes")
    assert film == "0.3000 (0.2000 to 0.4000), identified: right"
    assert exact == "0.2100 (0.2000 to 0.2200), identified: WRONG"
    radius = Estimate(label="tripod_radius", unit="m", value=0.055, low=0.045, high=None,
                      verdict="effective")  # fmt: skip
    ((name, _, film, *_),) = estimate_table(((radius, radius),), (0.05,)).rows
    assert (name, film) == ("tripod_radius", "55.00 mm (at least 45.00 mm), effective: right")
    assert not any("right" in cell or "WRONG" in cell for cell in table.rows[1])


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path) -> None:
    refused(run_camera_tour, tmp_path, match="an existing file or folder")


@pytest.mark.slow
def test_the_film_gives_the_parameters_that_true_poses_give(tmp_path: Path) -> None:
    tour = run_camera_tour(tmp_path / "tour", pushes=(0, 12))
    assert tour.lost == 0
    position, angle = tour.errors
    assert position < 1.5e-4
    assert angle < math.radians(0.15)
    assert all(within_interval(tracked, true.value) for tracked, true in tour.estimates)
    assert tour.truths[0] is not None
    for pair, truth in zip(tour.estimates, tour.truths, strict=True):
        for one in pair:
            assert one.verdict != "identified" or truth is None or within_interval(one, truth)
    assert "side_by_side" in tour.report.page.read_text(encoding="utf-8")


def test_the_first_sentence_comes_before_anything_is_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []

    def simulated(*_: object) -> None:
        raise RuntimeError(said[-1])

    monkeypatch.setattr(camera_demo.SimulatedTestbed, "run", simulated)
    with pytest.raises(RuntimeError, match="simulating 1 pushes"):
        run_camera_tour(tmp_path / "tour", pushes=(0,), notify=said.append)


class Bench:
    """Stands in for filming, recording and tracking, and counts them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tracked: list[bool]) -> None:
        self.recorded, self.filmed = 0, 0
        self._tracked = tracked
        for name in ("record_film", "track_film", "load_scene", "_filmed", "_firmware"):
            stand_in = getattr(self, name, lambda *_, **__: MagicMock())
            monkeypatch.setattr(camera_demo, name, stand_in)

    def _filmed(self, project: object, folder: Path, *_: object) -> list[Path]:
        return [folder / "films" / "push"]

    def record_film(self, made: Path, out: Path, *_: object) -> tuple[object, float]:
        self.recorded += 1
        with RecordingWriter(out, RecordingHeader(size=(8, 8), codec="exact")) as writer:
            writer.write(Frame(0.0, np.zeros((8, 8, 3), np.uint8)))
        return MagicMock(), 0.1

    def track_film(self, *_: object, **__: object) -> object:
        scene = MagicMock() if self._tracked.pop(0) else None
        flags = (Flag("no-scene", "object first visible at 0.81 s, when it already moved"),)
        return MagicMock(experiment=MagicMock(scene=scene, flags=flags))


def test_a_run_that_cannot_be_tracked_ends_in_a_sentence_and_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A busy computer: two recordings without a start, later a good one."""
    bench = Bench(monkeypatch, [False, False, True])
    folder = tmp_path / "tour"
    error = refused(run_camera_tour, folder, pushes=(0,), match=r"first visible at 0\.81 s")
    assert "continue" in str(error.hint)
    assert bench.recorded == 2
    refused(run_camera_tour, folder, pushes=(12,), match="a tour of other pushes")
    monkeypatch.setattr(camera_demo, "true_twin", reached)
    with pytest.raises(Reached):
        run_camera_tour(folder, pushes=(0,))
    assert bench.recorded == 3


def test_what_was_recorded_is_not_recorded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(monkeypatch, [True, True])
    monkeypatch.setattr(camera_demo, "true_twin", reached)
    for _ in range(2):
        with pytest.raises(Reached):
            run_camera_tour(tmp_path / "tour", pushes=(0,))
    assert bench.recorded == 1


class Reached(Exception):
    """Recording and tracking are done."""


def reached(*_: object) -> None:
    raise Reached
