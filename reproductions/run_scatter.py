"""Predicted and measured motions of real pushes, with a scatter between runs.

The calibration of a group gives the predicted motion, its training pushes the scatter between runs
(`fixel.uncertainty.run_to_run`). Draws of the scatter are simulated for every push. How often their
intervals hold among the training pushes, by how far the part moves and turns, widens those of the
others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.model import wrapped
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.run_to_run import (
    CENTRE,
    FAR,
    FRICTION,
    START,
    RunEffects,
    RunToRun,
    pose_difference,
    rest_at,
)
from reproductions.coverage import outcomes_of
from reproductions.fitting import ARM, Belief, FittedPushes
from reproductions.linear import LinearPredictive, Outcomes, fit_predictive
from reproductions.protocols import full_beliefs
from reproductions.pushes import Key, PushGroup
from reproductions.residuals import Split, in_object

DRAWS: Final = 64  # simulated for every push
REPEATS: Final = 4  # of each, with other remainders and errors of measurement
LEVEL: Final = 0.9
TAILS: Final = (0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2)
# Training pushes of a group that count as much as all other groups do for its own factor.
SHRINK: Final = 60.0
# Motion and rotation from which widening grows with their logarithm [m, rad].
SMALL: Final = (1e-3, math.radians(1.0))


class ScatteredPushes(NamedTuple):
    """Motions of m pushes of one group, in the frame of the object at its start [m, m, rad]."""

    key: Key
    rows: IntArray  # (m,) members of the group
    predicted: FloatArray  # (m, 3)
    measured: FloatArray  # (m, 3); of a training push as if it had not been fitted
    draws: FloatArray  # (m, n, 3) measured motions that the scatter lets expect

    @property
    def moved(self) -> FloatArray:
        """Predicted displacements (m,) [m]."""
        return np.asarray(np.hypot(*self.predicted[:, :2].T))

    @property
    def turned(self) -> FloatArray:
        """Predicted rotations (m,) [rad]."""
        return np.asarray(np.abs(self.predicted[:, 2]))

    def widened(self, factors: FloatArray) -> ScatteredPushes:
        """Return draws farther from their median by factors (m, 2): of position, of angle."""
        middle = np.nanmedian(self.draws, axis=1, keepdims=True)
        own = factors[:, None, [0, 0, 1]]
        return self._replace(draws=middle + own * (self.draws - middle))

    def inside(self) -> np.ndarray:
        """Return whether the 90 % interval of each coordinate contains the measurement, (m, 3)."""
        low, _, high = np.nanquantile(self.draws, TAILS, axis=1)
        return np.asarray((low <= self.measured) & (self.measured <= high))

    def half_widths(self) -> FloatArray:
        """Return half the widths (m, 3) of the 90 % intervals [m, m, rad]."""
        low, _, high = np.nanquantile(self.draws, TAILS, axis=1)
        return np.asarray(0.5 * (high - low))


class GroupScatter(NamedTuple):
    """Predictions of one group with one split: training and held-out pushes."""

    scatter: RunToRun
    train: ScatteredPushes
    held_out: ScatteredPushes


@final
@dataclass(frozen=True, slots=True)
class SimulatedGroup:
    """Calibrated simulations of a group, prepared for draws.

    Parameters
    ----------
    group : PushGroup
    fit : FittedPushes
    beliefs : sequence of Belief
        Priors of the fitted parameters.
    split : Split
        Training and held-out members; those without a simulation are left out.
    """

    group: PushGroup
    fit: FittedPushes
    beliefs: Sequence[Belief]
    split: Split

    def predict(self, scatter: RunToRun | None = None, draws: int = DRAWS) -> GroupScatter:
        """Predict all pushes; learn the scatter from the training pushes unless it is given."""
        group, everyone = self.group, np.arange(len(self.group))
        outcomes = outcomes_of(group, self.fit, self.beliefs)
        good = np.asarray(np.isfinite(outcomes.residual).all(axis=1))
        train, held = (own[good[own]] for own in self.split)
        sd = np.array([belief.sd for belief in self.beliefs])
        linear = fit_predictive(Outcomes(*(table[train] for table in outcomes)), sd, ((0, 1), (2,)))
        base = group.ends(everyone, self.fit.values)
        left = self._in_object(train, linear.left)
        size = np.array([self._arm, self._arm, 1.0])
        turned = np.abs(wrapped(base[:, 2] - group.start[:, 2]))
        learn = scatter is None
        if scatter is None:
            scatter = RunToRun.learned(self._effects(train, left / size, linear, outcomes))
        both = np.concatenate((train, held))
        inner = self._draws(both, scatter, linear, draws, base)
        if learn:
            own = inner[: len(train)] / size
            scatter = scatter.with_remainder(left / size, own, turned[train])
        full = np.repeat(inner, REPEATS, axis=1)
        full += self._outer(both, scatter, draws * REPEATS, turned[both])
        motion = in_object(group, both, pose_difference(base[both], group.start[both]))
        measured = in_object(group, both, pose_difference(group.end[both], group.start[both]))
        measured[: len(train)] = motion[: len(train)] + left
        ends = motion[:, None] + full
        return GroupScatter(
            scatter,
            *(
                ScatteredPushes(group.key, both[own], motion[own], measured[own], ends[own])
                for own in (slice(None, len(train)), slice(len(train), None))
            ),
        )

    @property
    def _arm(self) -> float:
        return math.sqrt(self.group.shape.unit_inertia)

    def _in_object(self, which: IntArray, along_across: FloatArray) -> FloatArray:
        """Rotate errors along and across the push, with ARM times the angle, to the object."""
        heading = (self.group.tip_end - self.group.tip_start)[which]
        along = heading / np.hypot(*heading.T)[:, None]
        a, b = along_across[:, 0], along_across[:, 1]
        x, y = a * along[:, 0] - b * along[:, 1], a * along[:, 1] + b * along[:, 0]
        return in_object(self.group, which, np.column_stack((x, y, along_across[:, 2] / ARM)))

    def _effects(
        self, train: IntArray, left: FloatArray, linear: LinearPredictive, outcomes: Outcomes
    ) -> RunEffects:
        """Return the effects of the default scatter on training pushes, in the object's frame."""
        arm, size = self._arm, np.array([self._arm, self._arm, 1.0])
        mu = self.fit.values["mu_pusher"]

        def effect(name: str, low: float, high: float) -> FloatArray:
            ends = [self.group.ends(train, self.fit.values | {name: x}) for x in (low, high)]
            off = in_object(self.group, train, pose_difference(ends[1], ends[0]))
            return np.asarray(np.nan_to_num(off / (2.0 * FAR * size)))

        steps = zip(("start_x", "start_y", "start_theta"), (arm, arm, 1.0), strict=True)
        start = [effect(name, -FAR * START * x, FAR * START * x) for name, x in steps]
        far = FAR * CENTRE * arm
        centre = [effect(f"friction_centre_{axis}", -far, far) for axis in "xy"]
        factor = math.exp(FAR * FRICTION)
        columns = outcomes.columns[train]
        turn = np.stack(
            [self._in_object(train, columns[:, :, k]) for k in range(columns.shape[2])], axis=2
        )
        turn = turn / size[:, None]
        return RunEffects(
            residual=left,
            start=np.stack(start, axis=2),
            centre=np.stack(centre, axis=2),
            friction=effect("mu_pusher", mu / factor, mu * factor)[:, :, None],
            turned=np.abs(
                wrapped(self.group.ends(train, self.fit.values)[:, 2] - self.group.start[train, 2])
            ),
            known=np.matmul(np.matmul(turn, linear.covariance), turn.transpose(0, 2, 1)),
        )

    def _draws(
        self, which: IntArray, scatter: RunToRun, linear: LinearPredictive, n: int, base: FloatArray
    ) -> FloatArray:
        """Return simulated changes (m, n, 3) of the ends of members."""
        rng = np.random.default_rng([len(which), n])
        total = len(which) * n
        low, high = (np.array([getattr(b, end) for b in self.beliefs]) for end in ("low", "high"))
        root = np.linalg.cholesky(linear.covariance + 1e-18 * np.eye(len(low)))
        drawn = self.fit.point + rng.standard_normal((total, len(low))) @ root.T
        values: Mapping[str, FloatArray] = dict(
            zip(self.fit.names, np.clip(drawn, low, high).T.copy(), strict=True)
        )
        seed = int(rng.integers(2**31))
        changes = scatter.drawn(total, seed=seed, scene=self.group.cases[0].scene, values=values)
        members = np.repeat(which, n)
        found = self.group.simulate(members, changes.parameters)
        end = np.where(found.good[:, None], found.end, np.nan)
        off = in_object(self.group, members, pose_difference(end, base[members]))
        return off.reshape(len(which), n, 3)

    def _outer(self, which: IntArray, scatter: RunToRun, n: int, turned: FloatArray) -> FloatArray:
        """Return the remainder of draws (m, n, 3), and the noise of their measurement."""
        total, scene = len(which) * n, self.group.cases[0].scene
        drawn = scatter.drawn(total, seed=len(which), scene=scene).rest
        rest = rest_at(drawn, np.repeat(turned, n))
        tails = np.random.default_rng(n).standard_t(scatter.freedom, (total, 3))
        return np.asarray((rest + tails * scatter.noise(scene)).reshape(len(which), n, 3))


