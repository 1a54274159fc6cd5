"""Stored experiments at steps along axes from the nominal ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from fixel.calibration.target import Target, target_of
from fixel.database.project import known_names
from fixel.database.store import Store
from fixel.domain.growth import AXES, NOMINAL, AxisPlace, ExperimentGroup
from fixel.errors import InvalidInput, counted, some_of
from fixel.model.selection import (
    Bound,
    ExperimentQuery,
    ExperimentRow,
    no_experiment_has,
    unknown_names,
)
from fixel.workflows.analysis import banner_of

OFFSETS: Final = {"x": "offset_x_m", "y": "offset_y_m", "theta": "offset_theta_rad"}


class _Seat(NamedTuple):
    """Shape, layout and place of an experiment."""

    shape: str
    layout: str
    place: AxisPlace

    @property
    def name(self) -> str:
        return f"{self.shape} {self.layout} {self.place.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class GrowthSamples:
    """Experiments of an exploration."""

    ids: list[int]
    targets: list[Target]
    groups: list[ExperimentGroup]  # their numbers count within `ids`
    # Length of a step [m or rad], for axes on which all groups agree.
    lengths: dict[str, float] = field(default_factory=dict)
    # Program that simulated each experiment; empty for real ones.
    makers: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def keys(self) -> list[str]:
        """Dataset and name of each experiment."""
        return [target.key for target in self.targets]

    @property
    def banner(self) -> str:
        """Banner over charts of the experiments; empty if all are real."""
        return banner_of([f"SIMULATED by {maker}" if maker else "" for maker in self.makers])


def read_samples(
    store: Store, shape: str | None = None, dataset: str | None = None
) -> GrowthSamples:
    """Load experiments of a plan with steps along axes, such as the thesis's: one per place.

    Of repetitions the first is used, as the thesis had one experiment per place: the mean of two
    would hide a set of parameters that fits neither. Raise `InvalidInput` for a group without its
    nominal one, or two datasets at one place.
    """
    conditions = () if shape is None else (Bound("shape", "=", shape),)
    query = ExperimentQuery(dataset=dataset, bounds=conditions)
    listing = store.experiments(query)
    for what, typed, known in () if listing.rows else unknown_names(query, known_names(store)):
        raise no_experiment_has(what.removeprefix("filter: "), typed, known)
    seated: dict[_Seat, list[ExperimentRow]] = {}
    for summary in listing.rows:
        seat = _seat_of(summary)
        if seat is not None:
            seated.setdefault(seat, []).append(summary)
    _refuse_none(seated, shape)
    for seat, found in seated.items():
        names = sorted({summary.dataset for summary in found})
        if len(names) > 1:
            several = f"{' and '.join(names)} at {seat.name}"
            hint = f"choose one: --dataset {names[0]}"
            raise InvalidInput("experiments", found=several, expected="one data set", hint=hint)
    warnings = []
    if listing.left_out:
        warnings.append(f"faults in the data: {counted(listing.left_out, 'experiment')} skipped.")
    if again := sum(len(found) - 1 for found in seated.values()):
        warnings.append(f"{counted(again, 'repetition')} skipped; the first at an offset counts.")
    first = {
        seat: min(found, key=lambda own: (float(own.conditions.get("repetition", 1.0)), own.id))
        for seat, found in seated.items()
    }
    return _read(store, first, warnings)


def _seat_of(summary: ExperimentRow) -> _Seat | None:
    """Return shape, layout and place of an experiment; None if it is on no axis."""
    own = summary.conditions
    axis, step = own.get("axis"), own.get("step", 0.0)
    if not all(isinstance(own.get(name), str) for name in ("shape", "layout", "axis")):
        return None
    if not isinstance(step, int | float) or not math.isclose(step, round(step), abs_tol=1e-9):
        return None
    if axis == NOMINAL.axis:
        return _Seat(str(own["shape"]), str(own["layout"]), NOMINAL)
    if axis not in AXES or round(step) == 0:
        return None
    return _Seat(str(own["shape"]), str(own["layout"]), AxisPlace(str(axis), round(step)))


def _refuse_none(seated: dict[_Seat, list[ExperimentRow]], shape: str | None) -> None:
    if not seated:
        raise InvalidInput(
            "experiments",
            found="none" + ("" if shape is None else f" of shape {shape}")
            + " with a shape, a layout and steps along x, y or theta among their conditions",
            expected="experiments of a plan like that of the thesis",
            hint="fixel list shows all experiments; perform a plan: fixel testbed run",
        )  # fmt: skip


def _read(store: Store, first: dict[_Seat, ExperimentRow], warnings: list[str]) -> GrowthSamples:
    ids: list[int] = []
    targets: list[Target] = []
    makers: list[str] = []
    at: dict[tuple[str, str], dict[AxisPlace, int]] = {}
    unusable: list[str] = []
    for seat, summary in sorted(first.items(), key=lambda entry: entry[1].id):
        experiment = store.experiment(summary.id)
        try:
            target = target_of(experiment)
        except InvalidInput:
            if seat.place == NOMINAL:
                raise
            unusable.append(summary.key)
            continue
        at.setdefault((seat.shape, seat.layout), {})[seat.place] = len(ids)
        ids.append(summary.id)
        targets.append(target)
        makers.append("" if experiment.real else experiment.simulated_by or "an unknown program")
    if unusable:
        skipped = f"skipped {counted(len(unusable), 'experiment')} that cannot be compared with a"
        warnings.append(f"{skipped} simulation: {some_of(unusable, 3)}.")
    return GrowthSamples(
        ids=ids,
        targets=targets,
        groups=[ExperimentGroup(shape=s, layout=layout, at=own) for (s, layout), own in at.items()],
        lengths=_lengths(first),
        makers=makers,
        warnings=warnings,
    )


def _lengths(first: dict[_Seat, ExperimentRow]) -> dict[str, float]:
    """Length of a step on each axis, if all experiments agree to a thousandth."""
    found: dict[str, list[float]] = {}
    for seat, summary in first.items():
        offset = summary.conditions.get(OFFSETS.get(seat.place.axis, ""))
        if isinstance(offset, int | float):
            found.setdefault(seat.place.axis, []).append(offset / seat.place.step)
    return {
        axis: own[0]
        for axis, own in found.items()
        if own[0] > 0.0 and all(math.isclose(x, own[0], rel_tol=1e-3) for x in own)
    }
