"""Engines: who answers chunks."""

from __future__ import annotations

import abc
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self, final

from fixel.jobs.functions import ChunkFunction, chunk_function
from fixel.jobs.work import Answer, Chunk, Failure

Batch = list[tuple[str, Answer]]


class AbstractEngine(abc.ABC):
    """Answers chunks, in any order; a context manager, so that processes end with it."""

    workers: int = 0  # processes that compute now
    deaths: int = 0  # of workers while they computed
    again: int = 0  # chunks that were given out once more

    @abc.abstractmethod
    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        """Names and answers as they come, each chunk once.

        A batch may be empty: there is one every second or so, so that who waits can do
        something else, such as stop.
        """

    @abc.abstractmethod
    def __enter__(self) -> Self: ...

    @abc.abstractmethod
    def __exit__(self, *_: object) -> None: ...


@final
class LocalEngine(AbstractEngine):
    """One chunk after the other in this process; the functions use all cores by themselves."""

    workers = 1

    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        call = chunk_function(function)
        for chunk in chunks:
            yield [(chunk.name, answer_of(call, inputs, chunk.payload))]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def answer_of(call: ChunkFunction, inputs: Path, payload: bytes) -> Answer:
    """What a chunk function answers; what it raises is an answer too."""
    try:
        answer: object = call(inputs, payload)
    except (Exception, SystemExit) as problem:
        where = traceback.extract_tb(problem.__traceback__)[-1]
        said = str(problem) or "no reason given"
        place = f"{Path(where.filename).name}, line {where.lineno}"
        return Failure(f"{type(problem).__name__}: {said} ({place})")
    if not isinstance(answer, bytes):
        return Failure(f"the chunk function answered {type(answer).__name__}, expected bytes")
    return answer
