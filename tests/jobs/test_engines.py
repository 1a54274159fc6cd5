"""Contract of all engines, and deaths of the workers of one of them."""

import os
import signal
import socket
import ssl
import subprocess
import sys
import time

import pytest
from tests.fixtures import refused
from tests.jobs.helpers import await_true, kill, processes

from fixel.errors import JobRefused
from fixel.jobs import dask_engine, link
from fixel.jobs.functions import stamp
from fixel.jobs.pool import LocalPool, worker_command
from fixel.jobs.work import OTHER_VERSION, Chunk, Failure, LocalEngine, run_chunk, unframed
from fixel.testing import toy_work

pytest.importorskip("distributed")

from fixel.jobs.dask_engine import Cluster, DaskEngine

pytestmark = pytest.mark.system


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "inputs").mkdir()
    return tmp_path


def chunks(n, **options):
    return [
        Chunk(f"c{k}", toy_work._payload(f"c{k}", 0.1 * k, {"sleep_s": 0.02} | options))
        for k in range(n)
    ]


def workers(folder, size=2, said=None, **options):
    notify = (said if said is not None else []).append
    return DaskEngine(folder, LocalPool(folder, size), notify=notify, **options)


def answers(engine, folder, asked):
    found = [
        pair
        for batch in engine.results(toy_work.FUNCTION, folder / "inputs", asked)
        for pair in batch
    ]
    assert len(dict(found)) == len(found), "an answer came twice"
    return dict(found)


@pytest.mark.parametrize("kind", ["local", "workers"])
def test_the_contract_of_engines(folder, kind):
    asked = chunks(8, faulty=["c3"])
    with LocalEngine() if kind == "local" else workers(folder) as engine:
        found = answers(engine, folder, asked)
        again = answers(engine, folder, asked[:1])
        assert answers(engine, folder, []) == {}
    assert found.keys() == {chunk.name for chunk in asked}
    assert isinstance(found["c3"], Failure)
    assert found["c3"].reason.startswith("ValueError: fails on request (toy_work.py, line ")
    for chunk in asked:
        if chunk.name != "c3":
            assert found[chunk.name] == toy_work.evaluate(folder / "inputs", chunk.payload)
    assert again["c0"] == found["c0"]
    assert not (folder / "tls").exists()
    await_true(lambda: not processes(folder, "worker"), "the workers to end")
    assert not processes(folder, "scheduler")


@pytest.mark.parametrize("size", [0, 1_000_000])
def test_a_number_of_workers_that_no_machine_has_is_refused(folder, size):
    """The number may come from a foreign folder, and each worker is a process."""
    refused(LocalPool, folder, size, match=f"workers is {size}, .* on this machine")


def test_all_talk_is_encrypted_and_on_loopback(folder):
    with workers(folder) as engine:
        answers(engine, folder, chunks(2))
        assert (folder / "tls").stat().st_mode & 0o777 == 0o700
        assert (folder / "tls" / "key.pem").stat().st_mode & 0o777 == 0o600
        assert link.read_address(folder).startswith("tls://127.0.0.1:")
        pids = processes(folder, "worker") + processes(folder, "scheduler")
        assert len(pids) == 3
        for pid in pids:
            await_true(lambda pid=pid: _listening(pid), "it to listen")
            (address,) = _listening(pid)
            assert address.startswith("0100007F:")  # 127.0.0.1 in the kernel's hexadecimal


def test_no_engine_joins_without_the_key_of_the_job(folder):
    with workers(folder, size=1) as engine:
        answers(engine, folder, chunks(1))
        host, _, port = link.read_address(folder).removeprefix("tls://").rpartition(":")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        with (
            socket.create_connection((host, int(port)), timeout=10.0) as plain,
            context.wrap_socket(plain) as encrypted,
            pytest.raises((ssl.SSLError, ConnectionResetError)),
        ):
            encrypted.recv(1)


