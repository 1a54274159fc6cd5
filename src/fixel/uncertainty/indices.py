"""Sobol indices: shares of the variance of an outcome due to each uncertain input."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, require
from fixel.model import Scene
from fixel.model.fields import vector, whole
from fixel.model.parameters import info_of
from fixel.model.space import check_bounds
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepping import AbstractStepper
from fixel.table import Table
from fixel.typing import FloatArray, ProgressCallback
from fixel.uncertainty.error_terms import Kind, StartError
from fixel.uncertainty.prediction import Prediction
from fixel.uncertainty.start_ensemble import START, simulate_starts

OUTCOMES: Final = ("along", "across", "angle")
UNITS: Final = ("m", "m", "rad")

MAX_BASE: Final = 2**20
RESAMPLES: Final = 200
CONFIDENCE: Final = 0.95

# Largest share of rollouts without an outcome; they are replaced by the mean.
MAX_FAILED: Final = 0.02
# Standard deviation of an outcome below which its indices are zero [m], [rad].
NO_SPREAD: Final = 1e-9


class Factor(NamedTuple):
    """Uncertain input of a model."""

    name: str
    low: float  # for a normal one, the mean minus one standard deviation
    high: float  # for a normal one, the mean plus one standard deviation
    kind: Kind = "uniform"

    def at(self, share: FloatArray) -> FloatArray:
        """Return the quantiles (n,) at probabilities (n,)."""
        from scipy.special import ndtri

        if self.kind == "uniform":
            return np.asarray(self.low + (self.high - self.low) * share)
        middle, deviation = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        return np.asarray(middle + deviation * ndtri(np.clip(share, 1e-9, 1.0 - 1e-9)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Indices:
    """Sobol indices of the outcomes of a model."""

    factors: tuple[Factor, ...]
    outcomes: tuple[str, ...]
    units: tuple[str, ...]
    # (n_outcome, n_factor) First order: mean share of the variance that disappears if the factor is
    # known. Total: share that remains if all other factors are known. Zero if an outcome does not
    # vary.
    first: FloatArray
    total: FloatArray
    # (n_outcome, n_factor) Half-widths of 95 % intervals, by bootstrap.
    first_error: FloatArray
    total_error: FloatArray
    deviation: FloatArray  # (n_outcome,) standard deviation of each outcome [its unit]
    evaluations: int
    failed: int  # number of rollouts without an outcome, replaced by the mean

    def table(self, title: str = "Sobol indices") -> Table:
        """Return first-order and total indices of every input, with 95 % intervals, as text."""
        rows = [
            (
                outcome,
                factor.name,
                f"{self.first[k, j]:z.3f} +- {self.first_error[k, j]:.3f}",
                f"{self.total[k, j]:z.3f} +- {self.total_error[k, j]:.3f}",
            )
            for k, outcome in enumerate(self.outcomes)
            for j, factor in enumerate(self.factors)
        ]
        return Table(("outcome", "input", "first order", "total"), rows, title=title)

    def summary(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "evaluations": self.evaluations,
            "failed": self.failed,
            "outcomes": {
                outcome: {
                    "standard_deviation": float(self.deviation[k]),
                    "unit": self.units[k],
                    "indices": {
                        factor.name: {
                            "first": float(self.first[k, j]),
                            "first_error": float(self.first_error[k, j]),
                            "total": float(self.total[k, j]),
                            "total_error": float(self.total_error[k, j]),
                        }
                        for j, factor in enumerate(self.factors)
                    },
                }
                for k, outcome in enumerate(self.outcomes)
            },
        }


def sobol_indices(
    model: Callable[[FloatArray], FloatArray],
    factors: Sequence[Factor],
    outcomes: Sequence[str],
    n: int = 512,
    *,
    units: Sequence[str] | None = None,
    seed: int = 0,
) -> Indices:
    """Compute first-order and total Sobol indices of a model.

    The model is a function of points (m, n_factor) -> outcomes (m, n_outcome), NaN for a failure.
    It is evaluated at ``n (n_factor + 2)`` points, where n is a power of two.

    Raise `InvalidInput` without a factor, for another `n`, or if more than 2 % of the points have
    no outcome; `MissingExtra` without SALib.

    Source
    ------
    Saltelli et al. (2010), Variance based sensitivity analysis of model output; computed by SALib.
    """
    _check(factors, n)
    sample, analyse = _salib()
    problem = {
        "num_vars": len(factors),
        "names": [factor.name for factor in factors],
        "bounds": [[0.0, 1.0]] * len(factors),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SALib warns of its own dependencies
        shares = sample(problem, n, calc_second_order=False, seed=seed)
    points = np.column_stack([f.at(shares[:, k]) for k, f in enumerate(factors)])
    found = np.asarray(model(points), np.float64).reshape(len(points), len(outcomes))
    found, failed = _filled(found)
    tables = np.zeros((4, len(outcomes), len(factors)))
    deviation = found.std(axis=0)
    for k in range(len(outcomes)):
        if deviation[k] <= NO_SPREAD * max(1.0, float(np.abs(found[:, k]).max())):
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            answer = analyse(
                problem,
                found[:, k],
                calc_second_order=False,
                num_resamples=RESAMPLES,
                conf_level=CONFIDENCE,
                seed=seed + 1,  # SALib ignores a seed of zero
            )
        tables[:, k] = [answer[name] for name in ("S1", "ST", "S1_conf", "ST_conf")]
    return Indices(
        factors=tuple(factors),
        outcomes=tuple(outcomes),
        units=tuple(units or ["-"] * len(outcomes)),
        first=tables[0],
        total=tables[1],
        first_error=tables[2],
        total_error=tables[3],
        deviation=deviation,
        evaluations=len(points),
        failed=failed,
    )


def indices_of(
    scene: Scene,
    error: StartError,
    ranges: Mapping[str, tuple[float, float]],
    n: int = 256,
    *,
    values: Mapping[str, ArrayLike] | None = None,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> Indices:
    """Compute Sobol indices of the end of a push, for parameters and errors of the start.

    Parameters are uniform in their ranges, and `values` have no uncertainty. `n` is a power of two;
    other options are those of `simulate_starts`. Indices are of the end along and across the
    nominal way [m], and of the angle [rad].
    """
    factors = [_ranged(name, interval) for name, interval in ranges.items()]
    sizes = zip(START, error.size.tolist(), strict=True)
    factors += [Factor(name, -size, size, error.kind) for name, size in sizes if size > 0.0]
    held = {name: value for name, value in (values or {}).items() if name not in ranges}

    def ends(points: FloatArray) -> FloatArray:
        own = {f.name: points[:, k] for k, f in enumerate(factors)}
        drawn = np.column_stack([own.get(name, np.zeros(len(points))) for name in START])
        ensemble = simulate_starts(
            scene,
            error,
            drawn=drawn,
            values=held | {name: own[name] for name in ranges},
            times=[scene.duration],
            motion=motion,
            stepper=stepper,
            threads=threads,
            progress=progress,
        )
        return scalars(ensemble)

    return sobol_indices(ends, factors, OUTCOMES, n, units=UNITS, seed=seed)


def scalars(ensemble: Prediction) -> FloatArray:
    """Return deviations (n, 3) of ends from the nominal one: along and across the nominal way, and
    angle; NaN for starts without an end."""
    off = ensemble.pose[:, -1] - ensemble.nominal[-1]
    way = ensemble.nominal[-1, :2] - ensemble.scene.bodies[0].pose[:2]
    length = float(np.hypot(*way))
    c, s = way / length if length > 0.0 else (1.0, 0.0)
    found = np.column_stack(
        (c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0], off[:, 2])
    )
    found[~ensemble.ended] = math.nan
    return found


def _ranged(name: str, interval: tuple[float, float]) -> Factor:
    where = f"vary {name}"
    info = info_of(name, where)
    low, high = vector(interval, where, "low, high").tolist()
    check_bounds(low, high, where, info)
    if name in START:
        hint = "it is already in the start error"
        raise InvalidInput(where, found="an error of the start", expected="a parameter", hint=hint)
    return Factor(name, low, high)


def _check(factors: Sequence[Factor], n: int) -> None:
    if not factors:
        raise InvalidInput("factors", found="none", expected="at least one")
    if whole(n, "base", 2, MAX_BASE) & (n - 1):
        raise InvalidInput("base", found=n, expected=f"a power of two, from 2 to {MAX_BASE}")


def _filled(found: FloatArray) -> tuple[FloatArray, int]:
    """Return the outcomes with missing ones replaced by the mean, and their number."""
    missing = ~np.isfinite(found).all(axis=1)
    if missing.mean() > MAX_FAILED:
        raise InvalidInput(
            "indices",
            found=f"{missing.mean():.1%} of the rollouts without an outcome",
            expected=f"at most {MAX_FAILED:.0%}",
            hint="reduce the ranges or the start error",
        )
    filled = np.array(found)
    filled[missing] = found[~missing].mean(axis=0)
    return filled, int(missing.sum())


def _salib() -> tuple[Callable[..., Any], Callable[..., Any]]:
    require("SALib", "an analysis by Sobol indices", extra="infer")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from SALib.analyze import sobol as analysis
        from SALib.sample import sobol as sampling
    return sampling.sample, analysis.analyze
