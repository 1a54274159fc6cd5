"""Reproductions of published work by name, with their dataset folders and functions."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from fixel.errors import DatasetMissing, InvalidInput
from fixel.io.atomic import written_whole
from fixel.reproductions import (
    asme_figure_11,
    asme_table_1,
    cmu_tripod,
    coverage,
    new_sides,
    promise,
    rates,
    repeats,
    rpi_141,
)
from fixel.reproductions.reproduction import Reproduction, Row
from fixel.typing import Progress


class Part(NamedTuple):
    """Reproduction: folder of its data and function that runs it."""

    folder: str | None  # folder of its dataset; empty for the folder of all datasets, None for none
    run: Callable[..., Reproduction]  # (folder, progress, *, quick[, kept])
    keeps: bool = False  # whether it accepts a folder of finished fits


REPRODUCTIONS: Final[Mapping[str, Part]] = MappingProxyType(
    {
        "cmu-tripod": Part("cmu_tripod_push", cmu_tripod.run),
        "rpi-141": Part("rpi_2dgad", rpi_141.run),
        "asme-table-1": Part(None, asme_table_1.run),
        "asme-figure-11": Part(None, asme_figure_11.run),
        "repeats": Part("cmu_two_point_push", repeats.run),
        "promise": Part("mit_push_endpoints", promise.run, keeps=True),
        "new-sides": Part("mit_push_endpoints", new_sides.run, keeps=True),
        "coverage": Part("mit_push_endpoints", coverage.run, keeps=True),
        "rates": Part("", rates.run, keeps=True),
    }
)


def reproduce(
    name: str,
    data: Path | None = None,
    *,
    out: Path | None = None,
    progress: Progress | None = None,
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
    part = REPRODUCTIONS[name]
    folder = None if part.folder is None else _folder(data, part.folder)
    more = {"kept": None if out is None else out / "fits"} if part.keeps else {}
    answer = part.run(folder, progress or _silent, quick=quick, **more)
    if out is not None:
        write(answer, out)
    return answer


def write(answer: Reproduction, out: Path) -> None:
    """Write tables and figure to a folder, which is created."""
    from fixel.drawing.chart import AbstractChart, draw_chart
    from fixel.reproductions.charts.reproductions import draw

    out.mkdir(parents=True, exist_ok=True)
    with written_whole(out / f"{answer.name}.json") as beside:
        beside.write_text(json.dumps(answer.summary(), indent=1), encoding="utf-8")
    for name, rows in answer.tables.items():
        _write_table(out / f"{answer.name}_{name}.csv", rows)
    picture = out / f"{answer.name}.png"
    if isinstance(answer.picture, AbstractChart):
        draw_chart(answer.picture, picture)
    else:
        draw(answer.picture, picture)


def _write_table(file: Path, rows: list[Row]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with (
        written_whole(file) as beside,
        beside.open("w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def _folder(data: Path | None, name: str) -> Path:
    if data is not None and not name:
        return data
    for folder in () if data is None else (data / name, data):
        if folder.name == name and folder.is_dir():
            return folder
    raise DatasetMissing(data or Path(name), name or "any dataset")


def _silent(done: int, total: int, note: str = "") -> None:
    """Progress callback that does nothing."""
