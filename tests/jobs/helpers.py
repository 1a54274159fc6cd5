"""Toy jobs, and ways to look at and kill their processes."""

import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

from fixel.exchange.journal import MAGIC, read_journal
from fixel.jobs import folder as files
from fixel.jobs.engine import LocalEngine
from fixel.jobs.folder import Run
from fixel.jobs.work import block_name
from fixel.testing.toy_work import MAKER, make_toy_work
from fixel.workflows.jobs import prepare_job

PATIENCE_S = 90.0


def toy_job(folder, run=None, **options):
    """A prepared job of toy work."""
    prepare_job(folder, maker=MAKER, inputs={"offset": b"0.31"}, options=options)
    if run is not None:
        files.write_run(folder, run)
    return folder


def undisturbed(inputs, **options):
    """What a toy job returns when nothing happens, and the names of its blocks."""
    quick = options | {"sleep_s": 0.0, "compute_s": 0.0}
    names = []
    with LocalEngine() as engine:
        work, asked = make_toy_work(inputs, options), make_toy_work(inputs, quick)
        turn, question = next(work), next(asked)
        while True:
            names += [block_name(turn.function, chunk) for chunk in turn.chunks]
            batches = engine.results(question.function, inputs, question.chunks)
            answers = dict(pair for batch in batches for pair in batch)
            try:
                turn, question = work.send(answers), asked.send(answers)
            except StopIteration as end:
                return end.value, names


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


def await_true(condition, what, patience_s=PATIENCE_S):
    """Wait until something holds."""
    deadline = time.monotonic() + patience_s
    while not (held := condition()):
        assert time.monotonic() < deadline, f"waited {patience_s} s for {what}"
        time.sleep(0.05)
    return held


def names_in(folder):
    """Names of the blocks of a job's journal."""
    path = folder / files.JOURNAL
    return [name for name, _ in read_journal(path)] if path.exists() else []


def blocks_written(folder):
    """How many blocks there are in a job's journal, those of equal names too."""
    data = (folder / files.JOURNAL).read_bytes()
    mark = data[len(MAGIC) : len(MAGIC) + 8]
    return data.count(mark) - 1


def best(result):
    """What toy work returned: where the minimum is, and its value."""
    return struct.unpack("<dd", result)


def assert_as_undisturbed(folder, **options):
    """The same bits as without any trouble; every answer kept, and kept once."""
    expected, names = undisturbed(folder / "inputs", **options)
    assert files.read_status(folder).state == "done"
    assert (folder / files.RESULT).read_bytes() == expected
    assert sorted(names_in(folder)) == sorted(names)
    assert blocks_written(folder) == len(names)


LOCAL_2 = Run(workers=2)
