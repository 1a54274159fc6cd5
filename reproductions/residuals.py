"""Splits of pushes, and what calibrated predictions leave over: errors, features, and a model."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.datasets.mit_plates import TIP
from fixel.domain.features import (
    PLACE,
    Configurations,
    Features,
    configuration_features,
    neighbour_features,
    scaled,
    simulated_features,
)
from fixel.errors import InvalidInput
from fixel.model import wrapped
from fixel.typing import BoolArray, FloatArray, IntArray
from reproductions.fitting import FittedPushes
from reproductions.pushes import PushGroup

# Number of times at which simulated pushes are sampled.
SAMPLES: Final = 10
# Weight of the object's angle on the table in the distance of neighbours, relative to the place of
# contact (in units of the spread of places) and the direction of the push.
TABLE_TURN: Final = 0.5
# Largest number of examples: the computing time grows with its cube.
MAX_EXAMPLES: Final = 4000
MIN_EXAMPLES: Final = 8
# Residuals are clipped at this distance from the median, in robust standard deviations: a push with
# an entirely different end says nothing about the others. Of 3, 4, 6 and no limit, 4 was
# best on inner folds of training pushes.
FARTHEST: Final = 4.0
# Folds, each predicted from the others, to measure the errors of predictions.
PARTS: Final = 3
# Standard deviations that contain 90 % of a normal distribution.
NINETY: Final = 1.6449


class Split(NamedTuple):
    """Disjoint training and held-out members of a group, by index."""

    train: IntArray
    held_out: IntArray


def random_split(strata: Sequence[Hashable], share: float, seed: int) -> Split:
    """Select a random share of every stratum for training, and hold out the rest.

    Parameters
    ----------
    strata : (n,) sequence
        Stratum of each member, for instance its speed.
    share : float
        Share for training, between 0 and 1.
    """
    if not 0.0 < share < 1.0:
        raise InvalidInput("share", found=share, expected="a number between 0 and 1")
    rng = np.random.default_rng(seed)
    train: list[int] = []
    for own in _members(strata):
        train += rng.permutation(own)[: round(share * len(own))].tolist()
    return _split(train, len(strata))


def folds(strata: Sequence[Hashable], n: int, seed: int) -> list[Split]:
    """Create splits that hold out every member exactly once, with each stratum spread evenly."""
    if not 2 <= n <= max(len(strata), 2):
        raise InvalidInput("--folds", found=n, expected=f"2 to {len(strata)}")
    rng = np.random.default_rng(seed)
    fold = np.zeros(len(strata), np.int64)
    dealt = 0
    for own in _members(strata):
        fold[rng.permutation(own)] = (dealt + np.arange(len(own))) % n
        dealt += len(own)
    return [Split(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(n)]


def split_without(labels: IntArray, label: int, seed: int) -> Split:
    """Split that trains on three quarters of the members of every label except one.

    All members of that label, such as a side, and the remaining quarters are held out.
    """
    rng = np.random.default_rng(seed)
    train: list[int] = []
    for own in np.unique(labels[labels != label]).tolist():
        members = rng.permutation(np.flatnonzero(labels == own))
        train += members[: round(0.75 * len(members))].tolist()
    return _split(train, len(labels))


def few_of(split: Split, n: int, seed: int) -> Split:
    """Reduce the training members to `n` random ones; held-out members stay the same."""
    rng = np.random.default_rng(seed)
    return split._replace(train=np.sort(rng.permutation(split.train)[:n]))


def _members(strata: Sequence[Hashable]) -> list[IntArray]:
    names = list(dict.fromkeys(strata))
    number = {name: k for k, name in enumerate(names)}
    which = np.array([number[name] for name in strata], np.int64)
    return [np.flatnonzero(which == k) for k in range(len(names))]


def _split(train: Sequence[int], n: int) -> Split:
    learned = np.zeros(n, bool)
    learned[list(train)] = True
    return Split(np.flatnonzero(learned), np.flatnonzero(~learned))


# --- a model of what physics leaves over ------------------------------------------------------


def learned_ends(
    group: PushGroup, split: Split, physics: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predict ends (n, 3) of held-out members, and their standard deviations along the object's
    axes at the start.

    Parameters
    ----------
    physics : (m, 3) float64
        Ends of all members by the physics. Of the measured ends only those for training are used.
    """
    features = _features(group, physics, speed)
    good: BoolArray = np.asarray(np.isfinite(physics).all(axis=1))
    train = split.train[good[split.train]]
    residual = in_object(group, train, group.end[train] - physics[train])
    process = ResidualProcess(features[train], residual)
    held = split.held_out
    more, sd = process.predict(np.nan_to_num(features[held]))
    end = physics[held] + in_world(group, held, more)
    return end, sd


