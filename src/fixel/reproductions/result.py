"""What a benchmark leaves behind: errors of every scored record, and rows that sum them up.

Shared by all benchmarks on real data: each scores records under protocols, beside what was
published and what the simulator says before anything is calibrated.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.io.atomic import written_whole
from fixel.reproductions.replay.report import mean_and_median
from fixel.typing import FloatArray

Row = dict[str, Any]
# Told after each part: how many of how many are done, and what they are.

ALL: Final = "all"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutScores:
    """Held-out records of one protocol; every array has one entry each.

    Attributes
    ----------
    protocol : str
    names : tuple of str
        Of the records; one may come several times, held out by several splits.
    repeat : (n,) int
        Which split, or fold.
    groups : tuple of tuple of str
        What each belongs to, from coarse to fine: surface, shape.
    position, angle : mapping from model to (n,) float64
        Errors [mm], absolute ones [deg]; NaN where a model has no answer.
    inside : (n, 3) bool array, optional
        Whether x, y and angle lie in the interval predicted to hold 90 %.
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
    """The answer of a benchmark on one dataset.

    Attributes
    ----------
    part : str
        `"mit"`.
    scored : tuple of HeldOutScores
    settings, timing : dict
        Enough to do it again; wall times [s].
    notes : tuple of str
    fits : tuple of dict
        What was found, one a fit.
    """

    part: str
    scored: tuple[HeldOutScores, ...]
    settings: Row
    timing: Row
    notes: tuple[str, ...] = ()
    fits: tuple[Row, ...] = field(default=(), repr=False)

    @property
    def rows(self) -> list[Row]:
        """One a protocol and group, and one a protocol of all its groups together."""
        return [row for scored in self.scored for row in rows_of(scored)]

    def summary(self) -> Row:
        """The answer of `--json`."""
        return {
            "part": self.part,
            "settings": self.settings,
            "rows": self.rows,
            "notes": list(self.notes),
            "timing": self.timing,
        }


def rows_of(scored: HeldOutScores) -> list[Row]:
    """Aggregates of the whole, of the coarse groups and of the fine ones."""
    rows = [_row(scored, (ALL, ALL), np.ones(len(scored.names), bool))]
    for depth in (1, 2):
        for group in sorted({own[:depth] for own in scored.groups if len(own) >= depth}):
            fits = np.array([own[:depth] == group for own in scored.groups], bool)
            rows.append(_row(scored, (*group, ALL)[:2], fits))
    return rows


def _row(scored: HeldOutScores, group: tuple[str, ...], chosen: NDArray[np.bool_]) -> Row:
    """Every model on the same records: those that all of them have an answer to."""
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
    """A row without nesting, for a table: `calibrated_position_mm_mean`."""
    found: Row = {}
    for name, value in row.items():
        if isinstance(value, dict):
            found |= {f"{name}_{key}": inner for key, inner in flat(value).items()}
        else:
            found[name] = value
    return found


def write_tables(answer: Benchmark, folder: Path) -> list[Path]:
    """`rows.csv` with the aggregates and `pushes.csv` with every record."""
    files = [folder / f"{answer.part}_rows.csv", folder / f"{answer.part}_pushes.csv"]
    _write(files[0], [flat(row) for row in answer.rows])
    _write(files[1], [row for scored in answer.scored for row in _records(scored)])
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


def _write(path: Path, rows: Sequence[Row]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with (
        written_whole(path) as beside,
        beside.open("w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
