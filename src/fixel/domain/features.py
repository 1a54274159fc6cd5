"""Features of a configuration that are known before an experiment, from geometry and from cheap
simulations.

They do not depend on measurements of the configuration itself, so they may be used to predict the
error of the simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import Configurations
from fixel.calibration.objective import ANGLE_SCALE
from fixel.model import Disk, Shape, rotated, wrapped
from fixel.model.overlap import gaps_and_normals
from fixel.model.trajectory import pose_difference
from fixel.typing import BoolArray, FloatArray, IntArray

# Disturbances of a configuration, as large as the uncertainty of trackers and tables.
SIDEWAYS: Final = 0.7e-3  # shift of the object across the push [m]
TURN: Final = float(np.radians(1.0))  # rotation of the object [rad]
FRICTION: Final = 1.25  # factor on the friction at the pusher
CENTRE: Final = 2.0e-3  # shift of the centre of friction along the axes of the body [m]

# Gap above which the pusher has lost contact [m].
PARTED: Final = 0.3e-3
# Distance from a corner below which a contact is on it [m].
AT_CORNER: Final = 2.0e-3
# Motion of a contact below which it sticks [m].
STUCK: Final = 0.5e-3
# Smallest turn of an outline at a corner [rad].
CORNER_TURN: Final = float(np.radians(20.0))

Tracks = tuple[FloatArray, BoolArray]  # (m, k, 3) poses after the start, and (m,) whether it ended
# Simulates configurations `which` (m,) with parameters by name (m,) that replace calibrated ones.
Roll = Callable[[IntArray, Mapping[str, FloatArray]], Tracks]


class Features(NamedTuple):
    """Table of features with named columns."""

    names: tuple[str, ...]
    table: FloatArray  # (n, n_name), finite

    def columns(self, names: tuple[str, ...]) -> FloatArray:
        """Return columns (n, len(names)) by name."""
        return self.table[:, [self.names.index(name) for name in names]]


def simulated_features(asked: Configurations, roll: Roll, mu: float) -> Features:
    """Return features from eleven rollouts per configuration: motion, contact, sensitivity.

    Sensitivity is that of the end to the start, the friction at the pusher and the centre of
    friction. Lengths are in metres, angles in radians at 35 mm. `roll` is the calibrated simulator,
    whose poses are at equal intervals up to the end of the push, `mu` the calibrated friction at
    the pusher. A disturbed rollout that did not finish counts as undisturbed; `lost` is the share
    of these. If the undisturbed one did not finish, `lost` is 1 and the other features describe the
    motion so far.
    """
    n = len(asked.start)
    pose, good = roll(np.arange(n), {})
    names, columns = _way(asked, pose)
    spread, bent, lost = _answers(asked, roll, mu, pose[:, -1], good)
    for k, name in enumerate(("sideways", "turn", "friction", "centre_x", "centre_y")):
        names += [f"sensitive_{name}", f"bent_{name}"]
        columns += [spread[:, k], bent[:, k]]
    names += ["sensitivity", "bent", "lost"]
    columns += [np.hypot.reduce(spread, axis=1), np.hypot.reduce(bent, axis=1), lost]
    return Features(tuple(names), np.nan_to_num(np.column_stack(columns)))


def _answers(
    asked: Configurations, roll: Roll, mu: float, end: FloatArray, good: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return half the distance of the ends of opposite disturbances (n, 5), the distance of their
    middle from the undisturbed end (n, 5), and the share of lost rollouts (n,)."""
    n = len(end)
    heading = headings(asked)
    across = np.column_stack((-heading[:, 1], heading[:, 0])) * SIDEWAYS
    kinds: list[dict[str, tuple[FloatArray, FloatArray]]] = [
        {"start_x": (across[:, 0], -across[:, 0]), "start_y": (across[:, 1], -across[:, 1])},
        {"start_theta": (np.full(n, TURN), np.full(n, -TURN))},
        {"mu_pusher": (np.full(n, mu * FRICTION), np.full(n, mu / FRICTION))},
        {"friction_centre_x": (np.full(n, CENTRE), np.full(n, -CENTRE))},
        {"friction_centre_y": (np.full(n, CENTRE), np.full(n, -CENTRE))},
    ]
    which = np.arange(n)
    spread, bent = np.zeros((n, len(kinds))), np.zeros((n, len(kinds)))
    lost = np.where(good, 0.0, 1.0)
    for k, kind in enumerate(kinds):
        away = []
        for side in (0, 1):
            pose, ended = roll(which, {name: both[side] for name, both in kind.items()})
            ended &= good
            away.append(np.where(ended[:, None], scaled(pose[:, -1] - end), 0.0))
            lost = np.maximum(lost, np.where(ended, lost, lost + 1.0 / (2 * len(kinds))))
        spread[:, k] = 0.5 * np.linalg.norm(away[0] - away[1], axis=1)
        bent[:, k] = 0.5 * np.linalg.norm(away[0] + away[1], axis=1)
    return spread, bent, np.minimum(lost, 1.0)


