"""The journal: what `append` has returned for is there, whatever happens next."""

import errno
import os
import random
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.fixtures import refused
from tests.processes import line_of

from fixel.errors import JobRefused
from fixel.io import lock
from fixel.io.journal import MAGIC, Journal, read_journal, writer_of
from fixel.io.lock import FileLock, holder

BLOCKS = [("a", b"first"), ("b", b""), ("ä/2", bytes(range(256)) * 20), ("c", b"last")]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "journal"
    with Journal(path) as journal:
        assert journal.append(BLOCKS) == len(BLOCKS)
    return path


def other_process(path, code):
    script = (
        "from pathlib import Path\n"
        "from fixel.io.journal import Journal\n"
        f"journal = Journal(Path({str(path)!r}))\n{code}"
    )
    return subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)


def test_a_journal_of_marks_alone_is_refused_soon(tmp_path, monkeypatch):
    """The rest of the file would be read for each mark, as each may begin a large block."""
    path, mark, read = tmp_path / "journal", b"\1" * 8, []
    front = mark + struct.pack("<IQI", 4, 10_000, 0)
    path.write_bytes(MAGIC + mark + front * 5_000)
    monkeypatch.setattr("fixel.io.journal._pieces", lambda *place: read.append(place) or ())
    refused(list, read_journal(path), match="damage in all of it")
    assert len(read) < 1100


def test_what_is_appended_is_read_back(path):
    assert list(read_journal(path)) == BLOCKS
    with Journal(path) as journal:
        assert (len(journal), list(journal), journal.damaged) == (4, [n for n, _ in BLOCKS], 0)
        assert journal.get("ä/2") == BLOCKS[2][1]
        assert journal.get("z") is None
        assert "b" in journal


def test_the_first_of_a_name_counts(path):
    with Journal(path) as journal:
        assert journal.append([("a", b"second"), ("d", b"new"), ("d", b"newer")]) == 1
        assert journal.append([("d", b"again")]) == 0
        assert (journal.get("a"), journal.get("d")) == (b"first", b"new")
    assert dict(read_journal(path))["d"] == b"new"


def test_a_tail_torn_anywhere_costs_that_block_alone(path):
    whole = path.read_bytes()
    start = whole.rindex(whole[len(MAGIC) : len(MAGIC) + 8])
    for length in range(start, len(whole)):
        path.write_bytes(whole[:length])
        with Journal(path) as journal:
            assert list(journal) == ["a", "b", "ä/2"]
            journal.append([("d", b"after")])
        assert list(read_journal(path)) == [*BLOCKS[:3], ("d", b"after")]


def test_any_corrupt_byte_costs_at_most_its_block(path):
    whole = path.read_bytes()
    names = [name for name, _ in BLOCKS]
    generator = random.Random(0)
    for position in generator.sample(range(24, len(whole)), 200):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << generator.randrange(8)
        path.write_bytes(damaged)
        with Journal(path) as journal:
            lost = set(names) - set(journal)
            assert len(lost) == 1
            assert journal.damaged == (lost != {"c"})
            assert all(journal.get(n) == data for n, data in BLOCKS if n not in lost)
            journal.append([(lost.pop(), b"computed again")])
        assert {n for n, _ in read_journal(path)} == set(names)


def test_another_file_is_refused_and_left_alone(tmp_path):
    for content in (b"something", b"something much longer than a header is"):
        path = tmp_path / "notes"
        path.write_bytes(content)
        refused(Journal, path, match="fixel needs a journal")
        assert path.read_bytes() == content


def test_a_header_cut_short_is_begun_again(tmp_path):
    path = tmp_path / "journal"
    for begun in (b"", MAGIC[:7], MAGIC + b"mark"):  # as another process sees it meanwhile
        path.write_bytes(begun)
        assert list(read_journal(path)) == []
    with Journal(path) as journal:
        journal.append([("a", b"1")])
    assert list(read_journal(path)) == [("a", b"1")]


