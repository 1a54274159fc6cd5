""" """

import gc
import math
import os
import signal
import sys
import warnings

import numpy as np
import pytest

from fixel.calibration import CmaEs, Mads, SearchBox, external_searches
from fixel.errors import MissingExtra
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


pytest.importorskip("PyNomad")


def begun():
    search = Mads().start(box())
    run(search, bowl, 5)
    return search


@pytest.fixture
def processes(monkeypatch):
    """Processes that searches start, in order."""
    found, popen = [], external_searches.subprocess.Popen

    def start(*arguments, **options):
        found.append(popen(*arguments, **options))
        return found[-1]

    monkeypatch.setattr(external_searches.subprocess, "Popen", start)
    return found


@pytest.mark.system
def test_two_searches_do_not_disturb_each_other():
    alone = np.concatenate([points for points, _ in run(Mads().start(box(), 2), bowl, 80)])
    a, b = Mads().start(box(), 2), Mads().start(box(), 2)
    together = []
    while sum(len(points) for points in together) < len(alone):
        together.append(a.ask().copy())
        for search in (a, b):
            search.tell(np.array([bowl(point) for point in search.ask()]))
    assert np.array_equal(np.concatenate(together), alone)


def test_seeds_differ():
    a, b = (run(Mads().start(box(), seed), bowl, 60) for seed in (1, 2))
    assert any(p.shape != q.shape or not np.array_equal(p, q) for (p, _), (q, _) in zip(a, b))  # noqa: B905


def test_process_ends_with_the_search(processes):
    search = Mads(max_evaluations=20).start(box())
    assert not processes  # nothing runs before the first ask
    run(search, bowl)
    assert search.reason == "20 evaluations were made"
    assert search.evaluations == 20
    (child,) = processes
    assert child.poll() is not None


def test_process_ends_when_the_search_is_dropped(processes):
    search = begun()
    (child,) = processes
    assert child.poll() is None
    del search
    gc.collect()
    assert child.poll() is not None
    assert child.stdout.closed


def test_process_that_died_ends_the_search(processes):
    search = begun()
    search.ask()
    processes[0].kill()
    processes[0].wait()
    search.tell(np.ones(len(search.ask())))
    assert search.reason == "NOMAD ended without an answer"
    assert math.isfinite(search.best.error)


def test_process_that_hangs_is_ended(monkeypatch, processes):
    search = begun()
    asked = search.ask()
    processes[0].send_signal(signal.SIGSTOP)
    monkeypatch.setattr(external_searches, "THINKS_WITHIN", 0.2)
    search.tell(np.ones(len(asked)))
    assert search.reason == "NOMAD ended without an answer"
    assert processes[0].returncode == -signal.SIGKILL


def test_frame_size_ends_it():
    search = Mads(threshold=0.05).start(box())
    run(search, bowl)
    assert search.reason == "the frame shrank to 0.05 of the scale"


def test_silent(capfd):
    run(Mads().start(box()), bowl, 40)
    assert capfd.readouterr() == ("", "")


def test_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "PyNomad", None)
    with pytest.raises(MissingExtra, match=r"pip install 'fixel\[mads\]'"):
        Mads().start(box())