def _listening(pid):
    names = {os.path.basename(os.readlink(f)) for f in _descriptors(pid)}
    inodes = {n.partition("[")[2].rstrip("]") for n in names if n.startswith("socket:")}
    rows = []
    for file in ("tcp", "tcp6"):
        try:
            with open(f"/proc/{pid}/net/{file}") as table:
                rows += [line.split() for line in table][1:]
        except FileNotFoundError:
            continue
    return [row[1] for row in rows if row[3] == "0A" and row[9] in inodes]  # 0A is listening


def _descriptors(pid):
    folder = f"/proc/{pid}/fd"
    return [f"{folder}/{n}" for n in os.listdir(folder) if os.path.islink(f"{folder}/{n}")]


def test_a_chunk_that_kills_its_workers_is_given_up_and_the_rest_goes_on(folder):
    said = []
    with workers(folder, said=said, max_deaths=3) as engine:
        found = answers(engine, folder, chunks(6, poison=["c1"]))
    assert found["c1"] == Failure("its worker died 3 times while computing it")
    assert all(isinstance(found[f"c{k}"], bytes) for k in (0, 2, 3, 4, 5))
    assert sum("died while computing c1" in sentence for sentence in said) == 3


def test_a_worker_of_another_fixel_is_refused_before_work_starts(folder, monkeypatch):
    (folder / "calls").touch()
    monkeypatch.setattr("fixel.jobs.pool.stamp", lambda: "0.0.9+0123456789abcdef")
    with workers(folder) as engine, pytest.raises(JobRefused) as refused:
        answers(engine, folder, chunks(4))
    assert stamp() in str(refused.value)
    assert "but the job has fixel 0.0.9+0123456789abcdef" in str(refused.value)
    assert refused.value.hint == "install the same fixel for the workers"
    assert (folder / "calls").read_text() == ""


def test_a_chunk_is_not_computed_by_another_fixel_that_joined_all_the_same(folder, monkeypatch):
    (folder / "calls").touch()
    where = str(folder), str(folder / "inputs"), toy_work.FUNCTION, "b"
    found = run_chunk("0.0.9+0123456789abcdef", *where, chunks(1)[0].payload, 300.0)
    assert found == OTHER_VERSION + stamp().encode()
    monkeypatch.setattr("fixel.jobs.dask_engine.stamp", lambda: "0.0.9+0123456789abcdef")
    with workers(folder, size=1) as engine, pytest.raises(JobRefused, match="a worker has fixel"):
        answers(engine, folder, chunks(2))
    assert (folder / "calls").read_text() == ""


