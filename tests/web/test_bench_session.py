"""The bench of a server, without devices."""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

from tests.jobs.helpers import await_true

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