def test_a_second_writer_is_refused_while_the_first_lives(path):
    first = other_process(path, "import time; print('open', flush=True); time.sleep(60)")
    assert line_of(first) == "open\n"
    assert writer_of(path).pid == first.pid
    with pytest.raises(JobRefused, match=f"in use by process {first.pid} on "):
        Journal(path)
    assert dict(read_journal(path)) == dict(BLOCKS)  # reading is free
    first.send_signal(signal.SIGKILL)
    first.wait()
    first.stdout.close()
    assert writer_of(path) is None
    with Journal(path) as journal:
        assert len(journal) == 4


@pytest.mark.system
def test_kill_9_while_writing_loses_nothing_that_was_reported(tmp_path):
    path = tmp_path / "journal"
    code = (
        "import os\n"
        "for k in range(len(journal), 10**6):\n"
        "    journal.append([(str(k), os.urandom(4000))])\n"
        "    print(k, flush=True)\n"
    )
    reported = -1
    for seed in range(8):
        process = other_process(path, code)
        line_of(process)
        time.sleep(0.02 + 0.03 * random.Random(seed).random())
        process.kill()
        said = process.stdout.read().split()
        process.wait()
        process.stdout.close()
        reported = max([reported, *(int(k) for k in said if k.isdigit())])
        names = [name for name, _ in read_journal(path)]
        assert names == [str(k) for k in range(len(names))]
        assert len(names) > reported
    assert reported > 8


def test_a_full_disk_leaves_the_journal_as_it_was(path):
    with Journal(path) as journal:
        write, calls = journal._stream.write, []

        class Full:
            def __getattr__(self, name):
                return getattr(stream, name)

            def write(self, data):
                calls.append(len(data))
                if len(calls) > 1:
                    raise OSError(28, "No space left on device")
                return write(data[: len(data) // 2])

        stream = journal._stream
        journal._stream = Full()
        with pytest.raises(JobRefused, match="no space left on device"):
            journal.append([("d", b"x" * 1000)])
        journal._stream = stream
        assert "d" not in journal
        journal.append([("d", b"fits now")])
    assert dict(read_journal(path)) == dict(BLOCKS) | {"d": b"fits now"}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES])
def test_the_advice_fits_the_error(path, monkeypatch, number):
    open_file = os.open

    def fail(name, *options):
        if Path(name).suffix == ".lock":
            return open_file(name, *options)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", fail)
    with pytest.raises(
        JobRefused, match=f"cannot be written: {os.strerror(number).lower()}"
    ) as bad:
        Journal(path)
    is_full = number in (errno.ENOSPC, errno.EDQUOT)
    assert ("free disk space" in str(bad.value)) == is_full


def test_a_look_at_the_lock_does_not_take_it(tmp_path):
    path = tmp_path / "lock"
    assert holder(path) is None
    with FileLock(path, "it"):
        assert holder(path).pid == os.getpid()
    assert holder(path) is None
    FileLock(path, "it").release()


def test_where_the_file_system_knows_no_locks_a_file_stands_in(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "_lock", lambda descriptor, shared=False: None)
    monkeypatch.setattr(lock, "PATIENCE_S", 0.05)
    path = tmp_path / "lock"
    with FileLock(path, "it"):
        assert holder(path).pid == os.getpid()
        with pytest.raises(JobRefused, match=f"process {os.getpid()} on"):
            FileLock(path, "it")
    assert holder(path) is None
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    host = os.uname().nodename
    (tmp_path / "lock.held").write_text(f'{{"host": "{host}", "pid": {gone.pid}}}')
    FileLock(path, "it").release()
    (tmp_path / "lock.held").write_text('{"host": "elsewhere", "pid": 1}')
    with pytest.raises(JobRefused, match="process 1 on elsewhere"):
        FileLock(path, "it")


def test_large_blocks_are_dropped_and_the_others_stay(tmp_path):
    path = tmp_path / "journal"
    with Journal(path) as journal:
        journal.append([("a", b"small"), ("b", bytes(1000)), ("c", bytes(10))])
        journal.drop(larger_than=100)
        assert list(journal) == ["a", "c"]
        assert journal.get("b") is None
        assert journal.append([("d", b"later")]) == 1
    assert path.stat().st_size < 300
    assert dict(read_journal(path)) == {"a": b"small", "c": bytes(10), "d": b"later"}
    with Journal(path) as journal:
        assert journal.damaged == 0
        before = path.read_bytes()
        journal.drop(larger_than=100)
        assert path.read_bytes() == before
