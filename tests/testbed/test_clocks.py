"""Clocks of boards and cameras, against known delays, drift and faults."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.testbed.films import film
from tests.testbed.test_frame_source import Webcam

from fixel.testbed.clocks import CaptureClock, DeviceClock
from fixel.testbed.file_source import LoopbackCamera
from fixel.testbed.open_source import DeviceSource, UrlSource


def exchanges(duration: float, drift: float, seed: int = 1):
    """True instants on the host, and what an exchange at 30 Hz tells of them."""
    random = np.random.default_rng(seed)
    for instant in 100.0 + np.arange(0.0, duration, 1 / 30):
        ticks = int(1e6 * (3.0 + (instant - 100.0) / (1.0 + drift))) % 2**32
        before, after = random.exponential(4e-4, 2)
        yield instant, ticks, instant - before - 1e-5, instant + after + 1e-5


@pytest.mark.parametrize("drift", [0.0, 0.005, -0.005, 3e-5])
def test_offset_and_drift_are_found(drift):
    clock = DeviceClock()
    error, raw = [], []
    for instant, ticks, earliest, latest in exchanges(20.0, drift):
        _, host = clock.place(ticks, earliest, latest)
        error.append(host - instant)
        raw.append(0.5 * (earliest + latest) - instant)

    settled = slice(90, None)
    assert clock.drift == pytest.approx(drift, abs=3e-5)
    assert np.abs(error[settled]).max() < 3e-4
    assert np.std(error[settled]) < 0.4 * np.std(raw[settled])


def test_the_result_stays_in_the_room_of_the_exchange():
    clock = DeviceClock()
    random = np.random.default_rng(2)
    for _, ticks, earliest, latest in exchanges(5.0, 0.004):
        _, host = clock.place(ticks + int(random.integers(0, 20000)), earliest, latest)
        assert earliest <= host <= latest


def test_the_count_wraps_without_a_restart():
    clock = DeviceClock()
    start = 2**32 - 500_000
    for k in range(30):
        device, _ = clock.place((start + k * 33_333) % 2**32, k / 30, k / 30 + 1e-3)
        assert device == pytest.approx(1e-6 * (start + k * 33_333))
    assert clock.restarts == 0


def test_a_restart_is_noticed():
    clock = DeviceClock()
    clock.place(50_000_000, 10.0, 10.001)
    device, host = clock.place(20_000, 10.5, 10.501)

    assert clock.restarts == 1
    assert device == pytest.approx(0.02)
    assert 10.5 <= host <= 10.501


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
