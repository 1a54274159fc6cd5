import gc
import math
import signal
import sys

import numpy as np
import pytest

from fixel.calibration import Mads, mads
from fixel.errors import MissingExtra
from fixel.testing.optimiser_contract import bowl, box, run

pytest.importorskip("PyNomad")


def begun():
    search = Mads().start(box())
    run(search, bowl, 5)
    return search


def process(search):
    return search._nomad._process


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


def test_process_ends_with_the_search():
    search = Mads(max_evaluations=20).start(box())
    assert search._nomad is None  # nothing runs before the first ask
    run(search, bowl)
    assert search.reason == "20 evaluations were made"
    assert search.evaluations == 20
    assert process(search).poll() is not None


def test_process_ends_when_the_search_is_dropped():
    search = begun()
    child = process(search)
    assert child.poll() is None
    del search
    gc.collect()
    assert child.poll() is not None
    assert child.stdout.closed


def test_process_that_died_ends_the_search():
    search = begun()
    search.ask()
    process(search).kill()
    process(search).wait()
    search.tell(np.ones(len(search.ask())))
    assert search.reason == "NOMAD ended without an answer"
    assert math.isfinite(search.best.error)


def test_process_that_hangs_is_ended(monkeypatch):
    search = begun()
    asked = search.ask()
    process(search).send_signal(signal.SIGSTOP)
    monkeypatch.setattr(mads, "THINKS_WITHIN", 0.2)
    search.tell(np.ones(len(asked)))
    assert search.reason == "NOMAD ended without an answer"
    assert process(search).returncode == -signal.SIGKILL


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
