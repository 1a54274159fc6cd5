"""Solve a million random step problems, and say which were not solved.

    python -m benchmarks.soak --n 1000000 --seed 0

Every problem is a function of its seed (`benchmarks.random_problems`): a failure can be had
again.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.random_problems import solve_many
from fixel.kernels import codes

CHUNK = 2_000
SHOWN = 20  # failures named


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=1_000_000, help="problems, half of them warm")
    parser.add_argument("--seed", type=int, default=0, help="of the first one")
    arguments = parser.parse_args()
    tally = np.zeros(4)
    failures: list[int] = []
    n_failed = 0
    started = time.perf_counter()
    console = Console(stderr=True)
    seeds = range(arguments.seed, arguments.seed + max(1, arguments.n // 2), CHUNK)
    for first in track(seeds, description="solving", console=console):
        failed = np.full(SHOWN, -1, np.int64)
        count = min(CHUNK, arguments.seed + max(1, arguments.n // 2) - first)
        n_failed += int(solve_many(first, count, codes.NEWTON, 0, failed, tally))
        failures += [int(k) for k in failed if k >= 0]
    seconds = time.perf_counter() - started
    print(
        f"{tally[0]:.0f} problems in {seconds:.1f} s ({tally[0] / seconds:.0f} per second); "
        f"{n_failed} failures; worst residual {tally[2]:.2e}; "
        f"{100.0 * tally[1] / max(tally[0], 1.0):.1f} % by a fallback"
    )
    for k in failures[:SHOWN]:
        print(f"not solved: seed {k // 2}, {'warm' if k % 2 else 'cold'}")
    return 1 if n_failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
