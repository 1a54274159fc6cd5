"""Result of a calibration: sets of parameters, their records, and those that fit almost as well.

The nearly optimal points are a cheap estimate of the uncertainty: those whose error exceeds the
smallest by no more than noise explains. Separate clusters of them are different solutions. They
cover only the region that the search visited: the posterior is the complete result.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.noise import correlation_time
from fixel.calibration.objective import ERRORS, AbstractError, MeanSquare
from fixel.calibration.optimiser import Best
from fixel.calibration.study import Trace
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.model.fields import non_negative, positive, settle
from fixel.model.parameters import is_parameter
from fixel.model.records import CalibrationRecord, Estimate, Evaluations, ProfileRecord
from fixel.model.space import meets, split_label
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.typing import FloatArray


class FitKind(StrEnum):
    """Way in which a set of parameters was found, stored in `CalibrationRecord.method["how"]`."""

    ALONE = "alone"  # for a single experiment
    NEIGHBOUR = "of a neighbour"
    WEIGHTED = "weighted mean"
    SUBSET = "weighted mean of a subset"
    DIRECT = "direct minimisation"
    STORED = "best of the stored sets"
    GROWTH = "domain growth"  # a weighted mean computed by `workflows/growth`

    @property
    def is_single(self) -> bool:
        """Whether the set is for a single experiment."""
        return self in (FitKind.ALONE, FitKind.NEIGHBOUR)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSet:
    """Set of parameters for one experiment or for several."""

    how: FitKind
    members: tuple[int, ...]  # indices of the experiments
    point: FloatArray  # (n_free,) best fit, for prediction
    errors: FloatArray  # (n_member,) error of each experiment with this set; inf where it has none
    trace: Trace | None = None  # evaluations of the search; None without a search
    estimates: tuple[Estimate, ...] = ()  # one per parameter
    profiles: tuple[ProfileRecord, ...] = ()  # one per free parameter; empty if not requested
    noise: str = ""  # source of the measurement noise assumed by the intervals
    # Warning that the model is wrong by more than the noise explains, its size first; empty if it
    # is not, or if not requested.
    misfit: tuple[str, ...] = ()
    misfit_ratio: float = math.nan  # residuals over noise; nan if the noise is unknown
    # (n_solution, n_free) Distinct ends of several starts nearly as good as the first, the best.
    solutions: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    # Number of recorded ends in the regions predicted without them, and of how many experiments;
    # None if they were not compared.
    prediction_check: tuple[int, int] | None = None
    seconds: float = field(default=0.0, compare=False)  # duration of the computation [s]
    note: str = ""  # why the error is missing, if it is

    def __post_init__(self) -> None:
        settle(
            self,
            how=FitKind(self.how),
            members=tuple(self.members),
            misfit=tuple(self.misfit),
            solutions=self.solutions.reshape(len(self.solutions), len(self.point)),
            prediction_check=self.prediction_check and tuple(self.prediction_check),
        )

    @property
    def ended(self) -> str:
        """Why the search ended; empty without a search."""
        return "" if self.trace is None else self.trace.ended

    @property
    def ends(self) -> list[Best]:
        """Best point of each of several searches; empty for one search, or none."""
        found = [] if self.trace is None else self.trace.ends()
        return found if len(found) > 1 else []


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationResult:
    """Complete result of a calibration."""

    keys: tuple[str, ...]  # keys of the experiments
    labels: tuple[str, ...]  # labels of the free parameters
    nominal: FloatArray  # (n_key,) errors before calibration
    found: tuple[ParameterSet, ...]


CURVE: Final = ("values", "deviances", "slice_values", "slice_deviances")
CURVE_ENDS: Final = ("label", "low", "high", "threshold")
# Fields that are no arrays, in the order of their JSON.
PLAIN: Final = [
    own.name
    for own in fields(ParameterSet)
    if own.name not in ("point", "errors", "trace", "solutions")
]


def found_arrays(found: Sequence[ParameterSet]) -> dict[str, Any]:
    """Convert sets of parameters to named arrays."""
    plain: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for k, one in enumerate(found):
        trace = one.trace
        own: dict[str, Any] = {name: getattr(one, name) for name in PLAIN}
        own |= {
            "estimates": [estimate.stored() for estimate in one.estimates],
            "profiles": [{x: getattr(curve, x) for x in CURVE_ENDS} for curve in one.profiles],
            "misfit_ratio": None if math.isnan(one.misfit_ratio) else one.misfit_ratio,
            "ended": None,
            "reasons": {},
        }
        arrays |= {f"{name}_{k}": getattr(one, name) for name in ("point", "errors", "solutions")}
        for j, curve in enumerate(one.profiles):
            arrays |= {f"{name}_{k}_{j}": getattr(curve, name) for name in CURVE}
        if trace is not None:
            own["ended"] = trace.ended
            own["reasons"] = {str(n): reason for n, reason in enumerate(trace.reasons) if reason}
            arrays |= {f"points_{k}": trace.points, f"tried_{k}": trace.errors}
            arrays |= {f"iterations_{k}": trace.iterations, f"starts_{k}": trace.starts}
        plain.append(own)
    return {"found": json_array(plain), **arrays}


def found_of(arrays: Mapping[str, Any]) -> list[ParameterSet]:
    """Load sets of parameters; inverse of `found_arrays`."""
    found = []
    for k, entry in enumerate(json_of(arrays["found"])):
        own = {name: entry[name] for name in PLAIN if entry.get(name) is not None}
        own |= {name: arrays[f"{name}_{k}"] for name in ("point", "errors", "solutions")}
        own["estimates"] = tuple(Estimate(**estimate) for estimate in entry["estimates"])
        own["profiles"] = tuple(
            ProfileRecord(**curve, **{name: arrays[f"{name}_{k}_{j}"] for name in CURVE})
            for j, curve in enumerate(entry["profiles"])
        )
        if entry["ended"] is not None:
            own["trace"] = _trace(entry, arrays, k)
        found.append(ParameterSet(**own))
    return found


OF_SEARCH: Final = ("points_0", "tried_0")  # which a record has as its evaluations


def set_content(one: ParameterSet) -> dict[str, Any]:
    """Convert a set of parameters to plain values for a record; infinite numbers become None."""
    arrays = found_arrays([one])
    (plain,) = json_of(arrays.pop("found"))
    finite = {
        name: np.where(np.isfinite(array), array, np.array(None)).tolist()
        for name, array in arrays.items()
        if name not in OF_SEARCH
    }
    return {**plain, "arrays": finite}


def set_of(content: Mapping[str, Any], evaluations: Evaluations | None) -> ParameterSet:
    """Load a set of parameters from a record; inverse of `set_content`."""
    plain = dict(content)
    arrays: dict[str, Any] = {"found": json_array([plain])}
    for name, values in plain.pop("arrays").items():
        array = np.array(values, np.float64)
        counts = name.startswith(("iterations", "starts"))
        arrays[name] = (
            array.astype(np.int64) if counts else np.where(np.isnan(array), np.inf, array)
        )
    if evaluations is not None:
        arrays |= dict(zip(OF_SEARCH, (evaluations.values, evaluations.error), strict=True))
    (one,) = found_of(arrays)
    return one


def _trace(entry: Mapping[str, Any], arrays: Mapping[str, Any], k: int) -> Trace:
    point, points, errors = (arrays[f"{name}_{k}"] for name in ("point", "points", "tried"))
    reasons = [entry["reasons"].get(str(n), "") for n in range(len(errors))]
    unknown = np.zeros(0, np.int64)  # in results of earlier versions
    counts = arrays.get(f"iterations_{k}", unknown), arrays.get(f"starts_{k}", unknown)
    best = float(errors.min(initial=math.inf))
    return Trace(point, best, points, errors, reasons, entry["ended"], *counts)


def json_array(content: Any) -> FloatArray:
    """Return plain content as JSON in an array of bytes."""
    data: Any = np.frombuffer(json.dumps(content).encode(), np.uint8)
    return data  # type: ignore[no-any-return]


def json_of(data: Any) -> Any:
    """Return the content of an array; inverse of `json_array`."""
    return json.loads(data.tobytes())


# Maximum number of compared points, the best ones: their distances take 8 bytes per pair.
MAX_SOLUTIONS: Final = 2000


class Solution(NamedTuple):
    """Cluster of points that are almost as good as the best."""

    point: FloatArray  # (n,) best point
    error: float
    size: int  # number of points
    low: FloatArray  # (n,) smallest value of each parameter in the cluster
    high: FloatArray  # (n,)
    members: np.ndarray  # (size,) row numbers of its points, best first


def find_solutions(
    points: ArrayLike, errors: ArrayLike, scale: ArrayLike, threshold: float, distance: float = 1.0
) -> tuple[Solution, ...]:
    """Return the clusters of points (k, n) whose error is within a threshold of the smallest.

    Points are results of several starts, or all that were evaluated, with errors (k,), inf for
    failures. `distance` is the smallest gap between two clusters, in scales (n,) of the box. Points
    of a valley are one cluster, however long it is, if neighbours are closer than this. The best
    cluster is the first; there is none if all points failed.
    """
    table, values = np.asarray(points, np.float64), np.asarray(errors, np.float64)
    widths = np.asarray(scale, np.float64)
    if table.ndim != 2 or values.shape != table.shape[:1] or widths.shape != table.shape[1:]:
        found = f"shapes {table.shape}, {values.shape} and {widths.shape}"
        raise InvalidInput("solutions", found=found, expected="(k, n), (k,) and (n,)")
    limit = non_negative(threshold, "threshold")
    gap = positive(distance, "distance", "scales")
    order = np.argsort(np.where(np.isnan(values), np.inf, values), kind="stable")
    order = order[np.isfinite(values[order])]
    if not len(order):
        return ()
    order = order[values[order] <= values[order[0]] + limit][:MAX_SOLUTIONS]
    labels = _clusters(table[order] / widths, gap)
    return tuple(
        _solution(table, values, order[labels == label]) for label in dict.fromkeys(labels.tolist())
    )


def _clusters(points: FloatArray, gap: float) -> np.ndarray:
    """Return cluster labels (k,) by single linkage, which does not divide valleys."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(points) < 2:
        return np.ones(len(points), np.int64)
    return np.asarray(fcluster(linkage(points, "single"), gap, "distance"))


