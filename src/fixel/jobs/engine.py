"""Computation of chunks: in this process, or in a worker.

Separate from `worker.py`, which runs as `__main__`: an import would load a second copy of it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, final

from fixel.jobs import link
from fixel.jobs.functions import ChunkFunction, named_function, stamp
from fixel.jobs.work import AbstractEngine, Batch, Chunk, Failure, answer_of, framed

OTHER_VERSION: Final = b"V"  # first byte of an answer; not used by `fixel.jobs.work.framed`

running = threading.Event()  # a chunk is being computed
lost = threading.Event()  # no scheduler listens


@final
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
