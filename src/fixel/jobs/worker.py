"""Worker of a job, in a process of its own: `python -m fixel.jobs.worker FOLDER ...`.

It takes part only if its fixel is that of the coordinator. When the scheduler is lost, the worker
finishes its chunk, stores the answer in the folder, and waits for another scheduler, so that
its place in the queue of a cluster is not lost.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any, Final

from fixel.jobs import link, work
from fixel.jobs.functions import THREADS, stamp

GRACE_S: Final = 20.0  # [s] for a running chunk when the worker has to end; SLURM gives 30
CONNECT_S: Final = 10.0


def main(arguments: list[str] | None = None) -> int:
    """Work until SIGTERM, the end of the lifetime, or too long without a scheduler."""
    given = _parser().parse_args(arguments)
    if given.watch_parent:
        link.end_with_parent()
    if stamp() != given.stamp:
        return _refuse(given)
    if given.threads:
        os.environ[THREADS] = str(given.threads)
    until = time.monotonic() + given.lifetime_s * random.uniform(0.9, 1.0)
    alone_since: float | None = None
    while True:
        address = link.read_address(given.folder)
        if address is not None and link.answers(address):
            joined, asked_to_end = asyncio.run(_serve(given, address, until))
            _await_chunk(until)
            if asked_to_end:
                return 0
            if joined:
                alone_since = None
        now = time.monotonic()
        alone_since = now if alone_since is None else alone_since
        over = not (given.folder / "tls").exists()  # the coordinator has removed its key
        if over or now - alone_since > given.patience_s or now > until:
            print("no scheduler; ending", flush=True)
            return 0
        time.sleep(0.5)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the job")
    parser.add_argument("--name", required=True)
    parser.add_argument("--stamp", required=True, help="required version of fixel")
    parser.add_argument("--interface", default=link.LOOPBACK)
    parser.add_argument("--threads", type=int, default=0, help="number of cores of this worker")
    parser.add_argument(
        "--lifetime-s", type=float, default=1e9, help="time at which the worker ends"
    )
    parser.add_argument(
        "--patience-s", type=float, default=60.0, help="time to wait for a scheduler [s]"
    )
    parser.add_argument("--watch-parent", action="store_true", help="end with the standard input")
    return parser


def _refuse(given: argparse.Namespace) -> int:
    reason = (
        f"worker {given.name} on {socket.gethostname()} has fixel {stamp()}, "
        f"but the job has fixel {given.stamp}"
    )
    print(reason, flush=True)
    link.record_refusal(given.folder, given.name, reason)
    return link.REFUSED


async def _serve(given: argparse.Namespace, address: str, until: float) -> tuple[bool, bool]:
    """Work for one scheduler; return whether it was joined and whether the worker has to end."""
    worker = _worker(given, address)
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, asked.set)
    timer = loop.call_later(max(0.0, until - time.monotonic()), asked.set)
    try:
        await asyncio.wait_for(worker, 2 * CONNECT_S)
    # Dask raises RuntimeError for a refusal, e.g. of a name whose lost connection is still open
    # at the scheduler.
    except (OSError, TimeoutError, RuntimeError, asyncio.CancelledError) as problem:
        print(f"no connection to {address}: {problem!r}", flush=True)
        return False, asked.is_set()
    finally:
        if worker.status.name != "running":
            timer.cancel()
    link.record_joined(given.folder, given.name, socket.gethostname())
    work.lost.clear()
    ending = asyncio.ensure_future(asked.wait())
    finished = asyncio.ensure_future(worker.finished())
    watching = asyncio.ensure_future(_watch(worker))
    await asyncio.wait({ending, finished}, return_when=asyncio.FIRST_COMPLETED)
    if asked.is_set() and not finished.done():
        await _end_gracefully(worker)
    for task in (ending, watching):
        task.cancel()
    timer.cancel()
    await finished
    return True, asked.is_set()


async def _watch(worker: Any) -> None:
    """Notice the loss of the scheduler at once: closing waits for the running chunk."""
    while worker.status.name in ("running", "paused", "closing_gracefully"):
        await asyncio.sleep(0.05)
    work.lost.set()


async def _end_gracefully(worker: Any) -> None:
    """Take no more chunks, wait up to `GRACE_S` for the running one, then close."""
    from distributed.core import Status

    worker.status = Status.paused
    deadline = time.monotonic() + GRACE_S
    while work.running.is_set() and time.monotonic() < deadline:
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.2)  # for the answer to be sent
    await worker.close_gracefully()


def _worker(given: argparse.Namespace, address: str) -> Any:
    import dask
    from distributed import Worker

    dask.config.set(link.CONFIG | {"distributed.comm.timeouts.connect": f"{CONNECT_S} s"})

    class QuietWorker(Worker):
        """Dask's worker without a web server, which could be attacked."""

        def start_http_server(self, *_: Any, **__: Any) -> None:
            pass

    return QuietWorker(
        address,
        nthreads=1,
        name=given.name,
        security=link.security(given.folder),
        protocol="tls",
        memory_limit=0,
        dashboard=False,
        death_timeout=CONNECT_S,
        **link.listening(given.interface),
    )


def _await_chunk(until: float) -> None:
    """Wait for the running chunk, whose answer is stored in the folder."""
    work.lost.set()
    while work.running.is_set() and time.monotonic() < until:
        time.sleep(0.05)


if __name__ == "__main__":
    # Do not wait for threads of the engine: their results are not needed any more.
    code = main()
    sys.stdout.flush()
    os._exit(code)
