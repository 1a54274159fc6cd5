"""Engine that answers chunks in this process."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self, final

from fixel.jobs.functions import ChunkFunction, chunk_function
from fixel.jobs.work import AbstractEngine, Answer, Batch, Chunk, Failure


@final
class LocalEngine(AbstractEngine):
    """Engine that computes one chunk after the other in this process; functions use all cores."""

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
    """Return the answer of a chunk function; an exception becomes a `Failure`."""
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