def _features(group: PushGroup, physics: FloatArray, speed: FloatArray) -> FloatArray:
    """Features known before a push: tip and direction in the object's frame, pose of the object,
    speed, and motion predicted by the physics."""
    everyone = np.arange(len(group))
    heading = group.tip_end - group.tip_start
    heading = heading / np.hypot(*heading.T)[:, None]
    flat = np.zeros(len(group))
    tip = in_object(group, everyone, np.column_stack((group.tip_start - group.start[:, :2], flat)))
    along = in_object(group, everyone, np.column_stack((heading, flat)))
    angle = group.start[:, 2]
    moved = in_object(group, everyone, physics - group.start)
    return np.column_stack(
        (tip[:, :2], along[:, :2], np.cos(angle), np.sin(angle), group.start[:, :2], speed, moved)
    )


def in_object(group: PushGroup, which: IntArray, moves: FloatArray) -> FloatArray:
    """Rotate small motions (n, 3) to the axes of the object at the start."""
    return _turned(moves, -group.start[which, 2])


def in_world(group: PushGroup, which: IntArray, moves: FloatArray) -> FloatArray:
    return _turned(moves, group.start[which, 2])


def _turned(moves: FloatArray, angle: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    x, y = moves[:, 0], moves[:, 1]
    return np.column_stack((c * x - s * y, s * x + c * y, wrapped(moves[:, 2])))


def inside_ninety(group: PushGroup, which: IntArray, end: FloatArray, sd: FloatArray) -> BoolArray:
    off = in_object(group, which, group.end[which] - end)
    return np.asarray(np.abs(off) <= NINETY * sd)


# --- features and errors --------------------------------------------------------------------------


class PushErrors(NamedTuple):
    """Features and errors of all members of a group with one fit."""

    features: Features
    errors: FloatArray  # (n, 3) position [m], angle [rad], both at 35 mm/rad [m]


def evidence_of(
    group: PushGroup, split: Split, found: FittedPushes, speed: FloatArray
) -> PushErrors:
    """Compute features of all members of a group, and errors of their predictions.

    Features of a push never use its measured end; those of neighbours use the ends of training
    pushes.
    """
    everyone = np.arange(len(group))
    given = found.values
    configurations = _configurations(group, given)
    track = group.tracks(SAMPLES)

    def roll(which: IntArray, changed: Mapping[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
        values = {name: np.full(len(which), x) for name, x in given.items()}
        return track(which, values | dict(changed))

    end = found.predict(group, everyone)
    good: BoolArray = np.asarray(np.isfinite(end).all(axis=1))
    residual = np.where(good[:, None], group.end - np.nan_to_num(end), 0.0)
    place = configuration_features(configurations)
    simulated = simulated_features(configurations, roll, given["mu_pusher"])
    nominal = np.nan_to_num(scaled(group.nominal.end - np.where(good[:, None], end, group.start)))
    features = place.with_more(simulated.names, simulated.table)
    features = features.with_more(("speed", "model_change"), np.column_stack(
        (speed, np.linalg.norm(nominal, axis=1))
    ))  # fmt: skip
    near = _near(group, split, place, in_object(group, everyone, scaled(residual)))
    features = features.with_more(near.names, near.table)
    off = scaled(residual)
    position, both = np.hypot(off[:, 0], off[:, 1]), np.linalg.norm(off, axis=1)
    errors = np.column_stack((position, np.abs(wrapped(residual[:, 2])), both))
    return PushErrors(features, np.where(good[:, None], errors, np.inf))


def _configurations(group: PushGroup, given: Mapping[str, float]) -> Configurations:
    shift = np.array([given.get(f"registration_{axis}", 0.0) for axis in "xy"])
    return Configurations(
        group.shape, TIP.radius, group.start, group.tip_start + shift, group.tip_end + shift
    )


def _near(group: PushGroup, split: Split, place: Features, residual: FloatArray) -> Features:
    """Features of the nearest training pushes; a training push is not its own neighbour."""
    table = place.columns(PLACE)
    size = np.std(table[:, :2], axis=0).max()
    table = np.column_stack((table[:, :2] / size, table[:, 2:4], TABLE_TURN * table[:, 4:6]))
    itself = np.full(len(group), -1)
    itself[split.train] = np.arange(len(split.train))
    common = np.median(np.linalg.norm(residual[split.train], axis=1))
    found = neighbour_features(table, table[split.train], residual[split.train], 8, itself)
    return found.with_more(("group_error",), np.full((len(group), 1), common))


@final
class ResidualProcess:
    """Gaussian process for each column of the residual, with a length for each feature.

    This is not physics and is not valid outside the training pushes. Report it separately.

    Parameters
    ----------
    features : (n, n_feature) array
        Features that are known before a push, in any units.
    residuals : (n, n_output) array
        Measured minus simulated values.
    rounds : int
        Maximum number of iterations of the search for lengths and noise.

    Notes
    -----
    The standard deviations are scaled so that the 90 % intervals contain 90 % of the examples when
    each third of them is predicted from the rest: tails of pushes are heavier than normal, and many
    lengths overfit few examples.

    Source
    ------
    Rasmussen & Williams (2006), algorithm 2.1; kernel Matern 3/2.
    """

    def __init__(self, features: FloatArray, residuals: FloatArray, rounds: int = 60) -> None:
        _refuse_examples(features, residuals)
        _refuse_missing()
        self._processes = _Processes(features, residuals, rounds)
        self._widening = _widening(features, residuals, rounds)

    def predict(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return expected residuals (n, n_output) and their standard deviations (n, n_output)."""
        mean, sd = self._processes.predict(features)
        return mean, sd * self._widening


class _Processes:
    """Gaussian processes on scaled columns, without correction of the standard deviations."""

    def __init__(self, features: FloatArray, residuals: FloatArray, rounds: int) -> None:
        self._centre = features.mean(axis=0)
        spread = features.std(axis=0)
        self._used = spread > 1e-12
        self._spread = np.where(self._used, spread, 1.0)
        near = _without_tails(residuals)
        self._scale = np.maximum(near.std(axis=0), 1e-12)
        table = self._scaled(features)
        self._one_each = [_process(table, column, rounds) for column in (near / self._scale).T]

    def predict(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        table = self._scaled(features)
        found = [process.predict(table, return_std=True) for process in self._one_each]
        mean = np.column_stack([m for m, _ in found]) * self._scale
        return mean, np.column_stack([s for _, s in found]) * self._scale

    def _scaled(self, features: FloatArray) -> FloatArray:
        return np.asarray(((features - self._centre) / self._spread)[:, self._used])


def _without_tails(residuals: FloatArray) -> FloatArray:
    middle = np.median(residuals, axis=0)
    spread = 1.4826 * np.median(np.abs(residuals - middle), axis=0)
    return np.clip(residuals, middle - FARTHEST * spread, middle + FARTHEST * spread)


def _widening(features: FloatArray, residuals: FloatArray, rounds: int) -> FloatArray:
    """Return factors (n_output,) of the standard deviations for a 90 % coverage."""
    part = np.random.default_rng(0).permutation(len(features)) % PARTS
    z = np.zeros_like(residuals)
    for k in range(PARTS):
        own = part == k
        mean, sd = _Processes(features[~own], residuals[~own], rounds).predict(features[own])
        z[own] = np.abs(residuals[own] - mean) / sd
    return np.maximum(np.quantile(z, 0.9, axis=0) / NINETY, 1e-6)


def _process(table: FloatArray, column: FloatArray, rounds: int) -> Any:
    from scipy.optimize import minimize
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    def climb(objective: Any, start: FloatArray, bounds: FloatArray) -> tuple[FloatArray, float]:
        options = {"maxiter": rounds}
        end = minimize(
            objective, start, method="L-BFGS-B", jac=True, bounds=bounds, options=options
        )
        return end.x, float(end.fun)

    n = table.shape[1]
    lengths = Matern(np.full(n, 2.0), (0.2, 100.0), nu=1.5)
    kernel = ConstantKernel(0.5, (1e-3, 10.0)) * lengths + WhiteKernel(0.5, (1e-2, 4.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound: no influence
        process = GaussianProcessRegressor(kernel, optimizer=climb, alpha=1e-8)
        return process.fit(table, column)


def _refuse_examples(features: FloatArray, residuals: FloatArray) -> None:
    n = len(features)
    good = np.isfinite(features).all() and np.isfinite(residuals).all()
    if len(residuals) != n or not good or not MIN_EXAMPLES <= n <= MAX_EXAMPLES:
        raise InvalidInput(
            "learned residual",
            found=f"{n} rows of features, {len(residuals)} of residuals",
            expected=f"finite ones, {MIN_EXAMPLES} to {MAX_EXAMPLES} of each",
        )


def _refuse_missing() -> None:
    try:
        import sklearn  # noqa: F401
    except ImportError:
        raise InvalidInput(
            "learned residual",
            found="no package scikit-learn",
            expected="it to be installed",
            hint='pip install "fixel[learn]"',
        ) from None
