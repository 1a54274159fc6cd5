"""Computation of chunks on Dask workers, robust to the death of workers and schedulers.

Dask brings a chunk to a free worker and its answer back. The rest is done here: a chunk whose
worker died is tried again, and one that kills every worker is given up. A dead scheduler is
replaced and receives the missing chunks. A late answer is taken once. A worker of another
version of fixel is refused.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Self, final

from fixel.errors import JobRefused
from fixel.jobs import link
from fixel.jobs.cluster import (
    ChunkEnd,
    ChunkReturn,
    Cluster,
    ClusterLost,
    OtherVersion,
    Outcome,
    WorkerKilled,
)
from fixel.jobs.functions import stamp
from fixel.jobs.pool import AbstractPool
from fixel.jobs.work import AbstractEngine, Answer, Batch, Chunk, Failure, block_name, unframed

TICK_S: Final = 0.5  # [s] between two checks of workers and files
MAX_REBUILDS: Final = 20  # schedulers that died one after the other without an answer
MAX_BACK_OFF_S: Final = 60.0
MAX_REFUSALS: Final = 3


@final
class DaskEngine(AbstractEngine):
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

    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
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

    def _turn(self, state: _RoundState) -> Batch:
        """Submit the chunks that workers are free for, and return the answers that have arrived."""
        cluster = self._cluster or self._start()
        self._tick(cluster)
        state.top_up(cluster, self.workers)
        events = cluster.events(timeout_s=TICK_S)
        landed = [e for e in events if isinstance(e, ChunkReturn) and state.lands(e.name, e.future)]
        if all(event.future.status == "finished" for event in landed):
            # Before their answers are fetched and stored: the workers wait for this.
            state.top_up(cluster, self.workers)
        for arrival in landed:
            cluster.fetch(arrival)
        batch: Batch = []
        for fetched in (e for e in events if isinstance(e, ChunkEnd)):
            answer = self._judged(state, fetched.name, fetched.outcome)
            if answer is not None and state.close(fetched.name):
                batch.append((fetched.name, answer))
        return batch

    def _judged(self, state: _RoundState, name: str, outcome: Outcome) -> Answer | None:
        """Return the answer of a chunk, or None if it is to be tried again."""
        if isinstance(outcome, WorkerKilled):
            self.deaths += 1
            state.deaths[name] += 1
            n = state.deaths[name]
            self._say(f"{outcome.worker} died while computing {name} (time {n} for this chunk)")
            if n >= self._max_deaths:
                return Failure(f"its worker died {n} times while computing it")
        elif isinstance(outcome, OtherVersion):
            self._refusals += 1
            self._say(f"refused an answer of fixel {outcome.found}, since this is fixel {stamp()}")
            if self._refusals >= MAX_REFUSALS or not self._answered:
                raise _other_version(f"a worker has fixel {outcome.found}, not {stamp()}")
        elif outcome is not None:
            return outcome
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

    def _late(self, state: _RoundState) -> Batch:
        """Return the answers that workers have left in the folder."""
        batch = []
        for late in link.late_answers(self._folder):
            name = state.name_of.get(late.block)
            if name is not None and state.close(name):
                self._say(f"used the late answer of {name}")
                batch.append((name, unframed(late.framed)))
            late.path.unlink(missing_ok=True)
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


@final
class _RoundState:
    """Chunks of a round: waiting ones, those with workers, and those without an answer."""

    def __init__(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> None:
        self._function = function
        self._inputs = inputs
        self._blocks = {chunk.name: block_name(function, chunk) for chunk in chunks}
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
