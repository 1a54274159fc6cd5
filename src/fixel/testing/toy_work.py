"""Toy job: a cheap function, evaluated in several rounds that depend on each other.

For tests and benchmarks of `fixel.jobs`: chunks may sleep, compute, fail, or kill their worker.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fixel.jobs.functions import callable_by_jobs
from fixel.jobs.work import Chunk, Failure, Round, Work

FUNCTION = "toy:evaluate"
MAKER = "toy:make_toy_work"
_BLOCK = bytes(1_000_000)


@callable_by_jobs
def make_toy_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Run a small search: each round tries points around the best of the previous round.

    Options are `rounds`, `chunks` (per round), `sleep_s` and `compute_s` (per chunk), `poison` and
    `faulty` (names of chunks that kill their worker, or raise).
    """
    rounds, chunks = int(options.get("rounds", 3)), int(options.get("chunks", 8))
    best, best_value, width = 0.0, float("inf"), 1.0
    for k in range(rounds):
        points = {f"r{k}-c{i}": best + width * (i / chunks - 0.5) for i in range(chunks)}
        answers = yield Round(
            FUNCTION,
            [Chunk(name, _payload(name, x, options)) for name, x in points.items()],
            note=f"best {best_value:.6g}" if k else "",
            left=(rounds - 1 - k) * chunks,
        )
        for name, x in points.items():
            answer = answers[name]
            value = float("inf") if isinstance(answer, Failure) else struct.unpack("<d", answer)[0]
            if value < best_value:
                best, best_value = x, value
        width *= 0.5
    return struct.pack("<dd", best, best_value)


@callable_by_jobs
def evaluate(inputs: Path, payload: bytes) -> bytes:
    """Evaluate the minimised function, after the sleep, computation or failure in the payload."""
    given = json.loads(payload)
    offset = float((inputs / "offset").read_text()) if (inputs / "offset").exists() else 0.3
    _log_call(inputs, given["name"])
    if given["name"] in given["faulty"]:
        raise ValueError("fails on request")
    if given["name"] in given["poison"]:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(given["sleep_s"])
    _compute(given["compute_s"])
    x = given["x"]
    return struct.pack("<d", (x - offset) ** 2 + 0.1 * (1.0 - x) ** 4)


def _payload(name: str, x: float, options: Mapping[str, Any]) -> bytes:
    asked = {
        "name": name,
        "x": x,
        "sleep_s": float(options.get("sleep_s", 0.0)),
        "compute_s": float(options.get("compute_s", 0.0)),
        "poison": list(options.get("poison", ())),
        "faulty": list(options.get("faulty", ())),
    }
    return json.dumps(asked).encode()


def _log_call(inputs: Path, name: str) -> None:
    """Append a line to the file `calls`, if a test that counts calls has created it."""
    calls = inputs.parent / "calls"
    if calls.exists():
        with calls.open("a") as stream:
            stream.write(f"{name} {os.getpid()}\n")


def _compute(cpu_s: float) -> None:
    """Use a given CPU time [s], and, like kernels, let other threads run meanwhile."""
    end = time.thread_time() + cpu_s
    while time.thread_time() < end:
        hashlib.sha256(_BLOCK)