def _solution(points: FloatArray, errors: FloatArray, members: np.ndarray) -> Solution:
    rows = points[members]
    return Solution(
        point=rows[0].copy(),
        error=float(errors[members[0]]),
        size=len(members),
        low=rows.min(axis=0),
        high=rows.max(axis=0),
        members=members,
    )


# Gap between clusters, as a share of the range of the evaluated points.
GAP: Final = 0.1
LEVEL: Final = 0.95  # of the confidence region


class NearOptimal(NamedTuple):
    """Range and clusters of the nearly optimal points."""

    least: float  # smallest error
    rise: float  # rise above it that noise explains
    size: int  # number of points within the rise
    low: FloatArray  # (n,) smallest values of these points
    high: FloatArray  # (n,)
    clusters: tuple[Solution, ...]  # best first
    names: tuple[str, ...] = ()  # of the parameters


def rise_of(least: float, count: float, unknowns: int) -> float:
    """Return the rise of a mean squared error over its minimum that noise explains.

    For normal noise of a size estimated by the fit itself, the confidence region contains the
    points with (E - E_min) / E_min <= n / (N - n) F(n, N - n). `least` is E_min, and `unknowns` n.
    `count` is N, independent measurements: numbers in the residuals over their correlation time.

    Source
    ------
    Seber & Wild (1989), Nonlinear Regression, section 3.3.
    """
    from scipy.special import fdtri

    freedom = max(1.0, count - unknowns)
    quantile = float(fdtri(unknowns, freedom, LEVEL))
    return non_negative(least, "least") * unknowns / freedom * quantile


