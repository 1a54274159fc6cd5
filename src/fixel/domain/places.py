"""Places of the experiments of a group, and the order in which they join the domain.

Source: RPI thesis, section 5.3 for the places and appendix C.6 for the order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, final

from fixel.errors import InvalidInput
from fixel.model.fields import settle

Index = Literal["corrected", "printed"]
AXES: Final = ("x", "y", "theta")
INDEXES: Final = ("corrected", "printed")


class AxisPlace(NamedTuple):
    """Number of steps from the nominal pose along one axis."""

    axis: str
    step: int

    @property
    def name(self) -> str:
        """Name in the thesis's plan: `y-5`."""
        return self.axis if self == NOMINAL else f"{self.axis}{self.step}"


NOMINAL: Final = AxisPlace("nominal", 0)

# The 21 rows of a group in the order of the printed code, numbered from 1.
ROWS: Final = (
    NOMINAL,
    *(AxisPlace("x", k) for k in range(1, 6)),
    *(AxisPlace("y", k) for k in range(5, 0, -1)),
    *(AxisPlace("y", -k) for k in range(1, 6)),
    *(AxisPlace("theta", k) for k in range(1, 6)),
)
PRINTED_STEPS: Final = 5


def joining(step: int, index: Index = "corrected") -> tuple[AxisPlace, ...]:
    """Return the places that join the domain at a step, from 1: x+i, y+i, y-i, theta+i.

    The printed code takes theta from row 15 + i, one too early: at step 1 this is y-5, which joins
    again at step 5, and theta+5, row 21, never joins. `"printed"` does the same.
    """
    if index == "corrected":
        return (
            AxisPlace("x", step),
            AxisPlace("y", step),
            AxisPlace("y", -step),
            AxisPlace("theta", step),
        )
    if index not in INDEXES:
        raise InvalidInput("index", found=repr(index), expected="corrected or printed")
    if not 1 <= step <= PRINTED_STEPS:
        raise InvalidInput("step", found=step, expected="1 to 5, as printed")
    return tuple(ROWS[row - 1] for row in (1 + step, 12 - step, 11 + step, 15 + step))


def domain(step: int, index: Index = "corrected") -> tuple[AxisPlace, ...]:
    """Return the places in the domain after a step, in order: the nominal one, then 4 per step."""
    joined = (place for k in range(1, step + 1) for place in joining(k, index))
    return (NOMINAL, *joined)


def interval(axis: str, size: int) -> tuple[int, int]:
    """Return the first and last step of a domain of `size` samples along an axis.

    The samples include the nominal one: "when the domain size is expanded to 4 samples" (6.2.1).
    Along x and theta, sampled in one direction, they begin there: 4 is 0 to 3. Along y they are
    centred: 3 is -1 to 1; even numbers, unused in the thesis, have one more on the positive side.
    """
    if axis not in AXES:
        raise InvalidInput("axis", found=repr(axis), expected="x, y or theta")
    if size < 2:
        raise InvalidInput(f"size of {axis}", found=size, expected="2 samples at least")
    low = -((size - 1) // 2) if axis == "y" else 0
    return low, low + size - 1


def along(axis: str, step: int) -> AxisPlace:
    """Return a place on an axis; step 0 is the nominal place."""
    return AxisPlace(axis, step) if step else NOMINAL


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentGroup:
    """Experiments of one shape and layout.

    Parameters
    ----------
    shape, layout : str
    at : mapping from AxisPlace to int
        Index of the experiment at each place that has one.
    """

    shape: str
    layout: str
    at: Mapping[AxisPlace, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        settle(self, at=MappingProxyType(dict(self.at)))
        if NOMINAL not in self.at:
            raise InvalidInput(
                f"group {self.name}",
                found="no nominal experiment",
                expected="the one that all others are offset from",
                hint="perform it, or leave the group out: --shape",
            )

    @property
    def name(self) -> str:
        """Shape and layout as one name."""
        return f"{self.shape} {self.layout}"

    @property
    def reach(self) -> int:
        """Largest step at which an experiment joins."""
        return max(abs(place.step) for place in self.at)

    def found(self, places: Sequence[AxisPlace]) -> tuple[int, ...]:
        """Return the experiments at places, without those that are missing."""
        return tuple(self.at[place] for place in places if place in self.at)

    def missing(self, places: Sequence[AxisPlace]) -> list[AxisPlace]:
        """Return the places without an experiment, each once."""
        return [place for place in dict.fromkeys(places) if place not in self.at]
