"""Ctrl-C during compiled rollouts: prompt, with what was computed, and the next call works."""

import os
import signal
import socket
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from fixel.errors import Interrupted
from fixel.kernels.arrays import STOP
from fixel.simulation import StewartTrinkle, simulate, simulate_batch, threads
from fixel.testing.scenes import pushed_square

LONG = {"stepper": StewartTrinkle(step=1e-6)}  # a rollout of ten seconds of computing
FINE = {"stepper": StewartTrinkle(step=1e-3)}
SOON_S = 0.3
PROMPT_S = 5.0  # on a machine that does other things as well; alone it takes milliseconds

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(sys.platform == "win32", reason="sends a signal of POSIX"),
]


@contextmanager
def ctrl_c():
    """Send the signal of Ctrl-C to this process soon, and check how long the block goes on."""
    simulate(pushed_square())  # compiled before
    sent = []

    def send():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(SOON_S, send)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    assert time.monotonic() - sent[0] < PROMPT_S


@contextmanager
def restored(fd, handler):
    try:
        yield
    finally:
        signal.set_wakeup_fd(fd)
        signal.signal(signal.SIGUSR1, handler)


def test_a_long_rollout_stops_with_its_motion_up_to_then():
    with ctrl_c(), pytest.raises(Interrupted) as stop:
        simulate(pushed_square(), output_interval=0.001, **LONG)
    result = stop.value.result
    assert result.status == "interrupted"
    assert 0.0 < result.stopped_at < 2.0
    assert len(result.time) == len(result.pose["part"]) > 1
    assert "interrupted" in repr(result)
    assert simulate(pushed_square()).converged


@pytest.mark.parametrize("n_threads", [1, 2])
def test_a_long_batch_stops_with_the_runs_that_ended(n_threads):
    friction = np.linspace(0.1, 0.4, 5_000)  # of 15 ms each
    with ctrl_c(), pytest.raises(KeyboardInterrupt) as stop:
        simulate_batch(pushed_square(), {"mu_pusher": friction}, threads=n_threads, **FINE)
    runs = stop.value.result
    assert len(runs) == len(friction)
    assert set(runs.status) == {"converged", "interrupted"}
    alone = simulate_batch(pushed_square(), {"mu_pusher": friction[:1]}, **FINE)
    assert np.array_equal(runs[0].final, alone.final)


def test_other_threads_run_their_rollouts_themselves():
    ends = []
    other = threading.Thread(target=lambda: ends.append(simulate(pushed_square()).status))
    other.start()
    other.join()
    assert ends == ["converged"]


def test_a_late_signal_of_an_earlier_call_stops_nothing(monkeypatch):
    calls = []
    roll = threads.kernel.rollout_batch

    def stopped_once(*arguments):
        calls.append(1)
        if len(calls) == 1:
            arguments[2].total[:, STOP] = 1.0
        roll(*arguments)

    expected = simulate(pushed_square())
    monkeypatch.setattr(threads.kernel, "rollout_batch", stopped_once)

    assert simulate(pushed_square()).final == expected.final
    assert len(calls) == 2


def test_other_signals_reach_whoever_waited_for_them():
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    fd = signal.set_wakeup_fd(sender.fileno())
    with receiver, sender, restored(fd, before):
        timer = threading.Timer(SOON_S, os.kill, (os.getpid(), signal.SIGUSR1))
        timer.start()
        run = simulate(pushed_square(duration=0.1), output_interval=0.01, **LONG)
        receiver.settimeout(5.0)
        assert receiver.recv(1) == bytes([signal.SIGUSR1])
        assert signal.set_wakeup_fd(fd) == sender.fileno()
    assert run.converged


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forking with another thread
def test_a_forked_process_watches_for_itself():
    simulate(pushed_square())
    friction = {"mu_pusher": np.linspace(0.1, 0.4, 8)}
    runs = simulate_batch(pushed_square(), friction, threads=2)
    child = os.fork()
    if child == 0:
        own = simulate_batch(pushed_square(), friction, threads=2)
        same = np.array_equal(own.final, runs.final)
        os._exit(0 if same and simulate(pushed_square()).converged else 1)
    assert os.waitpid(child, 0)[1] == 0
