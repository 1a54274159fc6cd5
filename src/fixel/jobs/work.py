"""Rounds of chunks, the loop that has them computed, and their computation here or in a worker.

A `Work` is a generator. It yields a `Round` of chunks, is sent the answers by name, yields the next
round, and in the end returns the result as bytes. It must depend only on its inputs and the
answers: to resume an interrupted job, the generator is run again, and the journal answers all
chunks that were computed before.

Separate from `worker.py`, which runs as `__main__`: an import would load a second copy of it.
"""

from __future__ import annotations

import abc
import hashlib
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Final, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field

from fixel.errors import InvalidInput
from fixel.io.journal import Journal
from fixel.jobs import link
from fixel.jobs.functions import ChunkFunction, named_function, stamp
from fixel.progress import Progress, time_text

# [s] The rate is an average over this time, since workers come and go.
RATE_WINDOW_S: Final = 60.0
BETWEEN_STAGES_S: Final = 0.1  # [s] between two reports of a stage
# Largest share before the end, since the result is still to be computed.
ALMOST: Final = 0.99


class Chunk(NamedTuple):
    """Piece of a job that one worker computes within seconds."""

    name: str  # unique within the work: `"round-3/chunk-17"`
    payload: bytes  # argument of the chunk function


class Failure(NamedTuple):
    """Answer of a chunk whose function raised, or whose worker died every time."""

    reason: str


Answer = bytes | Failure


class Round(NamedTuple):
    """Chunks that do not depend on each other."""

    # `"KIND:FUNCTION"`, called as `function(inputs: Path, payload: bytes) -> bytes`. It may be
    # called again for the same payload, and must then return the same.
    function: str
    chunks: Sequence[Chunk]
    note: str = ""  # text of a progress bar: `"least squares"`
    # Chunks of the rounds after this one, known or estimated; None where the work may grow by any
    # number. Without it a progress bar shows no share and no time left.
    left: int | None = None
    best: float | None = None  # smallest error so far [m]


Answers = dict[str, Answer]
Work = Generator[Round, Answers, bytes]


