"""Splits of pushes, and what calibrated predictions leave over: errors, features, and a model."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import Configurations, contacts_of
from fixel.datasets.mit_push_records import TIP
from fixel.domain.features import (
    Features,
    corner_distance,
    headings,
    scaled,
    simulated_features,
)
from fixel.errors import InvalidInput
from fixel.model import rotated, wrapped
from fixel.model.overlap import gaps_and_normals
from fixel.typing import BoolArray, FloatArray, IntArray
from reproductions.fitting import FittedPushes
from reproductions.pushes import PushGroup
from reproductions.residual_process import NINETY, ResidualProcess

# Number of times at which simulated pushes are sampled.
SAMPLES: Final = 10
# Weight of the object's angle on the table in the distance of neighbours, relative to the place of
# contact (in units of the spread of places) and the direction of the push.
TABLE_TURN: Final = 0.5
PLACE: Final = ("tip_x", "tip_y", "along_x", "along_y", "object_cos", "object_sin")
NOTHING: Final[Mapping[str, float]] = MappingProxyType({})


def configuration_features(asked: Configurations) -> Features:
    """Return features from geometry alone: position and direction of the pusher in the frame of the
    object, pose of the object on the table, angle to the normal, lever arm, nearest corner."""
    angle = asked.start[:, 2]
    heading = headings(asked)
    tip = rotated(asked.tip_start - asked.start[:, :2], -angle)
    along = rotated(heading, -angle)
    _, normal = gaps_and_normals(asked.shape, asked.radius, asked.start, asked.tip_start)
    cosine = np.clip(-(normal * heading).sum(axis=1), -1.0, 1.0)
    sine = normal[:, 0] * heading[:, 1] - normal[:, 1] * heading[:, 0]
    centre = np.asarray(asked.shape.centroid)
    arm = (tip[:, 0] - centre[0]) * along[:, 1] - (tip[:, 1] - centre[1]) * along[:, 0]
    names = (*PLACE, "table_x", "table_y", "incidence", "incidence_abs", "arm", "arm_abs", "corner")
    incidence = np.arctan2(sine, cosine)
    table = np.column_stack(
        (tip, along, np.cos(angle), np.sin(angle), asked.start[:, :2], incidence,
         np.abs(incidence), arm, np.abs(arm), corner_distance(asked.shape, tip, asked.radius))
    )  # fmt: skip
    return Features(names, table)


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
    features, places = _features(group, physics, speed), _places(group, speed)
    good: BoolArray = np.asarray(np.isfinite(physics).all(axis=1))
    train = split.train[good[split.train]]
    residual = in_object(group, train, group.end[train] - physics[train])
    process = ResidualProcess(features[train], residual, places[train])
    held = split.held_out
    more, sd = process.predict(np.nan_to_num(features[held]), places[held])
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


def _places(group: PushGroup, speed: FloatArray) -> FloatArray:
    """First contacts (n, 6) in the object's frame: point in radii of the object, direction of the
    normal, direction of the push.

    Without the normal, pushes around a corner would be near pushes of another side.
    """
    asked = configurations_of(group)
    contact = contacts_of(asked, speed)
    along = configuration_features(asked).columns(("along_x", "along_y"))
    return np.column_stack((contact.place, np.cos(contact.normal), np.sin(contact.normal), along))


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
    configurations = configurations_of(group, given)
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
    features = _joined(place, simulated)
    more = np.column_stack((speed, np.linalg.norm(nominal, axis=1)))
    features = _joined(features, Features(("speed", "model_change"), more))
    near = _near(group, split, place, in_object(group, everyone, scaled(residual)))
    features = _joined(features, near)
    off = scaled(residual)
    position, both = np.hypot(off[:, 0], off[:, 1]), np.linalg.norm(off, axis=1)
    errors = np.column_stack((position, np.abs(wrapped(residual[:, 2])), both))
    return PushErrors(features, np.where(good[:, None], errors, np.inf))


def configurations_of(group: PushGroup, given: Mapping[str, float] = NOTHING) -> Configurations:
    """Return the intended pushes of a group, with tips at the fitted registration if given."""
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
    return _joined(found, Features(("group_error",), np.full((len(group), 1), common)))


def _joined(first: Features, second: Features) -> Features:
    """Features with the columns of both."""
    table = np.column_stack((first.table, second.table))
    return Features((*first.names, *second.names), table)


def neighbour_features(
    place: FloatArray,
    known_place: FloatArray,
    known_residual: FloatArray,
    groups: int = 8,
    itself: IntArray | None = None,
) -> Features:
    """Return features from the nearest configurations with known outcomes: their distances, the
    errors of the simulator there, and the part of these errors in a common direction.

    Parameters
    ----------
    place : (n, f) float64
        Coordinates of configurations; all columns have the same weight.
    known_place : (m, f) float64
    known_residual : (m, 3) float64
        Measured minus simulated, along the axes of the object [m, m, m at 35 mm/rad].
    groups : int
        Maximum number of neighbours.
    itself : (n,) int, optional
        Row of the known ones that is the configuration itself, which is skipped; -1 for none.
    """
    if len(known_place) < 2 or len(known_place) != len(known_residual):
        raise InvalidInput(
            "neighbours",
            found=f"{len(known_place)} places and {len(known_residual)} residuals",
            expected="equal numbers of both, at least two",
        )
    away = np.linalg.norm(place[:, None] - known_place[None], axis=2)
    if itself is not None:
        own = np.flatnonzero(itself >= 0)
        away[own, itself[own]] = np.inf
    k = min(groups, len(known_place) - 1)
    near = np.argsort(away, axis=1, kind="stable")[:, :k]
    distance = np.take_along_axis(away, near, axis=1)
    residual = known_residual[near]
    size = np.linalg.norm(residual, axis=2)
    weight = 1.0 / (distance + 0.5 * np.median(distance, axis=1, keepdims=True) + 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    mean = (weight[:, :, None] * residual).sum(axis=1)
    table = np.column_stack(
        (distance[:, 0], distance.mean(axis=1), (weight * size).sum(axis=1), size.max(axis=1),
         np.median(size, axis=1), size[:, 0], np.linalg.norm(mean, axis=1))
    )  # fmt: skip
    names = ("nearest", "near", "near_error", "near_worst", "near_median", "nearest_error")
    return Features((*names, "near_common"), table)