def _way(asked: Configurations, pose: FloatArray) -> tuple[list[str], list[FloatArray]]:
    """Return names and columns of features of the motion and the contact."""
    n, k = pose.shape[:2]
    share = np.linspace(0.0, 1.0, k + 1)[None, :, None]
    tip = asked.tip_start[:, None] * (1.0 - share) + asked.tip_end[:, None] * share
    pose = np.concatenate((asked.start[:, None], pose), axis=1)
    flat, tips = pose.reshape(-1, 3), tip.reshape(-1, 2)
    gap = gaps_and_normals(asked.shape, asked.radius, flat, tips)[0].reshape(n, k + 1)
    local = rotated(tips - flat[:, :2], -flat[:, 2])
    corner = corner_distance(asked.shape, local, asked.radius).reshape(n, k + 1)
    local = local.reshape(n, k + 1, 2)
    steps = np.hypot(*np.moveaxis(np.diff(local, axis=1), 2, 0))
    slid = np.hypot(*(local[:, -1] - local[:, 0]).T)
    moved = pose_difference(pose[:, -1], pose[:, 0])
    body = np.column_stack((rotated(moved[:, :2], -asked.start[:, 2]), moved[:, 2]))
    at_corner = corner < AT_CORNER
    named = {
        "moved_x": body[:, 0],
        "moved_y": body[:, 1],
        "turned": body[:, 2],
        "distance": np.hypot(*moved[:, :2].T),
        "turned_abs": np.abs(moved[:, 2]),
        "slid": slid,
        "slides": steps.sum(axis=1),
        "slides_late": steps[:, -1],
        "stuck": (steps < STUCK).mean(axis=1),
        "parted": (gap[:, 1:] > PARTED).mean(axis=1),
        "gap_end": np.clip(gap[:, -1], 0.0, 0.05),
        "corner_end": corner[:, -1],
        "corner_least": corner.min(axis=1),
        "corner_changes": np.abs(np.diff(at_corner.astype(float), axis=1)).sum(axis=1),
    }
    return list(named), list(named.values())


def scaled(difference: FloatArray) -> FloatArray:
    """Return differences of poses (n, 3) in metres, angles within half a turn at 35 mm/rad."""
    return np.column_stack((difference[:, :2], ANGLE_SCALE * wrapped(difference[:, 2])))


def corner_distance(shape: Shape, point: FloatArray, radius: float) -> FloatArray:
    """Return distances (n,) from the surface of a pusher at points (n, 2), in the frame of the
    shape, to the nearest corner; a hundred radii if the outline has none [m]."""
    corners = _corners(shape)
    if not len(corners):
        return np.full(len(point), 100.0 * radius)
    away = np.linalg.norm(point[:, None] - corners[None], axis=2).min(axis=1)
    return np.asarray(np.maximum(away - radius, 0.0))


def _corners(shape: Shape) -> FloatArray:
    """Return the vertices (n, 2) at which the outline turns sharply."""
    if isinstance(shape, Disk):
        return np.zeros((0, 2))
    outline = shape.outline
    before = outline - np.roll(outline, 1, axis=0)
    after = np.roll(outline, -1, axis=0) - outline
    turn = wrapped(np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0]))
    return np.asarray(outline[np.abs(turn) > CORNER_TURN])


