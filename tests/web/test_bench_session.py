"""The bench of a server, without devices."""

import errno
import os
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from tests.jobs.helpers import await_true

from fixel.errors import FixelError
from fixel.web.bench_session import BenchSession


def test_a_campaign_that_is_ended_while_its_devices_open_does_not_begin():
    """Ctrl-C, before anything could stop the drive."""
    session, open_now, ran = BenchSession(), threading.Event(), []

    @contextmanager
    def opened():
        open_now.wait(60.0)
        yield SimpleNamespace(run=lambda: ran.append("moved"))

    starting = threading.Thread(target=session.start, args=(opened(),))
    starting.start()
    await_true(lambda: session.running)
    ending = threading.Thread(target=session.close)
    ending.start()
    ending.join(0.5)
    assert ending.is_alive()  # it waits until the devices are closed
    open_now.set()
    starting.join(60.0)
    ending.join(60.0)
    assert not session.running
    assert ran == []


def test_a_folder_that_cannot_be_written_is_one_sentence(monkeypatch):
    """The terminal showed a traceback of the thread before it, and the page `[Errno 30]`."""
    session, traces = BenchSession(), []
    monkeypatch.setattr(threading, "excepthook", traces.append)

    @contextmanager
    def opened():
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "lab/bench/few")
        yield

    with pytest.raises(FixelError, match="lab/bench/few: read-only file system"):
        session.start(opened())
    assert session.trouble == "lab/bench/few: read-only file system"
    assert not traces
