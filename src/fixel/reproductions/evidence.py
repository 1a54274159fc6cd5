"""Features of every push, known before it is made, and errors of its calibrated prediction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from fixel.datasets.raw.mit_push import PUSHER_RADIUS
from fixel.domain.features import (
    PLACE,
    Configurations,
    Features,
    configuration_features,
    neighbour_features,
    scaled,
    simulated_features,
)
from fixel.model import wrapped
from fixel.reproductions.fitting import FittedPushes
from fixel.reproductions.leftover import in_object
from fixel.reproductions.pushes import Key, PushGroup
from fixel.reproductions.splits import Split
from fixel.typing import BoolArray, FloatArray, IntArray

# Number of times at which simulated pushes are sampled.
SAMPLES: Final = 10
# Weight of the object's angle on the table in the distance of neighbours, relative to the place of
# contact (in units of the spread of places) and the direction of the push.
TABLE_TURN: Final = 0.5


class PushErrors(NamedTuple):
    """Features and errors of one group of pushes with one fit."""

    key: Key
    repeat: int
    split: Split
    features: Features  # features of all members
    errors: FloatArray  # (n, 3) of all members: position [m], angle [rad], both at 35 mm/rad [m]


def evidence_of(
    group: PushGroup, repeat: int, split: Split, found: FittedPushes, speed: FloatArray
) -> PushErrors:
    """Compute features of all members of a group, and errors of their predictions.

    Features of a push never use its measured end; those of neighbours use the ends of training
    pushes.
    """
    everyone = np.arange(len(group))
    given = found.values
    asked = _asked(group, given)
    track = group.tracks(SAMPLES)

    def roll(which: IntArray, changed: Mapping[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
        values = {name: np.full(len(which), x) for name, x in given.items()}
        return track(which, values | dict(changed))

    end = found.predict(group, everyone)
    good: BoolArray = np.asarray(np.isfinite(end).all(axis=1))
    residual = np.where(good[:, None], group.end - np.nan_to_num(end), 0.0)
    place = configuration_features(asked)
    simulated = simulated_features(asked, roll, given["mu_pusher"])
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
    return PushErrors(group.key, repeat, split, features, np.where(good[:, None], errors, np.inf))


def _asked(group: PushGroup, given: Mapping[str, float]) -> Configurations:
    shift = np.array([given.get(f"registration_{axis}", 0.0) for axis in "xy"])
    return Configurations(
        group.shape, PUSHER_RADIUS, group.start, group.tip_start + shift, group.tip_end + shift
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
