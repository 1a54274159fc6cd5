"""Computing time and evaluations of each stage of a calibration, out of its journal.

    fixel new lab && cd lab && fixel import FOLDER/mit_push_endpoints
    fixel calibrate --dataset mit-push --where surface=abs --where shape=rect1 \\
        --where speed_m_s=0.02
    python -m benchmarks.joint_verdicts jobs/calibration-*

Works on jobs that were killed and continued: their journals hold the same answers.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

from fixel.calibration.search import TIME
from fixel.io.array_bytes import arrays_of
from fixel.io.journal import read_journal

STAGES = {"squares": "search", "all together": "search", "verdicts": "verdicts"}


def stages(journal: Path) -> dict[str, tuple[int, float]]:
    """Evaluations, of all experiments each, and CPU time [s] by stage."""
    points: dict[str, int] = defaultdict(int)
    seconds: dict[str, float] = defaultdict(float)
    for name, data in read_journal(journal):
        stage = STAGES.get(name.rpartition(" ")[0].rpartition("/")[0])
        if stage is not None and data[:1] == b"A":
            arrays = arrays_of(data[1:])
            table = arrays.get("table")
            points[stage] += 0 if table is None else len(table)
            seconds[stage] += float(arrays[TIME])
    return {stage: (points[stage], seconds[stage]) for stage in seconds}


def main() -> None:
    """Print one line for each stage of each job."""
    for folder in map(Path, sys.argv[1:]):
        for stage, (count, spent) in stages(folder / "journal").items():
            print(f"{folder.name}  {stage:9s} {count:5d} evaluations {spent:8.1f} s CPU")


if __name__ == "__main__":
    main()
