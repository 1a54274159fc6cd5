"""When a frame was taken, from the camera's stamps and the arrivals."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.testbed.films import film
from tests.testbed.test_frame_source import Webcam

from fixel.testbed.clocks import CaptureClock
from fixel.testbed.device_source import DeviceSource
from fixel.testbed.loopback import LoopbackCamera
from fixel.testbed.url_source import UrlSource


def placed(stamps: Any, arrivals: Any) -> np.ndarray:
    clock = CaptureClock()
    return np.array([clock.place(s, a) for s, a in zip(stamps, arrivals, strict=True)], float)


def test_stamps_of_this_clock_are_taken_as_they_are() -> None:
    taken = 100.0 + np.arange(50) / 30.0
    held = np.random.default_rng(0).exponential(0.03, 50)
    np.testing.assert_array_equal(placed(taken, taken + held), taken)


def test_another_clock_is_tied_by_the_shortest_delay() -> None:
    """The camera's clock is 1.7 billion seconds ahead, and gains 50 millionths."""
    taken = 100.0 + np.arange(900) / 30.0
    held = 0.01 + np.random.default_rng(0).exponential(0.02, 900)
    found = placed(1.7e9 + taken * (1.0 + 50e-6), taken + held)
    off = found - taken - 0.01
    assert np.abs(off[100:]).max() < 2e-3
    assert np.diff(found).std() < 1e-3 < held.std()


@pytest.mark.parametrize("stamp", [None, 0.0, -1.0, float("nan")])
def test_no_stamp_is_no_capture_time(stamp: float | None) -> None:
    assert CaptureClock().place(stamp, 5.0) is None


def test_a_stamp_that_stands_still_is_none() -> None:
    clock = CaptureClock()
    assert clock.place(50.0, 50.1) == 50.0
    assert clock.place(50.0, 50.2) is None


def test_a_clock_that_is_set_is_followed() -> None:
    clock = CaptureClock()
    clock.place(1e6, 10.0)
    assert clock.place(2e6, 10.1) == pytest.approx(10.1)


def test_a_webcam_says_when_a_frame_was_taken() -> None:
    class Stamped(Webcam):
        def get(self, what: int) -> float:
            if what == cv2.CAP_PROP_POS_MSEC:
                return 1e3 * (began + self.k / 30.0)
            return super().get(what)

    began = time.monotonic() - 0.5
    webcam = Stamped(5)
    with DeviceSource("0", capture=lambda _: webcam) as source:
        source.open()
        taken = [arrived.taken for arrived in source.frames()]
    assert np.diff(taken) == pytest.approx(1 / 30.0)


def test_a_network_camera_says_when_a_frame_was_taken(tmp_path: Path) -> None:
    with LoopbackCamera(film(tmp_path / "film", n=12, rate=50.0)) as camera:
        source = UrlSource(camera.url)
        with source:
            source.open()
            taken = [arrived.taken for arrived in source.frames()]
    assert np.diff(taken) == pytest.approx(0.02, abs=2e-6)
