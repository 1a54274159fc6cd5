"""Ways to look at jobs and kill their processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from fixel.io.journal import MAGIC, read_journal
from fixel.jobs import folder as files
from fixel.jobs.folder import RunSettings

PATIENCE_S = 120.0


def start(folder):
    """A coordinator in a process of its own."""
    with (folder / "coordinator.out").open("ab") as out:
        return subprocess.Popen(
            [sys.executable, "-m", "fixel.jobs.coordinator", str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            start_new_session=True,
        )


def processes(folder, kind):
    """Numbers of the living processes of a job: `worker`, `scheduler` or `coordinator`."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
            except OSError:
                continue
            if (
                f"fixel.jobs.{kind}".encode() in words
                and str(folder.resolve()).encode() in words
                and state != "Z"
            ):
                found.append(int(entry.name))
    return sorted(found)


def kill(pid, how=signal.SIGKILL):
    """Kill a process, if it is still there."""
    try:
        os.kill(pid, how)
    except ProcessLookupError:
        return False
    return True


def await_true(condition, what="what a test expects", patience_s=PATIENCE_S, pause_s=0.02):
    """Wait until something holds."""
    deadline = time.monotonic() + patience_s
    while not (held := condition()):
        assert time.monotonic() < deadline, f"waited {patience_s} s for {what}"
        time.sleep(pause_s)
    return held


def await_while_running(coordinator, folder, condition, what):
    """Wait until something holds; if the coordinator ends before, say its words."""

    def held():
        # Asked before the condition, which may come true with the coordinator's last act.
        ended = coordinator.poll() is not None
        found = condition()
        assert found or not ended, f"no {what}:\n" + (folder / files.LOG).read_text()
        return found

    return await_true(held, what)


def names_in(folder):
    """Names of the blocks of a job's journal."""
    path = folder / files.JOURNAL
    return [name for name, _ in read_journal(path)] if path.exists() else []


def blocks_written(folder):
    """Number of blocks in a job's journal, including those of equal names."""
    data = (folder / files.JOURNAL).read_bytes()
    mark = data[len(MAGIC) : len(MAGIC) + 8]
    return data.count(mark) - 1


LOCAL_2 = RunSettings(workers=2)