class JobProgress(BaseModel):
    """Progress of a job."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_serialization_defaults_required=True
    )

    reason: str = Field(default="", description="reason of a failure; what is being waited for")
    done: int = Field(default=0, description="number of chunks with an answer")
    total: int = Field(default=0, description="number of chunks known so far")
    failed: int = Field(default=0, description="number of chunks whose answer is a failure")
    # Chunks per second in the last minute; time left at that rate [s], None if unknown.
    rate: float = Field(default=0.0, serialization_alias="rate_per_s")
    left_s: float | None = None
    share: float | None = Field(
        default=None, description="finished share of the work; null if unknown"
    )
    note: str = Field(default="", description="note on the progress")
    best: float | None = Field(default=None, description="smallest error so far [m]")
    workers: int = Field(default=0, description="number of workers that are computing")
    deaths: int = Field(default=0, description="number of workers that died while computing")
    again: int = Field(default=0, description="number of chunks that were computed again")
    host: str = Field(default="", description="host of the coordinator")
    pid: int = 0
    started_utc: str = ""
    updated_utc: str = ""

    @property
    def words(self) -> str:
        """Note with the smallest error."""
        return ", ".join(Progress(self.note, 0, best=self.best).words)

    @property
    def text(self) -> str:
        """Progress in words, the same in terminals and on pages."""
        share = f"{self.done} chunks done" if self.share is None else f"{int(100 * self.share)} %"
        rate = f"{self.rate:.3g}/s" if self.rate else ""
        left = f"about {time_text(self.left_s)} left" if self.left_s else ""
        failed = f"{self.failed} failed" if self.failed else ""
        share = share if self.done or self.share is not None else ""
        return ", ".join(part for part in (share, self.words, rate, left, failed) if part)


Batch = list[tuple[str, Answer]]


class AbstractEngine(abc.ABC):
    """Engine that answers chunks in any order; a context manager that ends its processes."""

    workers: int = 0  # processes that compute now
    deaths: int = 0  # workers that died while they computed
    again: int = 0  # chunks that were submitted again

    @abc.abstractmethod
    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        """Yield names and answers as they arrive, each chunk once.

        A batch may be empty: one comes about every second, so that the caller can do
        something else, such as stop.
        """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:  # noqa: B027 - most have nothing to end
        """End the processes that the engine has started."""


class StopRequest(Exception):
    """Exception raised when a stop is requested; finished chunks are in the journal."""


Show = Callable[[JobProgress], None]
Stop = Callable[[], bool]


def run_work(
    work: Work,
    engine: AbstractEngine,
    inputs: Path,
    journal: Journal | None,
    *,
    progress: Show | None = None,
    stop: Stop | None = None,
) -> bytes:
    """Compute all rounds of a work and return its result; raise `StopRequest` if `stop()` is True.

    No other function writes its journal, if it has one.
    """
    tally = _Tally(progress, engine)
    shown = _STAGE.set(tally.stage)
    try:
        turn = next(work)
        while True:
            turn = work.send(_answered(turn, engine, inputs, journal, tally, stop))
    except StopIteration as end:
        result: bytes = end.value or b""
        tally.finish()
        return result
    finally:
        work.close()
        _STAGE.reset(shown)


def report_stage(now: Progress) -> None:
    """Report what a work computes besides its chunks, to everyone who watches its job."""
    if (show := _STAGE.get()) is not None:
        show(now)


def answer_of(call: Callable[..., bytes], *arguments: object) -> Answer:
    """Return the answer of a chunk function; an exception becomes a `Failure`."""
    try:
        answer: object = call(*arguments)
    except (Exception, SystemExit) as problem:
        where = traceback.extract_tb(problem.__traceback__)[-1]
        said = str(problem) or "no reason given"
        place = f"{Path(where.filename).name}, line {where.lineno}"
        return Failure(f"{type(problem).__name__}: {said} ({place})")
    if not isinstance(answer, bytes):
        return Failure(f"the chunk function returned {type(answer).__name__}, not bytes")
    return answer


def block_name(function: str, chunk: Chunk) -> str:
    """Return the name of a chunk's answer in the journal, which depends on the payload."""
    digest = hashlib.sha256(function.encode() + b"\0" + chunk.payload).hexdigest()[:32]
    return f"{chunk.name} {digest}"


def framed(answer: Answer) -> bytes:
    """Return an answer as bytes, for the journal and the network."""
    return b"F" + answer.reason.encode() if isinstance(answer, Failure) else b"A" + answer


def unframed(data: bytes) -> Answer:
    """Inverse of `framed`."""
    return data[1:] if data[:1] == b"A" else Failure(data[1:].decode())


def _answered(
    turn: Round,
    engine: AbstractEngine,
    inputs: Path,
    journal: Journal | None,
    tally: _Tally,
    stop: Stop | None,
) -> Answers:
    """Return the answers of a round, from the journal or else from the engine."""
    names = {chunk.name: block_name(turn.function, chunk) for chunk in turn.chunks}
    if len(names) < len(turn.chunks):
        raise InvalidInput("chunks of a round", found="a name twice", expected="each name once")
    answers: Answers = {}
    for name, block in names.items():
        data = None if journal is None else journal.get(block)
        if data is not None:
            answers[name] = unframed(data)
    tally.begin(turn, answers)
    missing = [chunk for chunk in turn.chunks if chunk.name not in answers]
    if missing:
        _check_stop(stop)
        for batch in engine.results(turn.function, inputs, missing):
            fresh = {name: answer for name, answer in batch if name not in answers}
            if journal is not None:
                journal.append((names[name], framed(answer)) for name, answer in fresh.items())
            answers |= fresh
            tally.add(fresh)
            _check_stop(stop)
    return {chunk.name: answers[chunk.name] for chunk in turn.chunks}


def _check_stop(stop: Stop | None) -> None:
    if stop is not None and stop():
        raise StopRequest