# --- widening -------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True)
class Widening:
    """Factors on intervals, by how far the part is predicted to move and to turn.

    Parameters
    ----------
    slopes : (2, 3) float64
        For position and angle: constant, and slopes over the logarithms of motion and rotation.
    of_group : mapping of key to (2,) float64
        Logarithm of the factor of single groups.
    """

    slopes: FloatArray
    of_group: Mapping[Key, FloatArray]

    @classmethod
    def fitted(cls, groups: Sequence[ScatteredPushes]) -> Widening:
        """Fit factors with which 90 % intervals contain 90 % of the training pushes."""
        ratios = [_needed(own) for own in groups]
        table = np.concatenate([_grown(own) for own in groups])
        slopes = np.array(
            [
                _quantile_fit(
                    np.concatenate([table[:, :] for _ in columns]),
                    np.concatenate([np.concatenate([r[:, c] for r in ratios]) for c in columns]),
                )
                for columns in ((0, 1), (2,))
            ]
        )
        of_group = {}
        for own, ratio in zip(groups, ratios, strict=True):
            beyond = ratio - (_grown(own) @ slopes.T)[:, [0, 0, 1]]
            share = len(ratio) / (len(ratio) + SHRINK)
            both = (beyond[:, :2].ravel(), beyond[:, 2])
            of_group[own.key] = share * np.array([np.quantile(b, LEVEL) for b in both])
        return cls(slopes, of_group)

    def applied(self, pushes: ScatteredPushes) -> ScatteredPushes:
        """Return pushes with wider or narrower draws; groups of its own have their own factor."""
        own = self.of_group.get(pushes.key, np.zeros(2))
        return pushes.widened(np.exp(_grown(pushes) @ self.slopes.T + own))


