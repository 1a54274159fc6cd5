"""The box a calibration searches: named values with unit, bounds, scale and start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, finite, frozen, optional_positive, positive, settle
from fixel.model.parameters import info_of, refuse_two_supports
from fixel.typing import FloatArray

# Of the range between its bounds: the scale of a parameter without one, as in Dakota.
SHARE_OF_RANGE: Final = 0.1


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknown(Comparable):
    """One value to calibrate.

    Parameters
    ----------
    name : str
        A known parameter: `"mu_pusher"`.
    low, high : float
        Bounds, in the parameter's own unit.
    nominal : float
        Where the search starts, and the value while it is frozen.
    scale : float, optional
        A step worth taking; a tenth of the range where left out.
    frozen : bool
        Whether it stays at its nominal value.
    prior : float, optional
        Standard deviation about the nominal value that was known before.
    where : mapping of str to str or float
        Conditions of the experiments that share this value; all of them where empty. An experiment
        takes the value of the first unknown of the name whose conditions it meets. The condition
        `"experiment"` is the experiment's key.
    """

    name: str
    low: float
    high: float
    nominal: float
    scale: float | None = None
    frozen: bool = False
    prior: float | None = None
    where: Mapping[str, str | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unit = info_of(self.name).unit
        low = finite(self.low, f"{self.name}.low", unit)
        high = finite(self.high, f"{self.name}.high", unit)
        nominal = finite(self.nominal, f"{self.name}.nominal", unit)
        if not low < high:
            raise InvalidInput(
                f"{self.name}", found=f"bounds {low:g} to {high:g}", expected="the lower one first"
            )
        if not low <= nominal <= high:
            raise InvalidInput(
                f"{self.name}.nominal",
                found=f"{nominal:g} outside the bounds {low:g} to {high:g}",
                expected="a start within them",
                hint="move the start, or widen the bounds",
            )
        scale = SHARE_OF_RANGE * (high - low) if self.scale is None else self.scale
        settle(
            self,
            low=low,
            high=high,
            nominal=nominal,
            scale=positive(scale, f"{self.name}.scale", unit),
            prior=optional_positive(self.prior, f"{self.name}.prior", unit),
            where=MappingProxyType(dict(sorted(self.where.items()))),
        )

    @property
    def label(self) -> str:
        """The name, with whom it is shared by: `"mu_pusher[surface=plywood]"`."""
        if not self.where:
            return self.name
        return f"{self.name}[{', '.join(f'{k}={v}' for k, v in self.where.items())}]"

    @property
    def unit(self) -> str:
        """Of its value."""
        return info_of(self.name).unit

    def covers(self, conditions: Mapping[str, str | float]) -> bool:
        """Whether an experiment under these conditions takes this value."""
        return all(conditions.get(k) == v for k, v in self.where.items())


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterSpace(Comparable):
    """Unknowns and where to look for them.

    Arrays have one entry a *free* unknown, in their order; frozen ones are left out.

    Parameters
    ----------
    unknowns : sequence of Unknown
        Each label once.
    """

    unknowns: tuple[Unknown, ...]

    def __post_init__(self) -> None:
        settle(self, unknowns=tuple(self.unknowns))
        labels = [unknown.label for unknown in self.unknowns]
        for label in labels:
            if labels.count(label) > 1:
                raise InvalidInput("space", found=f"{label} twice", expected="each unknown once")
        refuse_two_supports(u.name for u in self.unknowns if not u.where)
        if not self.free:
            raise InvalidInput(
                "space",
                found="no unknown that is free" if labels else "no unknown",
                expected="one at least to calibrate",
            )

    @property
    def free(self) -> tuple[Unknown, ...]:
        """Those that a search may change."""
        return tuple(unknown for unknown in self.unknowns if not unknown.frozen)

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the free unknowns."""
        return tuple(unknown.label for unknown in self.free)

    @property
    def low(self) -> FloatArray:
        """(n_free,) lower bounds."""
        return frozen([unknown.low for unknown in self.free])

    @property
    def high(self) -> FloatArray:
        """(n_free,) upper bounds."""
        return frozen([unknown.high for unknown in self.free])

    @property
    def nominal(self) -> FloatArray:
        """(n_free,) start of the search."""
        return frozen([unknown.nominal for unknown in self.free])

    @property
    def scale(self) -> FloatArray:
        """(n_free,) steps worth taking."""
        return frozen(np.array([unknown.scale for unknown in self.free], np.float64))

    def values(self, point: ArrayLike) -> dict[str, float]:
        """Value of every unknown, frozen ones too, by label, at a point (n_free,)."""
        free = dict(zip(self.labels, np.asarray(point, np.float64).tolist(), strict=True))
        return {u.label: free.get(u.label, u.nominal) for u in self.unknowns}

    def columns(
        self, points: ArrayLike, conditions: Mapping[str, str | float]
    ) -> dict[str, FloatArray]:
        """Values by name of parameter for one experiment, at points (n, n_free) -> (n,) each.

        A parameter that no unknown gives this experiment is left out.
        """
        table = np.asarray(points, np.float64)
        free = {label: k for k, label in enumerate(self.labels)}
        found: dict[str, FloatArray] = {}
        for unknown in self.unknowns:
            if unknown.name not in found and unknown.covers(conditions):
                k = free.get(unknown.label)
                found[unknown.name] = (
                    np.full(len(table), unknown.nominal) if k is None else table[:, k]
                )
        return found

    def with_frozen(self, values: Mapping[str, float]) -> ParameterSpace:
        """The space with some unknowns frozen at values, by label."""
        strangers = set(values) - {unknown.label for unknown in self.unknowns}
        if strangers:
            raise InvalidInput(
                "space",
                found=f"no unknown {', '.join(sorted(strangers))}",
                expected="one of " + ", ".join(unknown.label for unknown in self.unknowns),
            )
        return ParameterSpace(
            unknowns=tuple(
                replace(u, nominal=values[u.label], frozen=True) if u.label in values else u
                for u in self.unknowns
            )
        )

    def started_at(self, point: ArrayLike) -> ParameterSpace:
        """The space with its search starting at a point (n_free,), moved inside the bounds."""
        inside = np.clip(np.asarray(point, np.float64), self.low, self.high).tolist()
        start = dict(zip(self.labels, inside, strict=True))
        return ParameterSpace(
            unknowns=tuple(replace(u, nominal=start.get(u.label, u.nominal)) for u in self.unknowns)
        )


def shared_by(unknown: Unknown, condition: str, values: Sequence[str | float]) -> list[Unknown]:
    """One unknown a value of a condition, each shared by the experiments that have it."""
    return [replace(unknown, where={**unknown.where, condition: value}) for value in values]
