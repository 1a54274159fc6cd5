"""Results of reproductions and benchmarks: tables, conclusions and figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.io.atomic import written_whole
from fixel.replay.base import Row, mean_and_median
from fixel.typing import FloatArray, ProgressCallback

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Value of a group's column in rows that aggregate over all groups.
ALL: Final = "all"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Options of a reproduction.

    Parameters
    ----------
    folder : Path
        Folder of its dataset, or of all datasets if it needs several; unused if its data are
        generated.
    progress : callable
        Called with the numbers of finished parts and of all, and the name of the part.
    quick : bool
        Test run without meaningful figures.
    fits : Path, optional
        Folder of finished fits, such as `fits` of `python -m reproductions --out`.
    """

    folder: Path
    progress: ProgressCallback
    quick: bool = False
    fits: Path | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Tables of plain numbers, with units in the names, and conclusions from them.

    Attributes
    ----------
    tables : mapping of str to list of dict
        Tables as rows of plain values.
    conclusions : sequence of str
        Conclusions from the tables, in sentences.
    settings : dict
        Settings, sufficient to repeat the reproduction.
    figure : callable
        Function that draws the figure.
    name : str
    seconds : float
        Wall time [s]; like the name, set by `reproduce`.
    """

    tables: Mapping[str, list[Row]]
    conclusions: Sequence[str]
    settings: Row
    figure: Callable[[], Figure]
    name: str = ""
    seconds: float = 0.0

    def summary(self) -> Row:
        """Return all results as plain values, for `--json`."""
        return {
            "name": self.name,
            "settings": self.settings,
            **self.tables,
            "conclusions": list(self.conclusions),
            "seconds": round(self.seconds, 1),
        }

    def write(self, out: Path) -> None:
        """Write `<name>.json`, a `<name>_<table>.csv` for each table, and `<name>.png`."""
        from fixel.drawing.chart import save_figure

        out.mkdir(parents=True, exist_ok=True)
        with written_whole(out / f"{self.name}.json") as file:
            file.write_text(json.dumps(self.summary(), indent=1), encoding="utf-8")
        for name, rows in self.tables.items():
            write_table(out / f"{self.name}_{name}.csv", rows)
        save_figure(self.figure, out / f"{self.name}.png")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutScores:
    """Errors of the held-out records of one protocol; arrays have one entry per record.

    Attributes
    ----------
    protocol : str
    names : tuple of str
        Names of the records; several splits may hold out the same record.
    repeat : (n,) int
        Index of the split or fold.
    groups : tuple of tuple of str
        Groups of each record, from coarse to fine: surface, shape.
    position, angle : mapping from model to (n,) float64
        Errors [mm] and absolute errors [deg]; NaN if a model has no prediction.
    inside : (n, 3) bool array, optional
        Whether x, y and angle are within their predicted 90 % intervals.
    """

    protocol: str
    names: tuple[str, ...]
    repeat: NDArray[np.int64]
    groups: tuple[tuple[str, ...], ...]
    position: Mapping[str, FloatArray]
    angle: Mapping[str, FloatArray]
    inside: NDArray[np.bool_] | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """Result of a benchmark on one dataset.

    Attributes
    ----------
    part : str
        Name of the part, such as `"mit"`.
    scored : tuple of HeldOutScores
    settings, timing : dict
        Settings, sufficient to repeat it; wall times [s].
    notes : tuple of str
    fits : tuple of dict
        Fitted values, one entry per fit.
    """

    part: str
    scored: tuple[HeldOutScores, ...]
    settings: Row
    timing: Row
    notes: tuple[str, ...] = ()
    fits: tuple[Row, ...] = field(default=(), repr=False)

    @property
    def rows(self) -> list[Row]:
        """Aggregates: one row per protocol and group, and one per protocol for all its groups."""
        return [row for scored in self.scored for row in rows_of(scored)]

    def summary(self) -> Row:
        """Return the output of `--json`."""
        return {
            "part": self.part,
            "settings": self.settings,
            "rows": self.rows,
            "notes": list(self.notes),
            "timing": self.timing,
        }


def rows_of(scored: HeldOutScores) -> list[Row]:
    """Aggregate over all records, over coarse groups and over fine ones."""
    rows = [_row(scored, (ALL, ALL), np.ones(len(scored.names), bool))]
    for depth in (1, 2):
        for group in sorted({own[:depth] for own in scored.groups if len(own) >= depth}):
            fits = np.array([own[:depth] == group for own in scored.groups], bool)
            rows.append(_row(scored, (*group, ALL)[:2], fits))
    return rows


def _row(scored: HeldOutScores, group: tuple[str, ...], chosen: NDArray[np.bool_]) -> Row:
    """Aggregate the errors of every model, on the records that all models can predict."""
    common = chosen & np.all([np.isfinite(v) for v in scored.position.values()], axis=0)
    row: Row = {
        "protocol": scored.protocol,
        "surface": group[0],
        "shape": group[1],
        "held_out": int(common.sum()),
        "unanswered": int((chosen & ~common).sum()),
    }
    for model in scored.position:
        row[model] = {
            "position_mm": mean_and_median(scored.position[model][common]),
            "angle_deg": mean_and_median(scored.angle[model][common]),
        }
    if scored.inside is not None:
        row["inside_90"] = float(scored.inside[common].mean()) if common.any() else None
    return row


def flat(row: Row) -> Row:
    """Flatten a nested row for a table; names become `calibrated_position_mm_mean`."""
    found: Row = {}
    for name, value in row.items():
        if isinstance(value, dict):
            found |= {f"{name}_{key}": inner for key, inner in flat(value).items()}
        else:
            found[name] = value
    return found


def write_tables(answer: Benchmark, folder: Path) -> list[Path]:
    """Write `<part>_rows.csv` with aggregates and `<part>_pushes.csv` with every record."""
    files = [folder / f"{answer.part}_rows.csv", folder / f"{answer.part}_pushes.csv"]
    write_table(files[0], [flat(row) for row in answer.rows])
    write_table(files[1], [row for scored in answer.scored for row in _records(scored)])
    return files


def _records(scored: HeldOutScores) -> list[Row]:
    columns = {
        f"{model}_{what}": np.round(table[model], 4).tolist()
        for model in scored.position
        for what, table in (("position_mm", scored.position), ("angle_deg", scored.angle))
    }
    return [
        {
            "protocol": scored.protocol,
            "push": name,
            "split": int(scored.repeat[k]),
            "surface": scored.groups[k][0],
            "shape": scored.groups[k][1],
            **{column: values[k] for column, values in columns.items()},
        }
        for k, name in enumerate(scored.names)
    ]


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows to a CSV file, with a column for every name that occurs."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with (
        written_whole(path) as file,
        file.open("w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
