"""What several processes cost, and what they bring.

``python -m benchmarks.cluster [--chunks 40] [--seconds 1.0] [--kind sleep] [--slurm]``: chunks of
equal length in one process, then on one and on two workers, with all of a job around them: TLS,
journal on disk, answers in their order. Start-up is timed apart: a campaign pays it once.

Chunks sleep, which shows what the machinery itself costs, also on a busy machine; ``--kind
compute`` keeps a core busy instead. ``--slurm`` starts a real SLURM on this machine and takes its
workers from there.
"""

import argparse
import contextlib
import os
import tempfile
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

from fixel.io.journal import Journal
from fixel.jobs.dask_engine import DaskEngine
from fixel.jobs.pool import LocalPool, SlurmPool
from fixel.jobs.site import Site
from fixel.jobs.work import Chunk, LocalEngine, Round, run_work
from fixel.testing.toy_work import FUNCTION, make_toy_work

SITE = Site(queue="main", memory="500 MB", submit_interval_s=0.0, skip_directives=["--mem"])
MAX_OVERHEAD = 0.10
MIN_EFFICIENCY = 0.9


def main() -> None:
    given = _parser().parse_args()
    options = {"rounds": 1, "chunks": given.chunks, f"{given.kind}_s": given.seconds}
    print(
        f"{given.chunks} chunks of {given.seconds} s ({given.kind}), load {os.getloadavg()[0]:.1f}"
    )
    with contextlib.ExitStack() as stack:
        if given.slurm:
            from tests.jobs import slurm_one

            os.environ |= stack.enter_context(slurm_one.running(nodes=2))
        alone = _timed("one process", options, given.slurm, 0)
        one = _timed("1 worker", options, given.slurm, 1)
        two = _timed("2 workers", options, given.slurm, 2)
    overhead, efficiency = one / alone - 1.0, one / (2.0 * two)
    print(f"overhead   {100 * overhead:6.2f} %   (at most {100 * MAX_OVERHEAD:.0f} %)")
    print(f"efficiency {efficiency:6.3f}     (at least {MIN_EFFICIENCY})")


def _timed(name: str, options: dict[str, float], slurm: bool, workers: int) -> float:
    """Time for the chunks [s], once all workers are there."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        inputs = folder / "inputs"
        inputs.mkdir()
        begun = time.perf_counter()
        with _engine(folder, slurm, workers) as engine, Journal(folder / "journal") as journal:
            while engine.workers < max(1, workers):
                run_work(_warm_up(engine), engine, inputs, journal)
            ready = time.perf_counter()
            run_work(make_toy_work(inputs, options), engine, inputs, journal)
            done = time.perf_counter()
    print(f"{name:12s} {done - ready:8.3f} s, up after {ready - begun:.2f} s")
    return done - ready


def _engine(folder: Path, slurm: bool, workers: int) -> LocalEngine | DaskEngine:
    if not workers:
        return LocalEngine()
    if slurm:
        name = f"fixel-{time.time_ns():x}"[:18]
        pool: SlurmPool | LocalPool = SlurmPool(
            folder, workers, SITE, name, notify=print, poll_s=0.5
        )
    else:
        pool = LocalPool(folder, workers)
    return DaskEngine(folder, pool, notify=print)


def _warm_up(engine: LocalEngine | DaskEngine) -> Generator[Round, Any, Any]:
    """Chunks of no length, until the workers are there."""
    chunks = next(make_toy_work(Path(), {"rounds": 1, "chunks": 4})).chunks
    now = time.time_ns()
    time.sleep(0.1 if engine.workers else 0.0)
    yield Round(FUNCTION, [Chunk(f"{chunk.name}-{now}", chunk.payload) for chunk in chunks])
    return b""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--chunks", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a chunk")
    parser.add_argument("--kind", choices=["sleep", "compute"], default="sleep")
    parser.add_argument("--slurm", action="store_true", help="on a real SLURM on this machine")
    return parser


if __name__ == "__main__":
    main()
