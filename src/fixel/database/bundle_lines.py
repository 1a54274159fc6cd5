"""Schemas of the JSON lines of a bundle, validated before any record is created.

Names are those of the tables' columns. Records refer to each other by their places in the files,
counted from 0, not by ids, which mean other records in another project.
"""

from __future__ import annotations

from typing import Annotated, Any, cast

import sqlalchemy as sa
from pydantic import BaseModel, ConfigDict, Field

from fixel.database import rows
from fixel.database.rows import Measured
from fixel.model import Experiment, Flag, Parameters
from fixel.model.records import (
    CalibrationRecord,
    FilterParameters,
    FilterRun,
    Member,
    SimulationRecord,
)

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Place = Annotated[int, Field(ge=0)]
# Integers stay integers: the checksum of an experiment distinguishes 5 from 5.0.
Plain = dict[str, str | bool | int | float]


class Line(BaseModel):
    """Base of all lines; rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SeriesLine(Line):
    """Reference to a numeric table, the member ``series/SHA256.npy``."""

    name: str = Field(max_length=100)
    columns: list[str]
    sha256: Sha256


class FlagLine(Line):
    """Flag of an experiment, current or removed."""

    name: str = Field(max_length=100)
    detail: str
    is_fault: bool
    is_of_import: bool  # it came with the experiment and is part of its checksum
    created_at_utc: str = Field(max_length=40)
    deleted_at_utc: str | None = Field(max_length=40)

    @property
    def flag(self) -> Flag:
        """Flag without its history."""
        return Flag(self.name, self.detail, self.is_fault)


class NoteLine(Line):
    """Note that a user attached to an experiment."""

    text: str = Field(min_length=1, max_length=10_000)
    created_at_utc: str = Field(max_length=40)


class SourceEntry(Line):
    """Provenance of a record."""

    created_at_utc: str = Field(max_length=40)
    fixel_version: str = Field(max_length=40)
    command: str
    source_file: str
    source_sha256: str = Field(max_length=64)
    seed: int | None = Field(ge=-(2**63), lt=2**63)  # range of the database column


class ExperimentLine(SourceEntry):
    """Experiment without its series."""

    dataset: str = Field(max_length=200)
    name: str = Field(max_length=400)
    is_real: bool
    simulated_by: str
    object_name: str = Field(max_length=200)
    scene: dict[str, Any] | None
    object_height_m: float | None
    pusher_height_m: float | None
    fixel_height_m: float | None
    effective_start_s: float | None
    effective_end_s: float | None
    contact_mode: str = Field(max_length=40)
    conditions: Plain
    video_sha256: Sha256 | None
    flags: list[FlagLine]
    series: list[SeriesLine]
    notes: list[NoteLine] = []  # omitted if empty, since older versions of fixel have no notes

    def record(self, measured: list[Measured]) -> Experiment:
        """Experiment as first stored, with the flags of its import only."""
        # The line has the same names as the row, so the reader of rows can read it.
        row = self.model_copy(update={"video_sha256": self.video_sha256 or ""})
        flags = tuple(line.flag for line in self.flags if line.is_of_import)
        return rows.experiment_of(cast("sa.Row[Any]", row), flags, measured)


class ParametersLine(Line):
    """Values of a set of parameters, by name."""

    values: dict[str, float]


class SimulationLine(SourceEntry):
    """Simulation without its series."""

    experiment: Place
    parameters: Place
    method: Plain
    status: str = Field(max_length=40)
    contact_mode: str = Field(max_length=40)
    error_mm2: float | None
    series: list[SeriesLine]

    def record(
        self, experiment_id: int, parameters: Parameters, measured: list[Measured]
    ) -> SimulationRecord:
        """Record of the simulation, for an experiment id of this project."""
        paths = {name: rows.trajectory_of(values) for name, _, values in measured}
        return SimulationRecord(
            experiment_id=experiment_id,
            parameters=parameters,
            provenance=rows.provenance_of(cast("sa.Row[Any]", self)),
            trajectory=paths["object"],
            pusher=paths.get("pusher"),
            method=self.method,
            status=self.status,
            contact_mode=self.contact_mode,
            error_mm2=self.error_mm2,
        )


class MemberLine(Line):
    """Member of a calibration: an experiment, its weight and its error."""

    experiment: Place
    weight: float
    error_mm2: float


class EstimateLine(Line):
    """Estimate of one parameter by a calibration."""

    label: str
    unit: str
    value: float
    low: float | None
    high: float | None
    verdict: str
    reason: str


class CalibrationLine(SourceEntry):
    """Calibration without its series."""

    name: str = Field(max_length=400)
    parameters: Place
    method: Plain
    members: list[MemberLine]
    reasons: list[str]
    estimates: list[EstimateLine] | None = None
    series: list[SeriesLine]

    def record(
        self, ids: list[int], parameters: Parameters, measured: list[Measured]
    ) -> CalibrationRecord:
        """Record of the calibration, for experiment ids of this project."""
        return CalibrationRecord(
            name=self.name,
            parameters=parameters,
            members=tuple(Member(ids[m.experiment], m.weight, m.error_mm2) for m in self.members),
            provenance=rows.provenance_of(cast("sa.Row[Any]", self)),
            method=self.method,
            evaluations=rows.evaluations_of(measured, self.reasons),
            estimates=rows.estimates_of([line.model_dump() for line in self.estimates or ()]),
        )


class FilterParametersLine(SourceEntry):
    """Settings of a filter, with their provenance."""

    name: str = Field(max_length=400)
    is_particle_filter: bool
    options: Plain

    def record(self) -> FilterParameters:
        """Record of the settings."""
        return FilterParameters(
            name=self.name,
            is_particle_filter=self.is_particle_filter,
            provenance=rows.provenance_of(cast("sa.Row[Any]", self)),
            values=cast("dict[str, float]", self.options),
        )


class FilterRunLine(SourceEntry):
    """Run of a filter on an experiment, without its series."""

    experiment: Place
    filter_parameters: Place
    uses_tactile: bool
    occlusion: tuple[float, float] | None
    contact_mode: str = Field(max_length=40)
    series: list[SeriesLine]

    def record(
        self, experiment_id: int, filter_parameters_id: int, measured: list[Measured]
    ) -> FilterRun:
        """Record of the filter run, for ids of this project."""
        found = {name: (columns, values) for name, columns, values in measured}
        estimates = found.get("estimates")
        more = {} if estimates is None else {"estimates": estimates[1]}
        return FilterRun(
            experiment_id=experiment_id,
            filter_parameters_id=filter_parameters_id,
            provenance=rows.provenance_of(cast("sa.Row[Any]", self)),
            trajectory=rows.trajectory_of(found["object"][1]),
            uses_tactile=self.uses_tactile,
            occlusion=self.occlusion,
            contact_mode=self.contact_mode,
            estimate_names=() if estimates is None else estimates[0],
            **more,
        )


class MemberCheck(Line):
    """Size and checksum of a zip member."""

    bytes: Place
    sha256: Sha256


class Manifest(Line):
    """Format and version of a bundle, and the members it must contain."""

    format: str
    version: int
    fixel_version: str
    counts: dict[str, Place]
    members: dict[str, MemberCheck]