def headings(asked: Configurations) -> FloatArray:
    way = asked.tip_end - asked.tip_start
    length = np.hypot(*way.T)[:, None]
    return np.asarray(np.divide(way, length, out=np.zeros_like(way), where=length > 0.0))


# A model need not be correct: the conformal correction of a bound is measured on experiments that
# the model has not seen. A better model makes bounds narrower, not more reliable.


# Power of the error that models predict: bounds proportional to the error would be too wide for
# large errors, and bounds with a constant addition too wide for small ones.
POWER: Final = 1.0 / 3.0
# Fewer experiments than this give a constant.
MIN_MODEL: Final = 30
TREES: Final = 100
MIN_LEAF: Final = 5
SHARE_OF_FEATURES: Final = 1.0 / 3.0
NEIGHBOURS: Final = 12


# Function from features (n, f) to expected powers of errors (n,).
ScaleModel = Callable[[FloatArray], FloatArray]


def powered(errors: FloatArray) -> FloatArray:
    """Return the powers of errors that models predict."""
    return np.asarray(errors**POWER)


def unpowered(values: FloatArray) -> FloatArray:
    """Inverse of `powered`; negative values count as zero."""
    return np.asarray(np.maximum(values, 0.0) ** (1.0 / POWER))


def default_model(n: int) -> str:
    """Return the name of the best available model for n experiments."""
    if n < MIN_MODEL:
        return "constant"
    try:
        import sklearn  # noqa: F401
    except ImportError:
        return "neighbours"
    return "forest"


def fitted_model(name: str, features: FloatArray, values: FloatArray, seed: int) -> ScaleModel:
    """Fit a model to `values` (n,), finite powers of errors.

    `"forest"`: extremely randomised trees (Geurts, Ernst & Wehenkel 2006), of scikit-learn.
    `"neighbours"`: mean of the nearest experiments. `"constant"`: median.
    """
    if name == "forest":
        return _forest(features, values, seed)
    if name == "neighbours":
        return partial(_neighbours, Scale.of(features), features, values)
    return partial(_constant, float(np.median(values)) if len(values) else 0.0)


class Scale(NamedTuple):
    """Standardisation of columns by centre and spread; constant columns are dropped."""

    centre: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, features: FloatArray) -> Scale:
        centre = features.mean(axis=0)
        return cls(centre, features.std(axis=0))

    def __call__(self, features: FloatArray) -> FloatArray:
        used = self.spread > 1e-9 * np.maximum(np.abs(self.centre), 1e-9)
        return np.asarray((features[:, used] - self.centre[used]) / self.spread[used])


def _constant(value: float, features: FloatArray, /) -> FloatArray:
    """Return the same value for all features."""
    return np.full(len(features), value)


def _neighbours(
    scale: Scale, known: FloatArray, values: FloatArray, features: FloatArray, /
) -> FloatArray:
    """Return the means of the values of the nearest known features."""
    from scipy.spatial import KDTree

    k = min(NEIGHBOURS, len(values))
    _, near = KDTree(scale(known)).query(scale(features), k=range(1, k + 1))
    return np.asarray(values[near].mean(axis=1))


def _predicted(trees: list[Any], features: FloatArray, /) -> FloatArray:
    """Return the mean predictions of trees."""
    rows = features.astype(np.float32)
    total = np.zeros(len(rows))
    for tree in trees:
        total += tree.predict(rows)[:, 0]
    return np.asarray(total / len(trees))


def _forest(features: FloatArray, values: FloatArray, seed: int) -> ScaleModel:
    """Trees of `sklearn.ensemble.ExtraTreesRegressor`, whose own loop takes twice the time."""
    import sklearn
    from sklearn.tree import ExtraTreeRegressor

    state = np.random.RandomState(seed)
    rows, targets = features.astype(np.float32), np.ascontiguousarray(values)
    with sklearn.config_context(assume_finite=True, skip_parameter_validation=True):
        trees = [
            ExtraTreeRegressor(
                min_samples_leaf=MIN_LEAF, max_features=SHARE_OF_FEATURES,
                random_state=state.randint(np.iinfo(np.int32).max),
            ).fit(rows, targets, check_input=False)
            for _ in range(TREES)
        ]  # fmt: skip
    return partial(_predicted, [tree.tree_ for tree in trees])
