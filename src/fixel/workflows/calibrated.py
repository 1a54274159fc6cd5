"""A stored calibration as a model to simulate with."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import final

from fixel.calibration.objective import ANGLE_SCALE, ERRORS, AbstractError, MeanSquare
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model.records import CalibrationRecord
from fixel.simulation import AbstractMotionModel, Dynamic
from fixel.simulation.motion import MOTION_MODELS
from fixel.workflows.calibration.outcome import ALONE, GROWTH, NEIGHBOUR

_LABEL = re.compile(r"(?P<name>\w+)(?:\[(?P<where>.*)\])?")


@final
@dataclass(frozen=True)
class Calibrated:
    """Values of parameters with the method they were found by.

    Parameters
    ----------
    id : int
    record : CalibrationRecord
    """

    id: int
    record: CalibrationRecord

    @property
    def members(self) -> frozenset[int]:
        """Ids of the experiments it was found from."""
        return frozenset(member.experiment_id for member in self.record.members)

    @cached_property
    def motion(self) -> AbstractMotionModel:
        """As it was calibrated with."""
        name = self.record.method.get("motion")
        return next((model() for model in MOTION_MODELS if model.name == name), Dynamic())

    @cached_property
    def error(self) -> AbstractError:
        """As was minimised."""
        name = self.record.method.get("error")
        scale = float(self.record.method.get("error.angle_scale", ANGLE_SCALE))
        kind = next((kind for kind in ERRORS if kind.name == name), MeanSquare)
        return kind(angle_scale=scale)

    def values(self, conditions: Mapping[str, str | float]) -> dict[str, float]:
        """Parameters of an experiment under these conditions, by name [SI].

        Conditions have the experiment's key as `"experiment"`.
        """
        found = dict(self.record.parameters)
        for estimate in self.record.estimates:
            name, where = parted(estimate.label)
            if where and name not in found and _meets(conditions, where):
                found[name] = estimate.value
        return found


def newest(store: Store) -> int | None:
    """Id of the calibration that `calibrated` takes where none is named; none without any."""
    return calibrated(store).id if store.calibrations() else None


def parted(label: str) -> tuple[str, dict[str, str]]:
    """Name and conditions of an unknown's label: `"mu_pusher[surface=abs]"`."""
    match = _LABEL.fullmatch(label)
    if match is None:
        raise InvalidInput("label", found=repr(label), expected="NAME or NAME[CONDITION=VALUE]")
    pairs = (match["where"] or "").split(", ")
    where = dict(pair.split("=", 1) for pair in pairs if "=" in pair)
    return match["name"], where


def _meets(conditions: Mapping[str, str | float], where: Mapping[str, str]) -> bool:
    return all(str(conditions.get(name)) == value for name, value in where.items())


def calibrated(
    store: Store, number: int | None = None, experiment: int | None = None
) -> Calibrated:
    """A stored calibration.

    Parameters
    ----------
    store : Store
    number : int, optional
        Its id; where left out, the newest for several experiments, else the newest of all. Means
        that the growth of a domain made on its way count only by their id.
    experiment : int, optional
        Id of one that has to be among its members, where no number is given.
    """
    if number is not None:
        return Calibrated(number, store.calibration(number))
    newest: Calibrated | None = None
    for own in reversed(store.calibrations()):
        one = Calibrated(own, store.calibration(own))
        how = one.record.method.get("how")
        if how == GROWTH or (experiment is not None and experiment not in one.members):
            continue
        if len(one.members) > 1 and how not in (ALONE, NEIGHBOUR):
            return one
        newest = newest or one
    if newest is None:
        raise InvalidInput(
            "calibration",
            found="none stored" + ("" if experiment is None else " for this experiment"),
            expected="one at least",
            hint="calibrate first: fixel calibrate",
        )
    return newest