def test_workers_that_cannot_start_are_not_started_for_ever(folder, tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho no such module >&2\nexit 1\n")
    python.chmod(0o755)
    engine = DaskEngine(folder, LocalPool(folder, 1, str(python)), notify=lambda _: None)
    with engine, pytest.raises(JobRefused, match=r"3 workers in a row .*last one:\nno such module"):
        answers(engine, folder, chunks(1))


def test_a_stopped_worker_is_not_waited_for_and_its_late_answer_is_taken_once(folder):
    """SIGSTOP for longer than a lease, then SIGCONT."""
    said, calls = [], folder / "calls"
    calls.touch()
    # Dask lets a lease of few workers end after five seconds at the earliest.
    with workers(folder, size=1, said=said, lease_s=1.0) as engine:
        asked = chunks(2, sleep_s=2.0)
        stream = engine.results(toy_work.FUNCTION, folder / "inputs", asked)
        await_true(lambda: next(stream) or calls.read_text(), "the first chunk to run")
        (pid,) = processes(folder, "worker")
        kill(pid, signal.SIGSTOP)
        found, stopped, deadline = {}, True, time.monotonic() + 60.0
        for batch in stream:
            for name, answer in batch:
                assert name not in found
                found[name] = answer
            if stopped and engine.workers == 0:
                stopped = not kill(pid, signal.SIGCONT)
            assert time.monotonic() < deadline
    assert found.keys() == {"c0", "c1"}
    assert not stopped
    assert not any("died" in sentence for sentence in said)
    assert any("late answer" in sentence for sentence in said)
    assert all(isinstance(answer, bytes) for answer in found.values())


def test_a_late_answer_is_taken_once_and_rubbish_is_thrown_away(folder):
    late = folder / "late"
    late.mkdir()
    link.save_late(folder, "round/c 1234", b"Aanswer")
    (late / "rubbish").write_bytes(b"nothing of the kind")
    ((block, framed, path),) = link.late_answers(folder)
    assert (block, unframed(framed)) == ("round/c 1234", b"answer")
    assert [file.name for file in late.iterdir()] == [path.name]


def test_a_dead_scheduler_is_replaced_and_workers_stay(folder):
    said = []
    with workers(folder, said=said) as engine:
        # So many that some are left when a busy machine has brought the first answers.
        asked = chunks(40, sleep_s=0.2)
        found, before, killed = {}, [], False
        for batch in engine.results(toy_work.FUNCTION, folder / "inputs", asked):
            for name, answer in batch:
                assert name not in found
                found[name] = answer
            if len(found) >= 3 and not killed:
                before = processes(folder, "worker")
                killed = kill(engine._cluster.process.pid)
        assert processes(folder, "worker") == before
    assert len(found) == 40
    assert any("the scheduler has ended with code -9" in sentence for sentence in said)


def test_a_worker_that_is_refused_asks_again_until_its_patience_ends(folder):
    """A scheduler refuses a worker whose lost connection it still takes for a good one."""
    with workers(folder, size=1) as engine:
        answers(engine, folder, chunks(1))
        (name,) = (path.stem for path in (folder / "workers").glob("*.json"))
        twin = worker_command(folder, name, link.LOOPBACK, 1)
        done = subprocess.run(
            [sys.executable, *twin, "--patience-s", "2"], capture_output=True, timeout=60.0
        )
        assert answers(engine, folder, chunks(2)).keys() == {"c0", "c1"}
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.count(b"no connection to") >= 2
    assert b"no scheduler; ending" in done.stdout


def test_a_scheduler_that_hangs_is_replaced(folder, monkeypatch):
    monkeypatch.setattr("fixel.jobs.dask_engine.ANSWER_S", 2.0)
    said = []
    with workers(folder, size=1, said=said) as engine:
        stream = engine.results(toy_work.FUNCTION, folder / "inputs", chunks(4, sleep_s=0.2))
        first: list[object] = []  # a busy machine answers with several at once
        await_true(lambda: first.extend(next(stream)) or first, "an answer")
        kill(engine._cluster.process.pid, signal.SIGSTOP)
        assert len([*first, *(pair for batch in stream for pair in batch)]) == 4
    assert any("the scheduler does not answer" in sentence for sentence in said)


@pytest.mark.parametrize("trouble", [lambda: None, lambda: 1 / 0], ids=["no bytes", "a failure"])
def test_an_answer_that_cannot_be_read_is_asked_for_again(folder, monkeypatch, trouble):
    fetched, first = Cluster._fetched, [True]

    def once(self, future):
        return trouble() if first and first.pop() else fetched(self, future)

    monkeypatch.setattr(Cluster, "_fetched", once)
    with workers(folder, size=1) as engine:
        assert answers(engine, folder, chunks(2)).keys() == {"c0", "c1"}
        assert engine.again == 1


def test_a_client_that_was_not_closed_is_not_waited_for():
    """Dask's own waits a minute at the end of the process for a thread that no longer runs."""
    kind = dask_engine._client_class()
    one = kind.__new__(kind)
    one.status, one.close = "closing", lambda: pytest.fail("it waits")
    one.__del__()


def test_interfaces_are_named_ones():
    assert link.listening("lo") == {"host": "127.0.0.1"}
    refused(link.listening, "nowhere0", match="is 'nowhere0', but must be one of")
