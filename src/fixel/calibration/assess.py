"""What the experiments of a calibration determine: noise, profiles, verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.cost import Prior
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import (
    Dispersion,
    Noise,
    dispersion_of,
    noise_from_repetitions,
    noise_from_residuals,
)
from fixel.calibration.objective import Comparer, EndPose
from fixel.calibration.profile import ProfileLikelihood, Profiles, run_profiles
from fixel.calibration.repetitions import repetitions
from fixel.calibration.study import box_of
from fixel.calibration.verdict import Verdict, judge
from fixel.kernels.arrays import FloatArray
from fixel.model import Fixel, Parameters, Pusher
from fixel.model.fields import BoolArray
from fixel.simulation.simulate import simulate

# Residuals of one point held in memory; of more, only some frames are looked at. The profiles ask
# for some 500 points at a time.
MOST_RESIDUALS: Final = 30_000

Excitation = Callable[[str], bool]


class Assessment(NamedTuple):
    """All of it."""

    verdicts: tuple[Verdict, ...]
    profiles: Profiles
    noise: Noise
    dispersion: Dispersion


def assess(
    comparer: Comparer,
    members: Sequence[int],
    point: FloatArray,
    *,
    noise: Noise | None = None,
    level: float = 0.95,
    solutions: Sequence[FloatArray] = (),
) -> Assessment:
    """Say what experiments determine of the parameters they were calibrated for.

    Parameters
    ----------
    comparer : Comparer
    members : sequence of int
        Numbers of the experiments.
    point : (n_free,) float64
        The calibration's best.
    noise : Noise, optional
        Of the measured poses; from repetitions where there are some, else from what the fit leaves.
    level : float
        Of the intervals.
    solutions : sequence of (n_free,) arrays
        Other points nearly as good.
    """
    own = np.asarray(members, np.int64)
    chosen = Frames(comparer, own)
    noise = noise or repeated(comparer, own) or _left(comparer, own, point)
    box = box_of(comparer.space.started_at(point))
    # The search minimised its own error; the likeliest point lies near by.
    near = fit(LeastSquares().start(box), chosen.residuals(noise)).point
    dispersion = chosen.dispersion(noise, near)
    if dispersion.source != noise.source:
        # The fit is worse than the noise allows: the model is wrong by more, frame after frame.
        noise = _left(comparer, own, near)
        dispersion = chosen.dispersion(noise, near)
    residuals = chosen.residuals(noise)
    prior = Prior.of(comparer.space).weighted(dispersion.value)
    search = ProfileLikelihood().start(box, near, dispersion.threshold(level), prior)
    found = run_profiles(search, residuals)
    verdicts = judge(
        comparer.space,
        found,
        level=level,
        excited=excitation(comparer, own, point),
        solutions=solutions,
        dispersion=dispersion,
    )
    return Assessment(verdicts, found, noise, dispersion)


class Frames:
    """The frames of experiments that count, as residuals.

    Parameters
    ----------
    comparer : Comparer
    members : (n,) int
        Numbers of the experiments.
    """

    def __init__(self, comparer: Comparer, members: np.ndarray) -> None:
        self._comparer = comparer
        self._members = members
        length = comparer.length(members)
        frames = np.arange(comparer.ensemble.n_sample)
        self._stride = 1
        if isinstance(comparer.error, EndPose):
            seen = frames == length[:, None] - 1
        else:
            self._stride = max(1, math.ceil(3 * int(length.sum()) / MOST_RESIDUALS))
            # Counted from the last frame, which says most of where a push ends.
            before_end = length[:, None] - 1 - frames
            seen = (before_end >= 0) & (before_end % self._stride == 0)
        self._seen: BoolArray = np.asarray(seen)

    @property
    def weights(self) -> FloatArray:
        """(m,) how many frames stand for the experiment that a residual belongs to."""
        count = self._seen.sum(axis=1)
        return np.repeat(count, 3 * count).astype(np.float64)

    def dispersion(self, noise: Noise, point: FloatArray) -> Dispersion:
        """Of the residuals at the best."""
        at_best = self.residuals(noise)(point[None])[0]
        deviance = float(at_best @ at_best) if np.isfinite(at_best).all() else math.inf
        # Of frames so far apart, fewer say as much as one.
        correlation = max(1.0, noise.correlation / self._stride)
        noise = replace(noise, correlation=correlation)
        return dispersion_of(noise, deviance, len(at_best), len(point))

    def residuals(self, noise: Noise) -> Callable[[FloatArray], FloatArray]:
        """Points (k, n) -> residuals (k, m) in standard deviations; a failed row is inf."""

        def at(points: FloatArray) -> FloatArray:
            k, n = len(points), len(self._members)
            which = np.tile(self._members, k)
            difference, good, _ = self._comparer.differences(which, np.repeat(points, n, axis=0))
            scaled = difference / noise.standard_deviations
            table = scaled.reshape(k, n, -1, 3)[:, self._seen].reshape(k, -1)
            table[~good.reshape(k, n).all(axis=1)] = math.inf
            return table

        return at


def _left(comparer: Comparer, members: np.ndarray, point: FloatArray) -> Noise:
    """Noise from what the calibrated simulations leave."""
    series = comparer.residuals_at(members, point)
    if isinstance(comparer.error, EndPose):
        series = [np.concatenate([one[-1:] for one in series])] if series else []
    return noise_from_residuals(series, len(point))


def repeated(comparer: Comparer, members: np.ndarray) -> Noise | None:
    """Noise from experiments that were done again under the same conditions; none without."""
    targets = [comparer.targets[m] for m in members.tolist()]
    groups = repetitions(targets, ends=isinstance(comparer.error, EndPose))
    return noise_from_repetitions(groups) if groups else None


def excitation(comparer: Comparer, members: np.ndarray, point: FloatArray) -> Excitation:
    """Whether the simulations at a point have the contact that an unknown acts on.

    Friction at a fixel says nothing where no fixel is touched, whatever its value; likewise at the
    pusher.
    """
    acts_on = {"mu_fixel": "fixel", "mu_pusher": "pusher"}
    wanted = {u.label: u for u in comparer.space.free if u.name in acts_on}
    touched: dict[str, bool] = {}

    def excited(label: str) -> bool:
        unknown = wanted.get(label)
        if unknown is None:
            return True
        if label not in touched:
            own = [m for m in members.tolist() if unknown.covers(comparer.targets[m].conditions)]
            touched[label] = any(acts_on[unknown.name] in _touches(comparer, m, point) for m in own)
        return touched[label]

    return excited


def _touches(comparer: Comparer, member: int, point: FloatArray) -> set[str]:
    """Which kinds of obstacle the body of an experiment ever touches: `"pusher"`, `"fixel"`."""
    target = comparer.targets[member]
    scene = target.case.scene
    columns = comparer.space.columns(point[None], target.conditions)
    run = simulate(
        scene,
        Parameters({name: float(value[0]) for name, value in columns.items()}),
        motion=comparer.ensemble.motion,
        stepper=comparer.ensemble.stepper,
        duration=float(target.case.times[-1]),
    )
    others = {run.names[int(k)] for k in np.unique(run.contacts["other"])}
    others |= {run.names[int(k)] for k in np.unique(run.contacts["body"])}
    kinds: dict[str, tuple[Pusher | Fixel, ...]] = {
        "pusher": scene.pushers,
        "fixel": scene.fixels,
    }
    names = {kind: {thing.name for thing in things} for kind, things in kinds.items()}
    return {kind for kind, own in names.items() if own & others}
