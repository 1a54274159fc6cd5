"""Benchmarks on real data: calibrate on some records and score on held-out ones."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from fixel.datasets.raw.mit_push import read, recognised
from fixel.errors import DatasetMissing, InvalidInput, os_reason
from fixel.reproductions.joint import joint_calibration
from fixel.reproductions.mit_push import benchmark_pushes
from fixel.reproductions.protocols import PROTOCOLS, BenchmarkRequest
from fixel.reproductions.result import Benchmark, Row, write_tables
from fixel.typing import Progress

PARTS: Final = ("mit",)
# Subfolder of each part's dataset in the data folder; the data folder itself is tried too.
FOLDERS: Final = {"mit": "mit_push_endpoints"}


def benchmark_real(
    data: Path,
    request: BenchmarkRequest | None = None,
    *,
    part: str = "mit",
    out: Path | None = None,
    progress: Progress | None = None,
) -> Benchmark:
    """Run a benchmark on real data.

    Parameters
    ----------
    data : Path
        Folder of all datasets, or of this one.
    request : BenchmarkRequest, optional
        Protocols, splits and settings; all protocols by default.
    part : str
        Part of the benchmark, one of `PARTS`.
    out : Path, optional
        Folder for tables, a figure, and finished fits, from which the same request continues.
    progress : callable, optional
        Called with the numbers of finished parts and of all, and the name of the part.

    Raises
    ------
    DatasetMissing
        The dataset is not in the folder.
    InvalidInput
        An invalid request or folder.
    """
    pushes = read(folder_of(data, part))
    kept = None
    if out is not None:
        _make(out)
        kept = out / "fits"
    answer = benchmark_pushes(pushes, request or BenchmarkRequest(), kept, progress or _silent)
    if out is not None:
        write_tables(answer, out)
        draw_benchmark(answer, out / f"{part}.png")
    return answer


def joint_real(data: Path, part: str = "mit", progress: Progress | None = None) -> Row:
    """Run and time a joint calibration of many pushes; see `joint_calibration`."""
    return joint_calibration(read(folder_of(data, part)), progress or _silent)


def draw_benchmark(answer: Benchmark, file: Path) -> None:
    """Draw errors by group and their distributions to a file: .png, .svg or .pdf."""
    from fixel.reproductions.charts.benchmark import BenchmarkPicture, draw

    panels = []
    for scored in answer.scored:
        rows = [row for row in answer.rows if row["protocol"] == scored.protocol]
        panels.append((scored.protocol, rows, scored.position, scored.angle))
    draw(BenchmarkPicture.of(panels), file)


def folder_of(data: Path, part: str) -> Path:
    """Return the folder of a part's dataset; raise `DatasetMissing` if there is none."""
    if part not in PARTS:
        raise InvalidInput("--only", found=repr(part), expected="one of " + ", ".join(PARTS))
    for folder in (data / FOLDERS[part], data):
        if recognised(folder):
            return folder
    raise DatasetMissing(data, f"{FOLDERS[part]} with pushes.csv.gz and shapes.json")


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        reason = os_reason(problem)
        raise InvalidInput(str(out), found=reason, expected="a folder to write to") from None


def _silent(done: int, total: int, note: str = "") -> None:
    """Progress callback that does nothing."""


__all__ = [
    "PARTS",
    "PROTOCOLS",
    "Benchmark",
    "BenchmarkRequest",
    "benchmark_real",
    "draw_benchmark",
    "folder_of",
    "joint_real",
]
