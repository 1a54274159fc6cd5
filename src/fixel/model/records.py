"""Stored results of experiments: simulations, calibrations and filter runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.experiment import Provenance
from fixel.model.fields import Comparable, frozen, name_of, settle
from fixel.model.parameters import Parameters, info_of
from fixel.model.trajectory import Trajectory
from fixel.table import MISSING, Table
from fixel.typing import FloatArray
from fixel.units import displayed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationRecord(Comparable):
    """Simulation of a stored experiment."""

    experiment_id: int
    parameters: Parameters
    provenance: Provenance
    trajectory: Trajectory  # of the object
    pusher: Trajectory | None = None
    # Motion model, stepper and solver with their options.
    method: Mapping[str, str | float] = field(default_factory=dict)
    status: str = "converged"  # as `Simulation.status`
    contact_mode: str = ""  # contacts at the end, one digit per fixel
    # E of the thesis: mean squared distance to the path [mm^2], angles at 35 mm/rad.
    error_mm2: float | None = None

    def __post_init__(self) -> None:
        settle(self, method=MappingProxyType(dict(sorted(self.method.items()))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluations(Comparable):
    """All parameter sets that a calibration evaluated, in order."""

    names: tuple[str, ...]
    values: FloatArray  # (n, n_name)
    error: FloatArray  # (n,) errors; infinite where there is none
    reasons: tuple[str, ...] = ()  # why there is no error; empty where there is one
    unit: str = "mm2"  # unit of the error: `"mm2"` or `"mm"`

    def __post_init__(self) -> None:
        values, error = frozen(self.values), frozen(self.error)
        reasons = tuple(self.reasons) or ("",) * len(error)
        if values.shape != (len(error), len(self.names)) or len(reasons) != len(error):
            found = f"values of shape {values.shape} for {len(error)} errors"
            expected = f"a row of {len(self.names)} values and a reason for each error"
            raise InvalidInput("evaluations", found=found, expected=expected)
        settle(self, names=tuple(self.names), values=values, error=error, reasons=reasons)


@dataclass(frozen=True, slots=True)
class Member:
    """Experiment used in a calibration."""

    experiment_id: int
    weight: float
    error_mm2: float  # mean squared error with the calibration's result, for any error minimised

    @classmethod
    def of(cls, experiment_id: int, weight: float, error: float, unit: str) -> Member:
        """Create a member from an error in mm^2 or, its root, in mm."""
        return cls(experiment_id, weight, error * error if unit == "mm" else error)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Result of a calibration for one parameter: its value, interval and verdict.

    Parameters
    ----------
    label : str
        Name of the parameter with the conditions that share it: `"mu_pusher[surface=plywood]"`.
    unit : str
    value : float
        Value to quote, inside the interval.
    low, high : float, optional
        Ends of its interval; None where the data determine no end.
    verdict : str
        One of `fixel.calibration.verdict.WORDS`, `"trades off with X, Y"` (the most important
        first) or `"frozen"`; empty where not assessed.
    reason : str
        Reason of the verdict, as a sentence.
    noise_value, noise_low, noise_high : float, optional
        Value and interval from least squares, if noise were the only error; None where the model
        fits within the noise, and the interval is that one.
    best_fit : float, optional
        Value that predicts best, found by the search; None in records of earlier versions.
    bounds : (float, float), optional
        Bounds of the search; not stored, as the next two.
    before : float, optional
        Value before the calibration.
    level : float, optional
        Confidence level of the interval.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fit = fixel.calibrate(example_pushes(2), space, progress=False)
    >>> estimate = fit.estimates["mu_pusher"]
    >>> estimate.low < estimate.value < estimate.high
    True
    >>> estimate.verdict
    'identified'
    """

    label: str
    unit: str
    value: float
    low: float | None = None
    high: float | None = None
    verdict: str = ""
    reason: str = ""
    noise_value: float | None = None
    noise_low: float | None = None
    noise_high: float | None = None
    best_fit: float | None = None
    bounds: tuple[float, float] | None = None
    before: float | None = None
    level: float | None = None

    @property
    def name(self) -> str:
        """Label of the parameter."""
        return self.label

    @property
    def identified(self) -> bool:
        """Whether the data identify the parameter."""
        return self.verdict == "identified"

    @property
    def is_known(self) -> bool:
        """Whether the value may be quoted; False where the data leave it open."""
        return self.word not in UNKNOWN_WORDS

    @property
    def partners(self) -> tuple[str, ...]:
        """Parameters that it trades off with, the most important first."""
        return tuple(filter(None, self.verdict.partition(" with ")[2].split(", ")))

    @property
    def word(self) -> str:
        """Verdict without the parameters that it trades off with."""
        return "trades off" if self.verdict.startswith("trades off") else self.verdict

    @property
    def is_assessed(self) -> bool:
        """Whether the parameter has a verdict or an interval."""
        return bool(self.verdict) or self.low is not None or self.high is not None

    @property
    def noise_alone(self) -> Estimate | None:
        """Estimate with the value and interval from noise alone; None where it is the same."""
        if self.noise_value is None:
            return None
        found = replace(self, value=self.noise_value, low=self.noise_low, high=self.noise_high)
        return found.with_noise(None, None, None)

    def with_noise(self, value: float | None, low: float | None, high: float | None) -> Estimate:
        """Return the estimate with another value and interval from noise alone."""
        return replace(self, noise_value=value, noise_low=low, noise_high=high)

    @property
    def predictor(self) -> float:
        """Value to simulate with: the best fit where it is known."""
        return self.value if self.best_fit is None else self.best_fit

    def stored(self) -> dict[str, Any]:
        """Return the stored fields, as plain values."""
        return {name: getattr(self, name) for name in _STORED}

    @property
    def value_text(self) -> str:
        """Value with its unit for people; `-` where the data do not determine it."""
        return self.text(self.value) if self.is_known else MISSING

    @property
    def interval_text(self) -> str:
        """Interval with its unit for people, and what the data leave open."""
        if self.word == "frozen":
            return "fixed"
        if not self.is_assessed:
            return "not computed"
        if self.low is not None and self.high is not None:
            return f"{self._number(self.low)} to {self.text(self.high)}"
        if self.low is not None:
            return f"at least {self.text(self.low)}"
        if self.high is not None:
            return f"at most {self.text(self.high)}"
        if self.bounds is None:
            return "anything"
        unit, factor = displayed(self.unit)
        low, high = (f"{factor * end:.4g}" for end in self.bounds)
        return f"anything in {low} to {high} {unit}".rstrip()

    @property
    def verdict_text(self) -> str:
        """Verdict for people; `-` for parameters that are fixed or not assessed."""
        return MISSING if self.word in ("", "frozen") else self.verdict

    def text(self, value: float) -> str:
        """Value of the parameter for people, with its unit and the decimals of the interval."""
        return f"{self._number(value)} {displayed(self.unit)[0]}".rstrip()

    def _number(self, value: float) -> str:
        factor = displayed(self.unit)[1]
        ends = [end for end in (self.low, self.high) if end is not None]
        largest = max(abs(factor * own) for own in (self.value, *ends))
        decimals = 3 - math.floor(math.log10(largest)) if largest > 0 else 0
        if ends and 0 <= decimals <= 7:
            return f"{factor * value:.{decimals}f}"
        return f"{factor * value:.4g}"


