"""Computation of one chunk in a worker.

Separate from `worker.py`, which runs as `__main__`: an import would load a second copy of it.
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

OTHER_VERSION: Final = b"V"  # first byte of an answer; not used by `fixel.jobs.work.framed`

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
    """Compute a chunk; return its framed answer, or our stamp if another one is expected."""
    if stamp() != expected:
        return OTHER_VERSION + stamp().encode()
    begun = time.monotonic()
    running.set()
    try:
        answer = framed(answer_of(chunk_function(function), Path(inputs), payload))
        if lost.is_set() or time.monotonic() - begun > lease_s:
            # The coordinator may have given this chunk up.
            link.save_late(Path(folder), block, answer)
    except Exception as problem:
        return framed(Failure(f"{type(problem).__name__}: {problem}"))
    finally:
        running.clear()
    return answer
