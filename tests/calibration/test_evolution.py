import math
import os
import warnings

import numpy as np
import pytest

from fixel.calibration import CmaEs, SearchBox
from fixel.testing.optimiser_contract import bowl, box, run


def rastrigin(x):
    z = (x - 0.62) / 0.1
    return float((z**2 + 3.0 * (1.0 - np.cos(2.0 * np.pi * z))).sum())


def test_finds_its_way_through_many_minima():
    area = SearchBox(np.zeros(2), np.ones(2), np.full(2, 0.1), np.full(2, 0.1))
    search = CmaEs(restarts=3).start(area, seed=1)
    run(search, rastrigin)
    assert search.best.point == pytest.approx([0.62, 0.62], abs=1e-4)


def test_start_is_evaluated_with_the_first_cloud():
    search = CmaEs(population=6).start(box())
    asked = search.ask()
    assert asked.shape == (7, 3)
    assert np.array_equal(asked[0], box().start)
    search.tell(np.arange(7.0))
    assert len(search.ask()) == 6


def test_each_restart_is_twice_as_large():
    search = CmaEs(population=5, restarts=2, tolerance=0.1).start(box())
    journal = run(search, bowl)
    assert [n for n in (5, 10, 20) if any(len(points) == n for points, _ in journal)] == [5, 10, 20]


def test_reason():
    search = CmaEs().start(box())
    run(search, bowl)
    assert search.reason == "the cloud shrank to the tolerance"
    search = CmaEs(max_evaluations=30).start(box())
    run(search, bowl)
    assert search.reason == "30 evaluations were made"


def test_a_cloud_on_nothing_comes_home():
    area = box()

    def island(x):
        return bowl(x) if np.abs((x - area.start) / area.scale).max() < 0.3 else math.inf

    search = CmaEs().start(area)
    run(search, island)
    assert search.best.error < bowl(area.start)


def test_leaves_warnings_files_and_screen_alone(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(CmaEs(restarts=1).start(box()), bowl)
    assert os.listdir(tmp_path) == []
    assert capfd.readouterr() == ("", "")
