"""Stated success of choices among pushes, compared with the recorded ends of those pushes.

Experiments are left out in turn. A calibration and the scatter between runs are learned from the
others; for each of many goals the push with the highest stated success is chosen among those left
out, and its recorded end decides. Goals are predicted ends of these pushes, displaced at random, so
that they depend on no recorded end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from fixel.calibration.target import Target, target_of
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.model.fields import positive
from fixel.model.trajectory import pose_error
from fixel.planning.belief import Belief
from fixel.planning.success import interval
from fixel.progress import ProgressOption, show_progress
from fixel.results import Result, Summary
from fixel.simulation.vary import composed, inverted
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.predictive import CalibratedModel
from fixel.uncertainty.run_to_run import learn_run_to_run, rest_at
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.units import deg, mm

FOLDS: Final = 5
LEAST: Final = 20  # experiments from which the comparison is made
GOALS: Final = 200  # of each fold
WORLDS, RUNS = 32, 8
# Half of the worlds choose and the others state, so that choosing does not raise the statement.
BINS: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0)

Fit = Callable[[Sequence[Experiment], int], CalibratedModel]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class HeldSuccess(Result):
    """Stated success of chosen pushes, and whether their recorded ends met the goals."""

    stated: FloatArray  # (n,) stated success probability of the push that was chosen for each goal
    held: BoolArray  # (n,) whether its recorded end meets the goal
    push: np.ndarray  # (n,) number of the chosen experiment
    # Tolerances of the goals [m], [rad].
    position: float
    angle: float

    @property
    def curve(self) -> Table:
        """Held success by stated success, with 95 % intervals for the number of pushes."""
        columns: tuple[Column | str, ...] = (
            "stated", Column("choices"), Column("pushes"),
            *(Column(name, format=".3f") for name in ("mean stated", "held", "low", "high")),
        )  # fmt: skip
        rows = []
        for low, high in pairwise(BINS):
            own = (self.stated >= low) & ((self.stated < high) | (high == 1.0))
            if not own.any():
                continue
            pushes = len(np.unique(self.push[own]))
            share = float(self.held[own].mean())
            # Choices of the same push share its end, so that only pushes count as independent.
            rows.append(
                (f"{low:g} to {high:g}", int(own.sum()), pushes,
                 float(self.stated[own].mean()), share, *interval(share, pushes))
            )  # fmt: skip
        return Table(columns, rows)

    def _summary(self) -> Summary:
        off = float(np.abs(self.stated.mean() - self.held.mean()))
        return Summary(
            f"Stated {self.stated.mean():.3f} and held {self.held.mean():.3f} in {len(self.held)}"
            f" choices among {len(np.unique(self.push))} recorded pushes",
            [self.curve],
            [
                f"goals within {self.position / mm:g} mm and {self.angle / deg:g} deg",
                f"means differ by {100.0 * off:.1f} points",
            ],
        )


def held_success(
    fit: Fit,
    experiments: Sequence[Experiment],
    *,
    position: float = 3 * mm,
    angle: float = 3 * deg,
    seed: int = 0,
    progress: ProgressOption = None,
) -> HeldSuccess:
    """Compare stated with held success in choices among experiments that were left out.

    The function `fit` calibrates each fold: `(experiments, seed) -> calibrated model`. There are at
    least 20 pushes. Goals have the tolerances `position` [m] and `angle` [rad].
    """
    positive(position, "position", "m"), positive(angle, "angle", "rad")
    if len(experiments) < LEAST:
        expected = f"{LEAST} or more, to leave some out and choose among them"
        raise InvalidInput("experiments", found=f"{len(experiments)} pushes", expected=expected)
    rng = np.random.default_rng(seed)
    fold = rng.permutation(len(experiments)) % FOLDS
    parts = []
    with show_progress(progress, "leaving out") as report:
        for k in range(FOLDS):
            report(k, FOLDS)
            train = [own for own, at in zip(experiments, fold, strict=True) if at != k]
            rows = np.flatnonzero(fold == k)
            left = [experiments[int(row)] for row in rows]
            stated, held, chosen = _choices(
                fit(train, seed), train, left, (position, angle), rng, seed
            )
            parts.append((stated, held, rows[chosen]))
    stated, held, chosen = (np.concatenate(own) for own in zip(*parts, strict=True))
    return HeldSuccess(stated=stated, held=held, push=chosen, position=position, angle=angle)


def _choices(
    fit: CalibratedModel,
    train: Sequence[Experiment],
    left: Sequence[Experiment],
    tolerance: tuple[float, float],
    rng: np.random.Generator,
    seed: int,
) -> tuple[FloatArray, BoolArray, np.ndarray]:
    """Return stated and held success (GOALS,) of the chosen pushes, and which these are."""
    n_fitted = min(len(fit.estimates), 3 * len(train) - 1)
    scatter = learn_run_to_run(train, fit, fitted=n_fitted, seed=seed)
    belief = Belief(parameters=fit, run_to_run=scatter)
    targets = [target_of(own) for own in left]
    draws = np.array([_ends(belief, own, seed) for own in targets])
    measured = np.array([_motion(own, own.pose[-1:])[0] for own in targets])
    nominal = np.array([_nominal(fit, own) for own in targets])
    size = np.array([tolerance[0], tolerance[0], tolerance[1]])
    goals = nominal[rng.integers(len(nominal), size=GOALS)]
    goals = goals + (2.0 * rng.random((GOALS, 3)) - 1.0) * size
    met = np.array([_within(draws, goal, tolerance) for goal in goals])  # (goal, push, draw)
    even = np.arange(draws.shape[1]) // RUNS % 2 == 0
    chosen = met[:, :, even].mean(axis=2).argmax(axis=1)
    at = np.arange(GOALS)
    hit = np.array([_within(measured, goal, tolerance) for goal in goals])
    return met[:, :, ~even].mean(axis=2)[at, chosen], hit[at, chosen], chosen


def _ends(belief: Belief, target: Target, seed: int) -> FloatArray:
    """Return predicted motions (n, 3) of a push in the part's own frame; NaN where none ended."""
    scene = target.case.scene
    drawn = belief.scenarios(scene, worlds=WORLDS, runs=RUNS, seed=seed)
    found = simulate_starts(
        scene, None, drawn=drawn.start, values=drawn.values, times=target.case.times[-1:],
        motion=belief.motion,
    )  # fmt: skip
    ends = found.pose[:, -1] + rest_at(drawn.rest, found.pose[:, -1, 2] - found.start[:, 2])
    return np.where(found.ended[:, None], _motion(target, ends), np.nan)


def _nominal(fit: CalibratedModel, target: Target) -> FloatArray:
    found = simulate_starts(
        target.case.scene, None, 1, values=Belief(parameters=fit).nominal(target.case.scene),
        times=target.case.times[-1:], motion=fit.motion,
    )  # fmt: skip
    return np.asarray(_motion(target, found.nominal[-1:])[0])


def _motion(target: Target, ends: FloatArray) -> FloatArray:
    """Return ends (n, 3) in the frame of the part at its start."""
    return composed(inverted(np.array([target.case.scene.bodies[0].pose])), ends)


def _within(motions: FloatArray, goal: FloatArray, tolerance: tuple[float, float]) -> BoolArray:
    apart, turned = pose_error(motions, goal)
    return np.asarray((apart <= tolerance[0]) & (np.abs(turned) <= tolerance[1]))
