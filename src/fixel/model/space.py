"""Search space of a calibration: named values with unit, bounds, scale and start."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from types import MappingProxyType
from typing import Annotated, Any, Final, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, check_name
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    finite,
    frozen,
    optional_positive,
    positive,
    settle,
    texts,
    vector,
)
from fixel.model.parameters import ParameterInfo, Parameters, check_supports, info_of
from fixel.typing import FloatArray

_ANY: Final = ParameterInfo("-", "a number of any size", -math.inf)
# Default scale of a parameter, as a share of the range between its bounds, as in Dakota.
SHARE_OF_RANGE: Final = 0.1


_LABEL: Final = re.compile(r"(?P<name>[\w.]+)(?:\[(?P<where>.*)\])?")


@final
@dataclass(frozen=True, slots=True)
class Parameter:
    """Bounds within which a calibration searches a parameter, and how it searches.

    Parameters
    ----------
    low, high : float
        Bounds, in the parameter's SI unit.
    start : float, optional
        Start of the search; by default the mean of the prior, else the scene's own value.
    prior : (float, float), optional
        Mean and standard deviation of prior knowledge, in the parameter's unit. The search starts
        at the mean.
    scale : float, optional
        First step of the search; a tenth of the range by default.
    by : str or sequence of str
        Names of conditions. Each of their values has a parameter value of its own: `by="surface"`.

    Raises
    ------
    InvalidInput
        A bound, the start or the prior is not a finite number, or they contradict each other.

    Examples
    --------
    >>> from fixel.units import mm
    >>> space = {"mu_pusher": Parameter(0, 1, by="surface"), "tripod_radius": (10 * mm, 60 * mm)}
    >>> Parameter(1, 0)
    Traceback (most recent call last):
    fixel.errors.InvalidInput: parameter: found bounds 1 to 0, but fixel needs the lower bound first
    """

    low: Annotated[float, Value(finite)]
    high: Annotated[float, Value(finite)]
    _: KW_ONLY
    start: Annotated[float | None, Value(finite)] = None
    prior: tuple[float, float] | None = None
    scale: Annotated[float | None, Value(positive)] = None
    by: Annotated[str | Sequence[str], Value(texts)] = ()

    def __post_init__(self) -> None:
        check_fields(self, "parameter")
        check_bounds(self.low, self.high, "parameter")
        if self.prior is not None:
            mean, sd = vector(self.prior, "parameter.prior", "mean, standard deviation").tolist()
            if self.start not in (None, mean):
                found = f"{self.start:g}, and a prior about {mean:g}"
                expected = "one of them, since the search starts at the mean of the prior"
                raise InvalidInput("parameter.start", found=found, expected=expected)
            settle(self, start=mean, prior=(mean, positive(sd, "parameter.prior")))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknown(Comparable):
    """Value to calibrate.

    Parameters
    ----------
    name : str
        Name of a known parameter: `"mu_pusher"`.
    low, high : float
        Bounds, in the parameter's own unit.
    nominal : float
        Start of the search, and the value while it is frozen.
    scale : float, optional
        Typical step of a search; by default a tenth of the range.
    frozen : bool
        Whether it is fixed at its nominal value.
    prior : float, optional
        Standard deviation of prior knowledge about the nominal value.
    where : mapping of str to str or float
        Conditions of the experiments that share this value; empty for all experiments. An
        experiment has the value of the first unknown of a name whose conditions it meets. The
        condition `"experiment"` is the experiment's key.
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
        info = info_of(self.name)
        unit = info.unit
        low = finite(self.low, f"{self.name}.low", unit)
        high = finite(self.high, f"{self.name}.high", unit)
        nominal = finite(self.nominal, f"{self.name}.nominal", unit)
        check_bounds(low, high, self.name, info)
        if not low <= nominal <= high:
            found = f"{nominal:g} outside the bounds {low:g} to {high:g}"
            expected = "a start within them"
            hint = "move the start, or widen the bounds"
            raise InvalidInput(f"{self.name}.start", found=found, expected=expected, hint=hint)
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

    @classmethod
    def fixed(
        cls, name: str, value: float, where: Mapping[str, str | float] | None = None
    ) -> Unknown:
        """Return a parameter that is fixed at a value."""
        value = Parameters({name: value})[name]
        margin = max(abs(value), 1.0)
        low = max(value - margin, info_of(name).lowest)
        return cls(
            name=name, low=low, high=value + margin, nominal=value, frozen=True, where=where or {}
        )

    @property
    def label(self) -> str:
        """Name with the conditions that share it: `"mu_pusher[surface=plywood]"`."""
        if not self.where:
            return self.name
        return f"{self.name}[{', '.join(f'{k}={v}' for k, v in self.where.items())}]"

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return info_of(self.name).unit

    def plain(self) -> dict[str, Any]:
        """Return the fields as plain values, from which `Unknown(**plain)` makes the same."""
        own = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return own | {"where": dict(self.where)}

    def covers(self, conditions: Mapping[str, str | float]) -> bool:
        """Whether the value applies to an experiment under these conditions."""
        return all(conditions.get(k) == v for k, v in self.where.items())