_STAGE: ContextVar[Callable[[Progress], None] | None] = ContextVar("stage", default=None)


class _Tally:
    """Counter of chunks and of the rate at which they are answered."""

    def __init__(self, show: Show | None, engine: AbstractEngine) -> None:
        self._show = show
        self._engine = engine
        self._done = self._total = self._failed = 0
        self._note = ""
        self._best: float | None = None
        self._open, self._ended = True, False
        self._recent = deque([(time.monotonic(), 0)])
        self._fresh = 0
        self._stage = Progress("", 0)
        self._shown = -BETWEEN_STAGES_S

    def stage(self, now: Progress) -> None:
        """Report what is computed besides chunks."""
        self._stage, self._note, self._best = now, ", ".join(now.words), None
        if time.monotonic() - self._shown >= BETWEEN_STAGES_S or now.share == 1.0:
            self._shown = time.monotonic()
            self._report()

    def begin(self, turn: Round, known: Answers) -> None:
        self._note, self._best, self._stage = turn.note, turn.best, Progress("", 0)
        self._open, self._ended = turn.left is None, False
        self._total = self._done + len(turn.chunks) + (turn.left or 0)
        self._count(known)
        self._report()

    def add(self, fresh: Answers) -> None:
        now = time.monotonic()
        self._fresh += len(fresh)
        self._count(fresh)
        if fresh:
            self._recent.append((now, self._fresh))
        while len(self._recent) > 2 and now - self._recent[0][0] > RATE_WINDOW_S:
            self._recent.popleft()
        self._report()

    def finish(self) -> None:
        """Report that all rounds are answered."""
        self._total, self._open, self._ended = self._done, False, True
        self._report()

    def _count(self, answers: Answers) -> None:
        self._done += len(answers)
        self._failed += sum(isinstance(answer, Failure) for answer in answers.values())

    def _report(self) -> None:
        if self._show is None:
            return
        begun, count = self._recent[0]
        elapsed = time.monotonic() - begun
        rate = (self._fresh - count) / elapsed if elapsed > 0 else 0.0
        known = rate > 0 and not self._open
        left = (self._total - self._done) / rate if known else self._stage.left
        self._show(
            JobProgress(
                done=self._done,
                total=self._total,
                failed=self._failed,
                rate=rate,
                left_s=left,
                note=self._note,
                best=self._best,
                workers=self._engine.workers,
                share=self._share(),
            )
        )

    def _share(self) -> float | None:
        if self._ended:
            return 1.0
        if not self._total and self._stage.share is not None:
            return min(self._stage.share, ALMOST)
        return None if self._open else min(self._done / max(1, self._total), ALMOST)


OTHER_VERSION: Final = b"V"  # first byte of an answer; not used by `fixel.jobs.work.framed`

running = threading.Event()  # a chunk is being computed
lost = threading.Event()  # no scheduler listens


class LocalEngine(AbstractEngine):
    """Engine that computes one chunk after the other in this process; functions use all cores."""

    workers = 1

    def __init__(self, call: ChunkFunction | None = None) -> None:
        self._call = call  # instead of the chunk function, for work whose inputs are in memory

    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        call = self._call or named_function(function)
        for chunk in chunks:
            yield [(chunk.name, answer_of(call, inputs, chunk.payload))]


def run_chunk(
    expected: str,
    folder: str,
    inputs: str,
    function: str,
    block: str,
    payload: bytes,
    lease_s: float,
) -> bytes:
    """Compute a chunk; return its framed answer, or our stamp if another one is expected."""
    if stamp() != expected:
        return OTHER_VERSION + stamp().encode()
    begun = time.monotonic()
    running.set()
    try:
        answer = framed(answer_of(named_function(function), Path(inputs), payload))
        if lost.is_set() or time.monotonic() - begun > lease_s:
            # The coordinator may have given this chunk up.
            link.save_late(Path(folder), block, answer)
    except Exception as problem:
        return framed(Failure(f"{type(problem).__name__}: {problem}"))
    finally:
        running.clear()
    return answer
