import numpy as np
import pytest

from fixel.testbed.clocks import DeviceClock


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
