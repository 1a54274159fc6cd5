"""Dask scheduler in a process of its own, and its client."""

from __future__ import annotations

import contextlib
import logging
import queue
import select
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple, final

from fixel.jobs import link
from fixel.jobs.engine import OTHER_VERSION, run_chunk
from fixel.jobs.functions import stamp
from fixel.jobs.work import Answer, Chunk, unframed

MAX_STRANGE: Final = 20  # lost answers in a row, although no worker died
START_S: Final = 60.0  # [s] for a scheduler to listen; a cold file system is slow
FETCHERS: Final = 8  # answers fetched at once
ANSWER_S: Final = 30.0  # [s] for the scheduler to answer
CLOSE_S: Final = 2.0  # [s] for a client to close
END_S: Final = 0.2  # [s] from the end of connections to that of their process


class ClusterLost(Exception):
    """Exception raised when the scheduler has ended or does not answer."""


class WorkerKilled(NamedTuple):
    """Outcome of a chunk whose worker died."""

    worker: str


class OtherVersion(NamedTuple):
    """Outcome of a chunk whose worker runs another version of fixel."""

    found: str


Outcome = Answer | WorkerKilled | OtherVersion | None  # None: to be tried again


class ChunkReturn(NamedTuple):
    """Event: a worker has finished a chunk or lost it."""

    name: str
    future: Any


class ChunkEnd(NamedTuple):
    """Event: the outcome of a returned chunk is known."""

    name: str
    outcome: Outcome


Event = ChunkReturn | ChunkEnd