def near_optimal(
    points: FloatArray, errors: FloatArray, rise: float, names: tuple[str, ...] = ()
) -> NearOptimal:
    """Return the points whose error is within a rise of the smallest, and their clusters.

    Points (k, n) are all that a search has evaluated; errors (k,) are inf for failed evaluations.
    For the rise, see `rise_of`.
    """
    good = np.isfinite(errors)
    if not good.any():
        raise InvalidInput(
            "evaluations", found="no evaluation with an error", expected="at least one"
        )
    least = float(errors[good].min())
    near = good & (errors <= least + non_negative(rise, "rise"))
    span = np.ptp(points[good], axis=0)
    scale = GAP * np.where(span > 0.0, span, 1.0)
    clusters = find_solutions(points, errors, scale, rise)
    own = points[near]
    low, high = own.min(axis=0), own.max(axis=0)
    return NearOptimal(least, rise, int(near.sum()), low, high, clusters, names)


def near_best(tried: Evaluations, series: Sequence[FloatArray]) -> NearOptimal | None:
    """Return the near-optimal points of a calibration; None without mean squares or residuals.

    The noise is that of `series`, residuals (n, 3) of each experiment at the best point.
    """
    finite = np.isfinite(tried.error)
    if tried.unit != "mm2" or not finite.any() or not series:
        return None
    count = 3.0 * sum(map(len, series)) / correlation_time(series)
    rise = rise_of(float(tried.error[finite].min()), count, len(tried.names))
    return near_optimal(np.array(tried.values), np.array(tried.error), rise, names=tried.names)


@dataclass(frozen=True)
class CalibratedValues:
    """Calibrated parameters with the method that found them."""

    id: int
    record: CalibrationRecord

    @property
    def members(self) -> frozenset[int]:
        """Ids of the experiments of the calibration."""
        return frozenset(member.experiment_id for member in self.record.members)

    @property
    def is_for_several(self) -> bool:
        """Whether a single set of parameters was calibrated to several experiments."""
        single = [kind for kind in FitKind if kind.is_single]
        return len(self.record.members) > 1 and self.record.method.get("how") not in single

    @cached_property
    def motion(self) -> AbstractMotionModel:
        """Motion model of the calibration, or its engine."""
        return motion_model(self.record.motion or None)

    @cached_property
    def error(self) -> AbstractError:
        """Error that the calibration minimised."""
        method = self.record.method
        kind = next((own for own in ERRORS if own.name == method.get("error")), MeanSquare)
        options = {field.name: method.get(f"error.{field.name}") for field in fields(kind)}
        return kind(**{name: float(value) for name, value in options.items() if value is not None})

    def values(self, conditions: Mapping[str, str | float]) -> dict[str, float]:
        """Return the parameters for an experiment under these conditions, by name [SI].

        Conditions include the experiment's key as `"experiment"`.
        """
        found: dict[str, float] = {}
        for label, value in self.record.best_fit.items():
            name, where = split_label(label)
            if meets(conditions, where):
                found.setdefault(name, value)  # the first that applies, as in `values_under`
        return found

    def values_for(self, experiment: Experiment) -> dict[str, float]:
        """Return the parameters for an experiment that this version knows, by name [SI]."""
        values = self.values({**experiment.conditions, "experiment": experiment.key})
        return {name: value for name, value in values.items() if is_parameter(name)}
