"""Distance of an exported model from fixel, and its error on experiments."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Scene, pose_error
from fixel.simulation import AbstractMotionModel, AbstractStepper
from fixel.simulation.motion import OtherEngine
from fixel.simulation.rollouts import RolloutCase, ensemble_of
from fixel.typing import FloatArray, ProgressCallback
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.uncertainty.starts import StartError
from fixel.workflows.model_export.source import ModelSource, SourceCase

SHIFT: Final = 0.05  # half-width of start errors, over the size of the body
TURN: Final = math.radians(5.0)
MAX_AROUND: Final = 10  # experiments of a calibration around which scenes are drawn
MAX_JUDGED: Final = 200  # experiments on which errors are computed
RESAMPLES: Final = 1000  # of the bootstrap
LEVEL: Final = 0.95  # of the intervals of medians


class Distances(NamedTuple):
    """Distances of end poses, and simulations without an end, by reason."""

    position: FloatArray  # (k,) [m]
    angle: FloatArray  # (k,) [rad]
    failures: Counter[str]

    def stated(self) -> dict[str, Any]:
        """Return medians with intervals, 90 % quantiles and maxima in mm and degrees."""
        return {
            "simulations": len(self.position) + self.failures.total(),
            "failures": self.failures.total(),
            "reasons": dict(self.failures.most_common(5)),
            "position_mm": _statistics(1e3 * self.position),
            "angle_deg": _statistics(np.degrees(self.angle)),
        }


def start_error_of(scene: Scene) -> StartError:
    """Return the start errors with which scenes are drawn around one: 5 % of the body, 5 deg."""
    size = SHIFT * float(np.ptp(scene.bodies[0].shape.outline, axis=0).max())
    return StartError(x=size, y=size, theta=TURN, kind="uniform")


def distances_from_fixel(
    source: ModelSource,
    engine: OtherEngine,
    n: int,
    seed: int,
    progress: ProgressCallback | None = None,
) -> Distances:
    """Simulate scenes drawn around those of a source by an engine and by fixel, and compare ends.

    Parameters
    ----------
    source : ModelSource
    engine : OtherEngine
    n : int
        Number of scenes, shared by at most ten cases of the source.
    seed : int
        Seed of the start poses.
    progress : callable, optional
        Called with the number of scenes done and in all.
    """
    cases = _evenly(source.cases, min(MAX_AROUND, n))
    position, angle, failures = [], [], Counter[str]()
    done = 0
    for k, case in enumerate(cases):
        count = n // len(cases) + (k < n % len(cases))
        drawn = start_error_of(case.scene).samples(count, seed + k)
        ends = [
            _ends(case, drawn, source.motion, source.stepper),
            _ends(case, drawn, engine, None),
        ]
        good = ~np.isnan(ends[0].pose[:, 0]) & ~np.isnan(ends[1].pose[:, 0])
        apart = pose_error(ends[0].pose[good], ends[1].pose[good])
        position.append(apart[0])
        angle.append(np.abs(apart[1]))
        for row in np.flatnonzero(~good).tolist():
            reasons = (f"fixel: {ends[0].reasons[row]}", ends[1].reasons[row])
            failures[reasons[0] if ends[0].reasons[row] else reasons[1]] += 1
        done += count
        if progress is not None:
            progress(done, n)
    return Distances(np.concatenate(position), np.concatenate(angle), failures)


def errors_on(
    cases: Sequence[SourceCase],
    motion: AbstractMotionModel,
    stepper: AbstractStepper | None = None,
) -> Distances:
    """Return the distances of simulated end poses from the measured ones."""
    position, angle, failures = [], [], Counter[str]()
    for case in _evenly(cases, MAX_JUDGED):
        if case.measured is None:
            continue
        values = {k: np.array([v]) for k, v in _own(case.values, motion).items()}
        ensemble = ensemble_of([RolloutCase(case.scene, case.times)], motion, stepper, 1)
        outcome = ensemble.simulate(np.zeros(1, np.int64), values)
        if not outcome.converged[0]:
            failures[outcome.reasons[0]] += 1
            continue
        apart = pose_error(outcome.pose[0, len(case.times) - 1], case.measured[-1])
        position.append(float(apart[0]))
        angle.append(abs(float(apart[1])))
    return Distances(np.array(position), np.array(angle), failures)


class _EndPoses(NamedTuple):
    pose: FloatArray  # (n, 3) nan without an end
    reasons: Sequence[str]


def _ends(
    case: SourceCase,
    drawn: FloatArray,
    motion: AbstractMotionModel,
    stepper: AbstractStepper | None,
) -> _EndPoses:
    error, values = start_error_of(case.scene), _own(case.values, motion)
    try:
        found = simulate_starts(
            case.scene,
            error,
            drawn=drawn,
            values=values,
            times=case.times,
            motion=motion,
            stepper=stepper,
        )
    except InvalidInput as problem:
        return _EndPoses(np.full((len(drawn), 3), np.nan), [str(problem)] * len(drawn))
    # A jam is an end for fixel, and a failure here: no other engine stops there.
    good = found.ended & np.array([not reason for reason in found.reasons])
    return _EndPoses(np.where(good[:, None], found.pose[:, -1], np.nan), found.reasons)


def _own(values: Mapping[str, float], motion: AbstractMotionModel) -> dict[str, float]:
    """Return the parameters that a motion model or an engine has."""
    engine = motion.name.partition(":")[0] if isinstance(motion, OtherEngine) else ""
    return {
        name: value
        for name, value in values.items()
        if "." not in name or name.partition(".")[0] == engine
    }


def _evenly(cases: Sequence[SourceCase], most: int) -> list[SourceCase]:
    chosen = np.linspace(0, len(cases) - 1, min(most, len(cases))).round().astype(int)
    return [cases[k] for k in chosen.tolist()]


def _statistics(values: FloatArray) -> dict[str, float] | None:
    """Return quantiles, and the bootstrap interval of the median; None without values."""
    if not len(values):
        return None
    rows = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    medians = np.median(values[rows], axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(medians, (tail, 1.0 - tail)).tolist()
    return {
        "median": float(np.median(values)),
        "median_low": low,
        "median_high": high,
        "quantile_90": float(np.quantile(values, 0.9)),
        "maximum": float(values.max()),
    }
