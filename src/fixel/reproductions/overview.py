"""Reproductions of published work by name: the folder each needs, and what runs it."""

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
from fixel.typing import NotedProgress


class Part(NamedTuple):
    """One reproduction."""

    folder: str | None  # of its dataset; empty for the folder of all, None where it needs none
    run: Callable[..., Reproduction]  # (folder, progress, *, quick[, kept])
    keeps: bool = False  # whether it takes a folder of finished fits


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
    progress: NotedProgress | None = None,
    quick: bool = False,
) -> Reproduction:
    """Run one reproduction, and leave its tables and picture in a folder.

    Parameters
    ----------
    name : str
        Out of `REPRODUCTIONS`.
    data : Path, optional
        Folder of the datasets, or of the one.
    out : Path, optional
        Receives `<name>.json`, a table of each kind as `<name>_<table>.csv`, and `<name>.png`;
        finished fits in `fits`, where there are any.
    progress : callable, optional
    quick : bool
        A look, not figures.
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
    """Leave tables and picture in a folder, which is made."""
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


def _silent(done: int, of: int, what: str) -> None:
    """Nobody watches."""
