"""Reproductions of published work and benchmarks on real data, by name."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Final

from fixel.datasets.mit_push import has_pushes, read_mit_pushes
from fixel.drawing.chart import save_figure
from fixel.errors import DatasetMissing, InvalidInput, os_reason
from fixel.replay.base import Row
from fixel.typing import ProgressCallback
from reproductions import (
    asme_2006,
    asme_assembly,
    cmu_tripod,
    coverage,
    engines,
    error_bounds,
    learned_sides,
    mit_push,
    new_parts,
    new_sides,
    plans,
    rates,
    repeated_plans,
    repeats,
    rpi_141,
    table_maps,
    thesis_grasps,
)
from reproductions.charts.pictures import benchmark_figure
from reproductions.protocols import PROTOCOLS, BenchmarkRequest
from reproductions.result import (
    Benchmark,
    Reproduction,
    RunOptions,
    write_tables,
)

PARTS: Final = ("mit",)  # parts of the benchmark
MIT_PUSHES: Final = "mit_push_endpoints"  # its folder in the data folder


# Folder of the dataset (empty for the folder of all datasets, None for none), and function that
# runs the reproduction.
REPRODUCTIONS: Final[Mapping[str, tuple[str | None, Callable[[RunOptions], Reproduction]]]] = (
    MappingProxyType(
        {
            "cmu-tripod": ("cmu_tripod_push", cmu_tripod.run),
            "rpi-141": ("rpi_2dgad", rpi_141.run),
            "asme-table-1": (None, asme_2006.run_table_1),
            "asme-figure-11": (None, asme_2006.run_figure_11),
            "asme-assembly": (None, asme_assembly.run),
            "thesis-grasps": (None, thesis_grasps.run),
            "repeats": ("cmu_two_point_push", repeats.run),
            "error-bounds": (MIT_PUSHES, error_bounds.run),
            "new-sides": (MIT_PUSHES, new_sides.run),
            "new-parts": (MIT_PUSHES, new_parts.run),
            "table-maps": (MIT_PUSHES, table_maps.run),
            "learned-sides": (MIT_PUSHES, learned_sides.run),
            "coverage": (MIT_PUSHES, coverage.run),
            "plans": (MIT_PUSHES, plans.run),
            "repeated-plans": ("cmu_two_point_push", repeated_plans.run),
            "rates": ("", rates.run),
            "engines": ("", engines.run),
        }
    )
)


def reproduce(
    name: str,
    data: Path | None = None,
    *,
    out: Path | None = None,
    progress: ProgressCallback | None = None,
    quick: bool = False,
) -> Reproduction:
    """Run one reproduction, and write its tables and figure to a folder.

    Parameters
    ----------
    name : str
        Name of the reproduction, one of `REPRODUCTIONS`.
    data : Path, optional
        Folder of all datasets, or of the required one.
    out : Path, optional
        Folder for `<name>.json`, a `<name>_<table>.csv` for each table, and `<name>.png`; also for
        finished fits in `fits`, if there are any.
    progress : callable, optional
    quick : bool
        Test run without meaningful figures.
    """
    if name not in REPRODUCTIONS:
        raise InvalidInput(
            "reproduction", found=repr(name), expected="one of " + ", ".join(REPRODUCTIONS)
        )
    begun = clock.perf_counter()
    dataset, run = REPRODUCTIONS[name]
    options = RunOptions(
        folder=Path() if dataset is None else _folder(data, dataset),
        progress=progress or _silent,
        quick=quick,
        fits=None if out is None else out / "fits",
    )
    answer = replace(run(options), name=name, seconds=clock.perf_counter() - begun)
    if out is not None:
        answer.write(out)
    return answer


def benchmark_real(
    data: Path,
    request: BenchmarkRequest | None = None,
    *,
    part: str = "mit",
    out: Path | None = None,
    progress: ProgressCallback | None = None,
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
    pushes = read_mit_pushes(folder_of(data, part))
    fits = None
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            reason = os_reason(problem)
            raise InvalidInput(str(out), found=reason, expected="a folder to write to") from None
        fits = out / "fits"
    answer = mit_push.benchmark_pushes(
        pushes, request or BenchmarkRequest(), fits, progress or _silent
    )
    if out is not None:
        write_tables(answer, out)
        draw = partial(benchmark_figure, answer.scored, answer.rows)
        save_figure(draw, out / f"{part}.png")
    return answer


def joint_real(data: Path, part: str = "mit") -> Row:
    """Run and time a joint calibration of many pushes; see `joint_calibration`."""
    pushes = read_mit_pushes(folder_of(data, part))
    return mit_push.joint_calibration(pushes)


def folder_of(data: Path, part: str) -> Path:
    """Return the folder of a part's dataset; raise `DatasetMissing` if there is none."""
    if part not in PARTS:
        raise InvalidInput("--only", found=repr(part), expected="one of " + ", ".join(PARTS))
    for folder in (data / MIT_PUSHES, data):
        if has_pushes(folder):
            return folder
    raise DatasetMissing(data, f"{MIT_PUSHES} with pushes.csv.gz and shapes.json")


def _folder(data: Path | None, name: str) -> Path:
    if data is not None and not name:
        return data
    for folder in () if data is None else (data / name, data):
        if folder.name == name and folder.is_dir():
            return folder
    raise DatasetMissing(data or Path(name), name or "any dataset")


def _silent(done: int, total: int, note: str = "") -> None:
    """ProgressCallback callback that does nothing."""


__all__ = [
    "PARTS",
    "PROTOCOLS",
    "REPRODUCTIONS",
    "BenchmarkRequest",
    "benchmark_real",
    "folder_of",
    "joint_real",
    "reproduce",
]