@final
class Cluster:
    """Connection to one Dask scheduler, from its start to its end.

    The scheduler listens on one network interface. A worker that is silent for `lease_s` counts as
    dead.
    """

    def __init__(self, folder: Path, interface: str, lease_s: float) -> None:
        self._folder = folder
        self._lease_s = lease_s
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        # In threads: one worker that hangs would delay the others in the loop that feeds them.
        self._fetchers = ThreadPoolExecutor(FETCHERS)
        self._count = self._strange = 0
        self._client: Any = None
        with (folder / "workers" / "scheduler.log").open("ab") as log:
            self.process = subprocess.Popen(
                [
                    sys.executable, "-P", "-m", "fixel.jobs.scheduler", str(folder.resolve()),
                    "--interface", interface, "--lease-s", str(lease_s),
                ],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, start_new_session=True,
            )  # fmt: skip
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

    def capacity(self) -> int:
        """Return the number of chunks that can be computed at once, or raise `ClusterLost`."""
        self._check_alive()
        try:
            # `nthreads()` has no time limit: it would never return if the scheduler hangs.
            cores = self._client.sync(
                self._client.scheduler.ncores, workers=None, callback_timeout=ANSWER_S
            )
            return sum(cores.values())
        except Exception as problem:  # what Dask raises here depends on what broke
            raise self._lost("the scheduler does not answer", problem) from None

    def submit(self, chunk: Chunk, function: str, inputs: Path, block: str) -> Any:
        """Send a chunk to a free worker; the caller must store the future until it is done."""
        self._count += 1
        try:
            future = self._client.submit(
                run_chunk,
                stamp(),
                str(self._folder.resolve()),
                str(inputs.resolve()),
                function,
                block,
                chunk.payload,
                self._lease_s,
                key=f"chunk-{self._count}",
                pure=False,
            )
            future.add_done_callback(lambda done: self._events.put(ChunkReturn(chunk.name, done)))
        except Exception as problem:
            raise self._lost("the scheduler accepts no work", problem) from None
        return future

    def events(self, timeout_s: float) -> list[Event]:
        """Return the events that have happened; wait for the first for at most `timeout_s`.

        It raises `ClusterLost` if the scheduler has ended.
        """
        happened: list[Event] = []
        with contextlib.suppress(queue.Empty):
            happened.append(self._events.get(timeout=timeout_s))
            while True:
                happened.append(self._events.get_nowait())
        if not happened:
            self._check_alive()
        return happened

    def fetch(self, landed: ChunkReturn) -> None:
        """Fetch an answer from its worker; an event reports its arrival."""
        self._fetchers.submit(self._fetch, landed)

    def _fetch(self, landed: ChunkReturn) -> None:
        try:
            outcome = self._outcome(landed.future)
        # Lost on the way, cancelled with the scheduler, or unreadable: without an event for it, the
        # coordinator would wait for this chunk without end.
        except BaseException:
            outcome = None
        self._strange = self._strange + 1 if outcome is None else 0
        self._events.put(ChunkEnd(landed.name, outcome))

    def _outcome(self, future: Any) -> Outcome:
        """Return the outcome of a chunk."""
        from distributed import KilledWorker

        try:
            framed = self._fetched(future)
        except KilledWorker as killed:
            return WorkerKilled(str(killed.last_worker.address))
        if framed[:1] == OTHER_VERSION:
            return OtherVersion(framed[1:].decode())
        return unframed(framed)

    def _fetched(self, future: Any) -> bytes:
        """Return an answer from its worker; do not wait if the worker died with it."""
        patience_s = 1.0
        while True:
            try:
                framed: bytes = future.result(timeout=patience_s)
                return framed
            except TimeoutError:
                if future.status != "finished" or patience_s > ANSWER_S:
                    raise
                # A large answer on a slow network: each attempt starts again, so wait longer.
                patience_s *= 2.0

    def close(self) -> None:
        """End the scheduler; workers wait some time for another one."""
        link.forget_address(self._folder)
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                stream.close()
        self._fetchers.shutdown(wait=False, cancel_futures=True)
        if self._client is not None:
            with contextlib.suppress(Exception):
                self._client.close(timeout=CLOSE_S)
            self._client = None

    def _connect(self) -> None:
        import dask

        dask.config.set(link.CONFIG)
        kind = _client_class()
        _quieten()
        address = self._first_line()
        try:
            self._client = kind(
                address,
                security=link.security(self._folder),
                timeout=ANSWER_S,
                set_as_default=False,
            )
        except Exception as problem:
            raise self._lost("no connection to the scheduler", problem) from None
        link.write_address(self._folder, address)

    def _first_line(self) -> str:
        """Return the address, which is the first line that the scheduler prints."""
        stream = self.process.stdout
        assert stream is not None
        ready, _, _ = select.select([stream], [], [], START_S)
        address = stream.readline().decode().strip() if ready else ""
        if not address:
            raise ClusterLost("the scheduler did not start; its output is in workers/scheduler.log")
        return address

    def _lost(self, what: str, problem: Exception) -> ClusterLost:
        """Return the error for a failed request; it names an end of the scheduler."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return _ended(self.process.wait(END_S))
        return ClusterLost(f"{what}: {problem!r}")

    def _check_alive(self) -> None:
        code = self.process.poll()
        if code is not None:
            raise _ended(code)
        if self._strange > MAX_STRANGE:
            raise ClusterLost("answers of workers are lost on the network")


def _ended(code: int) -> ClusterLost:
    return ClusterLost(f"the scheduler has ended with code {code}")


def _client_class() -> Any:
    """Return Dask's client, which takes half a second to import, with another end."""
    from distributed import Client

    class OneConnection(Client):
        """Client that ends with its connection: a scheduler that is lost never comes back."""

        def __init__(self, *arguments: Any, **options: Any) -> None:
            try:
                super().__init__(*arguments, **options)  # type: ignore[no-untyped-call]
            except BaseException:  # also Ctrl-C, while it connects
                with contextlib.suppress(Exception):
                    self.close(timeout=CLOSE_S)  # type: ignore[no-untyped-call]
                raise

        def __del__(self) -> None:
            """Do nothing: Dask's would wait a minute for a thread that no longer runs."""

        async def _reconnect(self) -> None:
            await self._close()

    return OneConnection


def _quieten() -> None:
    """Silence Dask's messages about lost connections: fixel reports these itself."""
    for name, logger in list(logging.root.manager.loggerDict.items()):
        if name.split(".")[0] == "distributed" and isinstance(logger, logging.Logger):
            logger.handlers.clear()
            logger.setLevel(logging.CRITICAL)
