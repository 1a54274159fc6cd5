"""Several readers of one camera: each gets every picture from its beginning on."""

import math
import threading
import time
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from tests.jobs.helpers import await_true

from fixel.testbed.frame_source import HELD, CameraPicture, FrameQueue, FrameSource, Stream
from fixel.testbed.shared_camera import SharedCamera


class Counting(FrameSource):
    """Camera whose pictures are numbered, at most `n` of them."""

    def __init__(self, n=10**9, live=False, pause=0.0):
        self.name, self.n, self.live, self.pause = "counting", n, live, pause
        self.closed = threading.Event()

    def open(self):
        return Stream((4, 3), 30.0, jpeg=False, live=self.live)

    def frames(self):
        for number in range(self.n):
            if self.closed.wait(self.pause):
                break
            yield CameraPicture(time.monotonic(), pixels=np.full((3, 4, 3), number % 251, np.uint8))
        self.ended = "unplugged"

    def close(self):
        self.closed.set()


def numbers(view, count):
    return [int(one.pixels[0, 0, 0]) for one in islice(view.frames(), count)]


def test_two_readers_lose_no_picture_of_a_camera_that_waits():
    camera = SharedCamera(Counting)
    first, second = camera.view(), camera.view()
    found = {}
    threads = [
        threading.Thread(target=lambda view=view: found.update({view: numbers(view, 200)}))
        for view in (first, second)
    ]
    [thread.start() for thread in threads]
    [thread.join(60.0) for thread in threads]
    for view in (first, second):
        assert found[view] == [(found[view][0] + k) % 251 for k in range(200)]
    assert found[first][0] == 0  # the camera waited for its first reader
    camera.close()


def test_a_reader_that_leaves_does_not_hold_up_the_others():
    camera = SharedCamera(Counting)
    lazy, keen = camera.view(), camera.view()
    threading.Timer(0.3, lazy.close).start()
    assert len(numbers(keen, 150)) == 150
    camera.close()


def test_a_slow_reader_of_a_live_camera_loses_pictures_alone():
    ahead = threading.Semaphore(0)  # a reader whose thread is late is not slow

    class Waiting(Counting):
        def frames(self):
            for picture in super().frames():
                ahead.acquire()
                yield picture

        def close(self):
            super().close()
            ahead.release()

    camera = SharedCamera(lambda: Waiting(live=True))
    lazy, keen = camera.view(), camera.view()
    ahead.release(HELD)
    for _ in islice(keen.frames(), 300):
        ahead.release()
    dropped = lazy.dropped
    assert dropped >= 300 - HELD - 1
    assert len(numbers(lazy, 30)) == 30
    assert keen.dropped == 0
    camera.close()
    queue = FrameQueue(lazy, live=True)
    assert queue.lost >= dropped  # a recording states them


def test_a_view_counts_the_torn_pictures_of_its_own_time():
    camera = SharedCamera(lambda: Counting(live=True, pause=0.01))
    camera.source.torn = 3
    view = camera.view()
    assert len(numbers(view, 5)) == 5
    assert view.torn == 0
    camera.source.torn = 5
    assert len(numbers(camera.view(), 3)) == 3
    await_true(lambda: view.torn == 2, "the torn pictures")
    camera.close()


def test_the_end_of_the_camera_ends_every_view_and_it_can_be_opened_again():
    camera = SharedCamera(lambda: Counting(n=5))
    view = camera.view()
    assert numbers(view, 100) == [0, 1, 2, 3, 4]
    assert view.ended == camera.reason == "unplugged"

    camera.restart()
    assert numbers(camera.view(), 100) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("live", [True, False])
def test_a_queue_of_frames_can_be_closed_and_begun_again(live):
    camera = SharedCamera(lambda: Counting(live=live, pause=0.001))
    for _ in range(3):
        queue = FrameQueue(camera.view(), live=live)
        queue.start()
        assert queue.get(60.0) is not None
        queue.close()
    camera.close()


@pytest.mark.parametrize(
    ("interval", "allowed"), [(0.01, 0.5), (1 / 30, 0.5), (0.2, 1.0), (0.5, 2.5), (2.0, 4.0)]
)
def test_the_silence_of_a_live_camera_is_judged_by_its_rate(monkeypatch, interval, allowed):
    """On a clock of the test: five pictures, at least 0.5 s and at most 4 s."""
    now, sent = [0.0], threading.Event()
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr("fixel.testbed.shared_camera.time", clock)

    class Regular(Counting):
        def frames(self):
            for picture, _ in zip(super().frames(), range(200), strict=False):
                now[0] += interval
                yield picture
            sent.set()
            self.closed.wait(60.0)

    for live in (True, False):
        sent.clear()
        camera = SharedCamera(lambda live=live: Regular(live=live))
        if not live:  # it waits for a reader
            assert len(numbers(camera.view(), 199)) == 199
        assert sent.wait(60.0)
        assert camera.patience == pytest.approx(allowed if live else math.inf)
        now[0] += 0.95 * allowed
        assert not camera.lost
        now[0] += 0.1 * allowed
        assert ("has sent nothing for" in camera.lost) == live
        camera.close()
        assert camera.lost == "the camera was closed"
