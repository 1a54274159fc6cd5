"""Learned residuals on sides never pushed, on made-up pushes and on real ones."""

from importlib.util import find_spec

import numpy as np
import pytest
from reproductions import protocols
from reproductions.learned_sides import MAX_LOSS, quarter_labels
from reproductions.protocols import BenchmarkData, BenchmarkRequest
from reproductions.run import reproduce
from tests.reproductions.test_mit_push import made_up

from fixel.datasets.mit_push import read_mit_pushes
from fixel.io.array_bytes import ResultCache

pytestmark = pytest.mark.skipif(find_spec("sklearn") is None, reason="no sklearn")


def test_quarters_are_equally_large_and_contiguous(tmp_path):
    data = read_mit_pushes(made_up(tmp_path / "data", 32))
    bench = BenchmarkData(data, BenchmarkRequest(), ResultCache(None), lambda *_: None)
    group = bench.group(next(key for key in bench.rows if key[1] == "block"))

    quarter = quarter_labels(group)

    assert np.bincount(quarter).tolist() == [8, 8, 8, 8]
    away, (c, s) = group.tip_start - group.start[:, :2], (np.cos, np.sin)
    turn = group.start[:, 2]
    tip = np.stack([c(turn) * away[:, 0] + s(turn) * away[:, 1],
                    c(turn) * away[:, 1] - s(turn) * away[:, 0]])  # fmt: skip
    x, y = np.clip(tip, -0.03, 0.03)  # the nearest point of the block
    angle = [np.arctan2(y, x)[quarter == k] for k in range(4)]
    assert all(angle[k].max() <= angle[k + 1].min() for k in range(3))


@pytest.mark.system
def test_the_command_reports_what_it_has_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(protocols, "QUICK_SHAPES", 1)
    monkeypatch.setattr(protocols, "QUICK_ITERATIONS", 1)
    made_up(tmp_path / "mit_push_endpoints", 64)

    answer = reproduce("learned-sides", tmp_path, out=tmp_path / "out", quick=True)

    for row, group in zip(answer.tables["overall"], answer.tables["groups"], strict=True):
        assert row["pushes"] == group["pushes"] == 60
        assert row["worst_group_mm"] == group["group"] == "felt block"
        assert row["worst_change_mm"] == pytest.approx(row["learned_mm"] - row["physics_mm"])
        assert row["worst_change_mm"] < MAX_LOSS["mm"]
    assert "in the worst groups" in answer.conclusions[0]
    assert (tmp_path / "out" / "learned-sides.png").stat().st_size > 5_000


@pytest.mark.slow
def test_a_process_does_no_harm_on_real_sides_never_pushed(data_root):
    answer = reproduce("learned-sides", data_root)
    for row in answer.tables["overall"]:
        for unit, limit in MAX_LOSS.items():
            assert row[f"worst_change_{unit}"] <= limit
            assert row[f"learned_{unit}"] <= row[f"physics_{unit}"] + 0.01
