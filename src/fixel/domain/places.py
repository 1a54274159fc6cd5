"""Where the experiments of a group stand, and which join the domain at which step.

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
    """Steps from the nominal pose along one axis."""

    axis: str
    step: int

    @property
    def name(self) -> str:
        """As the thesis's plan writes it: `y-5`."""
        return self.axis if self == NOMINAL else f"{self.axis}{self.step}"


NOMINAL: Final = AxisPlace("nominal", 0)

# The 21 rows of a group in the order in which the printed code numbers them, from 1.
ROWS: Final = (
    NOMINAL,
    *(AxisPlace("x", k) for k in range(1, 6)),
    *(AxisPlace("y", k) for k in range(5, 0, -1)),
    *(AxisPlace("y", -k) for k in range(1, 6)),
    *(AxisPlace("theta", k) for k in range(1, 6)),
)
PRINTED_STEPS: Final = 5


def joining(step: int, index: Index = "corrected") -> tuple[AxisPlace, ...]:
    """Places that join the domain at a step, from 1: x+i, y+i, y-i, theta+i.

    The printed code takes theta from row 15 + i, one too early: at step 1 that is y-5, which comes
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
    """Places in the domain after a step, in the order they joined; 4 a step and the nominal one."""
    joined = (place for k in range(1, step + 1) for place in joining(k, index))
    return (NOMINAL, *joined)


def interval(axis: str, size: int) -> tuple[int, int]:
    """First and last step of a domain of so many samples along an axis.

    They contain the nominal one: "when the domain size is expanded to 4 samples" (6.2.1). Along x
    and theta, sampled one way, they begin there: 4 is 0 to 3. Along y they are centred: 3 is -1 to
    1; of an even number the odd one stands on the positive side, which the thesis does not use.
    """
    if axis not in AXES:
        raise InvalidInput("axis", found=repr(axis), expected="x, y or theta")
    if size < 2:
        raise InvalidInput(f"size of {axis}", found=size, expected="2 samples at least")
    low = -((size - 1) // 2) if axis == "y" else 0
    return low, low + size - 1


def along(axis: str, step: int) -> AxisPlace:
    """A place on an axis; the nominal one is on all of them."""
    return AxisPlace(axis, step) if step else NOMINAL


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentGroup:
    """Experiments of one shape and layout.

    Parameters
    ----------
    shape, layout : str
    at : mapping from Place to int
        Number of the experiment at each place that has one.
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
        """Shape and layout."""
        return f"{self.shape} {self.layout}"

    @property
    def reach(self) -> int:
        """Largest step at which any experiment would join."""
        return max(abs(place.step) for place in self.at)

    def found(self, places: Sequence[AxisPlace]) -> tuple[int, ...]:
        """Experiments at places, those without left out."""
        return tuple(self.at[place] for place in places if place in self.at)

    def missing(self, places: Sequence[AxisPlace]) -> list[AxisPlace]:
        """Places without an experiment, each once."""
        return [place for place in dict.fromkeys(places) if place not in self.at]
