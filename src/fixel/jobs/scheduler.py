"""Dask scheduler of a job, in a process of its own: `python -m fixel.jobs.scheduler FOLDER`.

It ends with its coordinator, when its standard input closes; no answer is lost with it. It is
separate from the coordinator so that an error here cannot end the job.
"""

from __future__ import annotations

import argparse
import asyncio
import inspect
from pathlib import Path
from typing import Any

from fixel.jobs.link import CONFIG, end_with_parent, listening, security


def main(arguments: list[str] | None = None) -> None:
    """Run a scheduler until the standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--interface", default="lo")
    parser.add_argument("--lease-s", type=float, default=300.0)
    given = parser.parse_args(arguments)
    end_with_parent()
    asyncio.run(_serve(given))


async def _serve(given: argparse.Namespace) -> None:
    import dask

    dask.config.set(CONFIG | {"distributed.scheduler.worker-ttl": f"{given.lease_s} s"})
    async with _scheduler(given) as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()


def _scheduler(given: argparse.Namespace) -> Any:
    from distributed import Scheduler

    class JobScheduler(Scheduler):
        """Dask's scheduler without a web server, and with another treatment of silent workers."""

        def start_http_server(self, *_: Any, **__: Any) -> None:
            """Start no web server, which could be attacked."""

        async def remove_worker(self, address: str, *, stimulus_id: str, **given: Any) -> Any:
            """Remove a worker; its death is not due to its chunk if it was silent too long."""
            if stimulus_id.startswith("check-worker-ttl"):
                given[expected] = True
            return await super().remove_worker(address, stimulus_id=stimulus_id, **given)

    known = inspect.signature(Scheduler.remove_worker).parameters
    expected = "expected" if "expected" in known else "safe"
    return JobScheduler(
        protocol="tls",
        port=0,
        security=security(given.folder),
        dashboard=False,
        **listening(given.interface),
    )


if __name__ == "__main__":
    main()
