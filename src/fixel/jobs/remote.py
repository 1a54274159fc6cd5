"""What runs in a worker: one chunk.

Apart from `worker.py`, which is a program: a program's module is not the one others import.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Final

from fixel.jobs import link
from fixel.jobs.engine import answer_of
from fixel.jobs.functions import chunk_function
from fixel.jobs.stamp import stamp
from fixel.jobs.work import Failure, framed

OTHER_VERSION: Final = b"V"  # first byte of an answer, beside those of `fixel.jobs.work.framed`

running = threading.Event()  # a chunk is being computed
lost = threading.Event()  # no scheduler listens


def run_chunk(
    expected: str,
    folder: str,
    inputs: str,
    function: str,
    block: str,
    payload: bytes,
    lease_s: float,
) -> bytes:
    """What Dask runs: one chunk, its answer framed, or the stamp of another fixel."""
    if stamp() != expected:
        return OTHER_VERSION + stamp().encode()
    begun = time.monotonic()
    running.set()
    try:
        answer = framed(answer_of(chunk_function(function), Path(inputs), payload))
        if lost.is_set() or time.monotonic() - begun > lease_s:
            # Nobody may be waiting any more.
            link.save_late(Path(folder), block, answer)
    except Exception as problem:
        return framed(Failure(f"{type(problem).__name__}: {problem}"))
    finally:
        running.clear()
    return answer
