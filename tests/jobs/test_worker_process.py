"""A function in a process that can be ended."""

import math
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import pytest
from tests.jobs.helpers import await_true, kill

from fixel.errors import JobRefused
from fixel.jobs.worker_process import CallCancellation, WorkerProcess

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def root():
    with WorkerProcess(math.sqrt, limit=30.0) as bounded:
        yield bounded


def test_it_answers_as_the_function_would(root):
    assert root.call(9.0) == 3.0
    process = root._process.pid
    assert root.call(16.0) == 4.0
    assert root._process.pid == process  # the same one: it stays


def test_and_raises_as_the_function_would(root):
    with pytest.raises(ValueError, match="math domain"):
        root.call(-1.0)
    assert root.call(1.0) == 1.0


def test_a_call_that_takes_too_long_is_ended_and_the_next_one_works():
    with WorkerProcess(time.sleep, limit=2.0) as sleep:
        sleep.start()
        began = time.monotonic()
        with pytest.raises(JobRefused, match=r"more than 2 s"):
            sleep.call(60.0)
        assert time.monotonic() - began < 40.0
        assert sleep.call(0.0) is None


def test_a_cancelled_call_is_ended():
    with WorkerProcess(time.sleep, limit=60.0) as sleep:
        sleep.start()
        gone = threading.Event()
        threading.Timer(0.1, gone.set).start()
        with pytest.raises(CallCancellation):
            sleep.call(60.0, gone.is_set)
        assert sleep._process is None


def test_a_process_that_dies_is_reported_and_replaced():
    with WorkerProcess(os._exit, limit=30.0) as end:
        with pytest.raises(JobRefused, match="died"):
            end.call(3)
        with pytest.raises(JobRefused, match="died"):
            end.call(4)


def test_a_process_that_hangs_and_hears_nothing_is_reported_and_replaced():
    with WorkerProcess(len, limit=0.5) as length:
        length.start()
        os.kill(length._process.pid, signal.SIGSTOP)
        with pytest.raises(JobRefused, match="died"):
            length.call(bytes(8_000_000))
        length.limit = 30.0
        assert length.call(b"abc") == 3


def test_others_wait_for_their_turn_only_so_long():
    with WorkerProcess(time.sleep, limit=0.5) as sleep:
        sleep.start()
        sleep._turn.acquire()
        with pytest.raises(JobRefused, match="another computation has run"):
            sleep.call(0.0)
        with pytest.raises(CallCancellation):
            sleep.call(0.0, lambda: True)
        sleep._turn.release()


def test_the_first_call_waits_for_a_process_that_starts_longer_than_for_another_call():
    with WorkerProcess(len, limit=2.0, ready=partial(time.sleep, 4.0)) as length:
        starter = threading.Thread(target=length.start)
        starter.start()
        while not length._starting:
            time.sleep(0.01)
        assert length.call(b"abc") == 3
        starter.join()


def test_it_ends_with_the_program_that_started_it_also_in_the_middle_of_a_call(tmp_path):
    script = tmp_path / "program.py"
    script.write_text(
        "import os, threading, time\n"
        "from fixel.jobs.worker_process import WorkerProcess\n"
        "if __name__ == '__main__':\n"
        "    sleep = WorkerProcess(time.sleep, limit=60.0)\n"
        "    sleep.start()\n"
        "    threading.Thread(target=sleep.call, args=(60.0,), daemon=True).start()\n"
        "    time.sleep(0.2)\n"
        "    print(sleep._process.pid, flush=True)\n"
        "    os._exit(0)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    process = int(done.stdout)
    await_true(lambda: not kill(process, 0), "its end", 40.0)