def check_bounds(low: float, high: float, where: str, info: ParameterInfo = _ANY) -> None:
    """Raise `InvalidInput` unless bounds increase, from the smallest value of a parameter up."""
    if not info.lowest <= low < high:
        found, expected = f"bounds {low:g} to {high:g} {info.unit}", "the lower bound first"
        if low < info.lowest:
            expected = f"bounds from {info.lowest:g} up, {expected}"
        raise InvalidInput(where, found=found.rstrip(" -"), expected=expected)


def check_once(where: str, labels: Sequence[str]) -> None:
    """Raise `InvalidInput` at `where` if a label of a parameter occurs more than once."""
    for label in labels:
        if labels.count(label) > 1:
            raise InvalidInput(where, found=f"{label} twice", expected="each parameter once")


def split_label(label: object) -> tuple[str, dict[str, str]]:
    """Split the label of a parameter into name and conditions: `"mu_pusher[surface=abs]"`."""
    match = _LABEL.fullmatch(label) if isinstance(label, str) else None
    if match is None:
        raise InvalidInput("label", found=repr(label), expected="NAME or NAME[CONDITION=VALUE]")
    pairs = (match["where"] or "").split(", ")
    where = dict(pair.split("=", 1) for pair in pairs if "=" in pair)
    return match["name"], where


def meets(conditions: Mapping[str, str | float], where: Mapping[str, str]) -> bool:
    """Whether an experiment under some conditions has those of a label."""
    return all(str(conditions.get(name)) == value for name, value in where.items())


def values_under(
    values: Mapping[str, float], conditions: Mapping[str, str | float]
) -> dict[str, float]:
    """Return the values of labels by name of parameter, for an experiment under some conditions.

    Conditions include the key of the experiment as `"experiment"`. Every parameter must have a
    value under them.
    """
    found: dict[str, float] = {}
    missing: dict[str, str] = {}
    for label, value in values.items():
        name, where = split_label(label)
        if meets(conditions, where):
            found.setdefault(name, value)
        else:
            missing.setdefault(name, next(iter(where)))
    lacking = [name for name in missing if name not in found]
    if lacking:
        name = lacking[0]
        raise InvalidInput(
            name,
            found="values for some conditions only, and none for these",
            expected=f"a value of {missing[name]!r}",
            hint=f"use fit.values_for({missing[name]}=...)",
        )
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterSpace(Comparable):
    """Unknowns of a calibration with their bounds.

    Arrays have one entry per *free* unknown, in their order; frozen ones are left out.

    Parameters
    ----------
    unknowns : sequence of Unknown
        Unknowns with different labels.
    """

    unknowns: tuple[Unknown, ...]

    def __post_init__(self) -> None:
        settle(self, unknowns=tuple(self.unknowns))
        labels = [unknown.label for unknown in self.unknowns]
        check_once("space", labels)
        check_supports(u.name for u in self.unknowns if not u.where)
        if not self.free:
            found = "no parameter that is free" if labels else "no parameter"
            expected = "at least one free parameter"
            raise InvalidInput("space", found=found, expected=expected)

    @property
    def free(self) -> tuple[Unknown, ...]:
        """Unknowns that a search may change."""
        return tuple(unknown for unknown in self.unknowns if not unknown.frozen)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the free unknowns."""
        return tuple(unknown.label for unknown in self.free)

    @property
    def low(self) -> FloatArray:
        """Lower bounds (n_free,)."""
        return frozen([unknown.low for unknown in self.free])

    @property
    def high(self) -> FloatArray:
        """Upper bounds (n_free,)."""
        return frozen([unknown.high for unknown in self.free])

    @property
    def nominal(self) -> FloatArray:
        """Start of the search (n_free,)."""
        return frozen([unknown.nominal for unknown in self.free])

    @property
    def scale(self) -> FloatArray:
        """Typical steps (n_free,) of a search."""
        return frozen(np.array([unknown.scale for unknown in self.free], np.float64))

    def values(self, point: ArrayLike) -> dict[str, float]:
        """Return the values of all unknowns, frozen ones too, by label, at a point (n_free,)."""
        free = dict(zip(self.labels, np.asarray(point, np.float64).tolist(), strict=True))
        return {u.label: free.get(u.label, u.nominal) for u in self.unknowns}

    def columns(
        self, points: ArrayLike, conditions: Mapping[str, str | float]
    ) -> dict[str, FloatArray]:
        """Return values (n,) by name of parameter for one experiment, at points (n, n_free).

        Parameters without an unknown for this experiment are left out.
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
        """Return the space with some unknowns frozen at values, by label."""
        labels = [unknown.label for unknown in self.unknowns]
        for label in values:
            check_name("space", label, labels)
        return ParameterSpace(
            unknowns=tuple(
                replace(u, nominal=values[u.label], frozen=True) if u.label in values else u
                for u in self.unknowns
            )
        )

    def under(self, conditions: Sequence[Mapping[str, str | float]]) -> ParameterSpace:
        """Return the space of the unknowns that apply under any of some conditions."""
        own = (u for u in self.unknowns if any(u.covers(one) for one in conditions))
        return ParameterSpace(unknowns=tuple(own))

    def started_at(self, point: ArrayLike) -> ParameterSpace:
        """Return the space with the start at a point (n_free,), clipped to the bounds."""
        inside = np.clip(np.asarray(point, np.float64), self.low, self.high).tolist()
        start = dict(zip(self.labels, inside, strict=True))
        return ParameterSpace(
            unknowns=tuple(replace(u, nominal=start.get(u.label, u.nominal)) for u in self.unknowns)
        )
