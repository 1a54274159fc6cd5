"""Result of a reproduction of published work: tables, conclusions and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

Row = dict[str, Any]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Tables of plain numbers, with units in the names, and conclusions from them.

    Attributes
    ----------
    name : str
    tables : mapping of str to list of dict
        Tables as rows of plain values.
    conclusions : sequence of str
        Conclusions from the tables, in sentences.
    settings : dict
        Settings, sufficient to repeat the reproduction.
    picture : object
        Figure for `fixel.reproductions.charts.reproductions.draw`.
    seconds : float
        Wall time [s].
    """

    name: str
    tables: Mapping[str, list[Row]]
    conclusions: Sequence[str]
    settings: Row
    picture: Any
    seconds: float

    def summary(self) -> Row:
        """Return all results as plain values, for `--json`."""
        return {
            "name": self.name,
            "settings": self.settings,
            **self.tables,
            "conclusions": list(self.conclusions),
            "seconds": round(self.seconds, 1),
        }
