"""What a reproduction of published work leaves behind: tables, conclusions, a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

Row = dict[str, Any]

# Told after each part: how many of how many are done, and what was.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Tables of plain numbers, units in the names, and what they say.

    Attributes
    ----------
    name : str
    tables : mapping of str to list of dict
        Rows of plain values.
    conclusions : sequence of str
        Sentences that the tables bear out.
    settings : dict
        What it takes to do it again.
    picture : object
        What `fixel.reproductions.charts.reproductions.draw` asks for.
    seconds : float
        Time it took.
    """

    name: str
    tables: Mapping[str, list[Row]]
    conclusions: Sequence[str]
    settings: Row
    picture: Any
    seconds: float

    def summary(self) -> Row:
        """Plain values, for `--json`."""
        return {
            "name": self.name,
            "settings": self.settings,
            **self.tables,
            "conclusions": list(self.conclusions),
            "seconds": round(self.seconds, 1),
        }