def _needed(pushes: ScatteredPushes) -> FloatArray:
    """Return logarithms (m, 3) of the factors that put measurements on the ends of intervals."""
    low, middle, high = np.nanquantile(pushes.draws, TAILS, axis=1)
    off = pushes.measured - middle
    side = np.where(off > 0.0, high - middle, middle - low)
    return np.asarray(np.log(np.maximum(np.abs(off) / np.maximum(side, 1e-12), 1e-3)))


def _grown(pushes: ScatteredPushes) -> FloatArray:
    """Return a constant, and logarithms of motion and rotation (m, 3)."""
    moved, turned = (
        np.log1p(x / small) for x, small in zip((pushes.moved, pushes.turned), SMALL, strict=True)
    )
    return np.column_stack((np.ones(len(moved)), moved - 3.0, turned - 2.3))


def _quantile_fit(table: FloatArray, values: FloatArray) -> FloatArray:
    """Return the linear 90 % quantile of values (k,) over columns (k, 3)."""
    from scipy.optimize import minimize

    def cost(z: FloatArray) -> float:
        off = values - table @ z
        return float(np.mean(np.where(off > 0.0, LEVEL * off, (LEVEL - 1.0) * off)))

    begin = np.array([np.quantile(values, LEVEL), 0.0, 0.0])
    return np.asarray(minimize(cost, begin, method="Nelder-Mead", options={"maxiter": 600}).x)


def widened(
    groups: Sequence[GroupScatter], learned_from: Sequence[GroupScatter]
) -> list[GroupScatter]:
    """Widen the held-out pushes of groups, as the training pushes of others need."""
    widening = Widening.fitted([own.train for own in learned_from])
    return [own._replace(held_out=widening.applied(own.held_out)) for own in groups]


def typical(scatters: Sequence[RunToRun]) -> RunToRun:
    """Return the median of every number, for a plate without pushes of its own."""
    names = ("start", "centre", "friction", "rest_position", "rest_angle", "noise_position",
             "noise_angle", "freedom")  # fmt: skip
    found = {name: float(np.median([getattr(s, name) for s in scatters])) for name in names}
    return replace(RunToRun(), **found, experiments=sum(s.experiments for s in scatters))


def simulated_group(group: PushGroup, fit: FittedPushes, split: Split) -> SimulatedGroup:
    """Return a group with its fit, prepared for draws."""
    return SimulatedGroup(group, fit, full_beliefs(group, split.train), split)
