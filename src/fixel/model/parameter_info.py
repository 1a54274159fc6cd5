"""Description of a parameter."""

from __future__ import annotations

from typing import NamedTuple


class ParameterInfo(NamedTuple):
    """Unit, range and meaning of a parameter."""

    unit: str
    meaning: str
    lowest: float = 0.0  # smallest value
    above: bool = False  # whether `lowest` itself is excluded
    # Property of the real object that an estimate of an effective parameter represents; empty where
    # the parameter itself is such a property.
    stands_for: str = ""
    # Contact of the free body that the parameter acts on: "pusher" or "fixel"; empty for others.
    contact: str = ""
    # Of another engine: lower bound, start and upper bound of a usual search.
    usual: tuple[float, float, float] | None = None