def estimate_table(estimates: Iterable[Estimate], level: float | None) -> Table:
    """Return the table of estimates for people; below an estimate, that from noise alone.

    `level` is the confidence level of the intervals; None if it is unknown.
    """
    rows, name = [], "interval" if level is None else interval_name(level)
    for own in estimates:
        name = interval_name(level) if own.is_assessed else name
        rows.append((own.label, own.value_text, own.interval_text, own.verdict_text))
        if (narrow := own.noise_alone) is not None:
            rows.append(("  noise alone", narrow.text(narrow.value), narrow.interval_text, ""))
    width = max((len(row[1]) for row in rows), default=0)
    return Table(
        ("parameter", "value", name, "verdict"),
        [(label, value.rjust(max(width, len("value"))), *rest) for label, value, *rest in rows],
        left=4,
    )


def interval_name(level: float | None) -> str:
    """Name of intervals with their confidence level, which records of earlier versions lack."""
    return "interval of unknown level" if level is None else f"{100 * level:g} % interval"


# Verdicts of parameters whose value the data leave open.
UNKNOWN_WORDS: Final = ("not identified", "not excited", "trades off", "at least", "at most")
_STORED: Final = (
    *("label", "unit", "value", "low", "high", "verdict", "reason"),
    *("noise_value", "noise_low", "noise_high", "best_fit"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileRecord:
    """Profile likelihood of one parameter, as stored with the result of a calibration."""

    label: str
    values: FloatArray  # (n,) of the parameter, ascending
    # (n,) rise above the minimum with the others fitted; inf without an evaluation.
    deviances: FloatArray
    # (m,), with `slice_deviances`: the same with the others fixed at the best fit.
    slice_values: FloatArray
    slice_deviances: FloatArray
    low: float | None  # with `high`, the ends of the interval
    high: float | None
    threshold: float  # rise at the ends of the interval

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        return info_of(self.label.partition("[")[0]).unit

    @property
    def best(self) -> float:
        """Value with the smallest deviance."""
        return float(self.values[int(np.argmin(self.deviances))])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationRecord(Comparable):
    """Finished calibration."""

    name: str
    parameters: Parameters  # best values of the parameters that all members share
    members: tuple[Member, ...]
    provenance: Provenance
    method: Mapping[str, str | float] = field(default_factory=dict)  # optimiser and its options
    evaluations: Evaluations | None = None
    estimates: tuple[Estimate, ...] = ()  # one per unknown
    # All options of the run, as plain values; None if an earlier version stored it.
    request: Mapping[str, Any] | None = None
    # Further results of the run, as plain values: profiles, noise, errors before.
    result: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        name_of(self.name, "calibration.name")
        if not self.members:
            found, expected = "no members", "at least one experiment"
            raise InvalidInput(f"calibration {self.name!r}", found=found, expected=expected)
        settle(
            self,
            members=tuple(self.members),
            estimates=tuple(self.estimates),
            method=MappingProxyType(dict(sorted(self.method.items()))),
        )

    @property
    def motion(self) -> str:
        """Name of the motion model or engine; empty if it was not stored."""
        return str(self.method.get("motion", ""))

    @property
    def best_fit(self) -> dict[str, float]:
        """Best fit of each parameter by label; the value to quote where only that was stored."""
        return {own.label: own.predictor for own in self.estimates} | dict(self.parameters)

    @property
    def error_unit(self) -> str:
        """Unit of the error that was minimised: `"mm^2"` or `"mm"`."""
        return str(self.method.get("error_unit", "mm^2"))

    @property
    def misfit(self) -> list[str]:
        """Warning that the model is wrong, by sentences; empty if it is not."""
        return str(self.method.get("misfit", "")).splitlines()

    @property
    def errors(self) -> tuple[float, ...]:
        """Errors of the members in the unit of the minimised error."""
        squares = [member.error_mm2 for member in self.members]
        return tuple(map(math.sqrt, squares) if self.error_unit == "mm" else squares)

    @property
    def sum_error_mm2(self) -> float:
        """Sum of the errors of all members [mm^2]."""
        return math.fsum(member.error_mm2 for member in self.members)

    @property
    def mean_error_mm2(self) -> float:
        """Mean of the errors of all members [mm^2]."""
        return self.sum_error_mm2 / len(self.members)

    @property
    def max_error_mm2(self) -> float:
        """Error of the worst member [mm^2]."""
        return max(member.error_mm2 for member in self.members)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterParameters(Comparable):
    """Settings of a filter that estimates poses and parameters during a run."""

    name: str
    is_particle_filter: bool
    provenance: Provenance
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        name_of(self.name, "filter_parameters.name")
        settle(self, values=MappingProxyType(dict(sorted(self.values.items()))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterRecord(Comparable):
    """Result of a filter for a stored experiment."""

    experiment_id: int
    filter_parameters_id: int
    provenance: Provenance
    trajectory: Trajectory  # estimated poses of the object
    uses_tactile: bool
    # First and last time at which the object was hidden from the filter [s].
    occlusion: tuple[float, float] | None = None
    contact_mode: str = ""
    estimate_names: tuple[str, ...] = ()
    # (n, n_name) parameters at the times of `trajectory`.
    estimates: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        values = frozen(self.estimates)
        n = len(self.trajectory.time) if self.estimate_names else 0
        if values.shape != (n, len(self.estimate_names)):
            found = f"an array of shape {values.shape}"
            expected = f"{n} rows of {len(self.estimate_names)} values"
            raise InvalidInput("filter_run.estimates", found=found, expected=expected)
        settle(self, estimates=values, estimate_names=tuple(self.estimate_names))
