"""Computation of chunks on Dask workers, robust to the death of workers and schedulers.

Dask brings a chunk to a free worker and its answer back. `Cluster` starts the scheduler, a process
of its own, and is its client. The rest is done by the engine: a chunk whose worker died is tried
again, and one that kills every worker is given up. A dead scheduler is replaced and receives the
missing chunks. A late answer is taken once. A worker of another version of fixel is refused.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import select
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from fixel.errors import JobRefused
from fixel.jobs import link, work
from fixel.jobs.functions import stamp
from fixel.jobs.pool import AbstractPool

TICK_S: Final = 0.5  # [s] between two checks of workers and files
MAX_REBUILDS: Final = 20  # schedulers that died one after the other without an answer
MAX_BACK_OFF_S: Final = 60.0
MAX_REFUSALS: Final = 3


class DaskEngine(work.AbstractEngine):
    """Engine that answers chunks on several workers, which share the folder of the job.

    A worker that is silent for `lease_s` counts as dead. Its chunk is tried elsewhere; its own
    answer is still taken if it comes first. A chunk that kills `max_deaths` workers is given up.
    `notify` is called with a sentence when something happens.
    """

    def __init__(
        self,
        folder: Path,
        pool: AbstractPool,
        *,
        notify: Callable[[str], None],
        lease_s: float = 300.0,
        max_deaths: int = 5,
    ) -> None:
        link.require_dask()
        self._folder = folder
        self._pool = pool
        self._say = notify
        self._lease_s = lease_s
        self._max_deaths = max_deaths
        self._cluster: Cluster | None = None
        self._rebuilds = 0
        self._answered = 0
        self._refusals = 0
        self._next_tick = 0.0

    def __enter__(self) -> Self:
        link.make_tls(self._folder)
        link.clear_workers(self._folder)
        (self._folder / "late").mkdir(exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.close()
        self._close_cluster()
        link.remove_tls(self._folder)

    @property
    def note(self) -> str:
        """Reason why workers wait; empty if they do not."""
        return self._pool.note

    def results(
        self, function: str, inputs: Path, chunks: Sequence[work.Chunk]
    ) -> Iterator[work.Batch]:
        state = _RoundState(function, inputs, chunks)
        while state.open:
            try:
                batch = self._turn(state)
            except ClusterLost as lost:
                batch = []
                self.again += state.forget_flights()
                self._bury(lost)
            batch += self._late(state)
            if batch:
                self._answered += len(batch)
                self._rebuilds = 0
            yield batch

    def _turn(self, state: _RoundState) -> work.Batch:
        """Submit the chunks that workers are free for, and return the answers that have arrived."""
        cluster = self._cluster or self._start()
        self._tick(cluster)
        state.top_up(cluster, self.workers)
        events = cluster.events(timeout_s=TICK_S)
        landed = [e for e in events if e.future is not None and state.lands(e.name, e.future)]
        if all(event.future.status == "finished" for event in landed):
            # Before their answers are fetched and stored: the workers wait for this.
            state.top_up(cluster, self.workers)
        for arrival in landed:
            cluster.fetch(arrival)
        batch: work.Batch = []
        for ended in (e for e in events if e.future is None):
            answer = self._judged(state, ended)
            if answer is not None and state.close(ended.name):
                batch.append((ended.name, answer))
        return batch

    def _judged(self, state: _RoundState, ended: Event) -> work.Answer | None:
        """Return the answer of a chunk, or None if it is to be tried again."""
        name = ended.name
        if ended.killed:
            self.deaths += 1
            state.deaths[name] += 1
            n = state.deaths[name]
            self._say(f"{ended.killed} died while computing {name} (time {n} for this chunk)")
            if n >= self._max_deaths:
                return work.Failure(f"its worker died {n} times while computing it")
        elif ended.version:
            self._refusals += 1
            self._say(f"refused an answer of fixel {ended.version}, since this is fixel {stamp()}")
            if self._refusals >= MAX_REFUSALS or not self._answered:
                raise _other_version(f"a worker has fixel {ended.version}, not {stamp()}")
        elif ended.answer is not None:
            return ended.answer
        state.again(name)
        self.again += 1
        return None

    def _tick(self, cluster: Cluster) -> None:
        """Check and replace workers, at most once per `TICK_S`."""
        now = time.monotonic()
        if now < self._next_tick:
            return
        self._next_tick = now + TICK_S
        self._check_refusals()
        self._pool.keep()
        self.workers = cluster.capacity()

    def _check_refusals(self) -> None:
        reasons = link.refusals(self._folder)
        if len(reasons) >= MAX_REFUSALS or (reasons and not self._answered and not self.workers):
            raise _other_version(reasons[-1])

    def _late(self, state: _RoundState) -> work.Batch:
        """Return the answers that workers have left in the folder."""
        batch = []
        for block, framed, path in link.late_answers(self._folder):
            name = state.name_of.get(block)
            if name is not None and state.close(name):
                self._say(f"used the late answer of {name}")
                batch.append((name, work.unframed(framed)))
            path.unlink(missing_ok=True)
        return batch

    def _start(self) -> Cluster:
        if self._rebuilds:
            time.sleep(min(0.25 * 2.0 ** (self._rebuilds - 1), MAX_BACK_OFF_S))
        self._cluster = Cluster(self._folder, self._pool.interface, self._lease_s)
        self._next_tick = 0.0
        return self._cluster

    def _bury(self, lost: ClusterLost) -> None:
        self._rebuilds += 1
        self._close_cluster()
        self.workers = 0
        if self._rebuilds > MAX_REBUILDS:
            raise JobRefused(f"{lost}, {self._rebuilds} times", hint="resume the job later")
        self._say(f"{lost}; starting another")

    def _close_cluster(self) -> None:
        if self._cluster is not None:
            self._cluster.close()
            self._cluster = None


class _RoundState:
    """Chunks of a round: waiting ones, those with workers, and those without an answer."""

    def __init__(self, function: str, inputs: Path, chunks: Sequence[work.Chunk]) -> None:
        self._function = function
        self._inputs = inputs
        self._blocks = {chunk.name: work.block_name(function, chunk) for chunk in chunks}
        self._waiting = deque(chunk.name for chunk in chunks)
        self._flying: dict[str, Any] = {}
        self.open = {chunk.name: chunk for chunk in chunks}
        self.name_of = {block: name for name, block in self._blocks.items()}
        self.deaths: Counter[str] = Counter()

    def top_up(self, cluster: Cluster, capacity: int) -> None:
        """Submit waiting chunks until `capacity` of them are with workers.

        No more: then every submitted chunk is running, and the death of a worker is due to it.
        """
        while self._waiting and len(self._flying) < capacity:
            name = self._waiting.popleft()
            if name in self.open:
                self._flying[name] = cluster.submit(
                    self.open[name], self._function, self._inputs, self._blocks[name]
                )

    def lands(self, name: str, future: Any) -> bool:
        """Whether an ended future is the current one of a chunk, which then has none."""
        if self._flying.get(name) is not future:
            return False
        del self._flying[name]
        return True

    def again(self, name: str) -> None:
        """Try a chunk once more, before those that have not been tried."""
        self._waiting.appendleft(name)

    def close(self, name: str) -> bool:
        """Mark a chunk as answered; return False if it was answered before."""
        self._flying.pop(name, None)
        return self.open.pop(name, None) is not None

    def forget_flights(self) -> int:
        """Mark all chunks with workers to be tried again, and return their number."""
        flying = len(self._flying)
        self._waiting = deque(self.open)
        self._flying.clear()
        return flying


def _other_version(reason: str) -> JobRefused:
    return JobRefused(reason, hint="install the same fixel for the workers")


MAX_STRANGE: Final = 20  # lost answers in a row, although no worker died
START_S: Final = 60.0  # [s] for a scheduler to listen; a cold file system is slow
FETCHERS: Final = 8  # answers fetched at once
ANSWER_S: Final = 30.0  # [s] for the scheduler to answer
CLOSE_S: Final = 2.0  # [s] for a client to close
END_S: Final = 0.2  # [s] from the end of connections to that of their process


class ClusterLost(Exception):
    """Exception raised when the scheduler has ended or does not answer."""


class Event(NamedTuple):
    """A chunk has returned from its worker, or, without a future, has been fetched or is lost."""

    name: str  # of the chunk
    future: Any = None  # of a chunk that a worker has finished or lost
    answer: work.Answer | None = None
    killed: str = ""  # address of the worker, if it died
    version: str = ""  # fixel of the worker, if it is not this one


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

    def submit(self, chunk: work.Chunk, function: str, inputs: Path, block: str) -> Any:
        """Send a chunk to a free worker; the caller must store the future until it is done."""
        self._count += 1
        try:
            future = self._client.submit(
                work.run_chunk,
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
            future.add_done_callback(lambda done: self._events.put(Event(chunk.name, done)))
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

    def fetch(self, landed: Event) -> None:
        """Fetch an answer from its worker; an event reports its arrival."""
        self._fetchers.submit(self._fetch, landed)

    def _fetch(self, landed: Event) -> None:
        from distributed import KilledWorker

        try:
            framed = self._fetched(landed.future)
            if framed[:1] == work.OTHER_VERSION:
                ended = Event(landed.name, version=framed[1:].decode())
            else:
                ended = Event(landed.name, answer=work.unframed(framed))
        except KilledWorker as death:
            ended = Event(landed.name, killed=str(death.last_worker.address))
        # Lost on the way, cancelled with the scheduler, or unreadable: without an event for it, the
        # coordinator would wait for this chunk without end.
        except BaseException:
            ended = Event(landed.name)
        self._strange = self._strange + 1 if ended == Event(landed.name) else 0
        self._events.put(ended)

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
